"""`league gauntlet` and `league compare`: races for an answer, not for the ratings."""

from __future__ import annotations

import math
import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from league.cli import flags, tables
from league.cli.season import base
from league.cli.season.base import Reading
from league.errors import ConfigError

if TYPE_CHECKING:
    from league.matchmaking.ratings.sprt import Comparison
    from league.matchmaking.store import Outcome, Store
    from league.matchmaking.workers.worker import Contestant


@dataclass
class Gauntlet(Reading):
    """Race a checkpoint against the field without submitting it: where would it stand?"""

    checkpoint: tyro.conf.Positional[Path]
    """The checkpoint (FILE.pt)."""
    rounds: int = 1
    """Heats against each opponent."""
    opponents: int = 8
    """Opponents, evenly spread over the standings."""
    workers: int = 0
    """Worker processes; 0 takes one for each core."""

    def run(self) -> int:
        """Run the command."""
        return _gauntlet(self)


@dataclass
class Compare(Reading):
    """Is B better than A? Race them until the answer is sure, and no longer."""

    one: tyro.conf.Positional[str]
    """A: an entry's name or id, or a checkpoint (FILE.pt)."""
    other: tyro.conf.Positional[str]
    """B."""
    elo0: float = 0.0
    """B is "not better" if it leads by this or less [Elo]."""
    elo1: float = 30.0
    """B is "better" if it leads by this or more [Elo]."""
    alpha: float = 0.05
    """Chance of a wrong "better"."""
    beta: float = 0.05
    """Chance of a wrong "not better"."""
    heats: int = 400
    """Give up undecided after so many heats."""
    workers: int = 0
    """Worker processes; 0 takes one for each core."""

    def run(self) -> int:
        """Run the command."""
        return _compare(self)


def _gauntlet(command: Gauntlet) -> int:
    from league.agents import checkpoint
    from league.matchmaking import gauntlet as trials
    from league.matchmaking import workers as executors

    flags.at_least(command, "rounds", 1)
    flags.at_least(command, "opponents", 1)
    given = checkpoint.load(command.checkpoint)
    with command.opened() as store:
        field = trials.opponents(store, most=command.opponents)
        executor = executors.make("processes", command.workers or os.cpu_count() or 1)
        quiet = command.json or not sys.stderr.isatty()
        try:
            with tables.progress(disable=quiet) as progress:
                bar = progress.add_task("Racing", total=command.rounds * len(field))

                def watch(_outcome: Outcome) -> bool:
                    progress.advance(bar)
                    return True

                found = trials.gauntlet(
                    store, executor, given, field, rounds=command.rounds, watch=watch
                )
        finally:
            executor.close()
    if command.json:
        base.print_json(found)
        return 0
    table = tables.table(f"Gauntlet of {given.card.name}", "opponent", "races", "points")
    for name, races, points in found.against:
        table.add_row(name, str(races), f"{points:g}")
    tables.console().print(table)
    rating = base.plus_minus(found.elo, found.low95, found.high95)
    ranks = f" ({found.best_rank} to {found.worst_rank})" if found.provisional else ""
    print(f"Elo {rating}: that would be rank {found.rank}{ranks}.")
    if found.one_sided:
        print("It won, or lost, every race: read the number as a bound.")
    if found.provisional:
        print("More rounds tell more surely: --rounds 5")
    print(f"Nothing was kept; enter it with  league submit {command.checkpoint}")
    return 0


def _compare(command: Compare) -> int:
    from league.matchmaking import gauntlet as trials
    from league.matchmaking import workers as executors
    from league.matchmaking.ratings.sprt import SequentialSettings

    flags.at_least(command, "heats", 1)
    with command.opened() as store:
        one, other = (_contestant(store, given) for given in (command.one, command.other))
        if one.id == other.id:
            raise ConfigError(f"{command.one} and {command.other} are the same driver: name two")
        settings = SequentialSettings(
            elo0=command.elo0,
            elo1=command.elo1,
            alpha=command.alpha,
            beta=command.beta,
            slot_gap=_slot_gap(store),
        )
        executor = executors.make("processes", command.workers or os.cpu_count() or 1)
        quiet = command.json or not sys.stderr.isatty()
        try:
            with tables.progress(disable=quiet) as progress:
                bar = progress.add_task("Racing", total=command.heats)

                def watch(now: Comparison) -> None:
                    text = (
                        f"heat {now.heats}: LLR {now.llr:+.2f} in {now.lower:.2f}..{now.upper:.2f}"
                    )
                    progress.update(bar, completed=now.heats, description=text)

                found = trials.compare(
                    store, executor, one, other, settings, most_heats=command.heats, watch=watch
                )
        finally:
            executor.close()
    if command.json:
        base.print_json(found)
        return 0
    print(f"{other.name} is {found.decision.replace('better', f'better than {one.name}')}.")
    print(
        f"{found.heats} heats, score {100 * found.score:.1f} %, lead {_elo(found.elo)} Elo "
        f"({_elo(found.low95)} to {_elo(found.high95)}), LLR {found.llr:+.2f} "
        f"({found.lower:.2f} to {found.upper:.2f})"
    )
    return 0


def _elo(value: float) -> str:
    return f"{value:+.0f}" if math.isfinite(value) else ("+∞" if value > 0 else "-∞")


def _contestant(store: Store, given: str) -> Contestant:
    from league.agents import checkpoint
    from league.matchmaking import submission
    from league.matchmaking.workers import dispatcher
    from league.matchmaking.workers.worker import Contestant

    if not given.endswith(".pt"):
        return dispatcher.contestant(store, store.entry(given))
    found = checkpoint.load(given)
    submission.check_sensors(found.card.sensors, store.settings.ruleset)
    return Contestant(found.digest, Path(given).stem, weights=submission.pack(found))


def _slot_gap(store: Store) -> float:
    """Return what the front slot is worth by the league's own races [Elo]."""
    from league.errors import StoreError
    from league.matchmaking import standings

    try:
        slots = standings.of(store).ratings.slot_advantages
    except StoreError:
        return 0.0  # nobody has raced yet
    return float(slots[0] - slots[1])


COMMANDS = {"gauntlet": Gauntlet, "compare": Compare}
