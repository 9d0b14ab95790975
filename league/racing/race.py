"""Run one race: RaceSpec -> RaceResult; a pure function of the spec, the track and the drivers."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from league.agents.driver import Driver
from league.agents.driver_pool import Seat, Seats
from league.envs.config import EnvConfig, RewardConfig
from league.envs.race_env import Observations, RaceEnv, Step
from league.envs.sensor_suite import SensorSuite
from league.errors import ConfigError, PolicyError
from league.race_spec import Entry, RaceResult, RaceSpec
from league.racing.race_log import RaceLog, classify
from league.sim.config import CarConfig, ObstacleConfig, RaceRules, SimConfig, Spread
from league.sim.world import World
from league.track.track import Track, TrackSet

if TYPE_CHECKING:
    from league.replay import Replay

FAULTS_TO_END = 25
"""Answers in a row that are no action, after which a driver's race is over."""

_UNPAID = RewardConfig(progress=0.0, off_track=0.0, crash=0.0)

Watcher = Callable[[World], None]
"""Called with the live world at the start and after each step; it must not change it."""


@dataclass(frozen=True)
class Contest:
    """A race to run."""

    spec: RaceSpec
    """All that decides it."""
    track: Track | None = None
    """The course, if it is not one that ships under the spec's name."""
    drivers: Sequence[Driver] | None = None
    """Who drives, in grid order; by default loaded by the entries' names."""
    record: bool = True
    """Whether to keep a replay; it changes nothing in the race."""
    watch: Watcher | None = None
    """Told each world as it comes."""


@dataclass(frozen=True)
class Finished:
    """What a race leaves."""

    result: RaceResult
    """The classification."""
    replay: Replay | None
    """The race, step by step, if it was recorded."""


def sim_config(spec: RaceSpec) -> SimConfig:
    """Return the settings of the world that a spec asks for."""
    if spec.kind == "head_to_head" and len(spec.entries) < 2:
        raise ConfigError("a head_to_head race has 1 driver: name 2 to 8 drivers")
    if spec.kind != "head_to_head" and len(spec.entries) > 1:
        raise ConfigError(
            f"a {spec.kind} race has {len(spec.entries)} drivers: it is driven alone, name one "
            "driver, or choose kind head_to_head"
        )
    return SimConfig(
        kind=spec.kind,
        num_cars=len(spec.entries),
        obstacles=ObstacleConfig(
            count=spec.obstacles, kind=spec.obstacle_kind, random_places=spec.random_obstacles
        ),
        rules=RaceRules(
            laps=spec.laps,
            ranking=spec.ranking,
            off_track_penalty_s=spec.off_track_penalty_s,
            crash_penalty_s=spec.crash_penalty_s,
            max_time_s=spec.max_time_s,
        ),
        spread=_spread(spec.variation),
    )


def _spread(variation: float) -> Spread:
    """Return how far the cars of a race differ: as much as one's tyres and screws do in a day.

    Without it, drivers without sensors' noise repeat one race to the bit, whatever its seed, and
    a hundred such races would tell a rating no more than one.
    """
    return Spread(
        grip=0.02 * variation,
        mass=0.02 * variation,
        steering_offset=0.005 * variation,
        camera_position=0.001 * variation,
        camera_angle=0.004 * variation,
    )


def run(
    spec: RaceSpec,
    *,
    track: Track | None = None,
    drivers: Sequence[Driver] | None = None,
    record: bool = True,
    watch: Watcher | None = None,
) -> Finished:
    """Run a race from the grid to the classification.

    Args:
        spec: all that decides the race.
        track: the course, if it is not one that ships under the spec's name.
        drivers: who drives, in grid order; by default loaded by the entries' names.
        record: whether to keep a replay; it changes nothing in the race.
        watch: told each world as it comes.

    Raises:
        LeagueError: unknown drivers or track, or settings that contradict each other.
    """
    return run_together([Contest(spec, track, drivers, record, watch)])[0]


def run_together(contests: Sequence[Contest], *, patience_s: float = math.inf) -> list[Finished]:
    """Run races as one batch: each goes, to the bit, as it would alone, and the whole is faster.

    A driver that is in several of them, as one object, is asked once a step for all of its cars.

    Args:
        contests: races of the same settings but for track, seed and drivers.
        patience_s: processor time that a driver may take for an answer [s]; a later one is as good
            as none. The clock then has a say in the race: give far more than drivers need.

    Raises:
        LeagueError: as `run`; or the races are not alike.
    """
    from league.track import files

    if not contests:
        return []
    specs = [one.spec for one in contests]
    sim, solver = sim_config(specs[0]), specs[0].solver
    for spec in specs[1:]:
        if (sim_config(spec), spec.solver) != (sim, solver):
            raise ConfigError(
                f"races of seeds {specs[0].seed} and {spec.seed} have other settings: run together "
                "only races that differ in nothing but track, seed and drivers"
            )
    courses = [one.track or files.load(one.spec.track) for one in contests]
    field = [_drivers(one, course, sim.car) for one, course in zip(contests, courses, strict=True)]
    seats = Seats(field, patience_s)
    return _Batch(contests, courses, field, seats, EnvConfig(sim, solver, reward=_UNPAID)).run()


def _drivers(contest: Contest, course: Track, car: CarConfig) -> Sequence[Driver]:
    entries, drivers = contest.spec.entries, contest.drivers
    if drivers is None:
        tracks = TrackSet(course)
        drivers = [_loaded(entry, tracks, car) for entry in entries]
    if len(drivers) != len(entries):
        raise ConfigError(f"{len(drivers)} drivers for {len(entries)} entries: give as many")
    return drivers


class _Batch:
    """Races under way, a world each. A race that is over stands still until all are."""

    def __init__(
        self,
        contests: Sequence[Contest],
        courses: Sequence[Track],
        field: Sequence[Sequence[Driver]],
        seats: Seats,
        cfg: EnvConfig,
    ) -> None:
        different = {id(course): course for course in courses}
        rows = [list(different).index(id(course)) for course in courses]
        tracks = TrackSet(*different.values())
        self._env = RaceEnv(tracks, cfg, num_worlds=len(contests), track_index=rows)
        self._seats = seats
        self._races = [
            _Race(contest, tracks, replace(cfg, sensors=tuple(one.sensors for one in drivers)))
            for contest, drivers in zip(contests, field, strict=True)
        ]
        # Seats of races that are over and of drivers that were retired: nobody is asked for them.
        self._idle: set[Seat] = set()
        self._at_wall = np.zeros(self._env.world.cars.shape, np.bool_)

    def run(self) -> list[Finished]:
        env = self._env
        try:
            told = env.reset(seeds=[race.spec.seed for race in self._races])
            self._seats.reset()
            for index, race in enumerate(self._races):
                race.begin(env.world.row(index))
            while not all(race.result for race in self._races):
                step = env.step(self._actions(told))
                told = step.observations
                self._follow(step)
        finally:
            env.close()
        return [race.finished() for race in self._races]

    def _actions(self, told: Observations) -> np.ndarray:
        """Ask the drivers; an answer that is late or no action is replaced by the last good one."""
        answers = self._seats.ask(told, [race.readings for race in self._races], self._idle)
        actions = self._env.last_action
        for seat, answer in answers.items():
            if answer is not None:
                actions[seat] = answer
        for index, race in enumerate(self._races):
            for car in range(self._env.num_cars):
                seat = index, car
                if seat in self._idle or not race.fault(car, answers[seat] is None):
                    continue
                self._idle.add(seat)
                self._env.retire(car, index)
        return actions

    def _follow(self, step: Step) -> None:
        """Write down the step in each race, and end those that are over."""
        seen, env = step.verdicts, self._env
        scraped = seen["wall"] & ~self._at_wall
        self._at_wall = seen["wall"].copy()
        cars = scraped | (seen["overtook"] > 0) | seen["lead_changed"]
        for name in ("mistake", "lap", "released", "was_hit"):
            cars |= seen[name]
        news = np.any(cars, axis=1).tolist()
        ended = (step.terminated | step.truncated).tolist()
        for index, (race, noted) in enumerate(zip(self._races, news, strict=True)):
            if race.result:
                continue
            seats = [(index, car) for car in range(env.num_cars)]
            over = all(ended[index][car] or (index, car) in self._idle for index, car in seats)
            told = (seen[index], scraped[index]) if noted else None
            race.follow(env.world.row(index), told, over)
            if over and len(self._races) > 1:
                self._idle.update(seats)
                env.retire(slice(None), index)


class _Race:
    """One race under way."""

    def __init__(self, contest: Contest, tracks: TrackSet, cfg: EnvConfig) -> None:
        self.spec, self._watch = contest.spec, contest.watch
        self.result: RaceResult | None = None
        self.readings: Observations = ()
        # Its own, because the drivers of another race may carry other sensors.
        self._sensing = SensorSuite(tracks, cfg)
        self._log = RaceLog(cfg.sim.step_dt, cfg.sim.num_cars)
        self._faults = [0] * cfg.sim.num_cars
        self._recorder = None
        if contest.record:
            from league.replay import Recorder

            self._recorder = Recorder(contest.spec, tracks)

    def begin(self, world: World) -> None:
        """Take note of the grid."""
        if self._recorder:
            self._recorder.start(world)
        self._seen(world)

    def fault(self, car: int, failed: bool) -> bool:
        """Count a car's failures in a row; return whether its driver's race is over by them."""
        self._faults[car] = self._faults[car] + 1 if failed else 0
        if failed:
            self._log.add("driver_fault", car, value=float(self._faults[car]))
        return self._faults[car] >= FAULTS_TO_END

    def follow(self, world: World, news: tuple[np.ndarray, np.ndarray] | None, over: bool) -> None:
        """Take note of a step.

        Args:
            world: after it.
            news: the referee's verdicts, and who came to the wall, if there was anything.
            over: whether it was the last one.
        """
        self._log.steps += 1
        if news is not None:
            self._log.note(*news, world)
            self._sensing.refresh_after(news[0][np.newaxis])
        if self._recorder:
            self._recorder.add(world)
        if over:
            self.result = classify(self.spec, world, self._log)
        self._seen(world)

    def finished(self) -> Finished:
        """Return what the race leaves."""
        assert self.result is not None
        replay = self._recorder.finish(self.result) if self._recorder else None
        return Finished(result=self.result, replay=replay)

    def _seen(self, world: World) -> None:
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
    given = {checkpoint.digest(path): os.fspath(path) for path in checkpoints}
    drivers = [
        _loaded(entry.model_copy(update={"path": given.get(entry.digest, entry.path)}), tracks, car)
        for entry in replay.spec.entries
    ]
    again = run(replay.spec, track=replay.track, drivers=drivers)
    assert again.replay is not None
    return again.replay


def _loaded(entry: Entry, tracks: TrackSet, car: CarConfig) -> Driver:
    """Load the driver of an entry, and make sure that a policy is still the same one."""
    from league.agents import garage, roster

    whose = f"{entry.name!r} is the policy {entry.digest[:12]}"
    if entry.digest and not entry.path and entry.name not in garage.names():
        raise PolicyError(f"{whose}, but no file is named that holds it: give its checkpoint")
    try:
        driver = roster.load(entry.path or entry.name, tracks, car)
    except PolicyError as error:
        if not entry.digest:
            raise
        raise PolicyError(
            f"{whose}, which cannot be had any more: {error}; name the file that holds it now, "
            "as in `league verify REPLAY --policies FILE.pt`"
        ) from error
    found = getattr(driver, "digest", "")
    if entry.digest and found != entry.digest:
        raise PolicyError(
            f"{whose}, but {entry.path or entry.name} holds {found[:12]} now: "
            "give the file it was then, as in `league verify REPLAY --policies FILE.pt`"
        )
    return driver
