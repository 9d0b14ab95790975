"""A worker races heats: a job holds all it needs, so it knows nothing of the database."""

from __future__ import annotations

import hashlib
import traceback
from collections import OrderedDict
from collections.abc import Mapping
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING

from league.errors import ConfigError
from league.matchmaking.pairing.heat_spec import Half, Ruleset
from league.matchmaking.ratings.results import Run, places_of
from league.matchmaking.store.records import Outcome, RaceOutcome
from league.sim.version import PHYSICS

if TYPE_CHECKING:
    from league.agents.checkpoint import Checkpoint
    from league.agents.driver import Driver
    from league.race_spec import RaceResult
    from league.racing.race import FinishedRace, RaceJob
    from league.sim.config import CarConfig
    from league.track.track import Track, TrackSet

KEPT = 64
"""Drivers and checkpoints that a worker keeps ready."""
TOO_LATE_S = 2.0
"""Processor time after which an answer is too late [s]: eighty times what a submission may take, so
that whether an honest driver is late never depends on the machine."""


@dataclass(frozen=True)
class Contestant:
    """Who drives, as a worker needs it."""

    id: str
    """Entry id."""
    name: str
    """Name shown in the replay."""
    scripted: str = ""
    """Name of the scripted driver; empty for a policy."""
    weights: bytes = b""
    """The entry's safetensors file; empty for a scripted driver."""


@dataclass(frozen=True)
class Job:
    """A heat to race."""

    key: str
    """Key of the heat."""
    number: int
    """Number of the heat, for people."""
    halves: tuple[Half, ...]
    """Its races."""
    seeds: tuple[int, ...]
    """Seed of each race."""
    ruleset: Ruleset
    """By which rules."""
    field: Mapping[str, Contestant]
    """Who takes part, by id."""
    keep_replays: bool = True
    """Whether the recordings are handed in; their hashes always are."""


@dataclass(frozen=True)
class Report:
    """How a job went."""

    key: str
    """Key of the heat."""
    outcome: Outcome | None
    """Its results; None if it could not be raced."""
    traceback: str = ""
    """Why not."""
    wall_s: float = 0.0
    """Time it took [s]."""
    race_s: float = 0.0
    """Race time driven [s]."""


def check_physics(rules: Ruleset, what: str) -> None:
    """Refuse to race by another version of the physics than this program's.

    Raises:
        ConfigError: it is another one.
    """
    if rules.physics != PHYSICS:
        raise ConfigError(
            f"{what} is raced by physics {rules.physics}, this program has {PHYSICS}: "
            "use the version of the program that the league was made with"
        )


class Pit:
    """A worker's bench: it races jobs, and keeps drivers ready from one job to the next."""

    def __init__(self) -> None:
        self._drivers: OrderedDict[tuple[str, str], Driver] = OrderedDict()
        self._checkpoints: OrderedDict[str, Checkpoint] = OrderedDict()
        self._courses: dict[str, Track] = {}

    def race(self, job: Job) -> Report:
        """Race a heat; whatever goes wrong is told, never raised."""
        start = perf_counter()
        try:
            races = self._races(job)
            told = tuple(outcome_of(one, keep_replay=job.keep_replays) for one in races)
        except Exception:
            # The season goes on without this heat; its traceback is kept.
            return Report(job.key, None, traceback.format_exc(), perf_counter() - start)
        outcome = Outcome(job.key, told)
        driven = sum(one.result.race_s for one in races)
        return Report(job.key, outcome, "", perf_counter() - start, driven)

    def _races(self, job: Job) -> list[FinishedRace]:
        """Race all halves at once, as one batch: each goes as it would alone."""
        from league.racing import race

        races = [self._race_job(job, *one) for one in zip(job.halves, job.seeds, strict=True)]
        return race.run_together(races, patience_s=TOO_LATE_S)

    def _race_job(self, job: Job, half: Half, seed: int) -> RaceJob:
        from league.race_spec import checked
        from league.racing import race
        from league.track import files
        from league.track.track import TrackSet

        rules = job.ruleset
        # The same object each time: scripted drivers seek their line once for a track.
        if half.track not in self._courses:
            self._courses[half.track] = files.load(half.track)
        course = self._courses[half.track]
        field = [job.field[id] for id in half.grid]
        spec = checked(
            {
                "track": course.name,
                "kind": rules.kind,
                "laps": rules.laps,
                "seed": seed,
                "solver": rules.solver,
                "max_time_s": rules.max_time_s,
                "variation": rules.variation,
                "entries": [self._named(who) for who in field],
            }
        )
        tracks, car = TrackSet(course), race.sim_config(spec).car
        drivers = [self._driver(who, tracks, car) for who in field]
        return race.RaceJob(spec, course, drivers)

    def _named(self, who: Contestant) -> dict[str, str]:
        digest = "" if who.scripted else self._checkpoint(who).digest
        return {"name": who.name, "digest": digest}

    def _checkpoint(self, who: Contestant) -> Checkpoint:
        from league.matchmaking import submission

        if who.id not in self._checkpoints:
            self._checkpoints[who.id] = submission.unpack(who.weights, f"the entry {who.name!r}")
            _trim(self._checkpoints)
        return self._checkpoints[who.id]

    def _driver(self, who: Contestant, tracks: TrackSet, car: CarConfig) -> Driver:
        """Return the one driver of all of an entry's seats; scripted ones are built for a track."""
        from league.agents import roster
        from league.agents.policy import Policy

        place = (who.id, tracks.tracks[0].name if who.scripted else "")
        if place not in self._drivers:
            self._drivers[place] = (
                roster.load(who.scripted, tracks, car)
                if who.scripted
                else Policy(self._checkpoint(who), car, name=who.name)
            )
            _trim(self._drivers)
        self._drivers.move_to_end(place)
        return self._drivers[place]


def _trim(kept: OrderedDict) -> None:
    while len(kept) > KEPT:
        kept.popitem(last=False)


def outcome_of(finished: FinishedRace, *, keep_replay: bool = True) -> RaceOutcome:
    """Return a race's outcome as the store keeps it.

    The result holds the hash of every step's state and action, so that an audit notices a race
    that went another way to the same places.
    """
    from league.replay import format as replay_format

    assert finished.replay is not None
    columns, result = finished.replay.columns, finished.result
    told = result.model_dump(mode="json", exclude={"spec", "events"})
    told["faults"] = sum(event.kind == "driver_fault" for event in result.events)
    told["trace"] = hashlib.sha256(columns.checksum.astype("<u4").tobytes()).hexdigest()
    return RaceOutcome(
        places=places(result),
        result=told,
        replay=replay_format.encode(finished.replay) if keep_replay else None,
    )


def places(result: RaceResult) -> tuple[int, ...]:
    """Return the place of the car in each grid slot; equal runs share one."""
    from league.racing.race import FAULTS_TO_END

    cars = sorted(result.order, key=lambda car: car.car)
    last_word = dict.fromkeys(range(len(cars)), result.race_s)
    for event in result.events:
        if event.kind == "driver_fault" and event.value == FAULTS_TO_END:
            last_word[event.car] = event.time_s
    return places_of(
        [
            Run(car.total_s, car.laps)
            if car.finished
            else Run(None, car.laps, car.distance, last_word[car.car])
            for car in cars
        ]
    )
