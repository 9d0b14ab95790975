"""`league gauntlet` and `league compare`: races for an answer, not for the ratings."""

from __future__ import annotations

import contextlib
import math
import shlex
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from league.cli import lazy, season, tables
from league.cli.season import Reading
from league.errors import ConfigError, StoreError

PRINT_EVERY_S = 10.0  # Interval at which a comparison without a terminal reports its progress [s].


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
            f"{tables.counted(result.heats, 'heat')}, score {share}, lead {lead} Elo "
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
            f"Not decided after {tables.counted(result.heats, 'heat')}: whether {other} is better "
            f"than {one}. More heats may decide: --heats {4 * self.heats}"
        )


def _elo(value: float) -> str:
    return f"{value:+.0f}" if math.isfinite(value) else ("+∞" if value > 0 else "-∞")


def _driver(store: lazy.store.Store, text: str) -> lazy.worker.HeatDriver:
    """Return an entry by name or id, or a checkpoint by its file or its name in the garage."""
    entered = text not in lazy.roster.garage() or text in (entry.name for entry in store.entries())
    if entered and not text.endswith(".pt"):
        return lazy.dispatcher.heat_driver(store, store.entry(text))
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
