"""The page in the terminal while a policy learns: curves, lap times, speed, and the time left."""

from __future__ import annotations

import atexit
import time
from typing import TYPE_CHECKING

from league.training.monitor import sparkline
from league.training.monitor.callback import Onlooker
from league.training.monitor.console import (
    clock,
    figure,
    is_tutored,
    judged,
    left_s,
    line,
    percent,
    seconds,
    self_play,
    shares,
    speed,
)

if TYPE_CHECKING:
    from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
    from rich.live import Live
    from rich.table import Table

    from league.racing.table import Evaluation
    from league.training.monitor.history import History
    from league.training.ppo.learner import Update
    from league.training.settings import TrainConfig

PLAIN_EVERY_S = 5.0
"""Seconds between two plain lines."""
REFRESHES_HZ = 2.0
"""How often the page is drawn anew; once takes some milliseconds."""
_NARROW = 78
_HEIGHT = 4
_LEARNT, _JUDGED = "cyan", "green"


class Page(Onlooker):
    """An onlooker that draws a page in place, or prints lines where nothing can be drawn."""

    def __init__(
        self,
        cfg: TrainConfig,
        budget_s: float | None,
        budget_steps: int | None,
        name: str,
        plain: bool = False,
        *,
        console: Console | None = None,
    ) -> None:
        """Open the page.

        Args:
            cfg: settings of the run.
            budget_s: wall time after which training stops [s]; None: none.
            budget_steps: decisions after which it stops; None: none.
            name: what is trained, and where.
            plain: print a line every few seconds even where a page could be drawn.
            console: where to; by default stdout.
        """
        from rich.console import Console

        self._cfg, self._name = cfg, name
        self._budget_s, self._budget_steps = budget_s, budget_steps
        self._console = console or Console()
        self._history: History | None = None
        self._noted = self._printed = time.monotonic()
        self._live: Live | None = None
        self._racing = ""
        if not plain and _can_draw(self._console):
            self._open()
        else:
            self._print(f"training {name}: {cfg.kind.replace('_', ' ')}, {cfg.num_worlds} worlds")

    def update(self, history: History, update: Update) -> None:
        """Show an update."""
        self._history, self._noted = history, time.monotonic()
        if self._live is None and self._noted - self._printed >= PLAIN_EVERY_S:
            self._printed = self._noted
            self._print(line(history, self._budget_s, self._budget_steps))

    def evaluated(self, history: History, evaluation: Evaluation) -> None:
        """Show an evaluation."""
        self._history, self._noted = history, time.monotonic()
        if self._live is None:
            self._print(judged(history.evaluations[-1]))
        else:
            self._live.refresh()

    def racing(self, what: str) -> None:
        """Show what is raced after the last update."""
        self._racing = what
        if self._live is None:
            self._print(f"{'':>7}  {what} ...")
        else:
            self._live.refresh()

    def close(self) -> None:
        """Leave the page as it is last, with the cursor below it."""
        atexit.unregister(self.close)
        live, self._live = self._live, None
        self._racing = ""
        if live is not None:
            live.stop()
        elif self._history is not None and self._history.updates:
            self._print(line(self._history, self._budget_s, self._budget_steps))
        self._history = None

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the page as it is now."""
        yield self._drawn(options.max_width)

    def _open(self) -> None:
        from rich.live import Live

        self._live = Live(
            self, console=self._console, refresh_per_second=REFRESHES_HZ, transient=False
        )
        atexit.register(self.close)  # a cursor that was hidden comes back, whatever happens
        self._live.start()

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)
        # Whoever reads from a pipe or a log file reads now.
        self._console.file.flush()

    def _drawn(self, width: int) -> RenderableType:
        from rich import box
        from rich.console import Group
        from rich.panel import Panel
        from rich.text import Text

        history = self._history
        body: list[RenderableType] = [self._budget(history)]
        if history is None or not history.updates:
            body.append(Text("the first worlds are being driven ...", style="dim"))
        else:
            body += [Text(""), _charts(history, width - 4), Text(""), _figures(history)]
        if self._racing:
            body.append(Text(f"{self._racing} ...", style="dim"))
        kind = self._cfg.kind.replace("_", " ")
        return Panel(
            Group(*body),
            title=Text(f"{self._name} · {kind}", style="bold"),
            title_align="left",
            box=box.ROUNDED,
            border_style="dim",
            padding=(0, 1),
            width=width,
        )

    def _budget(self, history: History | None) -> RenderableType:
        from rich.progress_bar import ProgressBar
        from rich.table import Table
        from rich.text import Text

        since = time.monotonic() - self._noted
        spent = (history.time_s if history else 0.0) + since
        left = left_s(history, self._budget_s, self._budget_steps)
        grid = Table.grid(expand=True, padding=(0, 1))
        grid.add_column(no_wrap=True)
        grid.add_column(ratio=1)
        grid.add_column(justify="right", no_wrap=True)
        if left is None:
            end = f"to {self._budget_steps:,} decisions" if self._budget_steps else "until Ctrl-C"
            grid.add_row(Text(clock(spent), style="bold"), Text(""), Text(end))
            return grid
        left = max(left - since, 0.0)
        whole = max(spent + left, 1e-9)
        grid.add_row(
            Text(clock(spent), style="bold"),
            ProgressBar(total=whole, completed=min(spent, whole), complete_style=_LEARNT),
            Text(f"{clock(left)} left"),
        )
        return grid


def _can_draw(console: Console) -> bool:
    return console.is_terminal and not console.is_dumb_terminal and "utf" in console.encoding


def _charts(history: History, width: int) -> RenderableType:
    """Return the three curves of the console, side by side or below each other."""
    from rich.console import Group
    from rich.table import Table

    narrow = width < _NARROW
    across = max(width if narrow else (width - 4) // 3, 8)
    height = 2 if narrow else _HEIGHT
    drawn = [chart(history, across, height) for chart in (_earned, _driven, _evaluated)]
    if narrow:
        return Group(*drawn)
    grid = Table.grid(padding=(0, 2))
    for _ in drawn:
        grid.add_column(width=across, no_wrap=True)
    grid.add_row(*drawn)
    return grid


def _earned(history: History, width: int, height: int) -> RenderableType:
    at = [float(row.samples) for row in history.updates]
    shown = sparkline.resampled(at, [row.earned for row in history.updates], at[-1], width)
    known = [value for value in shown if value is not None]
    low, high = min(known, default=0.0), max(known, default=1.0)
    if low > 0 and low < 0.5 * high:
        low = 0.0  # rewards that grow from little are shown from nothing
    title = ("reward", figure(history.updates[-1].earned))
    return _chart(title, sparkline.rows(shown, low, high, height), "magenta", width)


def _driven(history: History, width: int, height: int) -> RenderableType:
    at = [float(row.samples) for row in history.updates]
    values = [row.completion for row in history.updates]
    shown = sparkline.resampled(at, values, at[-1], width)
    title = ("completion, training", percent(values[-1]))
    return _chart(title, sparkline.rows(shown, 0.0, 100.0, height), _LEARNT, width)


def _evaluated(history: History, width: int, height: int) -> RenderableType:
    rows = history.evaluations
    until = float(history.samples)
    at = [float(row.samples) for row in rows]
    shown = sparkline.resampled(at, [row.completion for row in rows], until, width)
    title = ("completion, evaluation", percent(rows[-1].completion if rows else None))
    lines = sparkline.rows(shown, 0.0, 100.0, height)
    return _chart(title, lines, _JUDGED, width, foot=_marked(history, width))


def _marked(history: History, width: int) -> str:
    """Return the line below the evaluations, with a star below the best model."""
    best = history.best
    if best is None:
        return ""
    column = min(int(best.samples / max(history.samples, 1) * width), width - 1)
    lap = "" if best.best_lap_s is None else f" {seconds(best.best_lap_s)}"
    right, left = f"★ best{lap}", f"best{lap} ★"
    if column + len(right) <= width:
        return " " * column + right
    return " " * max(column - len(left) + 1, 0) + left


def _chart(
    title: tuple[str, str], lines: list[str], style: str, width: int, foot: str = ""
) -> RenderableType:
    from rich.console import Group
    from rich.text import Text

    what, value = title
    gap = " " * max(width - len(what) - len(value), 1)
    parts = [Text.assemble((what, "dim"), gap, (value, f"bold {style}"))]
    parts += [Text(one, style=style) for one in lines]
    if foot:
        parts.append(Text(foot, style="bold yellow"))
    return Group(*parts)


def _figures(history: History) -> Table:
    from rich.table import Table
    from rich.text import Text

    spent = " · ".join(
        f"{name} {100 * share:.0f} %" for name, share in shares(history).items() if share >= 0.005
    )
    last = history.evaluations[-1] if history.evaluations else None
    laps = Text("none yet", style="dim")
    if last is not None:
        found = [one.best_lap_s for one in history.evaluations if one.best_lap_s is not None]
        laps = Text.assemble(
            ("best ", "dim"),
            (seconds(min(found, default=None)), "bold"),
            ("   last ", "dim"),
            seconds(last.last_lap_s),
            ("   laps ", "dim"),
            f"{last.complete_laps} of {last.asked}",
            ("   off-tracks ", "dim"),
            str(last.off_tracks),
            ("   crashes ", "dim"),
            str(last.crashes),
        )
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column()
    grid.add_row("laps", laps)
    samples = Text.assemble(
        (f"{history.samples:,}", "bold"), ("   at ", "dim"), f"{speed(history):,.0f}/s"
    )
    grid.add_row("samples", samples)
    if is_tutored(history):
        grid.add_row("tutor", "it learns first, from the truth; the policy will learn from it")
    if told := self_play(history):
        grid.add_row("self-play", told)
    grid.add_row("time", spent)
    return grid
