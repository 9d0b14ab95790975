"""A teacher that sees the true state learns first; the policy then learns from it, too.

The state is a few numbers instead of thousands of pixels, so the teacher makes four times as many
decisions in the same time, and races faster than a camera driver does after as many. After its
share of the budget the policy explores on its own and is drawn towards the teacher's actions.
Chen et al., "Learning by Cheating" (2019), have the idea, Schmitt et al., "Kickstarting Deep
Reinforcement Learning" (2018), the loss: the divergence of the policy from its teacher, with a
weight that falls to 0. The divergence is measured by the policy's exploration, which falls faster,
so the cost of a difference of actions grows until three quarters of the way, and is 0 at its end.
rsl-rl's distillation has no reward of the student's own.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor

from league.agents.network import NetworkConfig
from league.envs.actions import ContinuousActions
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.sim.config import SensorConfig
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.monitor.history import TEACHING, UpdateRow
from league.training.ppo import distributed, make_env, symmetry
from league.training.ppo.learner import Learner

NOISE_SHARE = 0.375  # Share of the first noise for a taught policy: it need not find the way alone.


def teacher_config(cfg: TrainConfig) -> TrainConfig:
    """Return the settings of a policy's teacher, which has no sensors."""
    return replace(
        cfg,
        sensors=SensorConfig(),
        network=NetworkConfig(hidden=(256, 128), activation="elu", normalise=True),
        symmetry=False,
        teacher=0.0,
    )


class Teacher(Learner):
    """PPO learner with the privileged state, else seen by the critic alone, as observation."""

    groups: tuple[str, ...] = ("state", "motion")  # Its observation groups, and its critic's.

    def targets(self, observations: TensorDict) -> Tensor:
        """Return its actions, or log probabilities of choices, without gradients."""
        with torch.no_grad():
            actions = self._alg.get_policy()(observations)
        if isinstance(self.cfg.action_space, ContinuousActions):
            return actions.clamp(-1.0, 1.0)
        return torch.log_softmax(actions, dim=-1)

    def _settings(self) -> dict[str, Any]:
        groups = {"actor": list(self.groups), "critic": list(self.groups)}
        return super()._settings() | {"obs_groups": groups}


def make_taught(tracks: TrackSet, cfg: TrainConfig, **settings: Any) -> TaughtLearner:  # noqa: ANN401
    """Build a learner, its teacher and the worlds of both; settings are those of make_env.make."""
    env = make_env.make(tracks, cfg, **settings)
    own = teacher_config(cfg)
    return TaughtLearner(env, cfg, Teacher(make_env.make(tracks, own, **settings), own))


class TaughtLearner(Learner):
    """A learner that lets its teacher learn first, and then learns from it, too."""

    def __init__(self, env: RacingVecEnv, cfg: TrainConfig, teacher: Teacher) -> None:
        """Build networks and storage; the teacher drives in worlds of its own."""
        self.teacher = teacher
        first, last = cfg.ppo.noise
        super().__init__(env, cfg.with_ppo(noise=(max(NOISE_SHARE * first, last), last)))
        self._lesson = _Lesson(self._symmetry, teacher, cfg)
        self._alg.symmetry = self._lesson  # type: ignore

    @property
    def has_learnt(self) -> bool:
        """Whether the teacher's time is over."""
        return self.updates > self.teacher.updates

    @property
    def at_save_point(self) -> bool:
        """Whether a run resumed from here ends in the same weights; see Learner."""
        return super().at_save_point if self.has_learnt else self.teacher.at_save_point

    @property
    def shown(self) -> tuple[RacingVecEnv, ...]:
        """The worlds of both."""
        return (self.env, self.teacher.env)

    def update(self, share: float) -> UpdateRow:
        """Update the teacher, or the policy; see Learner."""
        share, until = distributed.agreed(share), self.cfg.teacher
        if share < until and not self.has_learnt:
            try:
                update = self.teacher.update(share / until)
            finally:  # Ctrl-C may come after it has counted
                self.updates, self.samples = self.teacher.updates, self.teacher.samples
            return replace(update, log=update.log | {TEACHING: 1.0})
        if not self.has_learnt:
            self.teacher.load_weights(self.teacher.weights())  # their average teaches
            self.restart_rows()  # as after a resume from here
        done = max(share - until, 0.0) / (1.0 - until)
        self._lesson.weight = max(0.0, 1.0 - done)
        update = self._learn(done)
        losses = {"advice" if name == "symmetry" else name: v for name, v in update.losses.items()}
        return replace(update, losses=losses)

    def restart_rows(self) -> None:
        """Restart all episodes of the one that learns."""
        if not self.has_learnt:
            self.teacher.restart_rows()
        super().restart_rows()

    def _state(self) -> dict[str, Any]:
        return super()._state() | {"teacher": self.teacher._state()}

    def _load_state(self, state: dict[str, Any]) -> None:
        super()._load_state(state)
        # "tutor" in files of older versions.
        self.teacher._load_state(state["teacher" if "teacher" in state else "tutor"])


class _Lesson:
    """Replaces rsl-rl's symmetry extension: mirror images as before, and the teacher's loss."""

    use_mirror_loss = True
    mirror_loss_coeff = 1.0  # the weight is in the loss

    def __init__(
        self, mirror: symmetry.Symmetry | None, teacher: Teacher, cfg: TrainConfig
    ) -> None:
        self._mirror, self._teacher, self._cfg = mirror, teacher, cfg
        self.weight = 1.0

    def augment_batch(self, batch: RolloutStorage.Batch, original_batch_size: int) -> None:
        """Mirror a mini-batch in place, if it is its turn."""
        if self._mirror is not None:
            self._mirror.augment_batch(batch, original_batch_size)

    def compute_loss(
        self, actor: MLPModel, batch: RolloutStorage.Batch, original_batch_size: int
    ) -> Tensor:
        """Return the weighted divergence of the policy from its teacher."""
        if not self.weight:
            return torch.zeros((), device=self._cfg.device)
        params = actor.output_distribution_params
        # With the policy's own deviation: the teacher's action is the target of the mean.
        spread = (param.detach() for param in params[1:])
        target = (self.targets(batch.observations), *spread)  # type: ignore
        return self.weight * actor.get_kl_divergence(target, params).mean()

    def targets(self, observations: TensorDict) -> Tensor:
        """Return the teacher's actions; as it never sees mirrored tracks, they are turned back."""
        observations = observations.select(*self._teacher.groups)
        if self._mirror is None or not self._mirror.turned:
            return self._teacher.targets(observations)
        turned = symmetry.observations(observations, self._cfg.sensors)
        return self._cfg.action_space.mirror(self._teacher.targets(turned))
