"""What `league run` shows: a live page on a terminal, otherwise a line for each heat."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from league.cli import tables
from league.cli.season import base
from league.errors import LeagueError

if TYPE_CHECKING:
    from rich.console import RenderableType

    from league.matchmaking.loop import Tally
    from league.matchmaking.standings import Row, Standings
    from league.matchmaking.store import Store
    from league.matchmaking.workers.dispatcher import Crew, Ended

REFIT_EVERY_S = 5.0
"""How often the page works out the standings anew, at most [s]."""
TOP = 12
"""Entries on the page."""


def told(ended: Ended) -> str:
    """Return what became of a heat, in a line."""
    claim, report = ended.running.claim, ended.report
    who = " - ".join(ended.running.names)
    start = f"heat {claim.number} ({claim.heat.purpose}) {who}"
    if report.outcome is None:
        last = report.traceback.strip().splitlines()[-1:] or ["no reason told"]
        again = "given up" if ended.became == "error" else "will be tried again"
        return f"{start}: failed, {again}: {tables.spelled(last[0][:120])}"
    scores = " | ".join(
        "-".join(str(place) for place in one.places) for one in report.outcome.races
    )
    note = "" if ended.became == "accepted" else f"  [{ended.became}]"
    return f"{start}: places {scores}  {report.race_s:.0f} s in {report.wall_s:.1f} s{note}"


@dataclass
class Lines:
    """A line for each heat."""

    store: Store
    crew: Crew

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """End; there is nothing to tidy."""

    def show(self, tally: Tally, ended: list[Ended]) -> None:
        """Print what has ended."""
        for one in ended:
            print(told(one), flush=True)


class Page:
    """A page that is drawn anew in place: rates, heats under way, last results, standings."""

    def __init__(self, store: Store, crew: Crew) -> None:
        from rich.live import Live

        self._store, self._crew = store, crew
        self._began = time.monotonic()
        self._last: deque[str] = deque(maxlen=6)
        self._standings: Standings | None = None
        self._fitted_s, self._stale = 0.0, True
        self._live = Live(console=tables.console(), refresh_per_second=4, transient=True)

    def __enter__(self) -> Self:
        self._live.__enter__()
        return self

    def __exit__(self, *about: object) -> None:
        self._live.__exit__(None, None, None)

    def show(self, tally: Tally, ended: list[Ended]) -> None:
        """Draw the page."""
        for one in ended:
            self._last.append(told(one))
        self._stale = self._stale or bool(ended)
        if self._stale and time.monotonic() - self._fitted_s > REFIT_EVERY_S:
            self._refit()
        self._live.update(self._drawn(tally))

    def _refit(self) -> None:
        from league.matchmaking import standings

        try:
            self._standings = standings.of(self._store)
        except LeagueError:
            self._standings = None  # nobody is rated yet
        self._fitted_s, self._stale = time.monotonic(), False

    def _drawn(self, tally: Tally) -> RenderableType:
        from rich.console import Group
        from rich.text import Text

        wall_s = max(time.monotonic() - self._began, 1e-9)
        counts = self._store.counts()
        head = (
            f"{self._store.settings.name}   {wall_s / 60:.1f} min   {tally.heats} heats, "
            f"{60 * tally.heats / wall_s:.1f} a minute   {tally.race_s / wall_s:.1f} x real time   "
            f"queue {counts.get('planned', 0)}"
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
            parts.append(table(self._standings, TOP))
        parts += [Text("Racing", style="dim"), *(Text(line) for line in under_way)]
        parts += [Text("Last", style="dim"), *(Text(f"  {line}") for line in self._last)]
        return Group(*parts)


def table(standings: Standings, limit: int | None = None) -> RenderableType:
    """Return the standings as a table that fits 80 columns."""
    drawn = tables.table(
        "Standings", "", "entry", "owner", "Elo ± 95 %", "state", "races", "score", "DNF",
        "best lap", "ranks",
    )  # fmt: skip
    drawn.padding = (0, 0)  # the box leaves room enough between columns
    for row in standings.rows[:limit]:
        flags = "?" * row.provisional + "!" * row.one_sided + "~" * (not row.connected)
        ranks = f"{row.best_rank}-{row.worst_rank}" if row.best_rank < row.worst_rank else ""
        drawn.add_row(
            str(row.rank),
            row.name[:17],
            row.owner[:6],
            f"{base.plus_minus(row.elo, row.low95, row.high95)} {flags:2}",
            "anchor" if row.anchor else SHORT.get(row.state, row.state),
            str(row.races),
            f"{100 * row.score:.0f}%" if row.races else "",
            "" if row.unfinished is None else f"{100 * row.unfinished:.0f}%",
            best_lap(row, standings.tracks),
            ranks,
        )
    return drawn


SHORT = {"placement": "placing", "provisional": "prov.", "validating": "valid."}
"""States in fewer letters, where room is scarce."""


def best_lap(row: Row, tracks: Sequence[str]) -> str:
    """Return an entry's best lap on the league's first track, laps of several not being alike."""
    lap_s = row.best_laps_s.get(tracks[0]) if tracks else None
    return "" if lap_s is None else tables.clock(lap_s)
