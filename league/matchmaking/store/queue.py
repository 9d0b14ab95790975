"""The queue of heats: planned, claimed with a lease, renewed, failed, reaped."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from operator import itemgetter
from typing import Any

import sqlalchemy as sa

from league.errors import StoreError, brief
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Half, Heat, Purpose
from league.matchmaking.store import schema
from league.matchmaking.store.database import chunked
from league.matchmaking.store.records import HeatProgress, HeatRecord, HeatState
from league.matchmaking.store.schema import (
    Change,
    entries,
    heat_entries,
    heats,
    progress,
    rulesets,
)

LEASE_S = 60.0  # lease of a heat [s]; dispatchers renew it every 10 s
BATCH = 1000  # heats planned or completed per transaction
ATTEMPTS = 3  # failed races before a heat is marked as an error
PRIORITY: dict[Purpose, int] = {"validation": 0, "gauntlet": 1, "cup": 1, "rated": 2, "audit": 2}
"""Small numbers are claimed first; a season always has rated heats, and audits must not wait."""
TRACEBACK_CHARS = 8000  # the end of a traceback that is kept
COPIED = tuple(name for name in HeatRecord.__dataclass_fields__ if name not in ("heat", "seeds"))
"""What a record has from its row as it is."""
_copied = itemgetter(*map(list(heats.c.keys()).index, COPIED))  # by name would take much longer
STATES = (
    sa.select(heats.c.number, heats.c.state)
    .join(heat_entries, heat_entries.c.heat == heats.c.number)
    .where(heat_entries.c.entry == sa.bindparam("entry"))
    .order_by(heats.c.number)
)
"""Selects the states of an entry's heats; made once, which takes as long as to ask."""


class QueueStore(schema.Transactional):
    """The part of a Store that is about heats and their queue."""

    _entry_ids: dict[int, str]  # ids of entries by their numbers; they never change

    def _shown(self, heat: sa.ColumnElement[int]) -> sa.ColumnElement[bool]:
        """Return which heats, by number, reading methods return: here all of them."""
        return sa.true()

    def plan(self, planned: Sequence[Heat]) -> int:
        """Add heats to the queue and return how many are new; known ones are left as they are."""
        added = 0
        for start in range(0, len(planned), BATCH):
            with self._writing(lock=True) as change:
                added += _plan(change, planned[start : start + BATCH])
        return added

    def claim(
        self, worker: str, limit: int = 1, *, lease_s: float = LEASE_S, lender: str = ""
    ) -> list[HeatRecord]:
        """Lend up to `limit` heats to a worker; its name must be unique.

        Heats with an expired lease are lent again. Workers of an owner (`lender`) race neither
        heats of the owner's entries nor again what a worker of the owner has raced; the league's
        own have none.
        """
        check_worker(worker)
        with self._writing() as change:
            reap(change)
            wanted = (
                sa.select(heats.c.number)
                .where(heats.c.state == "planned", *(_impartial(lender) if lender else ()))
                .order_by(heats.c.priority, heats.c.number)
                .limit(min(limit, BATCH))
                .with_for_update(skip_locked=True)
            )
            numbers = list(change.connection.scalars(wanted))
            if not numbers:
                return []
            change.update(
                heats,
                heats.c.number.in_(numbers),
                state="claimed",
                worker=worker,
                claimed_s=change.now,
                lease_s=change.now + lease_s,
                attempts=heats.c.attempts + 1,
            )
            change.log(worker, "claim", "", heats=numbers)
            rows = change.connection.execute(with_rules().where(heats.c.number.in_(numbers)))
            lent = self._records(change.connection, rows)
            lent.sort(key=lambda record: numbers.index(record.number))
            return [replace(record, seeds=self.seeds(record.heat)) for record in lent]

    def heartbeat(
        self, worker: str, *, lease_s: float = LEASE_S, keys: Sequence[str] | None = None
    ) -> list[str]:
        """Renew a worker's leases, if not taken back; return the keys of what it holds.

        With `keys` only those of these heats, so that what it was lent without hearing of it ends.
        """
        check_worker(worker)
        with self._writing() as change:
            held = sa.select(heats.c.number, heats.c.key).where(
                heats.c.state == "claimed", heats.c.worker == worker, heats.c.lease_s >= change.now
            )
            if keys is not None:
                held = held.where(heats.c.key.in_(keys))
            # A row that is locked is being completed: it needs no lease any more.
            rows = change.connection.execute(held.with_for_update(skip_locked=True)).all()
            if rows:
                own = heats.c.number.in_([row.number for row in rows])
                change.update(heats, own, lease_s=change.now + lease_s)
            return [row.key for row in rows]

    def show(self, worker: str, under_way: Sequence[HeatProgress]) -> None:
        """Keep how far heats have come that a worker holds, for people who follow them."""
        check_worker(worker)
        replays_of = {one.key: one.replays for one in under_way}
        claimed = sa.select(heats.c.number, heats.c.key).where(heats.c.state == "claimed")
        own = claimed.where(heats.c.worker == worker, heats.c.key.in_(list(replays_of)))
        with self._writing(lock=True) as change:
            rows = change.connection.execute(own).all()
            over = progress.c.heat.not_in(claimed.with_only_columns(heats.c.number))
            change.delete(progress, over | progress.c.heat.in_([row.number for row in rows]))
            new = [
                {"heat": row.number, "half": half, "replay": replay}
                for row in rows
                for half, replay in enumerate(replays_of[row.key])
            ]
            change.insert(progress, *new)

    def shown(self, heat: int, half: int) -> bytes | None:
        """Return the recording so far of a race, by numbers, if its heat is being raced."""
        query = (
            sa.select(progress.c.replay)
            .join(heats, heats.c.number == progress.c.heat)
            .where(heats.c.state == "claimed", progress.c.heat == heat, progress.c.half == half)
        )
        with self._database.reading() as connection:
            return connection.scalar(query)

    def seeds(self, heat: Heat) -> tuple[int, ...]:
        """Return the seed of each race of a heat; a secret until it is over."""
        return heat.seeds(self._secret)

    def audit(self, keys: Sequence[str], share: float) -> int:
        """Plan a share of these heats again, drawn with the league's secret; return how many."""
        drawn = [k for k in keys if heat_spec.seed(self._secret, f"audit {k}", 0) < share * 2**63]
        records = [record for record in map(self.heat, drawn) if record.heat.purpose == "rated"]
        return self.plan([heat_spec.audit_of(record.heat) for record in records])

    def fail(self, worker: str, key: str, traceback: str, *, lost: bool = False) -> HeatState:
        """Hand back a heat that could not be raced, and return its state: planned, or error.

        A worker that has lost the lease changes nothing. If it was killed (`lost`), that is no
        failed try of the heat.
        """
        check_worker(worker)
        with self._writing() as change:
            row = _locked(change, key)
            if row is None:
                raise unknown_heat(key)
            text = traceback.replace("\x00", "?")[-TRACEBACK_CHARS:]
            tried = {"attempt": row.attempts, "traceback": text[-500:]}
            change.log(worker, "lose" if lost else "fail", key, **tried)
            if row.state != "claimed" or row.worker != worker:
                return row.state
            state: HeatState = "planned" if lost or row.attempts < ATTEMPTS else "error"
            now = {"state": state, "attempts": row.attempts - lost, "traceback": text}
            change.update(heats, heats.c.number == row.number, lease_s=None, **now)
            return state

    def retry(self, key: str) -> int:
        """Plan a heat again that is an error, cancelled or in quarantine; return its number, or 0.

        For an audit in quarantine the heat that it audited is planned. A result that agrees with
        one of a dispute settles it; another one leaves it in quarantine. An entry that was refused
        for the dispute is validating again.
        """
        with self._writing(lock=True) as change:
            row = _locked(change, key)
            if row is None:
                return 0
            number = row.audits if row.audits and row.state == "quarantined" else row.number
            over = heats.c.state.in_(("error", "cancelled", "quarantined"))
            match = (heats.c.number == number) & over
            if not change.update(heats, match, state="planned", attempts=0, done_s=None):
                return 0
            change.log("league", "retry", key, heat=number, was=row.state)
            _reopen_entries(change, number)
            return number

    def heat(self, name: str | int) -> HeatRecord:
        """Return the heat with this key, beginning of a key (6 digits or more), or number."""
        text, records = str(name), list[HeatRecord]()
        if text.isdigit() and len(text) < 16:
            records = self.heats(numbers=[int(text)])
        elif text.isdigit() or len(text) >= 6:
            begins = heats.c.key.startswith(text, autoescape=True)
            records = self._heats(with_rules().where(begins).order_by(heats.c.number).limit(2))
        if len(records) != 1:
            raise StoreError(
                f"{brief(name)} names {'several heats' if records else 'no heat'} of this league: "
                "give its number or its key"
            )
        return records[0]

    def heats(
        self,
        states: Sequence[HeatState] | None = None,
        *,
        numbers: Sequence[int] | None = None,
        entries: Sequence[int] = (),
        since: int = 0,
        limit: int | None = None,
        newest: bool = False,
    ) -> list[HeatRecord]:
        """Return heats by number, all or only some.

        Those in one of the `states`, with one of the `numbers`, with all of the `entries` (numbers)
        in them, and numbered above `since`; at most `limit`, and then those with the smallest
        numbers, or the largest ones (`newest`).
        """
        given: dict[str, object] = {f"entry_{at}": entry for at, entry in enumerate(entries)}
        lists = {"states": states, "numbers": numbers}
        given |= {name: list(some) for name, some in lists.items() if some is not None}
        given |= {"since": since} if limit is None else {"since": since, "limit": limit}
        return self._heats(_asked(frozenset(given), newest=newest), given)

    def heat_states(self, entry: int) -> dict[int, HeatState]:
        """Return the states of all heats of an entry (its number), by number, the oldest first."""
        with self._database.reading() as connection:
            return {number: state for number, state in connection.execute(STATES, {"entry": entry})}

    def heats_by_key(self, keys: Sequence[str]) -> list[HeatRecord]:
        """Return those of some heats that are known, by number."""
        return self._heats(with_rules().where(heats.c.key.in_(keys)))

    def counts(self) -> dict[HeatState, int]:
        """Return how many heats are in each state."""
        query = sa.select(heats.c.state, sa.func.count()).group_by(heats.c.state)
        with self._database.reading() as connection:
            return {state: number for state, number in connection.execute(query)}

    def _heats(
        self, query: sa.Select[Any], given: Mapping[str, object] | None = None
    ) -> list[HeatRecord]:
        """Return those of the heats that `with_rules` selects that are shown, by number."""
        shown = self._shown(heats.c.number)
        if shown is not sa.true():  # a statement that is the same each time is not made again
            query = query.where(shown)
        with self._database.reading() as connection:
            return self._records(connection, connection.execute(query, given))

    def _records(self, connection: sa.Connection, found: Iterable[Any]) -> list[HeatRecord]:
        """Return the heats in rows of `with_rules`, by number."""
        rows = [(row, json.loads(row.halves)) for row in found]
        numbers = {number for _, halves in rows for _, grid in halves for number in grid}
        if not numbers <= self._entry_ids.keys():
            ids = connection.execute(sa.select(entries.c.number, entries.c.id))
            self._entry_ids.update(map(tuple, ids))
        rows.sort(key=lambda row: row[0].number)
        return [self._record(row, heat_in(row, halves, self._entry_ids)) for row, halves in rows]

    def _record(self, row: sa.Row[Any], heat: Heat) -> HeatRecord:
        vars(heat)["key"] = row.key  # computed when it was planned; Store.verify computes it again
        is_public = row.state in ("done", "quarantined")
        seeds = self.seeds(heat) if is_public else None
        # The constructor of frozen data would set its fields one by one, of a hundred heats.
        record = object.__new__(HeatRecord)
        vars(record).update(zip(COPIED, _copied(row), strict=True), heat=heat, seeds=seeds)
        return record


@cache
def with_rules() -> sa.Select[Any]:
    """Select heats, the hashes of their rules (`rules`) and the keys of those they audit."""
    audited = heats.alias("audited")
    return (
        sa.select(heats, rulesets.c.hash.label("rules"), audited.c.key.label("audited_key"))
        .outerjoin(rulesets, rulesets.c.number == heats.c.ruleset)
        .outerjoin(audited, audited.c.number == heats.c.audits)
    )


@cache
def _asked(given: frozenset[str], *, newest: bool) -> sa.Select[Any]:
    """Select the heats that `QueueStore.heats` asks for, with parameters of the given names.

    It is made once for all such questions, which takes longer than to ask.
    """
    query = with_rules().where(heats.c.number > sa.bindparam("since"))
    if "states" in given:
        # By an index of states the database would sort all heats that are done for the newest.
        state = heats.c.state.concat("") if newest else heats.c.state
        query = query.where(state.in_(sa.bindparam("states", expanding=True)))
    if "numbers" in given:
        query = query.where(heats.c.number.in_(sa.bindparam("numbers", expanding=True)))
    for name in sorted(name for name in given if name.startswith("entry_")):
        query = query.where(heats.c.number.in_(of_entry(sa.bindparam(name))))
    query = query.order_by(heats.c.number.desc() if newest else heats.c.number)
    return query.limit(sa.bindparam("limit")) if "limit" in given else query


def heat_in(row: sa.Row[Any], halves: list[Any], id_of: Mapping[int, str]) -> Heat:
    """Return the heat in a row of `with_rules`, with the ids of entries (given by number)."""
    races = tuple(Half(track, tuple([id_of[number] for number in grid])) for track, grid in halves)
    return Heat(row.rules, races, row.draw, row.purpose, row.audited_key or "")


def _locked(change: Change, key: str) -> sa.Row[Any] | None:
    """Return the row of a heat, which no other transaction can change meanwhile."""
    query = sa.select(heats).where(heats.c.key == key).with_for_update()
    return change.connection.execute(query).one_or_none()


def _plan(change: Change, planned: Sequence[Heat]) -> int:
    """Add heats to the queue; those that were ever planned before are left out."""
    connection = change.connection
    ruleset_of = dict(connection.execute(sa.select(rulesets.c.hash, rulesets.c.number)).all())
    number_of = entry_numbers(connection, {entry for heat in planned for entry in heat.entries})
    has_results = sa.exists().where(schema.results.c.heat == heats.c.number)
    by_key = sa.select(heats.c.key, heats.c.number)
    audited = [heat.audits for heat in planned if heat.audits]
    audited_rows = chunked(connection, by_key.where(has_results), heats.c.key, audited)
    audited_of = {row.key: row.number for row in audited_rows}
    rows: list[dict[str, Any]] = []
    for heat in planned:
        if heat.ruleset not in ruleset_of:
            raise StoreError(
                f"a heat under the ruleset {heat.ruleset[:12]} was planned, which this league does "
                "not have: set the league's ruleset first"
            )
        if heat.audits and heat.audits not in audited_of:
            raise StoreError(
                f"an audit of heat {heat.audits[:12]} was planned, which has no results here: "
                "audit a heat that is done"
            )
        halves = [[half.track, [number_of[entry] for entry in half.grid]] for half in heat.halves]
        row = {
            "key": heat.key,
            "ruleset": ruleset_of[heat.ruleset],
            "purpose": heat.purpose,
            "priority": PRIORITY[heat.purpose],
            "halves": json.dumps(halves, separators=(",", ":")),
            "draw": heat.draw,
            "audits": audited_of.get(heat.audits),
            "state": "planned",
            "attempts": 0,
            "traceback": "",
            "created_s": change.now,
        }
        rows.append(row)
    before = connection.scalar(sa.select(sa.func.coalesce(sa.func.max(heats.c.number), 0)))
    change.insert_new(heats, *rows)
    entries_of = {heat.key: heat.entries for heat in planned}
    new = by_key.where(heats.c.number > before)
    added = chunked(connection, new, heats.c.key, list(entries_of))
    links = [
        {"heat": row.number, "entry": number_of[entry]}
        for row in added
        for entry in entries_of[row.key]
    ]
    change.insert_new(heat_entries, *links)
    if added:
        change.log("league", "plan", "", heats=len(added))
    return len(added)


def _impartial(owner: str) -> tuple[sa.ColumnElement[bool], ...]:
    """Return what holds for heats that workers of an owner may race: others have to judge."""
    of_owner = (
        sa.select(schema.owners.c.number).where(schema.owners.c.name == owner).scalar_subquery()
    )
    own_entry = (
        sa.exists()
        .where(heat_entries.c.heat == heats.c.number)
        .where(heat_entries.c.entry == entries.c.number, entries.c.owner == of_owner)
    )
    raced = sa.exists().where(
        schema.results.c.heat == sa.func.coalesce(heats.c.audits, heats.c.number),
        schema.tokens.c.owner == of_owner,
        schema.results.c.worker.like(sa.cast(schema.tokens.c.number, sa.String) + "/%"),
    )
    return ~own_entry, ~raced


def reap(change: Change) -> None:
    """Plan heats with an expired lease again; their machine's end is no failed try."""
    ended = (
        sa.select(heats.c.number, heats.c.attempts, heats.c.worker, heats.c.traceback)
        .where(heats.c.lease_s < change.now, heats.c.state == "claimed")
        .order_by(heats.c.number)
        .with_for_update(skip_locked=True)
    )
    for row in change.connection.execute(ended).all():
        lost = f"worker {row.worker} gave no sign until its lease ended"
        text = f"{row.traceback}\n{lost}".strip()[-TRACEBACK_CHARS:]
        now = {"state": "planned", "attempts": row.attempts - 1, "traceback": text}
        change.update(heats, heats.c.number == row.number, lease_s=None, **now)
        change.log("league", "reap", str(row.number), worker=row.worker)


def cancel(change: Change, which: sa.ColumnElement[bool]) -> int:
    """Take those of some heats that wait out of the queue; return how many."""
    return change.update(heats, (heats.c.state == "planned") & which, state="cancelled")


def entry_numbers(connection: sa.Connection, ids: Iterable[str]) -> dict[str, int]:
    """Return the numbers of entries; StoreError names one that the league does not have."""
    wanted = sorted(set(ids))
    query = sa.select(entries.c.id, entries.c.number)
    number_of = {row.id: row.number for row in chunked(connection, query, entries.c.id, wanted)}
    missing = [entry for entry in wanted if entry not in number_of]
    if missing:
        raise StoreError(
            f"there is no entry {missing[0][:12]!r} in this league: submit it before it is raced"
        )
    return number_of


def of_entry(entry: int | sa.BindParameter[int]) -> sa.Select[Any]:
    """Select the numbers of an entry's heats."""
    return sa.select(heat_entries.c.heat).where(heat_entries.c.entry == entry)


def _reopen_entries(change: Change, heat: int) -> None:
    """Move entries that were refused for a validation heat back to `validating`.

    Their other validation heats, which were cancelled, are planned again.
    """
    of_heat = sa.select(heat_entries.c.entry).where(heat_entries.c.heat == heat)
    validates = sa.exists().where(heats.c.number == heat, heats.c.purpose == "validation")
    refused = (entries.c.state == "refused") & entries.c.number.in_(of_heat) & validates
    query = sa.select(entries.c.number, entries.c.id).where(refused)
    for row in change.connection.execute(query).all():
        change.update(entries, entries.c.number == row.number, state="validating", reason="")
        change.record([schema.state_record(row.id, "validating", "")])
        cancelled = (heats.c.purpose == "validation") & (heats.c.state == "cancelled")
        own = heats.c.number.in_(of_entry(row.number))
        change.update(heats, own & cancelled, state="planned", attempts=0)
        change.log("league", "validating", row.id, was="refused", heat=heat)


def unknown_heat(key: str) -> StoreError:
    """Return the error of a key that no heat has."""
    return StoreError(f"there is no heat {key[:12]!r} in this league: give a key it planned")


def check_worker(worker: str) -> None:
    """Raise a StoreError if a worker's name cannot be shown."""
    if not 1 <= len(worker) <= 200 or not worker.isprintable():
        raise StoreError(f"a worker's name is {brief(worker)}: give 1 to 200 printable characters")
