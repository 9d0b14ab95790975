"""Learning to race on the true state: one network drives all cars of many worlds.

A network that sees the true state (envs/truth.py) decides 20 times as often in the same time as one
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

from league.envs.actions import to_actions
from league.envs.config import RewardConfig, Scenarios
from league.envs.rewards import PRESETS, Reward
from league.sim.config import SensorConfig
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.ppo import make_env
from league.training.ppo.learner import Learner, Update
from league.training.ppo.teacher import TaughtLearner, Teacher

FIRST_DECISIONS = 2_000_000
"""Decisions before rivals become faster or slower: the cars learn to drive."""
ENOUGH, TOO_FEW = 0.5, 0.4
"""Shares of clean attacks above which rivals become faster, and below which slower."""
PACE_STEP = 0.05
"""How much the rivals' largest top speed changes in a million decisions."""
FIRST_PACE, LEAST_PACE, RANGE = 0.70, 0.60, 0.15
"""Largest top speed of rivals at first and at least, and how far below it the smallest lies."""
DEAR = 3.0
"""Price of a contact at the end of the run, as a multiple of its price at the beginning."""
SPREAD = 0.5
"""Least randomisation of the cars; see TrainConfig."""
_MEMORY = 0.9
"""Share of what is known about attacks that is kept in an update."""


class Curriculum:
    """Rivals as fast as can just be passed, and contacts that become dear."""

    def __init__(self) -> None:
        """Start with slow rivals and cheap contacts."""
        self.pace = FIRST_PACE
        """Largest top speed of rivals, as a share of the fastest car's."""
        self._attacks = self._passed = self._clean = 0.0

    def add(self, update: Update) -> None:
        """Move the rivals' pace after an update, by how many attacks succeeded lately."""
        log = update.log
        self._attacks = _MEMORY * self._attacks + log["/race/attacks"]
        self._passed = _MEMORY * self._passed + log["/race/passed"]
        self._clean = _MEMORY * self._clean + log["/race/clean"]
        if update.samples < FIRST_DECISIONS:
            return
        rows = update.samples / max(update.number, 1)
        step = PACE_STEP * rows / 1e6
        if self.clean > ENOUGH:
            self.pace = min(self.pace + step, 1.0)
        elif self.clean < TOO_FEW:
            self.pace = max(self.pace - step, LEAST_PACE)

    @property
    def clean(self) -> float:
        """Share of the last attacks that succeeded without a mistake."""
        return self._clean / self._attacks if self._attacks > 0.0 else 0.0

    def scenarios(self, before: Scenarios) -> Scenarios:
        """Return scenarios with rivals of today's pace."""
        least = max(self.pace - RANGE, 0.45)
        return replace(before, fastest_rival=self.pace, slowest_rival=least)

    def reward(self, share: float) -> RewardConfig:
        """Return the weights at a share of the budget: touching becomes dear until four fifths."""
        dear = 1.0 + (DEAR - 1.0) * min(share / 0.8, 1.0)
        first = PRESETS["race"]
        return replace(first, touch=dear * first.touch, crash=dear * first.crash)

    def log(self) -> dict[str, float]:
        """Return metrics: the pace, and how many of the last attacks ended how."""
        passed = self._passed / self._attacks if self._attacks > 0.0 else 0.0
        return {"/race/pace": self.pace, "/race/clean": self.clean, "/race/passed": passed}

    def state(self) -> dict[str, float]:
        """Return what a resumed run goes on from."""
        return {
            "pace": self.pace,
            "attacks": self._attacks,
            "passed": self._passed,
            "clean": self._clean,
        }

    def restore(self, state: dict[str, float]) -> None:
        """Take over what `state` returned."""
        self.pace, self._attacks = float(state["pace"]), float(state["attacks"])
        self._passed, self._clean = float(state["passed"]), float(state["clean"])


class Rival:
    """A Driver of the other cars of a camera driver's worlds: the racer as it is now."""

    sensors = SensorConfig(truth=True)

    def __init__(self, racer: Racer) -> None:
        """Take the racer, which goes on learning."""
        self.name, self._racer = "racer", racer

    def reset(self, rows: np.ndarray | None) -> None:
        """Do nothing: it remembers nothing."""

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions [steering, speed] in [-1, 1], float32 (num_rows, 2)."""
        groups = {name: torch.from_numpy(observations[name].copy()) for name in Racer.groups}
        rows = len(groups["motion"])
        answer = self._racer.targets(TensorDict(groups, batch_size=[rows]))
        return to_actions(self._racer.cfg.action_space, answer.numpy(), self._racer.car)


class Racer(Teacher):
    """PPO learner of all cars, with a curriculum."""

    groups = ("truth", "motion")

    def __init__(self, tracks: TrackSet, cfg: TrainConfig) -> None:
        """Build its worlds and networks.

        Args:
            tracks: where it learns.
            cfg: settings that `TrainConfig.on_truth` returned.
        """
        super().__init__(make_env.make(tracks, cfg), cfg)
        self.car = self.env.cfg.sim.car
        self.curriculum = Curriculum()

    def update(self, share: float) -> Update:
        """Collect one round of steps and learn from it; see Learner."""
        worlds = self.env.race_env
        assert worlds.cfg.scenarios is not None
        worlds.change_scenarios(self.curriculum.scenarios(worlds.cfg.scenarios))
        worlds.change_weights(self.curriculum.reward(share))
        update = super().update(share)
        self.curriculum.add(update)
        return replace(update, log=update.log | self.curriculum.log())

    def _state(self) -> dict[str, Any]:
        return super()._state() | {"curriculum": self.curriculum.state()}

    def _load_state(self, state: dict[str, Any]) -> None:
        super()._load_state(state)
        self.curriculum.restore(state["curriculum"])


class RacingLearner(TaughtLearner):
    """A learner with its own sensors, which learns to race from a racer, and then against it."""

    def __init__(self, tracks: TrackSet, cfg: TrainConfig, racer: Racer, **settings: Any) -> None:  # noqa: ANN401
        """Build the worlds, in which the racer drives the other cars, networks and storage.

        Args:
            tracks: where it learns.
            cfg: settings of the run, with the racer's share of the budget.
            racer: in worlds of its own.
            settings: of make_env.make.
        """
        rivals = {car: Rival(racer) for car in range(1, cfg.num_cars)}
        super().__init__(make_env.make(tracks, cfg, opponents=rivals, **settings), cfg, racer)
        self.racer = racer
        """The network that sees the true state."""

    def update(self, share: float) -> Update:
        """Update the racer, or the policy; see Learner."""
        worlds, curriculum = self.env.race_env, self.racer.curriculum
        assert worlds.cfg.scenarios is not None
        worlds.change_scenarios(curriculum.scenarios(worlds.cfg.scenarios))
        worlds.change_weights(curriculum.reward(1.0))
        return super().update(share)


def make_racing(tracks: TrackSet, cfg: TrainConfig, *, reward: Reward | None = None) -> Learner:
    """Build the learner of a run of self-play: of the true state alone, or of its own sensors.

    Args:
        tracks: where it learns.
        cfg: settings of the run.
        reward: in Python, for the policy with its own sensors; None: the preset `race`.
    """
    # Differences between the cars make other rivals than a top speed does.
    spread = max(cfg.dynamics_randomization, SPREAD)
    cfg = replace(cfg, reward=PRESETS["race"], dynamics_randomization=spread)
    racer = Racer(tracks, cfg.on_truth())
    if cfg.sensors.truth:
        return racer
    return RacingLearner(tracks, cfg, racer, reward=reward)
