"""Learning to race on the true state: one network drives all cars of many worlds.

A network that sees the true state (`truth`) decides 20 times as often in the same time as one
that sees pictures, so passing is learnt here, and cameras learn from it (teacher.py). What makes it
possible: a contact costs little at first and ends nothing, closing speed costs much, and the pace
of the rivals follows success. docs/self_play.md has the measurements.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from league.agents import roster
from league.envs.actions import to_actions
from league.envs.driver import Driver, Guests
from league.envs.race_env import RaceEnv
from league.envs.rewards import PRESETS, Reward
from league.sim.config import CarConfig, SensorConfig
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.ppo import make_env
from league.training.ppo.learner import Learner, Update
from league.training.ppo.teacher import TaughtLearner, Teacher

WARM_UP = 0.04  # Share of a stage before rivals become faster or slower: the cars learn to drive.
ENOUGH = 0.5  # Share of clean attacks above which rivals become faster.
SLACK = 0.1  # How far below that share rivals become slower.
PACE_STEP = 2.5  # How much the rivals' largest top speed changes over a whole stage of success.
FIRST_PACE, LEAST_PACE, RANGE = 0.70, 0.60, 0.12
"""Largest top speed of rivals at first and at least, and how far below it the smallest lies."""
DEAR = 6.0
"""Price of a hard contact at the end of a stage, in its first: more than a pass earns. A light one
stays cheap: a car that must not touch at all waits for mistakes."""
SPREAD = 0.5  # Least randomisation of the cars; see TrainConfig.
Scripted = tuple[tuple[float, tuple[str, ...]], ...]
FIRST_SCRIPTED: Scripted = (
    (0.25, ("racing_line",)),
    (0.125, ("centerline",)),
    (0.125, ("cautious",)),
    (0.125, ("blocker",)),
)
"""Shares of the worlds of the first stage in which scripted drivers have the last car. As being hit
costs, too, cars learn to make way, and to rely on it; scripted drivers never make way."""
SCRIPTED: Scripted = (
    (0.25, ("centerline",)),
    (0.125, ("racing_line", "cautious", "blocker")),
)
"""The same of the worlds of a policy with its own sensors, where the other cars have these in turn.
The racer drives slow cars well; others brake for bends and keep to lines of their own."""
CAR = CarConfig()  # All cars in training.
_LATELY = 100.0  # Attacks after which what is known about earlier ones counts half.

_KEPT = ("pace", "share", "attacks", "passed", "clean")  # what a curriculum's state is made of


class Curriculum:
    """Rivals as fast as can just be passed, and hard contacts that become dear, over one stage."""

    def __init__(self, rows: int) -> None:
        """Start with slow rivals and cheap contacts, for updates of so many decisions."""
        self._rows = rows
        self.pace = FIRST_PACE  # largest top speed of rivals, as a share of the fastest car's
        self.share = self.attacks = self.passed = self.clean = 0.0

    def prepare(self, worlds: RaceEnv, share: float) -> None:
        """Set rivals' top speeds and the price of contacts, at a share of the stage."""
        assert worlds.cfg.scenarios is not None
        rivals = {"fastest_rival": self.pace, "slowest_rival": self.pace - RANGE}
        worlds.change_scenarios(replace(worlds.cfg.scenarios, **rivals))
        first, dear = PRESETS["race"], 1.0 + (DEAR - 1.0) * min(share / 0.8, 1.0)
        hits = {"crash": dear * first.crash, "closing": dear * first.closing}
        worlds.change_weights(replace(first, **hits))

    def add(self, update: Update, share: float) -> Update:
        """Move the rivals' pace after an update; return it with the shares of lately in its log."""
        attacks, passed, clean = (
            self._rows * update.log[f"/race/{name}"] for name in ("attacks", "passed", "clean")
        )
        kept = 0.5 ** (attacks / _LATELY)
        self.attacks = kept * self.attacks + attacks
        self.passed = kept * self.passed + passed
        self.clean = kept * self.clean + clean
        step = PACE_STEP * max(share - self.share, 0.0)
        self.share = share
        succeeded = self.clean / max(self.attacks, 1.0)
        if share > WARM_UP and succeeded > ENOUGH:
            self.pace = min(self.pace + step, 1.0)
        elif share > WARM_UP and succeeded < ENOUGH - SLACK:
            self.pace = max(self.pace - step, LEAST_PACE)
        shares = {"clean": succeeded, "passed": self.passed / max(self.attacks, 1.0)}
        log = {f"/race/{name}": value for name, value in {"pace": self.pace, **shares}.items()}
        return replace(update, log=update.log | log)

    def state(self) -> dict[str, float]:
        """Return what a resumed run goes on from."""
        return {name: getattr(self, name) for name in _KEPT}

    def restore(self, state: dict[str, float]) -> None:
        """Take over what `state` returned."""
        for name in _KEPT:
            setattr(self, name, float(state[name]))


class Rival:
    """A Driver of another car of a camera driver's worlds: the racer as it is now.

    In the first worlds a scripted driver has the car.
    """

    sensors = SensorConfig(truth=True)

    def __init__(self, racer: Racer, scripted: Guests) -> None:
        """Take the racer, which goes on learning, and the scripted drivers of this car."""
        self.name, self._racer, self._scripted = "racer", racer, scripted

    def reset(self, rows: np.ndarray | None) -> None:
        """Clear the scripted drivers' memory of some worlds; the racer remembers nothing."""
        self._scripted.reset(rows)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_worlds, 2)."""
        groups = {name: torch.from_numpy(observations[name].copy()) for name in Racer.groups}
        answer = self._racer.targets(TensorDict(groups, batch_size=[len(groups["motion"])]))
        actions = to_actions(self._racer.cfg.action_space, answer.numpy(), CAR)
        self._scripted.drive(actions, observations)
        return actions


def scripted_drivers(scripted: Scripted, tracks: TrackSet, car: int, num_worlds: int) -> Guests:
    """Load the scripted drivers of a car; none on several tracks, because each knows one."""
    return Guests(
        [
            (round(share * num_worlds), roster.load(names[(car - 1) % len(names)], tracks, CAR))
            for share, names in (scripted if len(tracks.tracks) == 1 else ())
        ]
    )


class _OnCurriculum(Learner):
    """A learner that saves its curriculum, and resumes with it."""

    curriculum: Curriculum

    def _state(self) -> dict[str, Any]:
        return super()._state() | {"curriculum": self.curriculum.state()}

    def _load_state(self, state: dict[str, Any]) -> None:
        super()._load_state(state)
        self.curriculum.restore(state["curriculum"])


class Racer(_OnCurriculum, Teacher):
    """PPO learner of all cars, with a curriculum."""

    groups = ("truth", "motion")

    def __init__(self, tracks: TrackSet, cfg: TrainConfig) -> None:
        """Build its worlds and networks, of settings that `TrainConfig.on_truth` returned."""
        last = cfg.num_cars - 1
        guests = {last: scripted_drivers(FIRST_SCRIPTED, tracks, last, cfg.num_worlds)}
        super().__init__(make_env.make(tracks, cfg, guests=guests), cfg)
        self.curriculum = Curriculum(self.env.num_envs * cfg.ppo.rollout)

    def update(self, share: float) -> Update:
        """Collect one round of steps and learn from it; see Learner."""
        self.curriculum.prepare(self.env.race_env, share)
        return self.curriculum.add(super().update(share), share)


class RacingLearner(_OnCurriculum, TaughtLearner):
    """A learner with its own sensors, which learns to race from a racer, and then against it."""

    def __init__(self, tracks: TrackSet, cfg: TrainConfig, racer: Racer, **settings: Any) -> None:  # noqa: ANN401
        """Build the worlds, in which the racer drives the other cars, networks and storage.

        The racer learns in worlds of its own; `settings` are those of make_env.make.
        """
        rivals: dict[int, Driver | str] = {
            car: Rival(racer, scripted_drivers(SCRIPTED, tracks, car, cfg.num_worlds))
            for car in range(1, cfg.num_cars)
        }
        env = make_env.make(tracks, cfg, opponents=rivals, **settings)
        super().__init__(env, cfg, racer)
        self.racer = racer  # The network that sees the true state.
        self.curriculum = Curriculum(self.env.num_envs * cfg.ppo.rollout)

    def _learn(self, share: float) -> Update:
        """Collect and learn at a share of its own stage, with rivals as fast as it can pass."""
        self.curriculum.prepare(self.env.race_env, share)
        return self.curriculum.add(super()._learn(share), share)


def make_racing(tracks: TrackSet, cfg: TrainConfig, *, reward: Reward | None = None) -> Learner:
    """Build the learner of a run of self-play: of the true state alone, or of its own sensors.

    `reward`, in Python, is for a policy with its own sensors; None: the preset `race`.
    """
    # Differences between the cars make other rivals than a top speed does.
    spread = max(cfg.dynamics_randomization, SPREAD)
    cfg = replace(cfg, reward=PRESETS["race"], dynamics_randomization=spread)
    racer = Racer(tracks, cfg.on_truth())
    if cfg.sensors.truth:
        return racer
    return RacingLearner(tracks, cfg, racer, reward=reward)
