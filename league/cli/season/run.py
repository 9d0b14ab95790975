"""`league run`, `work`, `serve` and `site`: the matchmaker, the workers, and pages to watch them.

On a terminal `run` and `work` show a live page, otherwise a line for each heat.
"""

from __future__ import annotations

import signal
import sys
import time
from collections import deque
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from tyro.conf import Positional, arg

from league import times
from league.cli import lazy, season, tables
from league.cli.season import OnLeague, OnServer
from league.errors import ConfigError, LeagueError
from league.flags import Unset

if TYPE_CHECKING:
    from rich.console import RenderableType

REFIT_EVERY_S = 5.0  # Interval at which the page computes the standings, at least [s].
TOP = 12  # Entries on the page.
PATIENCE_S = 600.0  # How long a remote worker waits for a server that does not answer [s].


@dataclass
class Racing(OnLeague):
    """A command that races heats."""

    heats: Unset[int | None] = None  # Stop after so many heats.
    minutes: Unset[float | None] = None  # Begin no heat after so many minutes.
    workers: int = 0  # Worker processes; 0 takes one for each core.
    executor: Literal["processes", "ray"] = "processes"
    """Where the workers live: on this machine, or on the Ray cluster that RAY_ADDRESS names."""
    lease_s: float = 60.0
    """Heats of a machine that gives no sign for so long are lent to others [s]."""
    replays: bool = True  # Keep the recordings; without them heats cannot be watched.
    plain: bool = False  # Print a line for each heat instead of the page.

    def run(self) -> None:
        self._check()
        with self.opened() as store:
            lazy.worker.check_physics(store.settings.ruleset, f"the league in {store.url}")
            self._race(store, store)

    def _check(self) -> None:
        season.at_least(self, "heats", 1)
        if self.minutes is not None and not self.minutes > 0:
            raise ConfigError(f"--minutes {self.minutes}: give more than 0")
        if not 1 <= self.lease_s <= 3600:
            raise ConfigError(f"--lease-s {self.lease_s}: give 1 to 3600 s")

    def _race(self, source: lazy.loop.HeatSource, store: lazy.store.Store | None) -> None:
        """Race heats of a source; `store` is the league, where it is on this machine."""
        with ExitStack() as stack:
            matchmaker = self._matchmaker(store) if store else None
            executor = stack.enter_context(season.local_workers(self.workers, self.executor))
            dispatcher = lazy.loop.Dispatcher(
                source, executor, lease_s=self.lease_s, keep_replays=self.replays
            )
            watch = _print_finished
            if store and sys.stdout.isatty() and not self.plain:
                page = LivePage(store, dispatcher)
                stack.enter_context(page.live)
                watch = page.show
            tally = lazy.loop.run(
                store,
                dispatcher,
                matchmaker,
                heats=self.heats,
                seconds=None if self.minutes is None else 60 * self.minutes,
                stop=stack.enter_context(_stopping()),
                watch=watch,
            )
            seasons = store.seasons() if store else []
        over = seasons[-1].name if seasons and seasons[-1].until is not None else ""
        _print_tally(tally, over)

    def _matchmaker(self, store: lazy.store.Store) -> lazy.matchmaker.Matchmaker | None:
        """Return the matchmaker; None races what is in the queue."""
        return None


@dataclass
class Work(Racing, OnServer):
    """Race heats from the queue: of a PostgreSQL league, or with --to of a league that is served.

    Heats of the token's owner are left to others, and so are those that must be raced again
    because a worker of the owner raced them.
    """

    def run(self) -> None:
        if not self.to:
            return super().run()
        self._check()
        if self.lease_s > 600:
            raise ConfigError(f"--lease-s {self.lease_s}: give 1 to 600 s with --to")
        client, queue = self.client(), lazy.remote.RemoteQueue
        queue(client).heartbeat("hello", lease_s=60.0, keys=())  # fails at once, if at all
        print(f"Racing for {client.url}; Ctrl-C finishes the heats under way.", flush=True)
        self._race(queue(replace(client, patience_s=PATIENCE_S)), None)


@dataclass
class RunSeason(Racing):
    """Run the season: pair entries, race heats, rate, and again; Ctrl-C finishes what has begun."""

    same_owner: bool = False
    """Let entries of one owner meet, too. By default they race only entries of others and anchors,
    so that entering many gains nothing; a league of one person needs this."""

    def _matchmaker(self, store: lazy.store.Store) -> lazy.matchmaker.Matchmaker:
        return lazy.matchmaker.Matchmaker(store, same_owner=self.same_owner)


@dataclass
class Serve(OnLeague):
    """Show the league in the browser, and take submissions there: standings, drivers, replays."""

    port: int = 8018  # Port to listen on; 0 takes a free one.
    host: str = "127.0.0.1"
    """Address to listen on; another one is possible once there are tokens (`league token`)."""
    name: Unset[tuple[str, ...]] = ()
    """Names under which browsers reach this server, apart from 127.0.0.1 and localhost."""
    entries: int = 4  # Entries that an owner may have.
    per_day: int = 5  # Submissions that an owner may make within 24 hours.
    audit: str = "5%"
    """Share of the heats of remote workers that are run again by others, in percent."""

    def run(self) -> None:
        for field in ("entries", "per_day"):
            season.at_least(self, field, 0)
        access = lazy.security.Access(
            hosts=("127.0.0.1", "localhost", *self.name),
            quota=lazy.store.Quota(self.entries, self.per_day),
            audited=season.share(self.audit, "--audit"),
        )
        with self.opened() as store:
            name = store.settings.name
            lazy.server.serve(
                store,
                self.port,
                host=self.host,
                access=access,
                ready=lambda url: print(f"{name}: {url}   (Ctrl-C ends it)", flush=True),
            )


@dataclass
class Site(OnLeague):
    """Write a league's pages as files, for any web space; they need no server."""

    folder: Annotated[Positional[Path], arg(metavar="FOLDER")]  # A new folder.
    heats: int = 200  # So many of the newest heats get pages, with their races to watch.
    season: Unset[int | None] = None
    """Number of a season that is over: everything is as it was at its end."""

    def run(self) -> None:
        season.at_least(self, "heats", 0)
        with self.opened() as store:
            written = lazy.site.export(store, self.folder, heats=self.heats, season=self.season)
        first = self.folder / "index.html"
        print(f"{written.pages} pages, {written.heats} of them with a race to watch: {first}")


@contextmanager
def _stopping() -> Generator[Callable[[], bool]]:
    """Turn the first Ctrl-C or SIGTERM into a request to stop; the second one stops at once."""
    requests: list[int] = []

    def request(number: int, _frame: object) -> None:
        if requests:
            raise KeyboardInterrupt
        requests.append(number)
        print("Finishing the heats under way; Ctrl-C again leaves them.", file=sys.stderr)

    with lazy.subprocesses.handling(request, signal.SIGINT, signal.SIGTERM):
        yield lambda: bool(requests)


def _print_tally(tally: lazy.loop.Tally, over: str) -> None:
    """Print what was raced; `over` is the name of the season if it has ended."""
    if tally.idle and not tally.heats:
        begin = f"The season {over!r} is over: begin the next one with `league season start`."
        submit = (
            "There is nothing to race: submit an entry with `league submit FILE.pt`; "
            "entries of one owner meet with --same-owner."
        )
        print(begin if over else submit)
        return
    rate = tally.race_s / tally.worker_s if tally.worker_s else 0.0
    print(
        f"{times.counted(tally.heats, 'heat')}, {times.counted(tally.races, 'race')}, "
        f"{tally.race_s / 60:.1f} min of race time, {rate:.1f} x real time per worker"
    )
    if tally.failures or tally.quarantined:
        print(
            f"Failed tries: {tally.failures}; heats given up: {tally.errors} (`league heats "
            f"--state error`), in quarantine: {tally.quarantined} (`league heats --state "
            "quarantined`)"
        )


def describe(finished: lazy.loop.FinishedHeat) -> str:
    """Return a heat's outcome in a line."""
    claim, report = finished.running.claim, finished.report
    names = " - ".join(finished.running.names)
    start = f"heat {claim.number} ({claim.heat.purpose}) {names}"
    if report.outcome is None:
        last = report.traceback.strip().splitlines()[-1:] or ["no reason given"]
        ends = {"error": "given up", "planned": "will be tried again"}
        end = ends.get(finished.became, "another worker has it")
        how = "interrupted" if report.lost else "failed"
        return f"{start}: {how}, {end}: {tables.spelled(last[0][:120])}"
    scores = " | ".join("-".join(map(str, one.places)) for one in report.outcome.races)
    note = "" if finished.became == "accepted" else f"  [{finished.became}]"
    return f"{start}: places {scores}  {report.race_s:.0f} s in {report.wall_s:.1f} s{note}"


def _print_finished(_tally: lazy.loop.Tally, finished: list[lazy.loop.FinishedHeat]) -> None:
    for one in finished:
        print(describe(one), flush=True)


class LivePage:
    """A page that is redrawn in place: rates, heats under way, last results, standings."""

    def __init__(self, store: lazy.store.Store, dispatcher: lazy.loop.Dispatcher) -> None:
        from rich.live import Live

        self._store, self._crew = store, dispatcher
        self._began = time.monotonic()
        self._last: deque[str] = deque(maxlen=6)
        self._standings: lazy.standings.Standings | None = None
        self._fitted_s, self._stale = 0.0, True
        self.live = Live(console=tables.console(), refresh_per_second=4, transient=True)

    def show(self, tally: lazy.loop.Tally, finished: list[lazy.loop.FinishedHeat]) -> None:
        """Draw the page."""
        for one in finished:
            self._last.append(describe(one))
        self._stale = self._stale or bool(finished)
        if self._stale and time.monotonic() - self._fitted_s > REFIT_EVERY_S:
            with suppress(LeagueError):  # where no entry is rated yet
                self._standings = lazy.standings.of(self._store)
            self._fitted_s, self._stale = time.monotonic(), False
        self.live.update(self._drawn(tally))

    def _drawn(self, tally: lazy.loop.Tally) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        from league.cli.season.standings import standings_table

        wall_s = max(time.monotonic() - self._began, 1e-9)
        counts = self._store.counts()
        head = (
            f"{self._store.settings.name}   {wall_s / 60:.1f} min   "
            f"{times.counted(tally.heats, 'heat')}, {60 * tally.heats / wall_s:.1f} a minute   "
            f"{tally.race_s / wall_s:.1f} x real time   queue {counts.get('planned', 0)}"
        )
        if tally.failures:
            head += f"   failed tries {tally.failures}"
        now = time.monotonic()
        under_way = [
            f"  {one.claim.number:>6} {one.claim.heat.purpose:<10} {' - '.join(one.names)}"
            f"  {now - one.since_s:.0f} s"
            for one in self._crew.running.values()
        ]
        parts: list[RenderableType] = [Text(head, style="bold")]
        if self._standings is not None:
            parts.append(standings_table(self._standings, TOP))
        parts += [Text("Racing", style="dim"), *(Text(line) for line in under_way)]
        parts += [Text("Last", style="dim"), *(Text(f"  {line}") for line in self._last)]
        return Group(*parts)
