"""The learner: rsl-rl's PPO on our worlds, one update at a time, with schedules and save points."""

import contextlib
import io
import pickle
import time
from collections.abc import Generator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution

from league.agents import network
from league.atomic_file import replacing
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.errors import ConfigError, PolicyError, brief
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.monitor.history import UpdateRow
from league.training.ppo import distributed, make_env, symmetry
from league.training.ppo.models import (
    CONTRAST,
    FIRST,
    PictureStorage,
    actor_settings,
    with_contrast,
)
from league.training.ppo.statistics import EpisodeStatistics, Moments, RewardNormalization

STATE_FORMAT = 1
_NO_STATE = (
    *(OSError, AttributeError, KeyError, TypeError, ValueError, RuntimeError, EOFError),
    pickle.UnpicklingError,
)
AVERAGED = 50  # Most updates that an average goes back; in the first 500 a tenth of all updates.


class Learner:
    """PPO with its worlds; each rank of torchrun has a learner with worlds of its own.

    They update together, with equal weights; rewards and episodes are those of the rank's worlds.
    """

    def __init__(self, env: RacingVecEnv, cfg: TrainConfig) -> None:
        """Build networks and storage; `env` has pictures as bytes, `cfg` this rank's device."""
        self.env, self.cfg = env, cfg
        distributed.join(cfg.device)
        if self._on_gpu:
            # Else convolutions are neither reproducible nor as precise as in evaluations.
            torch.backends.cudnn.deterministic, torch.backends.cudnn.allow_tf32 = True, False
        # rsl-rl draws weights and exploration from torch's global generator.
        torch.manual_seed(cfg.seed)
        self._obs = env.get_observations()
        with contextlib.redirect_stdout(io.StringIO()):  # it prints its networks
            self._alg = PPO.construct_algorithm(self._obs, env, self._settings(), cfg.device)
        if cfg.sensors.camera is not None:
            self._alg.storage.__class__ = PictureStorage  # its memory is allocated already
        self._symmetry = None
        if cfg.symmetry and symmetry.applies(cfg.sensors, cfg.action_space):
            self._symmetry = symmetry.Symmetry(cfg.sensors, cfg.action_space, cfg.ppo.mini_batches)
            self._alg.symmetry = self._symmetry  # type: ignore
        self._episodes = EpisodeStatistics(env.num_envs)
        self._normalization = RewardNormalization(env.num_envs, cfg.ppo.gamma, cfg.device)
        self.updates = self.samples = 0
        if distributed.count() > 1:
            self._alg.broadcast_parameters()
            self.restart_rows()
        self._begin_average()

    @property
    def shown(self) -> tuple[RacingVecEnv, ...]:
        """All worlds that a viewer shows."""
        return (self.env,)

    @property
    def has_learnt(self) -> bool:
        """Whether the policy has been updated, and is worth an evaluation."""
        return self.updates > 0

    def weights(self) -> dict[str, np.ndarray]:
        """Return the actor's weights, averaged over the last updates, as copies.

        The average drives better than any of those policies (docs/training.md).
        """
        return with_contrast(network.from_learner(self._average), CONTRAST)

    def load_weights(self, weights: Mapping[str, np.ndarray]) -> None:
        """Take the actor's weights from a policy; PolicyError if its layers differ."""
        shapes = {name: value.shape for name, value in self.weights().items()}
        if shapes != {name: value.shape for name, value in weights.items()}:
            raise PolicyError(
                "the policy to start from has other layers, sensors or actions than this run: "
                "give the run the same, or start a new run"
            )
        weights = with_contrast(weights, 1.0 / CONTRAST)
        new = {name: torch.from_numpy(value) for name, value in weights.items()}
        self._alg.get_policy().load_state_dict(new, strict=False)  # what a policy lacks stays
        self._begin_average()

    def update(self, share: float) -> UpdateRow:
        """Collect one round of steps and learn from it; LeagueError if a reward or a rank fails.

        The first rank's `share` of the budget that is used up, 0 to 1, sets the schedules.
        """
        return self._learn(distributed.agreed(share))

    def _learn(self, share: float) -> UpdateRow:
        """Collect and learn at a share of this learner's stage."""
        self._schedule(share)
        self._alg.train_mode()
        started = time.perf_counter()
        with distributed.failing_together():
            reward, log = self._collect()
        collected = time.perf_counter()
        self._normalization.synchronize()
        with torch.inference_mode():
            self._alg.compute_returns(self._obs)
        if self._symmetry is not None:
            self._symmetry.restart()
        with distributed.exchange():
            losses = self._alg.update()
        self.updates += 1
        self.samples += distributed.count() * self.env.num_envs * self.cfg.ppo.rollout
        self._averaged += 1
        newest = 1.0 / min(max(self._averaged / 10.0, 1.0), AVERAGED)
        for name, value in self._learnt().items():
            self._average[name].lerp_(value, newest)
        log = self._adapted(log, share)
        if self.at_save_point:
            self.restart_rows()
        completion = self._episodes.completion
        return UpdateRow(
            number=self.updates,
            samples=self.samples,
            time_s=0.0,  # the run knows it
            collect_s=round(collected - started, 4),
            learn_s=round(time.perf_counter() - collected, 4),
            reward=reward,
            earned=self._episodes.earned,
            completion=None if completion is None else 100.0 * completion,
            losses=losses,
            log=log,
            learning_rate=self._alg.learning_rate,
            mean_std=float(self._alg.get_policy().output_std.detach().mean()),
            episode_steps=self._episodes.steps,
        )

    def _adapted(self, log: dict[str, float], share: float) -> dict[str, float]:
        """Return the log of an update; what follows success changes here, before rows restart."""
        return log

    @property
    def at_save_point(self) -> bool:
        """Whether a run resumed from here ends in the same weights as an uninterrupted one."""
        return self.updates % self.cfg.save_every == 0

    def save(self, path: Path, notes: dict[str, object]) -> None:
        """Write all that a resume needs: networks, optimiser, generators, counts, notes.

        Of several ranks the first one writes. PolicyError if it cannot; the old state stays then.
        """
        if not distributed.is_first():
            return
        fixed = {"format": STATE_FORMAT, "generator": torch.get_rng_state(), "notes": notes}
        state = self._state() | fixed
        if self._on_gpu:
            state["card_generator"] = torch.cuda.get_rng_state(self.cfg.device)
        with replacing(path, "the learner's state", PolicyError, also=(RuntimeError,)) as file:
            # In memory first: torch.save does not report a full disk in a readable way.
            buffer = io.BytesIO()
            torch.save(state, buffer)
            file.write_bytes(buffer.getbuffer())

    def restore(self, path: Path) -> dict[str, Any]:
        """Load a saved state, of which only weights are unpickled; return its notes."""
        try:
            # Adam's counts stay on the CPU: on a GPU they would be read back in each step.
            state = torch.load(path, weights_only=True, map_location="cpu")
            if state["format"] != STATE_FORMAT:
                raise KeyError(state["format"])
            self._load_state(state)
            torch.set_rng_state(state["generator"])
            if self._on_gpu and "card_generator" in state:  # missing in early files
                torch.cuda.set_rng_state(state["card_generator"], self.cfg.device)
            notes = dict(state["notes"])
        except _NO_STATE as error:
            raise PolicyError(
                f"{path} cannot be resumed ({type(error).__name__}): give the run the "
                "settings it was started with, or start a new run with another --out"
            ) from None
        self.restart_rows()
        return notes

    def restart_rows(self) -> None:
        """Restart all episodes, from a seed that is a function of updates and rank."""
        seed = distributed.seed(self.cfg.seed * 1_000_003 + self.updates)
        if distributed.count() > 1:  # so that no generator of another rank has to be saved
            torch.manual_seed(seed)
        with torch.inference_mode():
            self._obs = self.env.reset(seed, self._next_tracks())
        self._episodes.restart()
        self._normalization.restart()

    def _state(self) -> dict[str, Any]:
        counts = {"updates": self.updates, "samples": self.samples}
        average = {"average": self._average, "averaged": self._averaged}
        scales = {"scale": asdict(self._normalization.seen), "contrast": CONTRAST}
        return self._alg.save() | counts | average | scales

    def _load_state(self, state: dict[str, Any]) -> None:
        self._alg.load(state, None, True)
        self.updates, self.samples = int(state["updates"]), int(state["samples"])
        self._normalization.restore(Moments(**state["scale"]))
        self._begin_average()
        for name, value in state.get("average", {}).items():  # missing in older files
            self._average[name].copy_(value)
        self._averaged = int(state.get("averaged", 0))
        self._rescale(state.get("contrast", 1.0) / CONTRAST)  # missing in older files

    def _rescale(self, by: float) -> None:
        """Scale the weights for pictures, and Adam's moments of them, of another contrast."""
        weight = dict(self._alg.get_policy().named_parameters()).get(FIRST)
        if weight is None or by == 1.0:
            return
        moments = self._alg.optimizer.state[weight]  # empty while a teacher learns
        with torch.no_grad():
            for value in (weight, self._average[FIRST]):
                value.mul_(by)
            for name, power in ("exp_avg", 1), ("exp_avg_sq", 2):
                if name in moments:
                    moments[name].div_(by**power)

    def _learnt(self) -> dict[str, torch.Tensor]:
        """Return the actor's floating-point state, which goes on changing."""
        state = self._alg.get_policy().state_dict()
        return {name: value for name, value in state.items() if value.is_floating_point()}

    def _begin_average(self) -> None:
        """Begin with the weights of now."""
        self._average = {name: value.clone() for name, value in self._learnt().items()}
        self._averaged = 0

    @property
    def _on_gpu(self) -> bool:
        return torch.device(self.cfg.device).type == "cuda"

    def _next_tracks(self) -> np.ndarray:
        """Return the next tracks of the worlds, where there are more tracks than worlds."""
        worlds, times = self.cfg.num_worlds, self.updates // self.cfg.save_every
        first = worlds * (times * distributed.count() + distributed.number())
        return np.arange(first, first + worlds) % len(self.env.race_env.tracks.tracks)

    def _collect(self) -> tuple[float, dict[str, float]]:
        reward, sums, steps = 0.0, {}, self.cfg.ppo.rollout
        with torch.inference_mode():
            for _ in range(steps):
                self._obs, rewards, dones, extras = self.env.step(self._alg.act(self._obs))
                normalized = self._normalization.normalize(rewards, dones)
                # rsl-rl adds the critic's value to the rewards of `time_outs`.
                bootstrap = self.cfg.ppo.bootstrap_on_failure
                ends = {"time_outs": dones > 0 if bootstrap else extras["time_outs"]}
                self._alg.process_env_step(self._obs, normalized, dones, extras | ends)
                self._episodes.add(rewards, dones, extras["driven"])
                reward += float(rewards.mean())
                for name, value in extras["log"].items():
                    sums[name] = sums.get(name, 0.0) + float(value)
        return reward / steps, {name: value / steps for name, value in sums.items()}

    def _schedule(self, share: float) -> None:
        ppo, share = self.cfg.ppo, min(max(share, 0.0), 1.0)
        (first, last), (loud, quiet), (high, low) = ppo.learning_rate, ppo.noise, ppo.entropy
        self._alg.learning_rate = rate = first * (last / first) ** share
        for group in self._alg.optimizer.param_groups:
            group["lr"] = rate
        distribution = self._alg.get_policy().distribution
        if isinstance(distribution, GaussianDistribution):
            with torch.no_grad():
                distribution.log_std_param.fill_(loud * (quiet / loud) ** share).log_()
        else:
            self._alg.entropy_coef = high + share * (low - high)

    def _settings(self) -> dict[str, Any]:
        """Return the settings from which rsl-rl builds its PPO."""
        cfg, ppo = self.cfg, self.cfg.ppo
        groups = list(network.group_shapes(cfg.sensors))
        meets = self.env.cfg.scenarios is not None
        seen = ["state", "truth", "motion"] if meets else ["state"]
        hidden = list(cfg.critic_hidden)
        critic = {"hidden_dims": hidden, "activation": "elu", "obs_normalization": True}
        return {
            "num_steps_per_env": ppo.rollout,
            "multi_gpu": distributed.rsl_rl_settings(),
            "obs_groups": {"actor": groups, "critic": seen},
            "actor": actor_settings(cfg),
            "critic": {"class_name": MLPModel, **critic},
            "algorithm": {
                "class_name": PPO,
                "num_learning_epochs": ppo.epochs,
                "num_mini_batches": ppo.mini_batches,
                "learning_rate": ppo.learning_rate[0],
                "schedule": "fixed",
                "gamma": ppo.gamma,
                "lam": ppo.lam,
                "clip_param": ppo.clip,
                "entropy_coef": 0.0,
                "max_grad_norm": ppo.max_gradient,
                # Returns are not of order 1, and a clipped critic lags far behind them.
                "use_clipped_value_loss": ppo.value_clip,
            },
        }


@contextlib.contextmanager
def threads(number: int) -> Generator[None]:
    """Set torch's threads; waiting ones must not spin (OMP_WAIT_POLICY)."""
    before = torch.get_num_threads()
    torch.set_num_threads(max(1, number))
    try:
        yield
    finally:
        torch.set_num_threads(before)


def make_learner(tracks: TrackSet, cfg: TrainConfig, **settings: Any) -> Learner:  # noqa: ANN401
    """Build a learner and its worlds; settings are those of make_env.make."""
    return Learner(make_env.make(tracks, cfg, **settings), cfg)


@contextlib.contextmanager
def memory_explained() -> Generator[None]:
    """Report a GPU's full memory in a sentence; ConfigError if it is full."""
    try:
        yield
    except torch.OutOfMemoryError as error:
        raise ConfigError(
            f"the device's memory is full ({brief(str(error).partition('. ')[0])}): start a new "
            "run with fewer --num-worlds, a shorter --rollout or more --mini-batches"
        ) from None
