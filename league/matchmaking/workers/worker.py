"""A worker races heats: a job holds all it needs, so it knows nothing of the database."""

from __future__ import annotations

import math
import platform
import struct
import traceback
from collections import deque
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib import metadata
from time import perf_counter
from typing import TYPE_CHECKING

from league.errors import ConfigError
from league.matchmaking.pairing.heat_spec import Half, Ruleset, digest
from league.matchmaking.store.records import HeatOutcome, HeatProgress, RaceOutcome
from league.sim import PHYSICS

if TYPE_CHECKING:
    from league.agents.checkpoint import Checkpoint
    from league.envs.driver import Driver
    from league.race_spec import RaceResult
    from league.racing.race import RaceJob
    from league.replay.replay import Replay
    from league.sim.config import CarConfig
    from league.track.track import Track

KEPT = 64  # drivers and checkpoints that a worker keeps ready
TOO_LATE_S = 2.0
"""Processor time after which an answer is too late [s]: eighty times what a submission may take, so
that whether an honest driver is late never depends on the machine."""
JOB_LIMIT_S = 1800.0  # a heat that takes longer than this is stuck: its worker is ended [s]
SHOWN_EVERY_S = 1.0  # a worker sends so often how far its heat has come [s]
_FUNCTIONS = (math.sin, math.cos, math.tan, math.asin, math.acos, math.atan, math.exp)


@dataclass(frozen=True)
class HeatDriver:
    """An entry as a worker needs it."""

    id: str
    name: str  # name shown in the replay
    scripted: str = ""  # name of the scripted driver; empty for a policy
    weights: bytes = field(default=b"", compare=False, repr=False)
    """The entry's safetensors file; empty for a scripted driver."""


@dataclass(frozen=True)
class HeatJob:
    """A heat to race."""

    key: str
    number: int  # number of the heat, for messages
    halves: tuple[Half, ...]
    seeds: tuple[int, ...]  # seed of each race
    ruleset: Ruleset
    drivers: Mapping[str, HeatDriver]  # by entry id
    keep_replays: bool = True  # whether the recordings are handed in; their hashes always are


@dataclass(frozen=True)
class HeatReport:
    """How a job went."""

    key: str
    outcome: HeatOutcome | None  # its results; None if it could not be raced
    traceback: str = ""  # why it could not
    wall_s: float = 0.0  # time it took [s]
    race_s: float = 0.0  # race time driven [s]
    lost: bool = False  # whether its worker was killed, which is not the race's fault


def check_physics(rules: Ruleset, what: str) -> None:
    """Raise a ConfigError if the rules are of another version of the physics."""
    if rules.physics != PHYSICS:
        raise ConfigError(
            f"{what} is raced with physics {rules.physics}, and this program has {PHYSICS}: use "
            "the version of the program that the league was made with, or go on under this one's "
            "with `league upgrade --physics`, where ratings begin again"
        )


class RaceWorker:
    """Races jobs, and keeps drivers ready from one job to the next."""

    def __init__(self) -> None:
        from league.track import files

        # The same object each time: scripted drivers search their line once for a track.
        self._track = cache(files.load)
        self._checkpoint = lru_cache(KEPT)(_checkpoint)
        self._driver = lru_cache(KEPT)(self._made_driver)

    def race(self, job: HeatJob) -> HeatReport:
        """Race a heat; whatever fails is in the report, never raised."""
        report = deque(self.follow(job), maxlen=1).pop()
        assert isinstance(report, HeatReport)
        return report

    def follow(self, job: HeatJob) -> Iterator[HeatProgress | HeatReport]:
        """Race a heat; yield how far it has come now and then, and last the report; see `race`."""
        from league.racing.race import Batch
        from league.replay import format as replay_format

        start, outcomes = perf_counter(), list[RaceOutcome]()
        try:
            jobs = [self._race_job(job, *one) for one in zip(job.halves, job.seeds, strict=True)]
            # All as one batch: each goes as it would alone.
            batch, shown = Batch(jobs, patience_s=TOO_LATE_S), start
            for _ in batch.steps():
                if perf_counter() - shown > SHOWN_EVERY_S:
                    yield HeatProgress(job.key, tuple(map(replay_format.encode, batch.so_far())))
                    shown = perf_counter()
            races = batch.finished()
            for one in races:
                assert one.replay is not None
                recording = replay_format.encode(one.replay) if job.keep_replays else None
                outcomes.append(race_outcome(one.replay, recording))
        except Exception:
            # The season goes on without this heat; its traceback is kept.
            yield HeatReport(job.key, None, traceback.format_exc(), perf_counter() - start)
            return
        race_s = sum(one.result.race_s for one in races)
        machine = machine_class() if job.ruleset.solver == "bullet" else ""
        outcome = HeatOutcome(job.key, tuple(outcomes), machine)
        yield HeatReport(job.key, outcome, "", perf_counter() - start, race_s)

    def _race_job(self, job: HeatJob, half: Half, seed: int) -> RaceJob:
        from league.race_spec import RaceSpec, checked
        from league.racing import race

        rules, track = job.ruleset, self._track(half.track)
        grid, entries = [job.drivers[id] for id in half.grid], list[dict[str, str]]()
        for driver in grid:
            weights = "" if driver.scripted else self._checkpoint(driver).digest
            entries.append({"name": driver.name, "digest": weights})
        given = {name: getattr(rules, name) for name in vars(rules).keys() & RaceSpec.model_fields}
        spec = checked({**given, "track": track.name, "seed": seed, "entries": entries})
        car = race.sim_config(spec).car
        drivers = [self._driver(one, track if one.scripted else None, car) for one in grid]
        return race.RaceJob(spec, track, drivers)

    def _made_driver(self, entry: HeatDriver, track: Track | None, car: CarConfig) -> Driver:
        """Return the driver of all cars of an entry; scripted ones are built for a track."""
        from league.agents import roster
        from league.agents.policy import Policy
        from league.track.track import TrackSet

        if track is None:
            return Policy(self._checkpoint(entry), car, name=entry.name)
        return roster.load(entry.scripted, TrackSet(track), car)


def _checkpoint(entry: HeatDriver) -> Checkpoint:
    from league.matchmaking import submission

    return submission.unpack(entry.weights, f"the entry {entry.name!r}")


def race_outcome(replay: Replay, recording: bytes | None) -> RaceOutcome:
    """Return a race's outcome as the store keeps it, with its recording or without.

    It holds the hash of every step's state and action, so that an audit notices a race that went
    another way to the same places.
    """
    result = replay.result
    document = result.model_dump(mode="json", exclude={"spec", "events"})
    if result.spec.rules == "deepracer":
        # Results of leagues made before the other rules hold no touches; an audit compares hashes.
        for car in document["order"]:
            del car["touches"]
    document["faults"] = sum(event.kind == "driver_fault" for event in result.events)
    document["trace"] = digest(replay.columns.checksum.astype("<u4").tobytes())
    return RaceOutcome(places=places(result), result=document, replay=recording)


def places(result: RaceResult) -> tuple[int, ...]:
    """Return the place of the car in each grid slot; equal runs share a place.

    Finishers are ordered by time, the others by laps, distance and when their race ended.
    """
    from league.racing.race import FAULTS_TO_END

    cars = sorted(result.order, key=lambda car: car.car)
    end_s = dict.fromkeys(range(len(cars)), result.race_s)
    for event in result.events:
        if event.kind == "driver_fault" and event.value == FAULTS_TO_END:
            end_s[event.car] = event.time_s
    worth = [
        (1, -car.total_s, 0.0, 0.0)
        if car.finished
        else (0, float(car.laps), car.distance, end_s[car.car])
        for car in cars
    ]
    return tuple(1 + sum(other > own for other in worth) for own in worth)


@cache
def machine_class() -> str:
    """Return the architecture, a hash of PyBullet's machine code, and one of libm's answers.

    Races in Bullet have the same bits on machines of one class. All else is computed in the same
    order with portable functions; Bullet calls the machine's libm (docs/physics.md), and its
    answers show its version and which features of the processor it uses.
    """
    answers = [function(n / 4096) for n in range(-4095, 4096) for function in _FUNCTIONS]
    answers += [math.atan2(n / 64, 1 - n / 97) for n in range(4096)]
    libm = digest(struct.pack(f"<{len(answers)}d", *answers))[:12]
    return f"{platform.machine()} pybullet:{_pybullet()} libm:{libm}"[:200]


def _pybullet() -> str:
    """Return a hash of PyBullet's machine code as its installer recorded it, or its version."""
    for file in metadata.files("pybullet") or ():
        if len(file.parts) == 1 and file.name.startswith("pybullet.") and file.hash:
            return digest(file.hash.value.encode())[:12]
    return metadata.version("pybullet")
