"""Results: each is taken in once, however often it is sent, and compared with those of others."""

from __future__ import annotations

import json
import zlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from league.errors import StoreError
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store import schema
from league.matchmaking.store.blobs import FolderBlobs, insert_blob
from league.matchmaking.store.database import asked_for, chunked, made_of
from league.matchmaking.store.queue import BATCH, check_worker, unknown_heat
from league.matchmaking.store.race_table import NO_TRACK, driven, packed, runs_of
from league.matchmaking.store.records import HeatOutcome, RaceOutcome, Received, StoredResult
from league.matchmaking.store.schema import Change, LedgerRecord, heats, races, results, rulesets

OF_HEATS = (
    sa.select(results)
    .where(results.c.heat.in_(sa.bindparam("asked", expanding=True)))
    .order_by(results.c.heat, results.c.half, results.c.received_s)
)
"""Selects the results of some heats; made once, which takes as long as to ask."""


class ResultStore(schema.Transactional):
    """The part of a Store that is about results."""

    def complete(self, worker: str, outcomes: Sequence[HeatOutcome]) -> Received:
        """Take in the results of heats, each once, however often they are sent.

        A known result changes nothing. One that differs from what is known puts its heat in
        quarantine, unless it comes late or from an audit, and from another class of machine. One
        with a lost lease counts if no other came first. A quarantined heat that was
        lent again is settled by a result that agrees with one it has.
        """
        check_worker(worker)
        received = Received()
        for start in range(0, len(outcomes), BATCH):
            received = received.joined(self._complete(worker, outcomes[start : start + BATCH]))
        return received

    def _complete(self, worker: str, outcomes: Sequence[HeatOutcome]) -> Received:
        keep = FolderBlobs(self._blobs_url).put if self._blobs_url else heat_spec.digest
        batch = [
            (outcome.key, [_pack(race, outcome, keep) for race in outcome.races])
            for outcome in outcomes
        ]
        with self._writing(lock=True) as change:
            received = _take_in(change, worker, batch)
            if not self._blobs_url:
                races = (race for outcome in outcomes for race in outcome.races)
                for replay in filter(None, (race.replay for race in races)):
                    insert_blob(change, replay)
        return received

    def results(self, *heats: int) -> list[StoredResult]:
        """Return all results of heats (by number), by race and time; several are a dispute."""
        with self._database.reading() as connection:
            return read_results(connection, heats)


@dataclass(frozen=True)
class PackedResult:
    """One result ready to be stored; made before the database is locked."""

    hash: str  # SHA-256 of places and result
    document: bytes  # places and result as deflated canonical JSON
    places: tuple[int, ...]  # of the car in each slot
    runs: tuple[int, ...]  # of the car in each slot; see Races.runs
    driven: str  # see `driven`
    replay: str | None  # SHA-256 of the recording
    machine: str  # class of the machine that raced it

    @classmethod
    def of(cls, text: bytes, replay: str | None, machine: str) -> PackedResult:
        """Return a result by its canonical JSON."""
        plain = json.loads(text)
        places, result = tuple(plain["places"]), plain["result"]
        return cls(
            hash=heat_spec.digest(text),
            document=zlib.compress(text, 6),
            places=places,
            runs=runs_of(result, len(places)),
            driven=driven(result, len(places)),
            replay=replay,
            machine=machine,
        )


def _pack(race: RaceOutcome, outcome: HeatOutcome, keep: Callable[[bytes], str]) -> PackedResult:
    replay = None if race.replay is None else keep(race.replay)
    try:
        text = heat_spec.canonical({"places": race.places, "result": race.result})
    except (TypeError, ValueError) as refusal:
        raise StoreError(
            f"the result of heat {outcome.key[:12]} is no plain data ({refusal}): "
            "give texts, finite numbers, lists and mappings"
        ) from refusal
    return PackedResult.of(text, replay, outcome.machine)


@dataclass
class _Intake:
    """What a batch of results is going to change; results are (half, hash), by heat."""

    tracks: dict[int, tuple[str, ...]]  # tracks of each ruleset, by its number
    known: dict[int, set[tuple[int, str]]] = field(default_factory=lambda: defaultdict(set))
    """Results that were not rejected."""
    before: dict[int, set[tuple[int, str]]] = field(default_factory=lambda: defaultdict(set))
    """All results, rejected or not, from before this batch."""
    machines: dict[int, set[str]] = field(default_factory=lambda: defaultdict(set))
    """Classes of the machines that the known results came from."""
    new_results: list[dict[str, Any]] = field(default_factory=list)
    new_races: list[dict[str, Any]] = field(default_factory=list)
    done: set[int] = field(default_factory=set)
    disputed: set[int] = field(default_factory=set)
    unverified: set[int] = field(default_factory=set)  # audits that prove nothing
    settled: dict[int, set[tuple[int, str]]] = field(default_factory=dict)
    """Results of a dispute that a third worker found, too."""


def _take_in(
    change: Change, worker: str, batch: Sequence[tuple[str, list[PackedResult]]]
) -> Received:
    """Take in results of heats; the caller must hold the database's lock."""
    connection, sent_keys = change.connection, [key for key, _ in batch]
    query = sa.select(heats).order_by(heats.c.number).with_for_update()
    rows = {row.key: row for row in chunked(connection, query, heats.c.key, sent_keys)}
    rules = connection.execute(sa.select(rulesets.c.number, rulesets.c.settings))
    intake = _Intake({number: tuple(json.loads(text)["tracks"]) for number, text in rules})
    targets = sorted({row.audits or row.number for row in rows.values()})
    columns = [results.c[name] for name in ("heat", "half", "hash", "rejected", "machine")]
    for row in chunked(connection, sa.select(*columns), results.c.heat, targets):
        intake.before[row.heat].add((row.half, row.hash))
        if not row.rejected:
            intake.known[row.heat].add((row.half, row.hash))
            intake.machines[row.heat].add(row.machine)
    keys: dict[str, list[str]] = {verdict: [] for verdict in Received.__dataclass_fields__}
    for key, sent in batch:
        if key not in rows:
            raise unknown_heat(key)
        keys[_judge(intake, rows[key], sent, worker, change.now)].append(key)
    _write(change, intake)
    counts = {verdict: len(some) for verdict, some in keys.items() if some}
    numbers = [rows[key].number for key, _ in batch]
    change.log(worker, "complete", "", heats=numbers, **counts)
    for key in keys["quarantined"]:
        change.log(worker, "quarantine", key, of=rows[key].audits)
    for number, kept in intake.settled.items():
        change.log(worker, "settle", str(number), kept=[hash for _, hash in sorted(kept)])
    return Received(**{verdict: tuple(some) for verdict, some in keys.items()})


def _judge(
    intake: _Intake, row: sa.Row[Any], sent: Sequence[PackedResult], worker: str, now: float
) -> str:
    """Note what one heat's results change; return the name of a field of Received."""
    _check_places(row, sent)
    target = row.audits or row.number
    known, hashes = intake.known[target], {(half, one.hash) for half, one in enumerate(sent)}
    if not row.audits and target not in intake.settled and hashes <= intake.before[target]:
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


def _check_places(row: sa.Row[Any], sent: Sequence[PackedResult]) -> None:
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
    tracks_of: Mapping[int, tuple[str, ...]], row: sa.Row[Any], sent: Sequence[PackedResult]
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
                "packed": packed(row.number, half, track, grid, one.places, one.runs),
                "driven": one.driven,
            }
        )
    return rows


def ledger_record(key: str, row: Mapping[str, Any]) -> LedgerRecord:
    """Return what the ledger records of a result of the heat with this key."""
    content = [key, *(row[name] for name in ("worker", "received_s", "machine", "replay"))]
    return LedgerRecord("result", f"{row['heat']}/{row['half']}/{row['hash']}", content)


def _write(change: Change, intake: _Intake) -> None:
    change.insert(results, *intake.new_results)
    query, numbers = sa.select(heats.c.number, heats.c.key), list(intake.known)
    key_of = dict(map(tuple, chunked(change.connection, query, heats.c.number, numbers)))
    change.record(ledger_record(key_of[row["heat"]], row) for row in intake.new_results)
    change.insert(races, *intake.new_races)
    for heat, kept in intake.settled.items():
        is_kept = [(results.c.half == half) & (results.c.hash == hash) for half, hash in kept]
        change.update(results, results.c.heat == heat, rejected=sa.not_(sa.or_(*is_kept)))
        change.record([settlement(heat, kept)])
        # Audits of it that differed are done: a third worker has judged them.
        audits = (heats.c.audits == heat) & (heats.c.state == "quarantined")
        change.update(heats, audits, state="done")
    changed = {"done": intake.done, "quarantined": intake.disputed, "cancelled": intake.unverified}
    for state, numbers in changed.items():
        if numbers:
            over = heats.c.number.in_(numbers)
            change.update(heats, over, state=state, lease_s=None, done_s=change.now)
    if intake.disputed:
        change.delete(races, races.c.heat.in_(intake.disputed))


def settlement(heat: int, kept: Iterable[tuple[int, str]]) -> LedgerRecord:
    """Return what the ledger records of a settled dispute: the beginnings of the kept hashes."""
    return LedgerRecord(
        "settle", "/".join([str(heat), *(hash[:16] for _, hash in sorted(kept))]), None
    )


def read_results(connection: sa.Connection, numbers: Sequence[int]) -> list[StoredResult]:
    """Return all results of heats, by race and time; several for one race are a dispute."""
    stored: list[StoredResult] = []
    for row in asked_for(connection, OF_HEATS, sorted(numbers)):
        document = json.loads(zlib.decompress(row.document))
        places = tuple(document["places"])
        stored.append(made_of(StoredResult, row, places=places, result=document["result"]))
    return stored
