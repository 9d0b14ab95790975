"""Evaluate a driver: laps from the start line, told as the console of the original tells them.

A pure function of driver, track and settings: nothing is kept, nothing is written, no policy is
changed. The words are the original's: a *trial* is one lap, or in mode "episode" one
attempt at a lap that the first mistake ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from league.agents.driver import Driver
from league.envs.actions import checked
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.envs.rewards import BuiltIn, Reward
from league.errors import ConfigError, brief
from league.racing.runs import Moment, Run, Told, Watcher
from league.racing.table import Evaluation, Mode, Trial
from league.sim.config import ObstacleConfig, RaceKind, RaceRules, SimConfig, SolverName
from league.sim.world import World
from league.track.track import Track, TrackSet

MAX_TRIALS = 1000
WORLDS_AT_ONCE = 32
"""Runs driven side by side; a driver's numbers are the same alone and in a batch."""


def evaluate(
    driver: Driver | str,
    track: Track | str,
    *,
    laps: int = 3,
    trials: int = 1,
    kind: RaceKind = "time_trial",
    mode: Mode = "race",
    seed: int = 0,
    solver: SolverName = "bullet",
    obstacles: ObstacleConfig | None = None,
    opponents: Sequence[Driver | str] = (),
    rules: RaceRules | None = None,
    reward: Callable[[int], Reward] | None = None,
    watch: Watcher | None = None,
) -> Evaluation:
    """Drive laps from the start line and return the table of trials.

    In mode "race" a run is a race: mistakes cost penalty seconds and the car goes on. In mode
    "episode" the first mistake ends a trial and the next one begins at the start line; after a
    complete lap the car drives on, so that the laps after the first are flying ones.

    Args:
        driver: who drives, or a driver's name or path.
        track: the course, or its name.
        laps: laps of each run; on an open track always 1.
        trials: runs, with seeds counting up.
        kind: kind of race; against `opponents` always head-to-head.
        mode: whether a mistake costs seconds or ends the trial.
        seed: seed of the first run.
        solver: physics.
        obstacles: boxes or bots, in obstacle avoidance.
        opponents: who races against the driver, behind it on the grid.
        rules: penalties and time limit of a run; its number of laps is not read.
        reward: makes what pays the cars, given the number of worlds; None: progress.
        watch: told each step.

    Raises:
        LeagueError: unknown names, settings that contradict each other, actions that are none.
    """
    from league.track import files

    if not 1 <= trials <= MAX_TRIALS:
        raise ConfigError(f"trials is {brief(trials)}: give 1 to {MAX_TRIALS}")
    if not 0 <= seed < 2**63 - trials:
        raise ConfigError(f"seed is {brief(seed)}: give a whole number from 0 to 2^63 - trials")
    course = files.load(track) if isinstance(track, str) else track
    tracks = TrackSet(course)
    sim = _sim(kind, laps, obstacles, rules, 1 + len(opponents))
    field_ = [_named(one, tracks, sim) for one in (driver, *opponents)]
    cfg = EnvConfig(sim=sim, solver=solver, sensors=tuple(one.sensors for one in field_))
    each = laps if course.closed else 1
    runs = [Run(number, seed + number, each) for number in range(trials)]
    for first in range(0, trials, WORLDS_AT_ONCE):
        batch = runs[first : first + WORLDS_AT_ONCE]
        paid = reward(len(batch)) if reward is not None else None
        _drive(tracks, cfg, field_, batch, mode, paid, watch)
    rows = [(run, row) for run in runs for row in run.rows]
    return Evaluation(
        driver=field_[0].name,
        track=course.name,
        kind=sim.kind,
        mode=mode,
        solver=solver,
        laps=each,
        asked=each * trials,
        seed=seed,
        trials=tuple(
            Trial(trial=number, run=run.number, seed=run.seed, **row)
            for number, (run, row) in enumerate(rows, 1)
        ),
        places=tuple(run.place for run in runs) if opponents else (),
    )


def _sim(
    kind: RaceKind,
    laps: int,
    obstacles: ObstacleConfig | None,
    rules: RaceRules | None,
    num_cars: int,
) -> SimConfig:
    return SimConfig(
        kind="head_to_head" if num_cars > 1 else kind,
        num_cars=num_cars,
        obstacles=obstacles or ObstacleConfig(),
        rules=replace(rules or RaceRules(), laps=laps),
    )


def _named(driver: Driver | str, tracks: TrackSet, sim: SimConfig) -> Driver:
    from league.agents import roster

    return roster.load(driver, tracks, sim.car) if isinstance(driver, str) else driver


def _drive(
    tracks: TrackSet,
    cfg: EnvConfig,
    drivers: Sequence[Driver],
    runs: Sequence[Run],
    mode: Mode,
    reward: Reward | None,
    watch: Watcher | None,
) -> None:
    """Drive a batch of runs to their ends, each in a world of its own."""
    onlooker = None if watch is None else _Onlooker(reward or BuiltIn(cfg.reward))
    env = RaceEnv(tracks, cfg, num_worlds=len(runs), reward=onlooker or reward)
    seeds = np.array([run.seed for run in runs])
    try:
        told = env.reset(seeds=seeds)
        for driver in drivers:
            driver.reset(None)
        while not all(run.over for run in runs):
            actions = np.stack(
                [
                    checked(driver.act(told[car]), driver.name, len(runs))
                    for car, driver in enumerate(drivers)
                ],
                axis=1,
            )
            restart = np.array([run.restart for run in runs])
            before = env.world.cars.copy()
            step = env.step(actions, restart=restart, seeds=seeds)
            told = step.observations
            now = Told.of(tracks, cfg.sim, before, env.world, step)
            seen = []
            for row, run in enumerate(runs):
                if run.restart:
                    run.restart = False
                elif not run.over:
                    seen.append(run.note(row, mode, now))
            if restart.any():
                for driver in drivers:
                    driver.reset(np.flatnonzero(restart))
            if watch is not None and onlooker is not None:
                judged = onlooker.judged
                watch(Moment(tracks, cfg.sim, before, judged, env.world, step, tuple(seen)))
    finally:
        env.close()


class _Onlooker:
    """A reward that pays what another does and keeps the worlds it was shown."""

    def __init__(self, reward: Reward) -> None:
        self._reward = reward
        self.judged: World

    @property
    def terms(self) -> tuple[str, ...]:
        return self._reward.terms

    def __call__(
        self,
        tracks: TrackSet,
        before: World,
        world: World,
        actions: np.ndarray,
        verdicts: np.ndarray,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        self.judged = world.copy()
        return self._reward(tracks, before, world, actions, verdicts)

    def restart(self, world: World, who: np.ndarray) -> None:
        self._reward.restart(world, who)
