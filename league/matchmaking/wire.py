"""What a served league and its remote workers send each other, as JSON that is checked."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Any, cast

from pydantic import AfterValidator, Field, model_validator

from league.errors import LeagueError, StoreError
from league.matchmaking.pairing.heat_spec import Half, Heat, Purpose, Ruleset, canonical
from league.matchmaking.store import (
    HeatOutcome,
    HeatProgress,
    HeatRecord,
    HeatState,
    LeagueEntry,
    RaceOutcome,
)
from league.matchmaking.workers.worker import race_outcome
from league.race_spec import CarResult, FrozenModel, printable
from league.sim.config import MAX_CARS

if TYPE_CHECKING:
    from league.replay import Replay

MOST_HEATS = 64  # heats of one message
MOST_REPLAY = 4 << 20  # bytes of a recording that a worker may send, as Base64
Key = Annotated[str, Field(pattern="^[0-9a-f]{64}$")]  # SHA-256
WorkerName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_.\-]{1,80}$")]
"""Unique among the workers of a token."""
LeaseS = Annotated[float, Field(ge=1, le=600)]
Recording = Annotated[str, Field(max_length=MOST_REPLAY)]  # Base64


class Claim(FrozenModel):
    """Asks for heats."""

    worker: WorkerName
    limit: Annotated[int, Field(ge=1, le=MOST_HEATS)] = 1  # heats at most
    lease_s: LeaseS = 60.0  # they are lent again after this time without a sign [s]
    physics: Annotated[str, Field(max_length=40)]
    """Version of the worker's physics, which must be the league's."""


class LentRace(FrozenModel):
    """One race of a lent heat."""

    track: str
    grid: tuple[str, ...]  # entry ids in grid order
    seed: int


class LentHeat(FrozenModel):
    """A heat to race."""

    key: str
    number: int
    ruleset: str  # hash of its rules
    races: tuple[LentRace, ...]
    draw: int
    purpose: str
    audits: str
    attempts: int


class LentEntry(FrozenModel):
    """A driver as a worker needs it."""

    name: str
    driver: str = ""  # name of the scripted driver; empty for a policy
    blob: str = ""  # SHA-256 of a policy's weights


class Lent(FrozenModel):
    """Heats that a worker was lent, and what it needs to race them."""

    heats: tuple[LentHeat, ...] = ()
    rulesets: dict[str, dict[str, Any]] = Field(default_factory=dict[str, dict[str, Any]])
    """Settings by hash."""
    entries: dict[str, LentEntry] = Field(default_factory=dict[str, LentEntry])  # drivers by id


class Renewal(FrozenModel):
    """Renews leases."""

    worker: WorkerName
    lease_s: LeaseS = 60.0
    keys: Annotated[tuple[Key, ...], Field(max_length=1000)] = ()  # of the heats that it races


class Held(FrozenModel):
    """Heats that a worker still holds."""

    keys: tuple[str, ...] = ()


class _Document(FrozenModel):
    """A race's result as the store keeps it."""

    order: Annotated[tuple[CarResult, ...], Field(min_length=1, max_length=MAX_CARS)]
    steps: Annotated[int, Field(ge=0)]
    race_s: Annotated[float, Field(ge=0)]
    lead_changes: Annotated[int, Field(ge=0)]
    faults: Annotated[int, Field(ge=0)]
    trace: Key


class SentRace(FrozenModel):
    """How one race ended."""

    places: Annotated[
        tuple[Annotated[int, Field(ge=1, le=MAX_CARS)], ...],
        Field(min_length=1, max_length=MAX_CARS),
    ]
    """Place of the car in each grid slot."""
    result: dict[str, Any]  # the classification, as `league heat --json` prints it
    replay: Recording = ""  # empty if none is kept

    @model_validator(mode="after")
    def _is_a_result(self) -> SentRace:
        document = _Document.model_validate(self.result)
        again = canonical(document.model_dump(mode="json", exclude_unset=True))
        if again != canonical(self.result):
            raise ValueError("the result is not written as a race's: send what the worker made")
        return self


class SentHeat(FrozenModel):
    """How a heat ended."""

    key: Key
    races: Annotated[tuple[SentRace, ...], Field(min_length=1, max_length=16)]
    machine: Annotated[str, Field(max_length=200), AfterValidator(printable)] = ""
    """Class of the machine; empty where races have the same bits on all."""


class Sent(FrozenModel):
    """Results of heats."""

    worker: WorkerName
    heats: Annotated[tuple[SentHeat, ...], Field(max_length=MOST_HEATS)]


class SentProgress(FrozenModel):
    """How far a heat has come."""

    key: Key
    replays: Annotated[tuple[Recording, ...], Field(min_length=1, max_length=16)]
    """The recording of each race so far."""


class Showing(FrozenModel):
    """How far heats have come, for people who follow them."""

    worker: WorkerName
    heats: Annotated[tuple[SentProgress, ...], Field(max_length=MOST_HEATS)]


class Failure(FrozenModel):
    """A heat that could not be raced."""

    worker: WorkerName
    key: Key
    traceback: Annotated[str, Field(max_length=20_000)] = ""
    lost: bool = False  # whether its process was killed, which is no failed try


class State(FrozenModel):
    """State of a heat."""

    state: HeatState


def lent(
    records: Sequence[HeatRecord], rules: Mapping[str, Ruleset], entries: Mapping[str, LeagueEntry]
) -> Lent:
    """Return lent heats as they are sent, with their rules (by hash) and entries (by id)."""
    ids = sorted({id for record in records for id in record.heat.entries})
    return Lent(
        heats=tuple(
            LentHeat(
                key=record.heat.key,
                number=record.number,
                ruleset=record.heat.ruleset,
                races=tuple(
                    LentRace(track=half.track, grid=half.grid, seed=seed)
                    for half, seed in zip(record.heat.halves, record.seeds or (), strict=True)
                ),
                draw=record.heat.draw,
                purpose=record.heat.purpose,
                audits=record.heat.audits,
                attempts=record.attempts,
            )
            for record in records
        ),
        rulesets={one.heat.ruleset: asdict(rules[one.heat.ruleset]) for one in records},
        entries={
            id: LentEntry(name=entries[id].name, driver=str(entries[id].card["driver"]))
            if entries[id].kind == "scripted"
            else LentEntry(name=entries[id].name, blob=entries[id].blob)
            for id in ids
        },
    )


def record_of(sent: LentHeat, worker: str) -> HeatRecord:
    """Return a heat that came over the wire; a StoreError if its key is not its content's."""
    halves = tuple(Half(one.track, one.grid) for one in sent.races)
    heat = Heat(sent.ruleset, halves, sent.draw, cast("Purpose", sent.purpose), sent.audits)
    if heat.key != sent.key:
        raise StoreError(
            f"heat {sent.number} came with another key than its content has: use the same version "
            "of the program as the server"
        )
    seeds = tuple(one.seed for one in sent.races)
    return HeatRecord(heat, sent.number, "claimed", worker, sent.attempts, seeds)


def entry_of(id: str, sent: LentEntry) -> LeagueEntry:
    """Return an entry that came over the wire, with what racing it needs."""
    card = {"driver": sent.driver} if sent.driver else {"blob": sent.blob}
    kind = "scripted" if sent.driver else "policy"
    return LeagueEntry(0, id, sent.name, "", kind, False, "ranked", "", card, 0.0)


def sent_heat(outcome: HeatOutcome) -> SentHeat:
    """Return a heat's results as they are sent."""
    races = tuple(
        SentRace(
            places=one.places,
            result=dict(one.result),
            replay=_encoded(one.replay or b""),
        )
        for one in outcome.races
    )
    return SentHeat(key=outcome.key, races=races, machine=outcome.machine)


def outcome_of(sent: SentHeat, record: HeatRecord, names: Mapping[str, str]) -> HeatOutcome:
    """Return the results that a stranger's worker sent, checked as far as one can without racing.

    A recording must be of this race, with the names of its entries (given by id), and the result
    must be what follows from it; results that contradict the heat, or each other, are a StoreError.
    """
    halves = record.heat.halves
    if len(sent.races) != len(halves):
        raise StoreError(f"heat {record.number} has {len(halves)} races, {len(sent.races)} came")
    races = []
    for number, (race, half) in enumerate(zip(sent.races, halves, strict=True)):
        if not len(race.places) == len(race.result["order"]) == len(half.grid):
            raise StoreError(f"a race of heat {record.number} has {len(half.grid)} cars: send all")
        outcome = RaceOutcome(race.places, race.result, _decoded(race.replay) or None)
        if outcome.replay is not None:
            replay = recording_of(outcome.replay, record, number, names)
            if race_outcome(replay, outcome.replay) != outcome:
                raise StoreError(
                    f"a result of heat {record.number} does not follow from its recording: "
                    "send both"
                )
        races.append(outcome)
    return HeatOutcome(sent.key, tuple(races), sent.machine)


def sent_progress(one: HeatProgress) -> SentProgress:
    """Return how far a heat has come as it is sent."""
    return SentProgress(key=one.key, replays=tuple(map(_encoded, one.replays)))


def progress_of(sent: SentProgress) -> HeatProgress:
    """Return how far a heat has come, as it came over the wire; a StoreError for no Base64."""
    return HeatProgress(sent.key, tuple(map(_decoded, sent.replays)))


def _encoded(replay: bytes) -> str:
    return base64.b64encode(replay).decode("ascii")


def _decoded(replay: str) -> bytes:
    try:
        return base64.b64decode(replay, validate=True)
    except ValueError as error:
        raise StoreError("a recording is no Base64: send it as the worker made it") from error


def recording_of(content: bytes, record: HeatRecord, race: int, names: Mapping[str, str]) -> Replay:
    """Return the recording that a stranger's worker sent of a race (from 0) of a heat with seeds.

    One that is broken, or of another race than this one of the entries with these names (given by
    id), is a StoreError.
    """
    from league.replay import format as replay_format

    try:
        replay = replay_format.decode(content)
    except LeagueError as error:
        raise StoreError(f"a recording of heat {record.number} {error}") from error
    half, spec = record.heat.halves[race], replay.result.spec
    own = half.track, (record.seeds or ())[race], [names[id] for id in half.grid]
    if (spec.track, spec.seed, [one.name for one in spec.entries]) != own:
        raise StoreError(f"a recording of heat {record.number} is of another race: send its own")
    return replay
