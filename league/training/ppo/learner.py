"""The learner: rsl-rl's PPO on our worlds, one update at a time, with schedules and save points."""

from __future__ import annotations

import contextlib
import io
import pickle
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution

from league.agents import network
from league.atomic_file import replacing
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.errors import PolicyError
from league.training.ppo import distributed, symmetry
from league.training.ppo.episode_stats import Episodes
from league.training.ppo.models import actor_settings
from league.training.ppo.reward_normalization import ReturnScale
from league.training.settings import TrainConfig

STATE_FORMAT = 1


@dataclass(frozen=True)
class Update:
    """What one round of collecting and learning brought."""

    number: int
    """Updates so far, this one included."""
    samples: int
    """Decisions learnt from so far, by all ranks."""
    collect_s: float
    """Wall time of collecting [s]."""
    learn_s: float
    """Wall time of learning [s]."""
    reward: float
    """Mean reward of a step."""
    losses: dict[str, float]
    """Mean losses by rsl-rl's names."""
    log: dict[str, float]
    """Means of the worlds' log over the steps."""
    learning_rate: float | None = None
    """Step size of the optimiser."""
    mean_std: float | None = None
    """Mean standard deviation of the actions: exploration."""
    episode_steps: float | None = None
    """Steps from one end of an episode to the next, of late; None before the first one."""


class Learner:
    """PPO with its worlds; what it has learnt can be taken out, saved and resumed.

    Where torchrun has started several ranks, each has a learner with worlds of its own. They update
    together, with equal weights, and what is told of rewards and episodes is the rank's own.
    """

    def __init__(self, env: RacingVecEnv, cfg: TrainConfig) -> None:
        """Build networks and storage.

        Args:
            env: the worlds, with pictures as bytes.
            cfg: settings of the run; the device is this rank's own.

        Raises:
            ConfigError: the other ranks cannot be found.
        """
        self.env, self.cfg = env, cfg
        distributed.join(cfg.device)
        if self._on_card:
            # Else convolutions learn in another way each time, in fewer bits than judged.
            torch.backends.cudnn.deterministic, torch.backends.cudnn.allow_tf32 = True, False
        # rsl-rl draws weights and exploration from torch's global generator.
        torch.manual_seed(cfg.seed)
        self._obs = env.get_observations()
        with contextlib.redirect_stdout(io.StringIO()):  # it prints its networks
            self._alg = PPO.construct_algorithm(self._obs, env, self._settings(), cfg.device)
        self._mirroring = None
        if cfg.mirror and symmetry.applies(cfg.sensors, cfg.action_space):
            self._mirroring = symmetry.Mirroring(
                cfg.sensors, cfg.action_space, cfg.ppo.mini_batches
            )
            self._alg.symmetry = self._mirroring  # type: ignore
        self._episodes = Episodes(env.num_envs)
        self._scale = ReturnScale(env.num_envs, cfg.ppo.gamma, cfg.device)
        self.updates = self.samples = 0
        if distributed.count() > 1:
            self._alg.broadcast_parameters()
            self.start_rows_anew()

    @property
    def device(self) -> str:
        """Where the networks live."""
        return self.cfg.device

    @property
    def episodes(self) -> Episodes:
        """What has become of the episodes of late."""
        return self._episodes

    @property
    def shown(self) -> tuple[RacingVecEnv, ...]:
        """All worlds in which somebody learns, to look on at."""
        return (self.env,)

    @property
    def has_learnt(self) -> bool:
        """Whether the policy is other than it began, and worth a look."""
        return self.updates > 0

    def weights(self) -> dict[str, np.ndarray]:
        """Return the actor's weights as copies."""
        return network.from_learner(self._alg.get_policy().state_dict())

    def begin(self, weights: Mapping[str, np.ndarray]) -> None:
        """Start from the weights of another policy of the same shape.

        Raises:
            PolicyError: the layers differ.
        """
        own = self._alg.get_policy().state_dict()
        mine = {name: value for name, value in own.items() if name in self.weights()}
        if {n: v.shape for n, v in mine.items()} != {n: v.shape for n, v in weights.items()}:
            raise PolicyError(
                "the policy to begin from has other layers, sensors or actions than this run: "
                "give the run the same, or start a new run"
            )
        given = {name: torch.from_numpy(value) for name, value in weights.items()}
        self._alg.get_policy().load_state_dict({**own, **given})

    def update(self, share: float) -> Update:
        """Collect one round of steps and learn from it.

        Args:
            share: share of the budget that is used up, 0 to 1, for the schedules; of several
                ranks the first one's counts.

        Raises:
            LeagueError: a reward function has failed, or another rank.
        """
        self._schedule(distributed.agreed(share))
        self._alg.train_mode()
        started = time.perf_counter()
        with distributed.together():
            reward, log = self._collect()
        collected = time.perf_counter()
        self._scale.share()
        with torch.inference_mode():
            self._alg.compute_returns(self._obs)
        if self._mirroring is not None:
            self._mirroring.restart()
        with distributed.exchange():
            losses = self._alg.update()
        self.updates += 1
        self.samples += distributed.count() * self.env.num_envs * self.cfg.ppo.steps
        if self.updates % self.cfg.save_every == 0:
            self.start_rows_anew()
        return Update(
            number=self.updates,
            samples=self.samples,
            collect_s=collected - started,
            learn_s=time.perf_counter() - collected,
            reward=reward,
            losses=losses,
            log=log,
            learning_rate=self._alg.learning_rate,
            mean_std=float(self._alg.get_policy().output_std.detach().mean()),
            episode_steps=self.episodes.steps,
        )

    @property
    def at_save_point(self) -> bool:
        """Whether a run that goes on from here ends as one that was never interrupted."""
        return self.updates % self.cfg.save_every == 0

    def save(self, path: Path, notes: dict[str, object]) -> None:
        """Write all that is needed to go on: networks, optimiser, generators, counts, notes.

        Of several ranks the first one writes; the others have the same networks, and their own
        draws restart with the rows. It does not wait for other ranks.

        Raises:
            PolicyError: it cannot be written; a state that was there stays.
        """
        if not distributed.is_first():
            return
        state = self._learnt() | {
            "format": STATE_FORMAT,
            "generator": torch.get_rng_state(),
            "notes": notes,
        }
        if self._on_card:
            state["card_generator"] = torch.cuda.get_rng_state(self.device)
        with replacing(path, "the learner's state", PolicyError, also=(RuntimeError,)) as file:
            # In memory first: to a full disk, torch has no better answer than its own position.
            whole = io.BytesIO()
            torch.save(state, whole)
            file.write_bytes(whole.getbuffer())

    def restore(self, path: Path) -> dict:
        """Go on from a saved state; return its notes.

        The file is this user's own, and is read weights-only all the same.

        Raises:
            PolicyError: it is no state, or one of another network.
        """
        try:
            # What belongs on a card is copied there; on one, Adam's counts would be read each step.
            state = torch.load(path, weights_only=True, map_location="cpu")
            if state["format"] != STATE_FORMAT:
                raise KeyError(state["format"])
            self._go_on_from(state)
            torch.set_rng_state(state["generator"])
            if self._on_card and "card_generator" in state:  # format 1 began without it
                torch.cuda.set_rng_state(state["card_generator"], self.device)
            notes = dict(state["notes"])
        except (
            OSError,
            AttributeError,
            KeyError,
            TypeError,
            ValueError,
            RuntimeError,
            EOFError,
            pickle.UnpicklingError,
        ) as error:
            raise PolicyError(
                f"{path} cannot be resumed ({type(error).__name__}): give the run the "
                "settings it was started with, or start a new run with another --out"
            ) from None
        self.start_rows_anew()
        return notes

    def start_rows_anew(self) -> None:
        """Begin all episodes anew, from a seed that the number of updates and the rank decide.

        Several ranks draw what comes next from that seed, too: so a run of several goes on as it
        would have without anything kept of the others but what they share.
        """
        seed = distributed.seed(self.cfg.seed * 1_000_003 + self.updates)
        if distributed.count() > 1:
            torch.manual_seed(seed)
        with torch.inference_mode():
            self._obs = self.env.reset(seed, self._next_tracks())
        self._episodes.restart()
        self._scale.restart()

    def _learnt(self) -> dict:
        """Return what is to be kept of networks, optimiser and counts."""
        counts = {"updates": self.updates, "samples": self.samples}
        return self._alg.save() | counts | {"scale": self._scale.state()}

    def _go_on_from(self, kept: dict) -> None:
        """Take up what `_learnt` has returned."""
        self._alg.load(kept, None, True)
        self.updates, self.samples = int(kept["updates"]), int(kept["samples"])
        self._scale.restore(kept["scale"])

    @property
    def _on_card(self) -> bool:
        return torch.device(self.device).type == "cuda"

    def _next_tracks(self) -> np.ndarray:
        """Return the tracks of the worlds from here on: where there are more, others each time."""
        worlds, times = self.cfg.num_worlds, self.updates // self.cfg.save_every
        first = worlds * (times * distributed.count() + distributed.number())
        return np.arange(first, first + worlds) % len(self.env.race_env.tracks.tracks)

    def _collect(self) -> tuple[float, dict[str, float]]:
        paid, sums = 0.0, {}
        with torch.inference_mode():
            for _ in range(self.cfg.ppo.steps):
                actions = self._alg.act(self._obs)
                self._obs, rewards, dones, extras = self.env.step(actions)
                scaled = self._scale.scaled(rewards, dones)
                # Who was cut off by the clock is told what it would have gone on to earn.
                cut = dones > 0 if self.cfg.ppo.forgiving else extras["time_outs"]
                told = extras | {"time_outs": cut}
                self._alg.process_env_step(self._obs, scaled, dones, told)
                self._episodes.add(rewards, dones, extras)
                paid += float(rewards.mean())
                for name, value in extras["log"].items():
                    sums[name] = sums.get(name, 0.0) + float(value)
        steps = self.cfg.ppo.steps
        return paid / steps, {name: value / steps for name, value in sums.items()}

    def _schedule(self, share: float) -> None:
        ppo, share = self.cfg.ppo, min(max(share, 0.0), 1.0)
        first, last = ppo.learning_rate
        rate = first * (last / first) ** share
        self._alg.learning_rate = rate
        for group in self._alg.optimizer.param_groups:
            group["lr"] = rate
        spread = self._alg.get_policy().distribution
        if isinstance(spread, GaussianDistribution):
            noise = ppo.noise[0] * (ppo.noise[1] / ppo.noise[0]) ** share
            with torch.no_grad():
                spread.log_std_param.fill_(noise).log_()
        else:
            self._alg.entropy_coef = ppo.entropy[0] + share * (ppo.entropy[1] - ppo.entropy[0])

    def _settings(self) -> dict:
        """Return what rsl-rl builds its PPO from, by the names of its runner's settings."""
        cfg, ppo = self.cfg, self.cfg.ppo
        groups = list(network.group_shapes(cfg.sensors))
        return {
            "num_steps_per_env": ppo.steps,
            "multi_gpu": distributed.for_rsl_rl(),
            "obs_groups": {"actor": groups, "critic": ["state"]},
            "actor": actor_settings(
                cfg.network, cfg.action_space, "stereo" in groups, ppo.noise[0], ppo.pull
            ),
            "critic": {
                "class_name": MLPModel,
                "hidden_dims": list(cfg.critic_hidden),
                "activation": "elu",
                "obs_normalization": True,
            },
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
                "value_loss_coef": ppo.value_weight,
                "max_grad_norm": ppo.max_gradient,
                # Returns are not of order 1, and a clipped critic lags far behind them.
                "use_clipped_value_loss": ppo.value_clip,
            },
        }


@contextlib.contextmanager
def threads(number: int) -> Iterator[None]:
    """Have torch compute with some threads; waiting ones must not spin (OMP_WAIT_POLICY)."""
    before = torch.get_num_threads()
    torch.set_num_threads(max(1, number))
    try:
        yield
    finally:
        torch.set_num_threads(before)
