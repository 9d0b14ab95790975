"""Results: each is taken in once, however often it is sent, and read as arrays for the rating."""

from __future__ import annotations

import json
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store.database import made_of
from league.matchmaking.store.drives import driven
from league.matchmaking.store.queue import chunked
from league.matchmaking.store.records import (
    BEST_MS,
    DRIVE_COLUMNS,
    FINISHED,
    KNOWN,
    Drives,
    HeatOutcome,
    Races,
    Received,
    StoredResult,
)
from league.matchmaking.store.schema import (
    Record,
    append,
    heats,
    log_event,
    races,
    results,
    rulesets,
)

BLOCK = 1 << 20
"""Races read at a time."""
NO_TRACK = 255
"""Number of a track that is not in the ruleset, or has a number too large for one byte."""


@dataclass(frozen=True)
class PackedResult:
    """One result ready to be stored; made before the database is locked."""

    hash: str
    """SHA-256 of places and result."""
    document: bytes
    """Places and result as deflated canonical JSON."""
    places: tuple[int, ...]
    """Of the car in each slot."""
    runs: tuple[int, ...]
    """Of the car in each slot; see Races.runs."""
    driven: str
    """See `driven`."""
    replay: str | None
    """SHA-256 of the recording."""
    machine: str
    """Class of the machine that raced it."""


def pack(outcome: HeatOutcome, replays: Sequence[str | None]) -> tuple[PackedResult, ...]:
    """Return an outcome's results ready to be stored."""
    packed_results = []
    for race, replay in zip(outcome.races, replays, strict=True):
        try:
            document = heat_spec.canonical({"places": race.places, "result": race.result})
        except (TypeError, ValueError) as refusal:
            raise StoreError(
                f"the result of heat {outcome.key[:12]} is no plain data ({refusal}): "
                "give texts, finite numbers, lists and mappings"
            ) from refusal
        packed_results.append(
            PackedResult(
                hash=heat_spec.digest(document),
                document=zlib.compress(document, 6),
                places=race.places,
                runs=_runs(race.result, len(race.places)),
                driven=driven(race.result, len(race.places)),
                replay=replay,
                machine=outcome.machine,
            )
        )
    return tuple(packed_results)


def unpack(document: bytes, replay: str | None, machine: str) -> PackedResult:
    """Return a result of which a document was stored."""
    plain = json.loads(document)
    places = tuple(plain["places"])
    return PackedResult(
        hash=heat_spec.digest(document),
        document=document,
        places=places,
        runs=_runs(plain["result"], len(places)),
        driven=driven(plain["result"], len(places)),
        replay=replay,
        machine=machine,
    )


def _runs(result: Mapping[str, Any], cars: int) -> tuple[int, ...]:
    """Return the bits of Races.runs for each car; 0 for a car that the result does not describe."""
    runs = [0] * cars
    order = result.get("order")
    for row in order if isinstance(order, list | tuple) else ():
        match row:
            case {"car": int(car), "finished": bool(finished), "lap_times_s": laps} if car < cars:
                best_ms = round(1000 * min(laps, default=0.0))
                runs[car] = KNOWN | finished * FINISHED | min(best_ms, BEST_MS)
    return tuple(runs)


def packed(
    heat: int,
    half: int,
    grid: Sequence[int],
    places: Sequence[int],
    *,
    track: int = NO_TRACK,
    runs: Sequence[int] = (),
) -> str:
    """Return a race in hexadecimal: heat, half, track; its cars' entries, their places, their runs.

    That is 12 digits, and 18 for each car. The database joins a million of these into one text,
    which numpy reads at once; as rows of columns they would take seconds.
    """
    entries = "".join(f"{number:08x}" for number in grid)
    run_digits = "".join(f"{run:08x}" for run in runs or (0,) * len(grid))
    return f"{heat:08x}{half:02x}{track:02x}{entries}{bytes(places).hex()}{run_digits}"


def _unpacked(text: str, cars: int) -> np.ndarray:
    """Return races of so many cars from their packed texts with spaces between."""
    return np.frombuffer(bytes.fromhex(text), dtype=race_type(cars))


def race_type(cars: int) -> np.dtype[Any]:
    """Return what the bytes of a packed race of so many cars are."""
    return np.dtype(
        [
            *(("heat", ">u4"), ("half", "u1"), ("track", "u1")),
            *(("entries", ">u4", (cars,)), ("places", "u1", (cars,)), ("runs", ">u4", (cars,))),
        ]
    )


@dataclass
class _Intake:
    """What a batch of results is going to change; results are (half, hash), by heat."""

    known: dict[int, set[tuple[int, str]]]
    """Results that were not rejected."""
    before: dict[int, set[tuple[int, str]]]
    """All results, rejected or not, from before this batch."""
    machines: dict[int, set[str]]
    """Classes of the machines that the known results came from."""
    tracks: dict[int, tuple[str, ...]]
    """Tracks of each ruleset, by its number."""
    new_results: list[dict[str, Any]] = field(default_factory=list)
    new_races: list[dict[str, Any]] = field(default_factory=list)
    done: set[int] = field(default_factory=set)
    disputed: set[int] = field(default_factory=set)
    unverified: set[int] = field(default_factory=set)
    """Audits that prove nothing."""
    settled: dict[int, set[tuple[int, str]]] = field(default_factory=dict)
    """Results of a dispute that a third worker found, too."""


def complete(
    connection: sa.Connection,
    now: float,
    worker: str,
    batch: Sequence[tuple[str, tuple[PackedResult, ...]]],
) -> Received:
    """Take in results of heats; the caller must hold the database's lock.

    A known result changes nothing. One that differs from what is known puts its heat in
    quarantine, unless it comes late or from an audit, and from another class of machine. One
    with a lost lease counts if no other came first. A quarantined heat that was
    lent again is settled by a result that agrees with one it has.
    """
    query = sa.select(heats).order_by(heats.c.number).with_for_update()
    rows = {row.key: row for row in chunked(connection, query, heats.c.key, [k for k, _ in batch])}
    intake = _intake(connection, sorted({row.audits or row.number for row in rows.values()}))
    keys: dict[str, list[str]] = {verdict: [] for verdict in Received.__dataclass_fields__}
    for key, sent in batch:
        if key not in rows:
            raise StoreError(f"there is no heat {key[:12]!r} in this league: give a key it planned")
        keys[_judge(intake, rows[key], sent, worker, now)].append(key)
    _write(connection, intake, now)
    counts = {verdict: len(some) for verdict, some in keys.items() if some}
    numbers = [rows[key].number for key, _ in batch]
    log_event(connection, now, worker, "complete", "", heats=numbers, **counts)
    for key in keys["quarantined"]:
        log_event(connection, now, worker, "quarantine", key, of=rows[key].audits)
    for number, kept in intake.settled.items():
        hashes = [hash for _, hash in sorted(kept)]
        log_event(connection, now, worker, "settle", str(number), kept=hashes)
    return Received(**{verdict: tuple(some) for verdict, some in keys.items()})


def _intake(connection: sa.Connection, targets: list[int]) -> _Intake:
    intake = _Intake(
        known={number: set() for number in targets},
        before={number: set() for number in targets},
        machines={number: set() for number in targets},
        tracks=tracks_of(connection),
    )
    stored = sa.select(
        results.c.heat, results.c.half, results.c.hash, results.c.rejected, results.c.machine
    )
    for row in chunked(connection, stored, results.c.heat, targets):
        intake.before[row.heat].add((row.half, row.hash))
        if not row.rejected:
            intake.known[row.heat].add((row.half, row.hash))
            intake.machines[row.heat].add(row.machine)
    return intake


def tracks_of(connection: sa.Connection) -> dict[int, tuple[str, ...]]:
    """Return the tracks of each ruleset, by its number."""
    query = sa.select(rulesets.c.number, rulesets.c.settings)
    return {number: tuple(json.loads(text)["tracks"]) for number, text in connection.execute(query)}


def _judge(
    intake: _Intake,
    row: Any,  # noqa: ANN401
    sent: tuple[PackedResult, ...],
    worker: str,
    now: float,
) -> str:
    """Note what one heat's results change; return the name of a field of Received."""
    _check_places(row, sent)
    target = row.audits or row.number
    known, hashes = intake.known[target], {(half, one.hash) for half, one in enumerate(sent)}
    if (
        not row.audits
        and target not in intake.settled
        and hashes
        and hashes <= intake.before[target]
    ):
        if row.state == "claimed" and row.worker == worker:  # the third opinion on a dispute
            intake.settled[target] = intake.known[target] = hashes
            intake.new_races += race_rows(intake.tracks, row, sent)
            intake.done.add(target)
            return "accepted"
        if not hashes <= known:
            return "repeated"  # it was rejected
        if row.state in ("planned", "claimed"):
            return "quarantined"  # an old result is no third opinion
    is_late = bool(row.audits) or row.state == "done"
    if known and not hashes <= known and is_late and sent[0].machine not in intake.machines[target]:
        intake.unverified |= {row.number} if row.audits else set()
        return "unverified"
    intake.new_results += [
        {
            "heat": target,
            "half": half,
            "hash": one.hash,
            "worker": worker,
            "received_s": now,
            "document": one.document,
            "replay": one.replay,
            "machine": one.machine,
        }
        for half, one in enumerate(sent)
        if (half, one.hash) not in known | intake.before[target]
    ]
    if not known and not row.audits:
        intake.new_races += race_rows(intake.tracks, row, sent)
    intake.known[target] = known | hashes
    intake.machines[target].add(sent[0].machine)
    if (known and not hashes <= known) or len(known) > len(sent):
        intake.disputed |= {target, row.number}
        return "quarantined"
    if known and (not row.audits or row.state == "done"):
        return "repeated"
    intake.done.add(row.number)
    return "accepted"


def _check_places(row: Any, sent: tuple[PackedResult, ...]) -> None:  # noqa: ANN401
    cars = [len(grid) for _, grid in json.loads(row.halves)]
    sent_cars = [len(one.places) for one in sent]
    if sent_cars != cars:
        raise StoreError(
            f"heat {row.key[:12]} has races of {cars} cars, results for {sent_cars} cars came: "
            "give all places of all its races"
        )
    if not all(1 <= place <= len(one.places) for one in sent for place in one.places):
        raise StoreError(
            f"the places of heat {row.key[:12]} lie outside 1 to the number of cars: "
            "count places from 1"
        )


def race_rows(
    tracks_of: Mapping[int, tuple[str, ...]],
    row: Any,  # noqa: ANN401
    sent: Sequence[PackedResult],
) -> list[dict[str, Any]]:
    """Return the rows of `races` that follow from a heat's row and its results."""
    tracks, rows = tracks_of[row.ruleset], []
    for half, ((name, grid), one) in enumerate(zip(json.loads(row.halves), sent, strict=True)):
        track = min(tracks.index(name), NO_TRACK) if name in tracks else NO_TRACK
        rows.append(
            {
                "heat": row.number,
                "half": half,
                "ruleset": row.ruleset,
                "rated": row.purpose == "rated",
                "cars": len(grid),
                "packed": packed(row.number, half, grid, one.places, track=track, runs=one.runs),
                "driven": one.driven,
            }
        )
    return rows


def ledger_record(key: str, row: Mapping[str, Any]) -> Record:
    """Return what the ledger records of a result of the heat with this key."""
    content = [key, *(row[name] for name in ("worker", "received_s", "machine", "replay"))]
    return Record("result", f"{row['heat']}/{row['half']}/{row['hash']}", content)


def _write(connection: sa.Connection, intake: _Intake, now: float) -> None:
    if intake.new_results:
        connection.execute(results.insert(), intake.new_results)
        query, numbers = sa.select(heats.c.number, heats.c.key), list(intake.known)
        key_of = dict(map(tuple, chunked(connection, query, heats.c.number, numbers)))
        append(connection, [ledger_record(key_of[row["heat"]], row) for row in intake.new_results])
    if intake.new_races:
        connection.execute(races.insert(), intake.new_races)
    for heat, kept in intake.settled.items():
        _settle(connection, heat, kept)
    changed = {
        "done": intake.done,
        "quarantined": intake.disputed,
        "cancelled": intake.unverified,
    }
    for state, numbers in changed.items():
        if numbers:
            over = {"state": state, "lease_s": None, "done_s": now}
            connection.execute(heats.update().where(heats.c.number.in_(numbers)).values(**over))
    if intake.disputed:
        connection.execute(races.delete().where(races.c.heat.in_(intake.disputed)))


def _settle(connection: sa.Connection, heat: int, kept: set[tuple[int, str]]) -> None:
    """Keep some results of a heat and reject the others; audits of it that differed are done."""
    keep = sa.or_(*((results.c.half == half) & (results.c.hash == hash) for half, hash in kept))
    of_heat = results.update().where(results.c.heat == heat)
    connection.execute(of_heat.values(rejected=sa.not_(keep)))
    append(connection, [settlement(heat, kept)])
    connection.execute(
        heats.update()
        .where(heats.c.audits == heat, heats.c.state == "quarantined")
        .values(state="done")
    )


def settlement(heat: int, kept: Iterable[tuple[int, str]]) -> Record:
    """Return what the ledger records of a settled dispute: the beginnings of the kept hashes."""
    return Record("settle", "/".join([str(heat), *(hash[:16] for _, hash in sorted(kept))]), None)


def read_results(connection: sa.Connection, numbers: Sequence[int]) -> list[StoredResult]:
    """Return all results of heats, by race and time; several for one race are a dispute."""
    query = sa.select(results).order_by(results.c.heat, results.c.half, results.c.received_s)
    stored = []
    for row in chunked(connection, query, results.c.heat, sorted(numbers)):
        document = json.loads(zlib.decompress(row.document))
        places = tuple(document["places"])
        stored.append(made_of(StoredResult, row, places=places, result=document["result"]))
    return stored


def read_races(
    connection: sa.Connection, ruleset: str, since: int = 0, *, rated: bool = True
) -> Races:
    """Return the races under a ruleset that count, those after number `since` only."""
    last = _last(connection)
    voided = connection.scalar(
        sa.select(sa.func.count()).select_from(heats).where(heats.c.state == "quarantined")
    )
    counted = _counted(ruleset, rated=rated)
    pieces = [
        _unpacked(text, cars)
        for text, cars in _joined(connection, races.c.packed, counted, since, last)
    ]
    return _stacked(pieces, max(last, since), voided or 0)


def _last(connection: sa.Connection) -> int:
    return connection.scalar(sa.select(sa.func.coalesce(sa.func.max(races.c.number), 0))) or 0


def _counted(ruleset: str, *, rated: bool) -> sa.ColumnElement[bool]:
    rules = sa.select(rulesets.c.number).where(rulesets.c.hash == ruleset).scalar_subquery()
    return sa.and_(races.c.ruleset == rules, *([races.c.rated] if rated else []))


def _joined(
    connection: sa.Connection,
    text: sa.ColumnElement[str],
    counted: sa.ColumnElement[bool],
    since: int,
    last: int,
) -> Iterator[tuple[str, int]]:
    """Yield a text of each of some races, with spaces between, and the cars that these have."""
    for start in range(since, last, BLOCK):
        block = sa.and_(races.c.number > start, races.c.number <= min(start + BLOCK, last), counted)
        fields = sa.select(races.c.cars).where(block).distinct().order_by(races.c.cars)
        for cars in connection.scalars(fields).all():
            joined = sa.select(sa.func.aggregate_strings(text, " "))
            yield connection.scalar(joined.where(block, races.c.cars == cars)) or "", cars


def read_drives(
    connection: sa.Connection, ruleset: str, since: int = 0, *, rated: bool = True
) -> Drives:
    """Return how each car drove in the races under a ruleset that count, see `read_races`."""
    last = _last(connection)
    counted = _counted(ruleset, rated=rated) & (races.c.driven != "")
    # Heat, half and track, then the entries of all cars: `packed` up to the places.
    text = sa.func.substr(races.c.packed, 1, 12 + 8 * races.c.cars) + races.c.driven
    pieces = [
        np.frombuffer(bytes.fromhex(joined), dtype=_drive_type(cars))
        for joined, cars in _joined(connection, text, counted, since, last)
    ]
    columns: dict[str, list[np.ndarray]] = {name: [] for name in DRIVE_COLUMNS}
    for piece in pieces:
        cars = piece["entry"].shape[1]
        for name in ("heat", "half", "track"):
            columns[name].append(np.repeat(piece[name].astype(np.int64), cars))
        columns["entry"].append(piece["entry"].astype(np.int64).ravel())
        for name in ("points", "distance_cm", "clean_ms"):
            columns[name].append(piece["driven"][name].astype(np.int64).ravel())
    empty = np.zeros(0, np.int64)
    stacked = {name: np.concatenate([empty, *parts]) for name, parts in columns.items()}
    return Drives(**stacked, last=max(last, since))


DRIVEN = np.dtype([("points", ">u2"), ("distance_cm", ">u4"), ("clean_ms", ">u4")])
"""What the bytes of `driven` are for each car."""


def _drive_type(cars: int) -> np.dtype[Any]:
    return np.dtype(
        [
            *(("heat", ">u4"), ("half", "u1"), ("track", "u1")),
            *(("entry", ">u4", (cars,)), ("driven", DRIVEN, (cars,))),
        ]
    )


def _stacked(pieces: list[np.ndarray], last: int, voided: int) -> Races:
    total = sum(len(piece) for piece in pieces)
    cars = max((piece["entries"].shape[1] for piece in pieces), default=2)
    stacked = Races(
        heat=np.empty(total, np.int64),
        half=np.empty(total, np.uint8),
        track=np.empty(total, np.uint8),
        entries=np.full((total, cars), -1, np.int32),
        places=np.zeros((total, cars), np.uint8),
        runs=np.zeros((total, cars), np.uint32),
        last=last,
        voided=voided,
    )
    start = 0
    for piece in pieces:
        end, width = start + len(piece), piece["entries"].shape[1]
        for name in ("heat", "half", "track"):
            getattr(stacked, name)[start:end] = piece[name]
        for name in ("entries", "places", "runs"):
            getattr(stacked, name)[start:end, :width] = piece[name]
        start = end
    return stacked
