"""`league run` and `league work`: the matchmaker, the workers, and a page to watch them."""

from __future__ import annotations

import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from league.cli import flags
from league.cli.season.base import OnLeague
from league.errors import ConfigError

if TYPE_CHECKING:
    from collections.abc import Callable

    from league.matchmaking.loop import Tally
    from league.matchmaking.store import Store


@dataclass
class Work(OnLeague):
    """Race heats from the queue; several machines may do so on one PostgreSQL league."""

    heats: int | None = None
    """Stop after so many heats."""
    minutes: float | None = None
    """Begin no heat after so many minutes."""
    workers: int = 0
    """Worker processes; 0 takes one for each core."""
    executor: Literal["processes", "ray"] = "processes"
    """Where the workers live: on this machine, or on the Ray cluster that RAY_ADDRESS names."""
    lease_s: float = 60.0
    """Heats of a machine that gives no sign for so long are lent to others [s]."""
    replays: bool = True
    """Keep the recordings; without them heats cannot be watched."""
    plain: bool = False
    """Print a line for each heat instead of the page."""

    def run(self) -> int:
        """Run the command."""
        return _run(self, plans=False, same_owner=False)


@dataclass
class Run(Work):
    """Run the season: pair entries, race heats, rate, and again; Ctrl-C finishes what has begun."""

    same_owner: bool = False
    """Let entries of one owner meet, as a league of one person needs."""

    def run(self) -> int:
        """Run the command."""
        return _run(self, plans=True, same_owner=self.same_owner)


def _run(command: Work, *, plans: bool, same_owner: bool) -> int:
    import os

    from league.cli.season.monitor import Lines, Page
    from league.matchmaking import loop
    from league.matchmaking import workers as executors
    from league.matchmaking.pairing.matchmaker import LEAST_ROUND, Season
    from league.matchmaking.workers.dispatcher import Crew

    _check(command)
    workers = command.workers or os.cpu_count() or 1
    with command.opened() as store:
        season = None
        if plans:
            least = max(LEAST_ROUND, 2 * workers)
            season = Season(store, same_owner=same_owner, least_round=least)
        executor = executors.make(command.executor, workers)
        try:
            crew = Crew(store, executor, lease_s=command.lease_s, keep_replays=command.replays)
            page = sys.stdout.isatty() and not command.plain
            with (Page if page else Lines)(store, crew) as shown, _stopping() as stop:
                tally = loop.run(
                    store,
                    crew,
                    season,
                    heats=command.heats,
                    seconds=None if command.minutes is None else 60 * command.minutes,
                    stop=stop,
                    watch=shown.show,
                )
        finally:
            executor.close()
        _print_tally(store, tally)
    return 0


def _check(command: Work) -> None:
    flags.at_least(command, "heats", 1)
    if command.minutes is not None and not command.minutes > 0:
        raise ConfigError(f"--minutes {command.minutes}: give more than 0")
    if not 1 <= command.lease_s <= 3600:
        raise ConfigError(f"--lease-s {command.lease_s}: give 1 to 3600 s")


@contextmanager
def _stopping() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C or SIGTERM into a wish to stop; the second one stops at once."""
    asked: list[int] = []

    def note(number: int, _frame: object) -> None:
        if asked:
            raise KeyboardInterrupt
        asked.append(number)
        print("Finishing the heats under way; Ctrl-C again leaves them.", file=sys.stderr)

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(asked)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _print_tally(store: Store, tally: Tally) -> None:
    if tally.idle and not tally.heats:
        print(
            "There is nothing to race: submit an entry with `league submit FILE.pt`; "
            "entries of one owner meet with --same-owner."
        )
        return
    rate = tally.race_s / tally.worker_s if tally.worker_s else 0.0
    print(
        f"{tally.heats} heats, {tally.races} races, {tally.race_s / 60:.1f} min of race time, "
        f"{rate:.1f} x real time per worker"
    )
    if tally.failures or tally.quarantined:
        print(
            f"{tally.failures} tries failed, {tally.errors} heats given up (`league heats --state "
            f"error`), {tally.quarantined} in quarantine (`league heats --state quarantined`)"
        )


COMMANDS = {"run": Run, "work": Work}
