"""A tutor: a driver that is told the truth learns first, and the policy then learns from it, too.

The truth is a few numbers instead of thousands of pixels, so the tutor makes four times as many
decisions in the same time, and races faster than a camera driver does after as many. It is never
raced; after its share of the budget it stands beside the policy, which explores on its own and is
drawn towards what the tutor would have done there. Chen et al., "Learning by Cheating" (2019), have
the idea, Schmitt et al., "Kickstarting Deep Reinforcement Learning" (2018), the loss: the
divergence of the policy from its teacher, with a weight that falls to nothing. Exploration, by
which divergence is measured, falls faster: what a difference of actions costs grows until three
quarters of the way, and is nothing only at its end.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import torch
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict
from torch import Tensor

from league.agents.network import NetworkConfig
from league.envs.actions import ContinuousActions
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.driver import Driver
from league.envs.rewards import Reward
from league.sim.config import SensorConfig
from league.track.track import TrackSet
from league.training.monitor.history import TUTORING
from league.training.ppo import distributed, make_env
from league.training.ppo import symmetry as mirror
from league.training.ppo.episode_stats import Episodes
from league.training.ppo.learner import Learner, Update
from league.training.settings import TrainConfig

TOLD = ("state", "motion")
"""Observation groups of a tutor, and of its critic."""
CALM = 0.375
"""Share of its tutor's first noise with which the policy begins: it need not find the way alone."""


def truth(cfg: TrainConfig) -> TrainConfig:
    """Return the settings of a tutor: those of its pupil, without senses."""
    return replace(
        cfg,
        sensors=SensorConfig(),
        network=NetworkConfig(hidden=(256, 128), activation="elu", normalise=True),
        mirror=False,
        tutor=0.0,
    )


class Tutor(Learner):
    """A learner whose actor is told what only critics are told else."""

    def advice(self, told: TensorDict) -> Tensor:
        """Return what it would ask for: actions, or log probabilities of choices; no gradients."""
        with torch.no_grad():
            asked = self._alg.get_policy()(told)
        if isinstance(self.cfg.action_space, ContinuousActions):
            return asked.clamp(-1.0, 1.0)
        return torch.log_softmax(asked, dim=-1)

    def _settings(self) -> dict:
        return super()._settings() | {
            "obs_groups": {who: list(TOLD) for who in ("actor", "critic")}
        }


def tutored(
    tracks: TrackSet,
    cfg: TrainConfig,
    *,
    opponents: Mapping[int, Driver | str] | None = None,
    reward: Reward | None = None,
) -> TutoredLearner:
    """Build the worlds of both, tutor and pupil; arguments are those of make_env.make."""
    seen, told = (
        make_env.make(tracks, one, opponents=opponents, reward=reward) for one in (cfg, truth(cfg))
    )
    return TutoredLearner(seen, cfg, Tutor(told, truth(cfg)))


class TutoredLearner(Learner):
    """A learner that lets its tutor learn first, and then learns with its advice."""

    def __init__(self, env: RacingVecEnv, cfg: TrainConfig, tutor: Tutor) -> None:
        """Build networks and storage.

        Args:
            env: the worlds, with pictures as bytes.
            cfg: settings of the run, with the tutor's share of the budget.
            tutor: the tutor, in worlds of its own.
        """
        self._tutor = tutor
        first, last = cfg.ppo.noise
        super().__init__(env, cfg.with_ppo(noise=(max(CALM * first, last), last)))
        self._advice = _Advice(self._mirroring, tutor, cfg)
        self._alg.symmetry = self._advice  # type: ignore

    @property
    def has_learnt(self) -> bool:
        """Whether the tutor's time is over."""
        return self.updates > self._tutor.updates

    @property
    def episodes(self) -> Episodes:
        """What has become of the episodes of whoever learns."""
        return super().episodes if self.has_learnt else self._tutor.episodes

    @property
    def shown(self) -> tuple[RacingVecEnv, ...]:
        """The worlds of both."""
        return (self.env, self._tutor.env)

    def update(self, share: float) -> Update:
        """Have the tutor learn, or learn from it; see Learner."""
        share, lesson = distributed.agreed(share), self.cfg.tutor
        if share < lesson and not self.has_learnt:
            try:
                found = self._tutor.update(share / lesson)
            finally:  # Ctrl-C may come after it has counted
                self.updates, self.samples = self._tutor.updates, self._tutor.samples
            return replace(found, log=found.log | {TUTORING: 1.0})
        if not self.has_learnt:
            super().start_rows_anew()  # as after a resume from here
        done = max(share - lesson, 0.0) / (1.0 - lesson)
        self._advice.weight = max(0.0, 1.0 - done)
        found = super().update(done)
        losses = {"advice" if name == "symmetry" else name: v for name, v in found.losses.items()}
        return replace(found, losses=losses)

    def start_rows_anew(self) -> None:
        """Begin all episodes of whoever learns anew."""
        if not self.has_learnt:
            self._tutor.start_rows_anew()
        super().start_rows_anew()

    def _learnt(self) -> dict:
        return super()._learnt() | {"tutor": self._tutor._learnt()}

    def _go_on_from(self, kept: dict) -> None:
        super()._go_on_from(kept)
        self._tutor._go_on_from(kept["tutor"])


class _Advice:
    """Takes the place of rsl-rl's symmetry extension: mirror images as before, and another loss."""

    use_mirror_loss = True
    mirror_loss_coeff = 1.0  # the weight is in the loss

    def __init__(self, mirroring: mirror.Mirroring | None, tutor: Tutor, cfg: TrainConfig) -> None:
        self._mirroring, self._tutor, self._cfg = mirroring, tutor, cfg
        self.weight = 1.0

    def augment_batch(self, batch: RolloutStorage.Batch, original_batch_size: int) -> None:
        """Mirror a mini-batch in place, if it is its turn."""
        if self._mirroring is not None:
            self._mirroring.augment_batch(batch, original_batch_size)

    def compute_loss(
        self, actor: MLPModel, batch: RolloutStorage.Batch, original_batch_size: int
    ) -> Tensor:
        """Return the weighted divergence of the policy from its tutor."""
        if not self.weight:
            return torch.zeros((), device=self._cfg.device)
        now = actor.output_distribution_params
        # Its own deviation: the tutor's advice is where the middle is to be.
        advised = (self._wanted(batch.observations), *(one.detach() for one in now[1:]))  # type: ignore
        return self.weight * actor.get_kl_divergence(advised, now).mean()

    def _wanted(self, told: TensorDict) -> Tensor:
        """Return the tutor's advice; it has never seen the mirrored track, so it is turned back."""
        told = told.select(*TOLD)
        if self._mirroring is None or not self._mirroring.turned:
            return self._tutor.advice(told)
        advice = self._tutor.advice(mirror.observations(told, self._cfg.sensors))
        return self._cfg.action_space.mirror(advice)
