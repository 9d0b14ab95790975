"""Run one race: RaceSpec -> RaceResult; a pure function of the spec, the track and the drivers."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from league.agents.rollout import DriverPool, Rollout
from league.envs.config import EnvConfig, RewardConfig
from league.envs.driver import Driver
from league.envs.race_env import Observations, RaceEnv, Step
from league.envs.sensor_suite import SensorSuite
from league.errors import ConfigError, PolicyError
from league.race_spec import Entry, Event, RaceResult, RaceSpec
from league.racing.race_log import RaceLog, classify
from league.sim.config import RULES, CarConfig, DynamicsRandomization, ObstacleConfig, SimConfig
from league.sim.records import World
from league.track.track import Track, TrackSet

if TYPE_CHECKING:
    from league.replay import Replay

FAULTS_TO_END = 25  # answers in a row that are no action, after which a driver's race is over

_UNPAID = RewardConfig(progress=0.0, off_track=0.0, crash=0.0)

WorldCallback = Callable[[World], None]
"""Called with the live world at the start and after each step; it must not change it."""


@dataclass(frozen=True)
class RaceJob:
    """A race to run."""

    spec: RaceSpec  # all that decides it
    track: Track | None = None  # the course, if it is not one that ships under the spec's name
    # the drivers in grid order; by default loaded by the entries' names
    drivers: Sequence[Driver] | None = None
    record: bool = True  # whether to keep a replay; it changes nothing in the race
    watch: WorldCallback | None = None
    # called with each event of the log as it happens, before `watch` of that step
    listen: Callable[[Event], None] | None = None


@dataclass(frozen=True)
class FinishedRace:
    """What a race leaves."""

    result: RaceResult  # the classification
    replay: Replay | None  # the race, step by step, if it was recorded


def sim_config(spec: RaceSpec) -> SimConfig:
    """Return the settings of the world that a spec asks for."""
    if spec.kind == "head_to_head" and len(spec.entries) < 2:
        raise ConfigError("a head_to_head race has 1 driver: name 2 to 8 drivers")
    if spec.kind == "time_trial" and len(spec.entries) > 1:
        raise ConfigError(
            f"a time_trial race has {len(spec.entries)} drivers: it is driven alone, name one "
            "driver, or choose kind head_to_head"
        )
    return SimConfig(
        kind=spec.kind,
        num_cars=len(spec.entries),
        obstacles=ObstacleConfig(
            count=spec.obstacles, kind=spec.obstacle_kind, random_places=spec.random_obstacles
        ),
        rules=replace(
            RULES[spec.rules],
            laps=spec.laps,
            start="pursuit" if spec.format == "pursuit" else "standing",
            ranking=spec.ranking,
            off_track_penalty_s=spec.off_track_penalty_s,
            crash_penalty_s=spec.crash_penalty_s,
            max_time_s=spec.max_time_s,
        ),
        spread=dynamics(spec.variation, spec.start_speed),
    )


def dynamics(variation: float, start_speed: float) -> DynamicsRandomization:
    """Return how far the cars of a race differ: as one car does within a day of racing.

    Without it drivers without sensor noise repeat one race to the bit, whatever its seed, and a
    hundred such races would give a rating no more information than one.
    """
    return DynamicsRandomization(
        grip=0.02 * variation,
        mass=0.02 * variation,
        steering_offset=0.005 * variation,
        camera_position=0.001 * variation,
        camera_angle=0.004 * variation,
        start_speed=start_speed,
    )


def run(
    spec: RaceSpec,
    *,
    track: Track | None = None,
    drivers: Sequence[Driver] | None = None,
    record: bool = True,
    watch: WorldCallback | None = None,
    listen: Callable[[Event], None] | None = None,
) -> FinishedRace:
    """Run a race from the grid to the classification; see RaceJob for the arguments.

    Raises:
        LeagueError: unknown drivers or track, or settings that contradict each other.
    """
    return run_together([RaceJob(spec, track, drivers, record, watch, listen)])[0]


def run_together(jobs: Sequence[RaceJob], *, patience_s: float = math.inf) -> list[FinishedRace]:
    """Run races as one batch: each goes, to the bit, as it would alone, and the whole is faster.

    A driver that is in several of them, as one object, is asked once a step for all of its cars.

    Args:
        jobs: races of the same settings but for track, seed and drivers.
        patience_s: processor time that a driver may take for an answer [s]; a later one is as good
            as none. The clock then has a say in the race: give far more than drivers need.

    Raises:
        LeagueError: as `run`; or the races are not alike.
    """
    if not jobs:
        return []
    batch = Batch(jobs, patience_s=patience_s)
    for _ in batch.steps():
        pass
    return batch.finished()


def _drivers(job: RaceJob, course: Track, car: CarConfig) -> Sequence[Driver]:
    entries, drivers = job.spec.entries, job.drivers
    if drivers is None:
        tracks = TrackSet(course)
        drivers = [_loaded(entry, tracks, car) for entry in entries]
    if len(drivers) != len(entries):
        raise ConfigError(f"{len(drivers)} drivers for {len(entries)} entries: give as many")
    return drivers


class Batch:
    """Races under way, a world each. A race that is over stands still until all are."""

    def __init__(self, jobs: Sequence[RaceJob], *, patience_s: float = math.inf) -> None:
        """Put the cars of at least one race on their grids; see `run_together`."""
        from league.track import files

        first = jobs[0].spec
        cfg = EnvConfig(sim_config(first), first.solver, reward=_UNPAID)
        for other in (job.spec for job in jobs[1:]):
            if (sim_config(other), other.solver) != (cfg.sim, cfg.solver):
                raise ConfigError(
                    f"races of seeds {first.seed} and {other.seed} have other settings: run "
                    "together only races that differ in nothing but track, seed and drivers"
                )
        courses = [job.track or files.load(job.spec.track) for job in jobs]
        different = {id(course): course for course in courses}
        track_index = [list(different).index(id(course)) for course in courses]
        tracks = TrackSet(*different.values())
        drivers = [
            _drivers(job, course, cfg.sim.car) for job, course in zip(jobs, courses, strict=True)
        ]
        self._env = RaceEnv(tracks, cfg, num_worlds=len(jobs), track_index=track_index)
        self._pool = DriverPool(drivers, patience_s=patience_s)
        # Sensors of their own, because the drivers of another race may carry other ones.
        self._races = [
            _RunningRace(job, tracks, replace(cfg, sensors=tuple(one.sensors for one in field)))
            for job, field in zip(jobs, drivers, strict=True)
        ]
        self._at_wall = np.zeros(self._env.world.cars.shape, np.bool_)

    def steps(self) -> Iterator[None]:
        """Drive the races to their ends; yield after each control step."""
        env, races = self._env, self._races
        try:
            rollout = Rollout(env, self._pool, [race.spec.seed for race in races], self._on_faults)
            for index, race in enumerate(races):
                race.observe(env.world.row(index))
            while not all(race.result for race in races):
                self._follow(rollout.step([race.readings for race in races]))
                yield
        finally:
            env.close()

    def so_far(self) -> list[Replay]:
        """Return the recordings up to now; the cars are classified as if the race ended here."""
        return [race.so_far(self._env.world.row(at)) for at, race in enumerate(self._races)]

    def finished(self) -> list[FinishedRace]:
        """Return what the races leave, all of which are over."""
        return [race.finished() for race in self._races]

    def _on_faults(self, faults: np.ndarray) -> None:
        """Count each driver's faults, and retire it after too many in a row."""
        for index, race in enumerate(self._races):
            for car in range(self._env.num_cars):
                seat = index, car
                if not self._pool.idle[seat] and race.fault(car, bool(faults[seat])):
                    self._pool.idle[seat] = True
                    self._env.retire(car, index)

    def _follow(self, step: Step) -> None:
        """Log the step in each race, and end those that are over."""
        verdicts, env, idle = step.verdicts, self._env, self._pool.idle
        scraped = verdicts["wall"] & ~self._at_wall
        self._at_wall = verdicts["wall"].copy()
        cars = scraped | (verdicts["overtook"] > 0) | verdicts["lead_changed"]
        for name in ("mistake", "lap", "released", "was_hit", "touched", "forced_off"):
            cars |= verdicts[name]
        eventful = np.any(cars, axis=1).tolist()
        ended = np.all(step.terminated | step.truncated | idle, axis=1).tolist()
        for index, (race, over) in enumerate(zip(self._races, ended, strict=True)):
            if race.result:
                continue
            news = (verdicts[index], scraped[index]) if eventful[index] else None
            race.follow(env.world.row(index), news, over)
            if over and len(self._races) > 1:
                idle[index] = True
                env.retire(slice(None), index)


class _RunningRace:
    def __init__(self, job: RaceJob, tracks: TrackSet, cfg: EnvConfig) -> None:
        self.spec, self._watch = job.spec, job.watch
        self.result: RaceResult | None = None
        self.readings: Observations = ()
        self._sensing = SensorSuite(tracks, cfg)
        self._log = RaceLog(cfg.sim.step_dt, cfg.sim.num_cars, listen=job.listen)
        self._faults = [0] * cfg.sim.num_cars
        self._recorder = None
        if job.record:
            from league.replay import Recorder

            self._recorder = Recorder(job.spec, tracks)

    def fault(self, car: int, failed: bool) -> bool:
        """Count a car's failures in a row; return whether its driver's race is over by them."""
        self._faults[car] = self._faults[car] + 1 if failed else 0
        if failed:
            self._log.add("driver_fault", car, value=float(self._faults[car]))
        return self._faults[car] >= FAULTS_TO_END

    def follow(self, world: World, news: tuple[np.ndarray, np.ndarray] | None, over: bool) -> None:
        """Log a step, after which the race is `world`.

        `news`, if there are any, are the verdicts and which cars came to the wall in this step.
        """
        self._log.steps += 1
        if news is not None:
            self._log.note(*news, world)
            self._sensing.refresh_after(news[0][np.newaxis])
        if over:
            self.result = classify(self.spec, world, self._log)
        self.observe(world)

    def so_far(self, world: World) -> Replay:
        """Return the recording up to now, when the race is `world`."""
        assert self._recorder is not None
        return self._recorder.finish(self.result or classify(self.spec, world, self._log))

    def finished(self) -> FinishedRace:
        assert self.result is not None
        replay = self._recorder.finish(self.result) if self._recorder else None
        return FinishedRace(result=self.result, replay=replay)

    def observe(self, world: World) -> None:
        """Record and show the race as it is; read the sensors, unless it is over."""
        if self._recorder:
            self._recorder.add(world)
        if self._watch:
            self._watch(world)
        if self.result is None:
            self.readings = self._sensing.read(world)


def rerun(replay: Replay, checkpoints: Sequence[str | os.PathLike[str]] = ()) -> Replay:
    """Run a recorded race again, with the drivers its spec names, and return the new recording.

    Args:
        replay: the recorded race.
        checkpoints: files among which the policies are found by their digests; those that are not
            among them are looked for where they were when the race was driven.

    Raises:
        PolicyError: a policy's file is gone, or holds another policy now.
    """
    from league.agents import checkpoint

    tracks, car = TrackSet(replay.track), sim_config(replay.spec).car
    paths = {checkpoint.load(path).digest: os.fspath(path) for path in checkpoints}
    drivers = [
        _loaded(entry.model_copy(update={"path": paths.get(entry.digest, entry.path)}), tracks, car)
        for entry in replay.spec.entries
    ]
    again = run(replay.spec, track=replay.track, drivers=drivers)
    assert again.replay is not None
    return again.replay


def _loaded(entry: Entry, tracks: TrackSet, car: CarConfig) -> Driver:
    """Load the driver of an entry, and make sure that a policy is still the same one."""
    from league.agents import roster

    policy = f"{entry.name!r} is the policy {entry.digest[:12]}"
    if entry.digest and not entry.path and entry.name not in roster.garage():
        raise PolicyError(f"{policy}, but no file is named that holds it: give its checkpoint")
    try:
        driver = roster.load(entry.path or entry.name, tracks, car)
    except PolicyError as error:
        if not entry.digest:
            raise
        raise PolicyError(
            f"{policy}, which is not available: {error}; name the file that holds it now, "
            "as in `league verify REPLAY --policies FILE.pt`"
        ) from error
    digest = getattr(driver, "digest", "")
    if entry.digest and digest != entry.digest:
        raise PolicyError(
            f"{policy}, but {entry.path or entry.name} holds {digest[:12]} now: "
            "give the file it was then, as in `league verify REPLAY --policies FILE.pt`"
        )
    return driver


QUALIFYING_LAPS = 2
"""Laps of a qualifying run: one from rest, and a flying one; the better one counts."""


def qualifying_laps(spec: RaceSpec, track: Track) -> list[float]:
    """Return the best lap of each driver of a race alone on the track [s], infinite for none.

    All drive the same car, of the seed's variation, by the rules and physics of the race.

    Raises:
        LeagueError: as `race.run`.
    """
    race = {"kind": "time_trial", "laps": QUALIFYING_LAPS, "format": "standing"}
    alone = {**race, "obstacles": 0, "max_time_s": 0.0}
    jobs = [
        RaceJob(spec.model_copy(update={**alone, "entries": (entry,)}), track, record=False)
        for entry in spec.entries
    ]
    return [finished.result.order[0].best_lap_s or math.inf for finished in run_together(jobs)]


def line_up(spec: RaceSpec, laps: Sequence[float]) -> RaceSpec:
    """Return the spec with its entries by their laps: the fastest first, in a reverse grid last.

    Equal laps keep the order in which they are given.
    """
    sign = -1.0 if spec.format == "reverse" else 1.0
    order = sorted(range(len(laps)), key=lambda car: sign * laps[car])
    return spec.model_copy(update={"entries": tuple(spec.entries[car] for car in order)})
