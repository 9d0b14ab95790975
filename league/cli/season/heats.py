"""`league heats`, `heat`, `audit`, `retry`: what was raced, and whether it can be trusted.

`gauntlet` and `compare` race for an answer, not for the ratings; `league export --csv` and `--json`
(see cli/inventory.py) write races here, too.
"""

from __future__ import annotations

import contextlib
import csv
import json
import shlex
import sys
import time
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
from league.flags import Unset

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
PRINT_EVERY_S = 10.0  # Interval at which a comparison without a terminal reports its progress [s].
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
        kept = {result.half for result in results if result.replay}
        if record.state == "done" and kept:
            second = "   (the second race: --race 2)" if 1 in kept else ""
            print(f"Watch it: league view {record.number}{second}")
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
    seed: Unset[int | None] = None  # Seed of the draw; by default chance.
    head: str = ""
    """The ledger's head as an earlier audit printed it: nothing up to then may have changed."""

    def run(self) -> int:
        import numpy as np

        share = season.share(self.sample, "--sample")
        if not share:
            raise ConfigError(f"--sample {self.sample}: give more than 0%")
        with self.opened() as store:
            found = store.verify(self.head)
            for mismatch in found.mismatches:
                print(tables.spelled(mismatch))
            print(
                f"{found.races} races and {found.records} records of the ledger were recomputed: "
                f"{times.counted(len(found.mismatches), 'mismatch')}. Ledger's head: "
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


@dataclass
class Gauntlet(Reading):
    """Race a checkpoint against the field without submitting it: where would it stand?"""

    checkpoint: Annotated[Positional[str], arg(metavar="CHECKPOINT")]
    """The checkpoint (FILE.pt), or a name in the garage."""
    rounds: int = 1  # Heats against each opponent.
    opponents: int = 8  # Opponents, evenly spread over the standings.
    workers: int = 0  # Worker processes; 0 takes one for each core.

    def run(self) -> None:
        season.at_least(self, "rounds", 1)
        season.at_least(self, "opponents", 1)
        newcomer = lazy.checkpoint.load(lazy.roster.checkpoint_path(self.checkpoint))
        quiet = self.json or not sys.stderr.isatty()
        with self.opened() as store:
            opponents = lazy.gauntlet.opponents(store, most=self.opponents)
            with (
                season.local_workers(self.workers) as executor,
                tables.progress(disable=quiet) as progress,
            ):
                bar = progress.add_task("Racing", total=self.rounds * len(opponents))

                def watch(_outcome: lazy.store.HeatOutcome) -> bool:
                    progress.advance(bar)
                    return True

                placed = lazy.gauntlet.gauntlet(
                    store, executor, newcomer, opponents, rounds=self.rounds, watch=watch
                )
        if self.json:
            return season.print_json(placed)
        rows = [(name, races, f"{points:g}") for name, races, points in placed.against]
        tables.table(f"Gauntlet of {newcomer.card.name}", ("opponent", "races", "points"), rows)
        rating = season.plus_minus(placed.elo, placed.low95, placed.high95)
        ranks = f" ({placed.best_rank} to {placed.worst_rank})" if placed.provisional else ""
        print(f"Elo {rating}: that would be rank {placed.rank}{ranks}.")
        if placed.one_sided:
            print("It won, or lost, every race: read the number as a bound.")
        if placed.provisional:
            print("More rounds give a narrower interval: --rounds 5")
        print(f"Nothing was kept; enter it with  league submit {shlex.quote(self.checkpoint)}")


@dataclass
class Compare(Reading):
    """Is B better than A? Race them until the answer is sure, and no longer."""

    one: Annotated[Positional[str], arg(metavar="A")]
    """A: an entry's name or id, a checkpoint (FILE.pt), or a name in the garage."""
    other: Annotated[Positional[str], arg(metavar="B")]  # B.
    elo0: float = 0.0  # B is "not better" if it leads by this or less [Elo].
    elo1: float = 30.0  # B is "better" if it leads by this or more [Elo].
    alpha: float = 0.05  # Chance of a wrong "better".
    beta: float = 0.05  # Chance of a wrong "not better".
    heats: int = 400  # Give up undecided after so many heats.
    workers: int = 0  # Worker processes; 0 takes one for each core.

    def run(self) -> None:
        season.at_least(self, "heats", 1)
        quiet = self.json or not sys.stderr.isatty()
        printed_s = time.monotonic()
        with self.opened() as store:
            one, other = (_driver(store, text) for text in (self.one, self.other))
            if one.id == other.id:
                raise ConfigError(f"{self.one} and {self.other} are the same driver: name two")
            bounds = self.elo0, self.elo1, self.alpha, self.beta
            settings = lazy.sprt.SequentialSettings(*bounds, slot_gap=_slot_gap(store))
            with (
                season.local_workers(self.workers) as executor,
                tables.progress(disable=quiet) as progress,
            ):
                bar = progress.add_task("Racing", total=self.heats)

                def watch(now: lazy.sprt.Comparison) -> None:
                    bounds = f"{now.lower:.2f}..{now.upper:.2f}"
                    text = f"heat {now.heats}: LLR {now.llr:+.2f} in {bounds}"
                    progress.update(bar, completed=now.heats, description=text)
                    nonlocal printed_s
                    if quiet and not self.json and time.monotonic() > printed_s + PRINT_EVERY_S:
                        printed_s = time.monotonic()
                        print(f"{text}, lead {_elo(now.elo)} Elo", file=sys.stderr, flush=True)

                result = lazy.gauntlet.compare(
                    store, executor, one, other, settings, most_heats=self.heats, watch=watch
                )
        if self.json:
            return season.print_json(result)
        print(self._verdict(result, one.name, other.name))
        share, lead = f"{100 * result.score:.1f} %", _elo(result.elo)
        print(
            f"{times.counted(result.heats, 'heat')}, score {share}, lead {lead} Elo "
            f"({_elo(result.low95)} to {_elo(result.high95)}), LLR {result.llr:+.2f} "
            f"({result.lower:.2f} to {result.upper:.2f})"
        )

    def _verdict(self, result: lazy.sprt.Comparison, one: str, other: str) -> str:
        if result.decision == "better":
            chance = f"{100 * self.alpha:g} %, if its lead were {self.elo0:g} Elo"
            return f"Yes, {other} is better than {one}. (Chance of a wrong yes: {chance}.)"
        if result.decision == "not better":
            chance, lead = f"{100 * self.beta:g} %, if it were", f"{self.elo1:g} Elo"
            verdict = f"No, {other} is not better than {one} by {lead}."
            return f"{verdict} (Chance of a wrong no: {chance}.)"
        return (
            f"Not decided after {times.counted(result.heats, 'heat')}: whether {other} is better "
            f"than {one}. More heats may decide: --heats {4 * self.heats}"
        )


def _elo(value: float) -> str:
    return f"{value:+.0f}".replace("inf", "∞")


def _driver(store: lazy.store.Store, text: str) -> lazy.worker.HeatDriver:
    """Return an entry by name or id, or a checkpoint by its file or its name in the garage."""
    entered = text not in lazy.roster.garage() or text in (entry.name for entry in store.entries())
    if entered and not text.endswith(".pt"):
        return lazy.loop.heat_driver(store, store.entry(text))
    loaded = lazy.checkpoint.load(lazy.roster.checkpoint_path(text))
    lazy.submission.check_sensors(loaded.card.sensors, store.settings.ruleset)
    return lazy.worker.HeatDriver(
        lazy.submission.identity(loaded), Path(text).stem, weights=lazy.submission.pack(loaded)
    )


def _slot_gap(store: lazy.store.Store) -> float:
    """Return what the front slot is worth by the league's own races [Elo]; 0 without any."""
    with contextlib.suppress(StoreError):
        slots = lazy.standings.of(store).ratings.slot_advantages
        return float(slots[0] - slots[1])
    return 0.0
