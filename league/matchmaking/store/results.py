"""Results: taken in once, whatever is sent how often, and given out as arrays for the rating."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store import audit_log
from league.matchmaking.store.database import insert_new
from league.matchmaking.store.queue import chunked
from league.matchmaking.store.records import (
    BEST_MS,
    FINISHED,
    TOLD,
    Outcome,
    Races,
    Received,
    StoredResult,
)
from league.matchmaking.store.schema import heats, races, results, rulesets

BLOCK = 1 << 20
"""Races read at a time."""
NO_TRACK = 255
"""Stands for a track whose number in the ruleset has no room."""


@dataclass(frozen=True)
class Parcel:
    """One result ready to be stored; made before the database is locked."""

    hash: str
    """Of places and result."""
    document: bytes
    """Places and result as deflated canonical JSON."""
    places: tuple[int, ...]
    """Of the car in each slot."""
    runs: tuple[int, ...]
    """Of the car in each slot; see Races.runs."""
    replay: str | None
    """Digest of the recording."""


def parcels(outcome: Outcome, replays: Sequence[str | None]) -> tuple[Parcel, ...]:
    """Return an outcome's results ready to be stored."""
    made = []
    for race, replay in zip(outcome.races, replays, strict=True):
        try:
            told = heat_spec.canonical({"places": race.places, "result": race.result})
        except (TypeError, ValueError) as refusal:
            raise StoreError(
                f"the result of heat {outcome.key[:12]} is no plain data ({refusal}): "
                "give texts, finite numbers, lists and mappings"
            ) from refusal
        made.append(
            Parcel(
                hash=heat_spec.digest(told),
                document=zlib.compress(told, 6),
                places=race.places,
                runs=runs_of(race.result, len(race.places)),
                replay=replay,
            )
        )
    return tuple(made)


def runs_of(result: Mapping[str, Any], cars: int) -> tuple[int, ...]:
    """Return how each car's race went as Races.runs has it; 0 where a result does not tell."""
    runs = [0] * cars
    order = result.get("order")
    for told in order if isinstance(order, list | tuple) else ():
        match told:
            case {"car": int(car), "finished": bool(finished), "lap_times_s": laps} if car < cars:
                best_ms = round(1000 * min(laps, default=0.0))
                runs[car] = TOLD | finished * FINISHED | min(best_ms, BEST_MS)
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

    That is 12 digits, and 18 for each car. A million of these are joined by the database and read
    by numpy at once; as rows of columns they would take seconds.
    """
    entries = "".join(f"{number:08x}" for number in grid)
    went = "".join(f"{run:08x}" for run in runs or (0,) * len(grid))
    return f"{heat:08x}{half:02x}{track:02x}{entries}{bytes(places).hex()}{went}"


@dataclass
class _Intake:
    """What a batch of results is going to change."""

    known: dict[int, set[tuple[int, str]]]
    """(half, hash) of the results of each heat that were not rejected."""
    ever: dict[int, set[tuple[int, str]]]
    """(half, hash) of all its results, before this batch."""
    tracks: dict[int, tuple[str, ...]]
    """Tracks of each ruleset, by its number."""
    new_results: list[dict[str, Any]] = field(default_factory=list)
    new_races: list[dict[str, Any]] = field(default_factory=list)
    done: set[int] = field(default_factory=set)
    disputed: set[int] = field(default_factory=set)
    settled: dict[int, set[tuple[int, str]]] = field(default_factory=dict)
    """(half, hash) of the results that a third worker found, too."""


def complete(
    connection: sa.Connection,
    now: float,
    worker: str,
    batch: Sequence[tuple[str, tuple[Parcel, ...]]],
) -> Received:
    """Take in results of heats; the caller must be alone.

    A result that is known changes nothing; one that differs from what is known puts its heat in
    quarantine; one whose lease was lost counts if no other came first. A heat in quarantine that
    was lent again is settled by a result that agrees with one it has.
    """
    query = sa.select(heats).order_by(heats.c.number).with_for_update()
    rows = {row.key: row for row in chunked(connection, query, heats.c.key, [k for k, _ in batch])}
    targets = sorted({row.audits or row.number for row in rows.values()})
    intake = _intake(connection, targets)
    sorted_out: dict[str, list[str]] = {"accepted": [], "repeated": [], "quarantined": []}
    for key, sent in batch:
        if key not in rows:
            raise StoreError(f"there is no heat {key[:12]!r} in this league: give a key it planned")
        verdict = _judge(intake, rows[key], sent, worker, now)
        sorted_out[verdict].append(key)
    _write(connection, intake, now)
    received = Received(**{verdict: tuple(found) for verdict, found in sorted_out.items()})
    counts = {verdict: len(found) for verdict, found in sorted_out.items() if found}
    numbers = [rows[key].number for key, _ in batch]
    audit_log.note(connection, now, worker, "complete", "", heats=numbers, **counts)
    for key in received.quarantined:
        audit_log.note(connection, now, worker, "quarantine", key, of=rows[key].audits)
    for number, kept in intake.settled.items():
        hashes = [hash for _, hash in sorted(kept)]
        audit_log.note(connection, now, worker, "settle", str(number), kept=hashes)
    return received


def _intake(connection: sa.Connection, targets: list[int]) -> _Intake:
    intake = _Intake(
        known={number: set() for number in targets},
        ever={number: set() for number in targets},
        tracks={
            row.number: tuple(json.loads(row.settings)["tracks"])
            for row in connection.execute(sa.select(rulesets.c.number, rulesets.c.settings))
        },
    )
    stored = sa.select(results.c.heat, results.c.half, results.c.hash, results.c.rejected)
    for row in chunked(connection, stored, results.c.heat, targets):
        intake.ever[row.heat].add((row.half, row.hash))
        if not row.rejected:
            intake.known[row.heat].add((row.half, row.hash))
    return intake


def _judge(intake: _Intake, row: Any, sent: tuple[Parcel, ...], worker: str, now: float) -> str:  # noqa: ANN401
    """Note what one heat's results change; return what becomes of them."""
    halves = json.loads(row.halves)
    grids = [grid for _, grid in halves]
    told = [len(parcel.places) for parcel in sent]
    if told != [len(grid) for grid in grids]:
        raise StoreError(
            f"heat {row.key[:12]} has races of {[len(grid) for grid in grids]} cars, results for "
            f"{told} cars came: give all places of all its races"
        )
    if not all(1 <= place <= len(parcel.places) for parcel in sent for place in parcel.places):
        raise StoreError(
            f"the places of heat {row.key[:12]} lie outside 1 to the number of cars: "
            "count places from 1"
        )
    target = row.audits or row.number
    known, came = intake.known[target], {(n, parcel.hash) for n, parcel in enumerate(sent)}
    ever = intake.ever[target]
    if ever and not row.audits and came <= ever and target not in intake.settled:
        # Raced again by whom it was lent to: a third opinion. Anybody else repeats an old one.
        if row.state == "claimed" and row.worker == worker:
            intake.settled[target] = intake.known[target] = came
            intake.new_races += [
                _race(intake, row, half, grids[half], parcel) for half, parcel in enumerate(sent)
            ]
            intake.done.add(target)
            return "accepted"
        if not came <= known:
            return "repeated"  # it was rejected, and stays so
        if row.state in ("planned", "claimed"):
            return "quarantined"
    for half, parcel in enumerate(sent):
        if (half, parcel.hash) in known:
            continue
        intake.new_results.append(
            {
                "heat": target,
                "half": half,
                "hash": parcel.hash,
                "worker": worker,
                "received_s": now,
                "document": parcel.document,
                "replay": parcel.replay,
            }
        )
        if not known and not row.audits:
            intake.new_races.append(_race(intake, row, half, grids[half], parcel))
    intake.known[target] = known | came
    if (known and not came <= known) or len(known) > len(sent):
        intake.disputed |= {target, row.number}
        return "quarantined"
    if known and (not row.audits or row.state == "done"):
        return "repeated"
    intake.done.add(row.number)
    return "accepted"


def _race(intake: _Intake, row: Any, half: int, grid: list[int], told: Parcel) -> dict[str, Any]:  # noqa: ANN401
    name, _ = json.loads(row.halves)[half]
    tracks = intake.tracks[row.ruleset]
    track = tracks.index(name) if name in tracks else NO_TRACK
    return {
        "heat": row.number,
        "half": half,
        "ruleset": row.ruleset,
        "rated": row.purpose == "rated",
        "cars": len(grid),
        "packed": packed(
            row.number, half, grid, told.places, track=min(track, NO_TRACK), runs=told.runs
        ),
    }


def _write(connection: sa.Connection, intake: _Intake, now: float) -> None:
    if intake.new_results:
        connection.execute(insert_new(connection, results), intake.new_results)
    if intake.new_races:
        connection.execute(races.insert(), intake.new_races)
    for heat, kept in intake.settled.items():
        _settle(connection, heat, kept)
    finished = {"state": "done", "lease_s": None, "done_s": now}
    if intake.done:
        connection.execute(heats.update().where(heats.c.number.in_(intake.done)).values(**finished))
    if intake.disputed:
        disputed = {**finished, "state": "quarantined"}
        connection.execute(
            heats.update().where(heats.c.number.in_(intake.disputed)).values(**disputed)
        )
        connection.execute(races.delete().where(races.c.heat.in_(intake.disputed)))


def _settle(connection: sa.Connection, heat: int, kept: set[tuple[int, str]]) -> None:
    """Keep some results of a heat, reject its others; audits of it that differed are over."""
    of_heat = results.c.heat == heat
    connection.execute(results.update().where(of_heat).values(rejected=True))
    for half, hash in kept:
        one = of_heat & (results.c.half == half) & (results.c.hash == hash)
        connection.execute(results.update().where(one).values(rejected=False))
    connection.execute(
        heats.update()
        .where(heats.c.audits == heat, heats.c.state == "quarantined")
        .values(state="done")
    )


def read_results(connection: sa.Connection, heat: int) -> list[StoredResult]:
    """Return all results of a heat, by race and time; several for one race are a dispute."""
    query = sa.select(results).where(results.c.heat == heat)
    found = []
    for row in connection.execute(query.order_by(results.c.half, results.c.received_s)):
        told = json.loads(zlib.decompress(row.document))
        found.append(
            StoredResult(
                half=row.half,
                hash=row.hash,
                worker=row.worker,
                received_s=row.received_s,
                places=tuple(told["places"]),
                result=told["result"],
                replay=row.replay,
                rejected=row.rejected,
            )
        )
    return found


def read_races(
    connection: sa.Connection, ruleset: str, since: int = 0, *, rated: bool = True
) -> Races:
    """Return the races under a ruleset that count, those after number `since` only."""
    last = connection.scalar(sa.select(sa.func.coalesce(sa.func.max(races.c.number), 0)))
    rules = sa.select(rulesets.c.number).where(rulesets.c.hash == ruleset).scalar_subquery()
    voided = connection.scalar(
        sa.select(sa.func.count()).select_from(heats).where(heats.c.state == "quarantined")
    )
    joined = sa.func.aggregate_strings(races.c.packed, " ")
    pieces: list[np.ndarray] = []
    assert last is not None
    for start in range(since, last, BLOCK):
        query = sa.select(joined).where(
            races.c.number > start,
            races.c.number <= min(start + BLOCK, last),
            races.c.ruleset == rules,
            *([races.c.rated] if rated else []),
        )
        pieces += _unpacked(connection.scalar(query) or "")
    return _stacked(pieces, max(last, since), voided or 0)


def _unpacked(text: str) -> list[np.ndarray]:
    """Return races from their packed texts with spaces between, those of as many cars together."""
    if not text:
        return []
    width = _width(text)
    gaps = np.frombuffer(text.encode("ascii"), np.uint8)[width :: width + 1]
    blocks = [text]
    if (len(text) + 1) % (width + 1) or (gaps != ord(" ")).any() or text.count(" ") != len(gaps):
        by_width: dict[int, list[str]] = {}
        for one in text.split(" "):
            by_width.setdefault(len(one), []).append(one)
        blocks = [" ".join(by_width[width]) for width in sorted(by_width)]
    return [_alike(block) for block in blocks]


def _width(text: str) -> int:
    """Return the length of the first of several packed texts."""
    return text.index(" ") if " " in text else len(text)


def _alike(text: str) -> np.ndarray:
    """Return races of as many cars each from their packed texts with spaces between."""
    cars = (_width(text) - 12) // 18
    row = [
        *(("heat", ">u4"), ("half", "u1"), ("track", "u1")),
        *(("entries", ">u4", (cars,)), ("places", "u1", (cars,)), ("runs", ">u4", (cars,))),
    ]
    return np.frombuffer(bytes.fromhex(text), dtype=row)


def _stacked(pieces: list[np.ndarray], last: int, voided: int) -> Races:
    total = sum(len(piece) for piece in pieces)
    cars = max((piece["entries"].shape[1] for piece in pieces), default=2)
    races = Races(
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
            getattr(races, name)[start:end] = piece[name]
        for name in ("entries", "places", "runs"):
            getattr(races, name)[start:end, :width] = piece[name]
        start = end
    return races
