"""Run one race: RaceSpec -> RaceResult; a pure function of the spec, the track and the drivers."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from league.agents.driver import Driver
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv, Step
from league.errors import ConfigError, PolicyError
from league.race_spec import CarResult, Entry, Event, EventKind, RaceResult, RaceSpec
from league.sim.config import CarConfig, ObstacleConfig, RaceRules, SimConfig, Spread
from league.sim.referee import NOBODY
from league.sim.world import World
from league.track.course import Track, TrackSet

if TYPE_CHECKING:
    from league.replay import Replay

FAULTS_TO_END = 25
"""Answers in a row that are no action, after which a driver's race is over."""

Watcher = Callable[[World], None]
"""Told the world at the start and after each step; it cannot change it."""


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
    from league.track import files

    sim = sim_config(spec)
    tracks = TrackSet.of(track or files.load(spec.track))
    if drivers is None:
        drivers = [_loaded(entry, tracks, sim.car) for entry in spec.entries]
    if len(drivers) != len(spec.entries):
        raise ConfigError(f"{len(drivers)} drivers for {len(spec.entries)} entries: give as many")
    cfg = EnvConfig(sim=sim, solver=spec.solver, sensors=tuple(d.sensors for d in drivers))
    with torch.inference_mode():
        return _Race(spec, tracks, cfg, drivers, record, watch).run()


class _Race:
    """One race under way."""

    def __init__(
        self,
        spec: RaceSpec,
        tracks: TrackSet,
        cfg: EnvConfig,
        drivers: Sequence[Driver],
        record: bool,
        watch: Watcher | None,
    ) -> None:
        self._spec, self._drivers, self._watch = spec, drivers, watch
        self._env = RaceEnv(tracks, cfg)
        self._book = _Book(cfg.sim.step_dt, len(drivers))
        self._faults = [0] * len(drivers)
        self._retired: set[int] = set()
        self._recorder = None
        if record:
            from league.replay import Recorder

            self._recorder = Recorder(spec, tracks)

    def run(self) -> Finished:
        env = self._env
        try:
            told = env.reset(seeds=torch.tensor([self._spec.seed]))
            for driver in self._drivers:
                driver.reset(None)
            if self._recorder:
                self._recorder.start(env.world)
            if self._watch:
                self._watch(env.world)
            while True:
                actions = self._actions(told)
                step = env.step(actions)
                told = step.observations
                self._book.note(step, env.world)
                if self._recorder:
                    self._recorder.add(env.world, env.last_action)
                if self._watch:
                    self._watch(env.world)
                if self._over(step):
                    break
            result = classify(self._spec, env.world, self._book)
        finally:
            env.close()
        replay = self._recorder.finish(result) if self._recorder else None
        return Finished(result=result, replay=replay)

    def _over(self, step: Step) -> bool:
        still_racing = ~(step.terminated | step.truncated)[0]
        for car in self._retired:
            still_racing[car] = False
        return not bool(still_racing.any())

    def _actions(self, told) -> Tensor:  # noqa: ANN001
        """Ask each driver; an answer that is no action is replaced by the last good one."""
        actions = self._env.last_action.clone()
        for car, driver in enumerate(self._drivers):
            if car in self._retired:
                continue
            answer = driver.act(told[car])
            if _is_action(answer):
                actions[:, car] = answer
                self._faults[car] = 0
                continue
            self._faults[car] += 1
            self._book.add("driver_fault", car, value=float(self._faults[car]))
            if self._faults[car] >= FAULTS_TO_END:
                self._retired.add(car)
                self._env.retire(car)
        return actions


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

    tracks, car = TrackSet.of(replay.track), sim_config(replay.spec).car
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


def _is_action(answer: object) -> bool:
    return (
        isinstance(answer, Tensor)
        and answer.shape == (1, 2)
        and answer.is_floating_point()
        and bool((answer.abs() <= 1.0).all())  # False for NaN
    )


@dataclass
class _Book:
    """The events of a race, and each car's laps, as they happen."""

    step_dt: float
    num_cars: int
    events: list[Event] = field(default_factory=list)
    laps: list[list[float]] = field(default_factory=list)
    penalties: list[float] = field(default_factory=list)
    at_wall: Tensor = field(init=False)
    steps: int = 0

    def __post_init__(self) -> None:
        self.laps = [[] for _ in range(self.num_cars)]
        self.penalties = [0.0] * self.num_cars
        self.at_wall = torch.zeros((1, self.num_cars), dtype=torch.bool)
        self.events.append(Event(time_s=0.0, kind="start", car=0))

    def add(
        self, kind: EventKind, car: int, other: int | None = None, value: float | None = None
    ) -> None:
        time_s = round(self.steps * self.step_dt, 4)
        self.events.append(Event(time_s=time_s, kind=kind, car=car, other=other, value=value))

    def note(self, step: Step, world: World) -> None:
        """Write down what the referee found in this step."""
        self.steps += 1
        seen, now = step.verdict, world.standing
        scraped = seen.wall & ~self.at_wall
        self.at_wall = seen.wall
        flags = seen.mistake | seen.lap | seen.released | seen.was_hit | scraped
        if not bool(flags.any() | seen.overtook.any() | seen.lead_changed.any()):
            return
        for car in range(self.num_cars):
            if seen.lap[0, car]:
                self.laps[car].append(round(float(now.last_lap_s[0, car]), 4))
                self.add("lap", car, value=self.laps[car][-1])
            if seen.finished[0, car]:
                self.add("finish", car, value=round(float(now.finish_s[0, car]), 4))
            self._note_mistakes(step, world, car)
            for other in seen.overtook[0, car].nonzero()[:, 0].tolist():
                self.add("overtake", car, other=other)
            if seen.was_hit[0, car]:
                self.add("contact", car)
            if scraped[0, car]:
                self.add("wall_contact", car)
        if seen.lead_changed[0]:
            self.add("lead_change", int(now.leader[0]))

    def _note_mistakes(self, step: Step, world: World, car: int) -> None:
        seen = step.verdict
        penalty = float(world.standing.penalty_s[0, car])
        named: tuple[tuple[EventKind, Tensor], ...] = (
            ("off_track", seen.off_track),
            ("immobilised", seen.immobilised),
            ("reversed", seen.reversed),
        )
        for kind, flag in named:
            if flag[0, car]:
                self.add(kind, car, value=round(penalty, 4))
        if seen.crashed[0, car]:
            car_hit, thing = int(seen.crashed_car[0, car]), int(seen.crashed_obstacle[0, car])
            if car_hit != NOBODY:
                self.add("crash", car, other=car_hit, value=round(penalty, 4))
            if thing != NOBODY:
                self.add("obstacle_contact", car, other=thing, value=round(penalty, 4))
        if seen.mistake[0, car]:
            self.penalties[car] += penalty
        if seen.released[0, car]:
            self.add("put_back", car)


def classify(spec: RaceSpec, world: World, book: _Book) -> RaceResult:
    """Return the classification of a race that is over (facts 5.4)."""
    now = world.standing
    race_s = book.steps * book.step_dt
    unplaced = []
    for car, entry in enumerate(spec.entries):
        finish_s = float(now.finish_s[0, car])
        finished = finish_s != float("inf")
        unplaced.append(
            CarResult(
                car=car,
                name=entry.name,
                place=1,
                finished=finished,
                laps=int(now.laps[0, car]),
                total_s=round(finish_s if finished else race_s, 4),
                lap_times_s=tuple(book.laps[car]),
                distance=round(float(now.best_distance[0, car]), 3),
                off_tracks=int(now.off_tracks[0, car]),
                crashes=int(now.crashes[0, car]),
                contacts_taken=int(now.contacts_taken[0, car]),
                immobilised=int(now.immobilised[0, car]),
                reversed=int(now.reversed[0, car]),
                penalty_s=round(book.penalties[car], 4),
                overtakes=int(now.overtakes[0, car]),
            )
        )
    ordered = sorted(unplaced, key=lambda car: _merit(spec, car))
    placed = [car.model_copy(update={"place": place}) for place, car in enumerate(ordered, 1)]
    return RaceResult(
        spec=spec,
        order=tuple(placed),
        steps=book.steps,
        race_s=round(race_s, 4),
        lead_changes=int(now.lead_changes[0]),
        events=tuple(book.events),
    )


def _merit(spec: RaceSpec, car: CarResult) -> tuple[float, ...]:
    """Return what to sort by: complete races first, by the spec's ranking; then by distance.

    Equal times are told apart by fewer mistakes, then by the place on the grid.
    """
    times = {
        "total": car.total_s,
        "best": car.best_lap_s or float("inf"),
        "average": car.total_s / max(car.laps, 1),
    }
    counts = car.best_lap_s is not None if spec.ranking == "best" else car.finished
    time_s = times[spec.ranking] if counts else 0.0
    mistakes = car.off_tracks + car.crashes
    return (0.0 if counts else 1.0, time_s, -car.distance, float(mistakes), float(car.car))
