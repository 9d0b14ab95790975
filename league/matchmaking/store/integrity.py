"""Checks all that standings are computed from against documents, hashes and the ledger."""

import json
import zlib
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import sqlalchemy as sa

from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.store import entries, results, schema, seasons
from league.matchmaking.store.database import chunked
from league.matchmaking.store.queue import heat_in, with_rules
from league.matchmaking.store.results import PackedResult
from league.matchmaking.store.schema import Change, LedgerRecord, heats, ledger, races, rulesets

BLOCK = 2000  # heats, or records of the ledger, checked at a time


@dataclass
class Integrity:
    """What a check found."""

    races: int = 0  # races that count, as recomputed from their results
    records: int = 0  # records of the ledger
    head: str = ""  # hash of the ledger's last record, which depends on all of them
    mismatches: list[str] = field(default_factory=list)  # what does not agree, a line each
    damaged: bool = False
    """Whether heats themselves were changed, or the present rules are missing, so that heats cannot
    be raced again."""


def verify(connection: sa.Connection, head: str = "") -> Integrity:
    """Check a league, see Store.verify; the connection must see one state of it throughout."""
    found = Integrity()
    simple = {record[:2]: record.content for record in _simple_records(connection)}
    num_results, settled, missing = Counter[int](), dict[int, set[str]](), set(simple)
    states, recorded = dict[str, str](), ""
    has_head = not head
    while rows := connection.execute(
        sa.select(ledger).where(ledger.c.number > found.records).order_by(ledger.c.number)
        .limit(BLOCK)
    ).all():  # fmt: skip
        subjects = [row.subject.split("/") for row in rows]
        heat_of = [int(parts[0]) if parts[0].isdecimal() else 0 for parts in subjects]
        now = simple | {r[:2]: r.content for r in _result_records(connection, sorted(set(heat_of)))}
        for row, parts, heat in zip(rows, subjects, heat_of, strict=True):
            _check_record(found, row, now)
            found.records, found.head = row.number, row.chain
            has_head |= row.chain.startswith(head)
            missing.discard((row.kind, row.subject))
            if row.kind == "result":
                num_results[heat] += (row.kind, row.subject) in now
            elif row.kind == "settle":
                settled[heat] = set(parts[1:])
            elif row.kind == "state":
                states[parts[0]] = row.subject
            elif row.kind == "present":
                recorded = row.subject
    found.mismatches += [f"{kind} {name[:12]}: not in the ledger" for kind, name in missing]
    for row in connection.execute(sa.select(entries.entries).order_by(entries.entries.c.number)):
        # Of entries from before states were recorded, the ledger knows none until they change.
        now = schema.state_record(row.id, row.state, row.reason).subject
        if states.get(row.id, now) != now:
            found.mismatches.append(
                f"entry {row.name!r}: it is {row.state}, and the ledger has another state or reason"
            )
    present = _present(connection)
    if present is None:
        found.damaged = True
        found.mismatches.append("the present rules are missing")
    elif recorded not in ("", present):  # none before they change, in leagues of older versions
        found.mismatches.append(
            f"the present rules are {present[:12]}, and the ledger has {recorded[:12]}"
        )
    if not has_head:
        found.mismatches.append(f"the ledger no longer has the record {head[:12]}")
    for name in seasons.damaged(connection, schema.seasons):
        found.mismatches.append(f"season {name}: its standings differ from their hash")
    for name in seasons.damaged(connection, schema.cups):
        found.mismatches.append(f"cup {name}: its bracket differs from its hash")
    _check_heats(connection, found, num_results, settled)
    return found


def _simple_records(connection: sa.Connection) -> Iterator[LedgerRecord]:
    for row in connection.execute(sa.select(rulesets).order_by(rulesets.c.number)):
        yield LedgerRecord("ruleset", row.hash, row.settings)
    for row in connection.execute(entries.with_owners().order_by(entries.entries.c.number)):
        yield entries.ledger_record(row)
    yield from seasons.ledger_records(connection)


def _result_records(connection: sa.Connection, numbers: list[int]) -> Iterator[LedgerRecord]:
    table = results.results
    columns = [column for column in table.c if column is not table.c.document]
    query = sa.select(*columns, heats.c.key)
    query = query.join(heats, heats.c.number == table.c.heat).order_by(table.c.received_s)
    for row in chunked(connection, query.order_by(*table.primary_key), table.c.heat, numbers):
        yield results.ledger_record(row.key, row._mapping)


def _check_record(found: Integrity, row: sa.Row[Any], now: dict[tuple[str, str], Any]) -> None:
    """Check that a record of the ledger follows from the one before and from what tables hold."""
    what = f"record {row.number} of the ledger ({row.kind} {row.subject[:24]})"
    if row.number != found.records + 1:
        found.mismatches.append(f"{what}: the record before it was deleted")
    known = (row.kind, row.subject)
    if row.kind not in ("settle", "state", "present") and known not in now:
        found.mismatches.append(f"{what}: what it records was deleted")
    elif schema.link(found.head, LedgerRecord(*known, now.get(known))) != row.chain:
        found.mismatches.append(
            f"{what}: what it records was changed, or a record before it inserted or deleted"
        )


def _sound_tracks(connection: sa.Connection, found: Integrity) -> dict[int, tuple[str, ...]]:
    """Return the tracks of the rulesets that are what their hashes say."""
    tracks = {}
    for row in connection.execute(sa.select(rulesets)):
        try:
            rules = Ruleset.of(json.loads(row.settings))
        except (ValueError, KeyError, TypeError):
            rules = None
        if rules is not None and rules.hash == row.hash:
            tracks[row.number] = rules.tracks
        else:
            found.mismatches.append(f"ruleset {row.hash[:12]}: its settings differ from its hash")
    return tracks


def _check_heats(
    connection: sa.Connection,
    found: Integrity,
    num_results: Counter[int],
    settled: dict[int, set[str]],
) -> None:
    """Check heats, given what the ledger has of each: results, and those a settled dispute kept."""
    tracks = _sound_tracks(connection, found)
    id_of = {row.number: row.id for row in connection.execute(entries.with_owners())}
    query = with_rules().order_by(heats.c.number).limit(BLOCK)
    last = 0
    while rows := connection.execute(query.where(heats.c.number > last)).all():
        last, numbers = rows[-1].number, [row.number for row in rows]
        stored, counted = defaultdict[int, list[Any]](list), defaultdict[int, list[Any]](list)
        for row in chunked(connection, sa.select(results.results), results.results.c.heat, numbers):
            stored[row.heat].append(row)
        for row in chunked(connection, sa.select(races), races.c.heat, numbers):
            counted[row.heat].append(row)
        for row in rows:
            try:
                is_as_planned = heat_in(row, json.loads(row.halves), id_of).key == row.key
            except (ValueError, KeyError, TypeError):
                is_as_planned = False
            if not is_as_planned:
                found.damaged = True
                found.mismatches.append(f"heat {row.number}: it is not what was planned")
                continue
            if len(stored[row.number]) > num_results[row.number]:
                found.mismatches.append(f"heat {row.number}: a result of it is not in the ledger")
            rejected = {one.hash[:16] for one in stored[row.number] if one.rejected}
            if rejected & settled.get(row.number, rejected):
                found.mismatches.append(f"heat {row.number}: a result that counts was rejected")
            _check_races(found, row, stored[row.number], counted[row.number], tracks)
    for table in (results.results, races):
        orphans = sa.select(table.c.heat).where(~sa.exists().where(heats.c.number == table.c.heat))
        for heat in connection.scalars(orphans.distinct()):
            found.mismatches.append(f"{table.name} of heat {heat}: there is no such heat")


def _check_races(
    found: Integrity,
    row: sa.Row[Any],
    stored: list[Any],
    counted: list[Any],
    tracks: dict[int, tuple[str, ...]],
) -> None:
    """Compare a heat's rows of `races` with those that follow from the documents of its results."""
    documents = {one.half: _read(found, one) for one in stored if not one.rejected}
    halves = range(len(json.loads(row.halves)))
    complete = sorted(one.half for one in stored if not one.rejected) == list(halves)
    if not row.audits and complete != (row.state == "done"):
        results_of = "one result a race" if complete else "not one result a race"
        found.mismatches.append(f"heat {row.number}: it is {row.state}, and has {results_of}")
    sent = [one for half in halves if complete and (one := documents[half]) is not None]
    if (complete and len(sent) < len(halves)) or row.ruleset not in tracks:
        return  # reported above
    expected = {one["half"]: one for one in results.race_rows(tracks, row, sent)} if sent else {}
    actual = {one.half: one for one in counted}
    for half in sorted(expected.keys() | actual.keys()):
        what = f"heat {row.number} race {half + 1}"
        if half not in actual:
            found.mismatches.append(f"{what}: the standings miss it")
        elif half not in expected:
            found.mismatches.append(f"{what}: the standings count it, but it has no valid result")
        elif any(getattr(actual[half], name) != value for name, value in expected[half].items()):
            found.mismatches.append(f"{what}: the standings read something else than its result")
    found.races += len(expected)


def _read(found: Integrity, row: sa.Row[Any]) -> PackedResult | None:
    """Return what the standings use of a result's document; None if it is not the one that came."""
    try:
        text = zlib.decompress(row.document)
        if heat_spec.digest(text) == row.hash:
            result = PackedResult.of(text, row.replay, row.machine)
            bytes(result.places)
            return result
    except (zlib.error, ValueError, KeyError, TypeError, AttributeError):
        pass
    what = f"heat {row.heat} race {row.half + 1}"
    found.mismatches.append(f"{what}: its result differs from its hash, or cannot be read")
    return None


def _present(connection: sa.Connection) -> str | None:
    """Return the hash of the present rules; None if they are missing."""
    query = sa.select(rulesets.c.hash).join(
        schema.league, schema.league.c.ruleset == rulesets.c.number
    )
    return connection.scalar(query)


def adopt_present(change: Change) -> bool:
    """Record the present rules of a league from before the ledger did; return whether it was."""
    query = sa.select(ledger.c.number).where(ledger.c.kind == "present").limit(1)
    hash = _present(change.connection)
    if hash is None or change.connection.scalar(query) is not None:
        return False
    change.record([schema.present_record(hash)])
    return True


def adopt_states(change: Change) -> int:
    """Record the states of entries from before the ledger did; return how many these are."""
    recorded = sa.select(ledger.c.subject).where(ledger.c.kind == "state")
    known = {subject.split("/")[0] for subject in change.connection.scalars(recorded)}
    query = sa.select(entries.entries).order_by(entries.entries.c.number)
    rows = [row for row in change.connection.execute(query) if row.id not in known]
    change.record(schema.state_record(row.id, row.state, row.reason) for row in rows)
    return len(rows)


def adopt(change: Change) -> int:
    """Begin the ledger of an older league with all that it holds; return the number of records."""
    connection = change.connection
    numbers = list(connection.scalars(sa.select(heats.c.number).order_by(heats.c.number)))
    change.record(_simple_records(connection))
    for start in range(0, len(numbers), BLOCK):
        change.record(_result_records(connection, numbers[start : start + BLOCK]))
    rejected = sa.select(results.results.c.heat).where(results.results.c.rejected).distinct()
    for heat in sorted(connection.scalars(rejected)):
        stored = results.read_results(connection, [heat])
        kept = [(one.half, one.hash) for one in stored if not one.rejected]
        change.record([results.settlement(heat, kept)])
    return connection.scalar(sa.select(sa.func.count()).select_from(ledger)) or 0
