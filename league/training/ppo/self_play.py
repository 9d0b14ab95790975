"""Learning to race on the true state: one network drives all cars of many worlds.

A network that sees the true state decides 20 times as often in the same time as one that sees
pictures, so passing is learnt here, and cameras learn from it (teacher.py). What makes it
possible: a contact costs little at first and ends nothing, closing speed costs much, and the pace
of the rivals follows success. docs/self_play.md has the measurements.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from league.agents import roster
from league.envs.driver import Driver
from league.envs.race_env import RaceEnv
from league.envs.rewards import PRESETS, Reward
from league.sim.config import CarConfig
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.monitor.history import UpdateRow
from league.training.ppo import make_env
from league.training.ppo.learner import Learner
from league.training.ppo.teacher import TaughtLearner, Teacher

WARM_UP = 0.04  # Share of a stage before rivals become faster or slower: the cars learn to drive.
ENOUGH = 0.5  # Share of clean attacks above which rivals become faster.
SLACK = 0.1  # How far below that share rivals become slower.
PACE_STEP = 2.5  # How much the rivals' largest top speed changes over a whole stage of success.
FIRST_PACE, LEAST_PACE, RANGE = 0.70, 0.60, 0.12
"""Largest top speed of rivals at first and at least, and how far below it the smallest lies."""
DEAR = {"crash": 6.0, "closing": 6.0}
"""How many times the price of a hard contact grows over a stage: to more than a pass earns."""
SPREAD = 0.5  # Least randomisation of the cars; see TrainConfig.
SCRIPTED = {"racing_line": 0.25, "centerline": 0.125, "cautious": 0.125, "blocker": 0.125}
"""Shares of the worlds in which scripted drivers have the last car. As being hit costs, too, cars
learn to make way, and to rely on it; scripted drivers never make way."""
CAR = CarConfig()  # All cars in training.
_LATELY = 100.0  # Attacks after which what is known about earlier ones counts half.

_KEPT = ("pace", "share", "attacks", "passed", "clean")  # what a curriculum's state is made of


class Curriculum:
    """Rivals as fast as can just be passed, and contacts that become dear, over one stage."""

    def __init__(self, rows: int, dear: Mapping[str, float]) -> None:
        """Start with slow rivals and cheap contacts, for updates of so many decisions.

        `dear` are the weights of the reward that grow, and how many times over a stage.
        """
        self._rows, self._dear = rows, dear
        self.pace = FIRST_PACE  # largest top speed of rivals, as a share of the fastest car's
        self.share = self.attacks = self.passed = self.clean = 0.0

    def prepare(self, worlds: RaceEnv, share: float) -> None:
        """Set rivals' top speeds and the price of contacts, at a share of the stage."""
        assert worlds.cfg.scenarios is not None
        rivals = {"fastest_rival": self.pace, "slowest_rival": self.pace - RANGE}
        worlds.change_scenarios(replace(worlds.cfg.scenarios, **rivals))
        first, grown = PRESETS["race"], min(share / 0.8, 1.0)
        prices = {
            name: (1.0 + (dear - 1.0) * grown) * getattr(first, name)
            for name, dear in self._dear.items()
        }
        worlds.change_weights(replace(first, **prices))

    def add(self, log: Mapping[str, float], share: float) -> dict[str, float]:
        """Move the rivals' pace after an update; return its log with the shares of lately."""
        attacks, passed, clean = (
            self._rows * log[f"/race/{name}"] for name in ("attacks", "passed", "clean")
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
        passes = self.passed / max(self.attacks, 1.0)
        lately = {"/race/pace": self.pace, "/race/clean": succeeded, "/race/passed": passes}
        return {**log, **lately}

    def state(self) -> dict[str, float]:
        """Return what a resumed run goes on from."""
        return {name: getattr(self, name) for name in _KEPT}

    def restore(self, state: dict[str, float]) -> None:
        """Take over what `state` returned."""
        for name in _KEPT:
            setattr(self, name, float(state[name]))


def scripted_drivers(tracks: TrackSet, num_worlds: int) -> list[Driver]:
    """Load scripted drivers of one car, one for each of the first worlds, several for each name.

    There are none on several tracks, because each knows one.
    """
    drivers: list[Driver] = []
    if len(tracks.tracks) == 1:
        for name, share in SCRIPTED.items():
            drivers += [roster.load(name, tracks, CAR)] * round(share * num_worlds)
    return drivers


class _OnCurriculum(Learner):
    """A learner of all cars, among rivals as fast as it can pass."""

    dear = DEAR  # A car that sees all and must not touch lightly waits for mistakes.

    def __init__(
        self,
        tracks: TrackSet,
        cfg: TrainConfig,
        *teacher: Teacher,
        reward: Reward | None = None,
    ) -> None:
        """Build worlds, networks and storage; the teacher, if any, learns in worlds of its own."""
        guests = {cfg.num_cars - 1: scripted_drivers(tracks, cfg.num_worlds)}
        super().__init__(make_env.make(tracks, cfg, guests=guests, reward=reward), cfg, *teacher)
        self.curriculum = Curriculum(self.env.num_envs * cfg.ppo.rollout, self.dear)

    def _learn(self, share: float) -> UpdateRow:
        self.curriculum.prepare(self.env.race_env, share)
        return super()._learn(share)

    def _adapted(self, log: dict[str, float], share: float) -> dict[str, float]:
        return self.curriculum.add(log, share)

    def restart_rows(self) -> None:
        """Restart all episodes, among rivals as fast as a resumed run meets them."""
        self.curriculum.prepare(self.env.race_env, self.curriculum.share)
        super().restart_rows()

    def _state(self) -> dict[str, Any]:
        return super()._state() | {"curriculum": self.curriculum.state()}

    def _load_state(self, state: dict[str, Any]) -> None:
        super()._load_state(state)
        self.curriculum.restore(state["curriculum"])


class Racer(_OnCurriculum, Teacher):
    """PPO learner that sees the true state."""

    def __init__(self, tracks: TrackSet, cfg: TrainConfig) -> None:
        """Build worlds and networks, of settings that `TrainConfig.on_truth` returned."""
        self.groups = (*cfg.sensors.privileged, "motion")
        if cfg.sensors.ahead:
            # Cameras that learn from cars which touch lightly ride into others.
            self.dear = DEAR | {"touch": 2.0}
        super().__init__(tracks, cfg)


class RacingLearner(_OnCurriculum, TaughtLearner):
    """A learner with its own sensors, which learns to race from a Racer, and against itself."""

    dear = DEAR | {"touch": 6.0}  # Its teacher has shown it how to pass.


def make_racing(tracks: TrackSet, cfg: TrainConfig, *, reward: Reward | None = None) -> Learner:
    """Build the learner of a run of self-play: of the true state alone, or of its own sensors.

    `reward`, in Python, is for a policy with its own sensors; None: the preset `race`.
    """
    # Differences between the cars make other rivals than a top speed does.
    spread = max(cfg.dynamics_randomization, SPREAD)
    cfg = replace(cfg, reward=PRESETS["race"], dynamics_randomization=spread)
    racer = Racer(tracks, cfg.on_truth())
    if cfg.sensors.privileged:
        return racer
    return RacingLearner(tracks, cfg, racer, reward=reward)
