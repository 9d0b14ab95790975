"""Evaluate a driver: laps from the start line, as the table of the original's console.

A pure function of driver, track and settings: it keeps nothing, writes nothing and changes no
policy. The words are the original's: a *trial* is one lap, or in mode "episode" one attempt at a
lap that the first mistake ends.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy import ndarray

from league.agents.rollout import DriverPool, Rollout
from league.envs.config import EnvConfig
from league.envs.driver import Driver
from league.envs.race_env import RaceEnv, Step
from league.envs.rewards import BuiltIn, Paid, Reward
from league.errors import ConfigError, brief
from league.racing.race import dynamics
from league.racing.table import Evaluation, Mode, Status, Trial
from league.sim import referee, rng
from league.sim.config import ObstacleConfig, RaceKind, RaceRules, SimConfig, SolverName
from league.sim.records import World, is_frozen
from league.track.track import Track, TrackSet

MAX_TRIALS = 1000
START_SPEED = 0.5
"""Largest speed at the start of a run where nothing but the course is on the track [m/s], times
the variation."""
WORLDS_AT_ONCE = 32
"""Runs driven in one batch; a driver's numbers are the same alone and in a batch."""
_ATTEMPT = 401  # purpose of the random numbers that seed the attempts of a run after its first
MISTAKES: dict[str, Status] = {
    "off_track": "off_track",
    "crashed": "crashed",
    "immobilised": "immobilized",
    "reversed": "reversed",
}
"""The referee's flags, the first of which names a mistake."""


@dataclass(frozen=True)
class TrialStep:
    """Progress of one run after a step."""

    run: int  # number of the run, over all batches
    row: int  # world of the batch
    trial: int  # number of the trial within its run, from 0
    step: int  # steps since the trial began, from 1
    status: str  # "in_progress", "pause" during a penalty, a mistake's name, or how the trial ended
    done: bool  # whether the trial ended in this step


@dataclass(frozen=True)
class EvalStep:
    """One step of a batch of runs; the evaluated car has slot 0."""

    tracks: TrackSet
    sim: SimConfig
    before: ndarray  # CAR records before the step, (num_worlds, num_cars)
    # the worlds as the referee and the reward saw them, before any penalty moved a car
    judged: World
    world: World  # the worlds after the step: cars that crashed have been put back
    step: Step  # observations, rewards and verdicts of the step
    trials: tuple[TrialStep, ...]  # the runs that are still under way


EvalCallback = Callable[[EvalStep], None]  # called after each step; it cannot change it


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
    variation: float = 1.0,
    obstacles: ObstacleConfig | None = None,
    opponents: Sequence[Driver | str] = (),
    rules: RaceRules | None = None,
    reward: Callable[[int], Reward] | None = None,
    watch: EvalCallback | None = None,
) -> Evaluation:
    """Drive laps from the start line and return the table of trials.

    In mode "race" a run is a race: mistakes cost penalty seconds and the car goes on. In mode
    "episode" the first mistake ends a trial and the next one begins at the start line; after a
    complete lap the car drives on, so that the laps after the first are flying ones.

    Args:
        driver: the driver to evaluate, or its name or path.
        track: the course, or its name.
        laps: laps of each run; on an open track always 1.
        trials: runs, with seeds counting up.
        kind: kind of race; against `opponents` always head-to-head.
        mode: whether a mistake costs seconds or ends the trial.
        seed: seed of the first run.
        solver: physics.
        variation: how far runs differ in the car and, alone on the track, in the speed at the
            start, drawn from their seeds: 1 as heats of a league do; 0 not at all.
        obstacles: boxes or bots; None: six boxes in obstacle avoidance, else none.
        opponents: drivers that start behind it on the grid.
        rules: penalties and time limit of a run; its number of laps is not read.
        reward: makes the reward of so many worlds; None: progress.
        watch: called after each step.

    Raises:
        LeagueError: unknown names, settings that contradict each other, actions that are none.
    """
    from league.agents import roster
    from league.track import files

    if not 1 <= trials <= MAX_TRIALS:
        raise ConfigError(f"trials is {brief(trials)}: give 1 to {MAX_TRIALS}")
    if not 0 <= seed < 2**63 - trials:
        raise ConfigError(f"seed is {brief(seed)}: give a whole number from 0 to 2^63 - trials")
    if not 0 <= variation <= 10:
        raise ConfigError(f"variation is {brief(variation)}: give 0, which is none, to 10")
    course = files.load(track) if isinstance(track, str) else track
    tracks = TrackSet(course)
    sim = SimConfig(
        kind="head_to_head" if opponents else kind,
        num_cars=1 + len(opponents),
        obstacles=obstacles or ObstacleConfig(),
        rules=replace(rules or RaceRules(), laps=laps),
        spread=dynamics(variation, start_speed(variation, 1 + len(opponents))),
    )
    drivers = [
        roster.load(one, tracks, sim.car) if isinstance(one, str) else one
        for one in (driver, *opponents)
    ]
    cfg = EnvConfig(sim=sim, solver=solver, sensors=tuple(one.sensors for one in drivers))
    run_laps = laps if course.closed else 1
    runs = [
        LapRun(number, seed + number, run_laps, mode, varied=variation > 0)
        for number in range(trials)
    ]
    for first in range(0, trials, WORLDS_AT_ONCE):
        batch = runs[first : first + WORLDS_AT_ONCE]
        batch_reward = reward(len(batch)) if reward is not None else None
        _drive(tracks, cfg, drivers, batch, batch_reward, watch)
    rows = [row for run in runs for row in run.rows]
    return Evaluation(
        driver=drivers[0].name,
        track=course.name,
        kind=sim.kind,
        mode=mode,
        solver=solver,
        laps=run_laps,
        asked=run_laps * trials,
        seed=seed,
        variation=variation,
        trials=tuple(Trial(trial=number, **row) for number, row in enumerate(rows, 1)),
        places=tuple(run.place for run in runs) if opponents else (),
    )


def start_speed(variation: float, num_cars: int) -> float:
    """Return the largest speed at the start of a run [m/s]; a grid of several cars stands."""
    return START_SPEED * variation if num_cars == 1 else 0.0


def _drive(
    tracks: TrackSet,
    cfg: EnvConfig,
    drivers: Sequence[Driver],
    runs: Sequence[LapRun],
    reward: Reward | None,
    watch: EvalCallback | None,
) -> None:
    """Drive a batch of runs to their ends, each in a world of its own."""
    recorder = None if watch is None else _WorldRecorder(reward or BuiltIn(cfg.reward))
    env = RaceEnv(tracks, cfg, num_worlds=len(runs), reward=recorder or reward)
    try:
        pool = DriverPool([drivers] * len(runs), strict=True)
        rollout = Rollout(env, pool, [run.seed for run in runs])
        while not all(run.over for run in runs):
            restart = np.array([run.restart for run in runs])
            before = env.world.cars.copy()
            step = rollout.step(restart=restart, seeds=[run.restart_seed for run in runs])
            paused, trial_steps = is_frozen(before[:, 0]).tolist(), []
            for row, run in enumerate(runs):
                if run.restart:
                    run.restart = False
                elif not run.over:
                    trial_steps.append(run.add(row, env, step, paused[row]))
            if watch is not None and recorder is not None:
                worlds = before, recorder.judged, env.world
                watch(EvalStep(tracks, cfg.sim, *worlds, step, tuple(trial_steps)))
    finally:
        env.close()


class _WorldRecorder:
    """A reward that pays what another does and keeps a copy of the worlds it was computed on."""

    def __init__(self, reward: Reward) -> None:
        self._reward, self.terms = reward, reward.terms
        self.judged: World

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: ndarray, verdicts: ndarray
    ) -> Paid:
        self.judged = world.copy()
        return self._reward(tracks, before, world, actions, verdicts)

    def restart(self, world: World, who: ndarray) -> None:
        self._reward.restart(world, who)


@dataclass
class LapRun:
    """One run from the start line: its trials so far and the counts of the current one."""

    number: int
    seed: int
    laps: int
    mode: Mode
    varied: bool = False
    rows: list[dict[str, Any]] = field(default_factory=list)
    place: int = 0
    over: bool = False
    restart: bool = False
    standing: bool = True
    steps: int = 0
    penalty_s: float = 0.0
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(MISTAKES, 0))

    @property
    def restart_seed(self) -> int:
        """Seed of the next attempt from the line; without variation all attempts are alike."""
        if not self.varied:
            return self.seed
        return rng.bits(self.seed, _ATTEMPT, len(self.rows)).item() & rng.SEED_MASK

    def add(self, row: int, env: RaceEnv, step: Step, paused: bool) -> TrialStep:
        """Count a step of this run, which is in a row of the batch.

        `paused` is whether the car served a penalty before the step.
        """
        seen, car = step.verdicts[row, 0], env.world.cars[row, 0]
        mistakes = [name for name in MISTAKES if seen[name]]
        self.steps += 1
        for name in mistakes:
            self.counts[name] += 1
        if mistakes and self.mode == "race":
            self.penalty_s += float(car["penalty_s"])
        mistake = MISTAKES[mistakes[0]] if mistakes else None
        trial, number = len(self.rows), self.steps
        ending: Status | None = "time_up" if step.truncated[row, 0] else None
        if self.mode == "episode" and mistake is not None:
            ending = mistake
        if seen["lap"]:
            ending = "lap_complete"
        if ending is not None:
            self._close(ending, car, env, row)
            self.over = len(self.rows) == self.laps or (self.mode, ending) == ("race", "time_up")
            # After a mistake the next attempt begins at the line; after a lap the car drives on.
            self.restart = not self.over and (ending != "lap_complete" or mistake is not None)
            self.standing = self.restart
        status = ending or mistake or ("pause" if paused else "in_progress")
        return TrialStep(self.number, row, trial, number, status, ending is not None)

    def _close(self, ending: Status, car: np.void, env: RaceEnv, row: int) -> None:
        race, share, time_s = env.world.row(row), 1.0, car["last_lap_s"]
        if ending != "lap_complete":
            # Beyond 0 to 1 by rounding, or behind the line.
            driven = car["best_distance"] / env.tracks.lap_length(race.track)[0] - car["laps"]
            share = min(max(float(driven), 0.0), 1.0)
            time_s = env.time_s[row] - car["lap_start_s"]
        self.rows.append(
            {
                "run": self.number,
                "seed": self.seed,
                "standing": self.standing,
                "status": ending,
                "time_s": round(float(time_s), 4),
                "completion": round(100.0 * share, 2),
                "off_tracks": self.counts["off_track"],
                "crashes": self.counts["crashed"],
                "immobilised": self.counts["immobilised"],
                "reversed": self.counts["reversed"],
                "penalty_s": round(self.penalty_s, 4),
            }
        )
        self.counts = dict.fromkeys(self.counts, 0)
        self.steps, self.penalty_s = 0, 0.0
        order = referee.running_order(race.cars, env.cfg.sim.rules.start == "pursuit")
        self.place = int(order[0, 0]) + 1
