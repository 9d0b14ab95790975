"""`league heats`, `heat`, `audit`, `retry`: what was raced, and whether it can be trusted.

`league export --csv` and `--json` (see cli/inventory.py) write the races here, too.
"""

from __future__ import annotations

import contextlib
import csv
import json
import sys
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, TextIO

from tyro.conf import Positional, arg

from league import times
from league.atomic_file import replacing
from league.cli import lazy, season, tables
from league.cli.season import OnLeague, Reading
from league.errors import ConfigError, StoreError

FIGURES = ("finished", "laps", "total_s", "distance", "off_tracks", "crashes", "overtakes")
COLUMNS = (
    *("heat", "race", "key", "purpose", "ruleset", "track", "seed"),
    *("slot", "entry", "id", "owner", "place", *FIGURES),
)
"""Columns of an export: one line for each car of each race."""
EXPORTED = 500  # Heats read at a time by an export.
VERDICTS = {
    "accepted": "agrees",
    "repeated": "agrees",
    "quarantined": "DIFFERS, and is in quarantine now",
    "unverified": "differs from a result of another class of machine, which proves nothing",
}
"""What an audit says of a heat."""
Shown = Literal["all", "planned", "claimed", "done", "error", "quarantined", "cancelled"]


@dataclass
class Heats(Reading):
    """List heats: the newest, those of an entry, or those in a state."""

    entry: str = ""  # Only those of this entry, by name or id.
    state: Shown = "all"  # Only those in this state.
    limit: int = 20  # How many, the newest.

    def run(self) -> None:
        season.at_least(self, "limit", 1)
        with self.opened() as store:
            numbers = [store.entry(self.entry).number] if self.entry else []
            states = None if self.state == "all" else (self.state,)
            records = store.heats(states, entries=numbers)[-self.limit :]
            names = lazy.documents.names_of(store.entries())
        if self.json:
            return season.print_json(
                [lazy.documents.heat_document(record, names) for record in records]
            )
        rows = []
        for record in records:
            heat, half = record.heat, record.heat.halves[0]
            grid, done = " - ".join(names[id] for id in half.grid), times.day(record.done_s)[5:]
            rows.append((record.number, grid, heat.purpose, record.state, half.track, done))
        heads = ("heat", "grid", "purpose", "state", "track", "done")
        tables.table("Heats", heads, rows, "done", "track")


@dataclass
class ShowHeat(Reading):
    """Show a heat: its races, results, seeds, and what went wrong if it failed."""

    heat: Annotated[Positional[str], arg(metavar="HEAT")]
    """Its number, or the beginning of its key."""

    def run(self) -> None:
        with self.opened() as store:
            record = store.heat(self.heat)
            names = lazy.documents.names_of(store.entries())
            results = store.results(record.number)
            audited = store.heat(record.heat.audits).number if record.heat.audits else 0
        if self.json:
            return season.print_json(
                {**lazy.documents.heat_document(record, names), "results": results}
            )
        heat = record.heat
        print(f"Heat {record.number} ({heat.purpose}), {record.state}, key {heat.key}")
        if record.worker:
            print(f"raced by {record.worker}, try {record.attempts}")
        disputed = len(results) > len(heat.halves)
        for result in results:
            half = heat.halves[result.half]
            title = f"Race {result.half + 1} on {half.track}"
            if record.seeds:
                title += f", seed {record.seeds[result.half]}"
            verdict = ", REJECTED" if result.rejected else ""
            on = f" on {tables.spelled(result.machine)}" if result.machine else ""
            if disputed or on:
                print(f"Result {result.hash[:12]} by {result.worker}{on}{verdict}:")
            rows = []
            for car in result.result["order"]:
                slot = car["car"]
                time = times.clock(car["total_s"]) if car["finished"] else "not finished"
                counts = car["off_tracks"], car["crashes"], car["overtakes"]
                driver = result.places[slot], names[half.grid[slot]], slot + 1
                rows.append((*driver, car["laps"], time, *counts))
            heads = ("", "entry", "slot", "laps", "time", "off", "crash", "passed")
            tables.table(title, heads, rows, "passed", "laps", "crash", "off")
        if record.state == "quarantined":
            of = f" of heat {audited}" if audited else ""
            print(
                f"The results{of} differ, so none counts. `league retry {record.number}` has the "
                "races run once more: the result that comes again is the one that counts."
            )
        if record.state == "done" and any(result.replay for result in results):
            print(f"Watch it: league view {record.number}   (the second race: --race 2)")
        if record.traceback:
            print(tables.spelled(record.traceback))


@dataclass
class Retry(OnLeague):
    """Race a heat again that was given up, cancelled, or is in quarantine.

    A dispute is settled if the new result agrees with one of the old ones, so use a machine that
    you trust and that raced none of them.
    """

    heat: Annotated[Positional[str], arg(metavar="HEAT")]
    """Its number, or the beginning of its key."""

    def run(self) -> None:
        with self.opened() as store:
            record = store.heat(self.heat)
            number = store.retry(record.heat.key)
            if not number:
                raise StoreError(
                    f"heat {record.number} is {record.state}: only heats in error, in quarantine "
                    "or cancelled ones can be tried again"
                )
        what = f", which heat {record.number} audited," if number != record.number else ""
        print(
            f"Heat {number}{what} waits to be raced again: `league run` or `league work` does it."
        )
        if record.state == "quarantined":
            print(f"Then `league heat {number}` shows which result was found again, if any.")


@dataclass
class Audit(OnLeague):
    """Recompute all that standings use, and run a sample of the heats again, to the last bit."""

    sample: str = "2%"  # Share of the rated heats not audited before, in percent.
    workers: int = 0  # Worker processes; 0 takes one for each core.
    seed: int | None = None  # Seed of the draw; by default chance.
    head: str = ""
    """The ledger's head as an earlier audit printed it: nothing up to then may have changed."""

    def run(self) -> int:
        import numpy as np

        share = season.share(self.sample, "--sample")
        with self.opened() as store:
            found = store.verify(self.head)
            for mismatch in found.mismatches:
                print(tables.spelled(mismatch))
            print(
                f"{found.races} races and {found.records} records of the ledger were recomputed: "
                f"{tables.counted(len(found.mismatches), 'mismatch')}. Ledger's head: "
                f"{found.head[:16]}",
                flush=True,
            )
            if found.damaged:
                print("Nothing can be raced again: restore the database from a backup, then audit.")
                return 1
            audits = lazy.gauntlet.pick_audit(store, share, np.random.default_rng(self.seed))
            if not audits:
                print(
                    "There is nothing to audit: no rated heat is done that was not audited before."
                )
                return 1 if found.mismatches else 0

            def watch(number: int, verdict: str) -> None:
                print(f"heat {number} {VERDICTS[verdict]}", flush=True)

            with season.local_workers(self.workers) as executor:
                verdicts = lazy.gauntlet.audit(store, executor, audits, watch=watch)
        heats = "1 heat was" if len(audits) == 1 else f"{len(audits)} heats were"
        differ, unverified = verdicts["quarantined"], verdicts["unverified"]
        agree = len(audits) - differ - unverified
        print(f"{heats} run again: {agree} agree, {differ} differ.")
        if unverified:
            print(
                f"{unverified} could not be judged: they were raced on another class of machine "
                "(`league heat N` names it), where Bullet may give other bits. Audit them on one "
                "like that; nothing was put in quarantine for it."
            )
        return 1 if differ or found.mismatches else 0


def export_csv(store: lazy.store.Store, path: Path) -> None:
    """Write a line for each car of each race; "-" is the standard output."""
    with _output(path) as file:
        table = csv.DictWriter(file, COLUMNS, lineterminator="\n")
        table.writeheader()
        for row in _rows(store):
            table.writerow({name: _inert(value) for name, value in row.items()})


def _inert(value: object) -> object:
    """Return a cell that no spreadsheet takes for a formula: then it begins with an apostrophe."""
    return f"'{value}" if isinstance(value, str) and value[:1] in tuple("=+-@\t\r") else value


def export_json(store: lazy.store.Store, path: Path) -> None:
    """Write rules, entries, standings and races; "-" is the standard output."""
    settings, rated = store.settings, None
    with contextlib.suppress(StoreError):  # where no entry is rated yet
        rated = lazy.documents.standings_document(lazy.standings.of(store))
    document = {
        "league": settings.name,
        "rules": lazy.documents.plain(settings.ruleset),
        "ruleset": settings.ruleset.hash,
        "entries": lazy.documents.plain(store.entries()),
        "standings": rated,
    }
    with _output(path) as file:
        head = json.dumps(document, indent=1, ensure_ascii=False)
        file.write(head.removesuffix("\n}") + ',\n "races": [')
        for number, row in enumerate(_rows(store)):
            file.write(("," if number else "") + "\n  " + json.dumps(row, ensure_ascii=False))
        file.write("\n ]\n}\n")


@contextlib.contextmanager
def _output(path: Path) -> Generator[TextIO]:
    """Yield a file to write, which appears when it is whole; "-" is the standard output."""
    if str(path) == "-":
        yield sys.stdout
        return
    with (
        replacing(path, "the export", ConfigError) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        yield file
    print(f"Wrote the league's results: {path}")


def _rows(store: lazy.store.Store) -> Iterator[dict[str, object]]:
    """Yield a line for each car of each race that is done; a few hundred heats are in memory."""
    entries, last = {entry.id: entry for entry in store.entries()}, 0
    while records := store.heats(("done",), since=last, limit=EXPORTED):
        last = records[-1].number
        # The results of an audit are those of the heat it audits.
        by_number = {record.number: record for record in records if not record.heat.audits}
        for result in store.results(*by_number):
            record = by_number[result.heat]
            half = record.heat.halves[result.half]
            order = () if result.rejected else result.result["order"]
            heat, seed = record.heat, record.seeds[result.half] if record.seeds else ""
            race = record.number, result.half + 1, heat.key, heat.purpose, heat.ruleset[:12]
            for car in sorted(order, key=lambda car: car["car"]):
                slot = car["car"]
                entry = entries[half.grid[slot]]
                driver = slot + 1, entry.name, entry.id, entry.owner, result.places[slot]
                figures = (car[name] for name in FIGURES)
                yield dict(zip(COLUMNS, (*race, half.track, seed, *driver, *figures), strict=True))
