"""The console during training: a live dashboard, or plain lines where nothing can be drawn."""

from __future__ import annotations

import atexit
import math
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich import box
from rich.console import Console, ConsoleOptions, Group, RenderableType, RenderResult
from rich.live import Live
from rich.panel import Panel
from rich.progress_bar import ProgressBar
from rich.table import Table
from rich.text import Text

from league.times import duration
from league.training.monitor.history import TrainingCallback, TrainingHistory

if TYPE_CHECKING:
    from league.racing.table import Evaluation
    from league.training.config import TrainConfig
    from league.training.monitor.history import EvaluationRow, Row, UpdateRow

PLAIN_EVERY_S = 5.0  # seconds between two plain lines
REFRESHES_HZ = 2.0  # how often the dashboard is drawn; once takes some milliseconds
RECENT = 16  # updates over which the speed is averaged
_NARROW = 78
_HEIGHT = 4
_BLOCKS = " ▁▂▃▄▅▆▇█"  # a character cell filled from below, in eighths


class Dashboard(TrainingCallback):
    """Draws curves, lap times, speed and time left in place, or prints lines."""

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
        """Open the dashboard of a budget of wall time [s] or decisions; None: no limit.

        `plain`: print a line every few seconds even where the dashboard could be drawn.
        """
        self._kind, self._name = cfg.kind.replace("_", " "), name
        self._budget_s, self._budget_steps = budget_s, budget_steps
        self._console = console = console or Console()
        self._history = TrainingHistory()
        self._updated_s = self._printed_s = time.monotonic()
        self._racing = ""
        self._live: Live | None = None
        can_draw = console.is_terminal and not console.is_dumb_terminal
        if can_draw and not plain and "utf" in console.encoding:
            self._live = Live(self, console=console, refresh_per_second=REFRESHES_HZ)
            atexit.register(self.close)  # shows the cursor again, whatever happens
            self._live.start()
        else:
            self._print(f"training {name}: {self._kind}, {cfg.num_worlds} worlds")

    def update(self, history: TrainingHistory, update: UpdateRow) -> None:
        """Show an update."""
        self._history, self._updated_s = history, time.monotonic()
        if self._live is None and self._updated_s - self._printed_s >= PLAIN_EVERY_S:
            self._printed_s = self._updated_s
            self._print(update_line(history, self._budget_s, self._budget_steps))

    def evaluated(self, history: TrainingHistory, evaluation: Evaluation) -> None:
        """Show an evaluation."""
        self._history, self._updated_s = history, time.monotonic()
        self._refresh(_evaluation_line(history.evaluations[-1]))

    def racing(self, what: str) -> None:
        """Show what is raced after the last update."""
        self._racing = what
        self._refresh(f"{'':>7}  {what} ...")

    def close(self) -> None:
        """Leave the dashboard as it is, with the cursor below it."""
        atexit.unregister(self.close)
        live, self._live = self._live, None
        self._racing = ""
        if live is not None:
            live.stop()
        elif self._history.updates:
            self._print(update_line(self._history, self._budget_s, self._budget_steps))
        self._history = TrainingHistory()

    def _refresh(self, plain: str) -> None:
        if self._live is None:
            self._print(plain)
        else:
            self._live.refresh()

    def _print(self, text: str) -> None:
        self._console.print(text, markup=False, emoji=False, highlight=False, soft_wrap=True)
        self._console.file.flush()  # for readers of a pipe or a log file

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw the dashboard as it is now."""
        width, history = options.max_width, self._history
        body: list[RenderableType] = [self._budget()]
        if not history.updates:
            body.append(Text("the first worlds are being driven ...", style="dim"))
        else:
            body += [Text(""), _charts(history, width - 4), Text(""), _figures(history)]
        if self._racing:
            body.append(Text(f"{self._racing} ...", style="dim"))
        yield Panel(
            Group(*body),
            title=Text(f"{self._name} · {self._kind}", style="bold"),
            title_align="left",
            box=box.ROUNDED,
            border_style="dim",
            padding=(0, 1),
            width=width,
        )

    def _budget(self) -> RenderableType:
        since = time.monotonic() - self._updated_s
        spent = self._history.time_s + since
        left = left_s(self._history, self._budget_s, self._budget_steps)
        grid = Table.grid(expand=True, padding=(0, 1))
        grid.add_column(no_wrap=True, style="bold")
        grid.add_column(ratio=1)
        grid.add_column(justify="right", no_wrap=True)
        if left is None:
            end = f"to {self._budget_steps:,} decisions" if self._budget_steps else "until Ctrl-C"
            grid.add_row(duration(spent), Text(""), end)
            return grid
        left = max(left - since, 0.0)
        whole = max(spent + left, 1e-9)
        bar = ProgressBar(total=whole, completed=min(spent, whole), complete_style="cyan")
        grid.add_row(duration(spent), bar, f"{duration(left)} left")
        return grid


def _charts(history: TrainingHistory, width: int) -> RenderableType:
    """Return the curves of reward and completion, in a row or, where it is narrow, in a column."""
    narrow = width < _NARROW
    across = max(width if narrow else (width - 4) // 3, 8)
    height = 2 if narrow else _HEIGHT

    def curve(rows: Sequence[Row], name: str) -> list[float | None]:
        values = [getattr(row, name) for row in rows]
        return resampled(history.learnt_s(rows), values, history.updates[-1].time_s, across)

    def chart(title: str, value: str, lines: list[str], style: str, foot: str = "") -> Text:
        gap = " " * max(across - len(title) - len(value), 1)
        text = Text.assemble((title, "dim"), gap, (value, f"bold {style}"))
        for line in lines:
            text.append("\n" + line, style=style)
        return text.append("\n" + foot, style="bold yellow") if foot else text

    def completion(title: str, rows: Sequence[Row], style: str, foot: str = "") -> Text:
        driven = bars(curve(rows, "completion"), 0.0, 100.0, height)
        value = percent(rows[-1].completion if rows else None)
        return chart(f"completion, {title}", value, driven, style, foot)

    rewards = curve(history.updates, "earned")
    known = [value for value in rewards if value is not None]
    low, high = min(known, default=0.0), max(known, default=1.0)
    if 0 < low < 0.5 * high:
        low = 0.0
    earned = figure(history.updates[-1].earned)
    charts = [
        chart("reward", earned, bars(rewards, low, high, height), "magenta"),
        completion("training", history.updates, "cyan"),
        completion("evaluation", history.evaluations, "green", _best_mark(history, across)),
    ]
    if narrow:
        return Group(*charts)
    grid = Table.grid(padding=(0, 2))
    for _ in charts:
        grid.add_column(width=across, no_wrap=True)
    grid.add_row(*charts)
    return grid


def _best_mark(history: TrainingHistory, width: int) -> str:
    """Return the line below the evaluations, with a star below the best model."""
    best = history.best
    if best is None:
        return ""
    (best_s,) = history.learnt_s([best])
    column = min(int(best_s / max(history.updates[-1].time_s, 1e-9) * width), width - 1)
    lap = "" if best.best_lap_s is None else f" {seconds(best.best_lap_s)}"
    right, left = f"★ best{lap}", f"best{lap} ★"
    if column + len(right) <= width:
        return " " * column + right
    return " " * max(column - len(left) + 1, 0) + left


def _figures(history: TrainingHistory) -> RenderableType:
    laps = Text("none yet", style="dim")
    if history.evaluations:
        last = history.evaluations[-1]
        times = [row.best_lap_s for row in history.evaluations if row.best_lap_s is not None]
        laps = Text.assemble(("best ", "dim"), (seconds(min(times, default=None)), "bold"))
        for name, value in (
            ("last", seconds(last.last_lap_s)),
            ("laps", f"{last.complete_laps} of {last.asked}"),
            ("off-tracks", str(last.off_tracks)),
            ("crashes", str(last.crashes)),
        ):
            laps.append(f"   {name} ", style="dim").append(value)
    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column()
    grid.add_row("laps", laps)
    samples = (f"{history.samples:,}", "bold"), ("   at ", "dim"), f"{speed(history):,.0f}/s"
    grid.add_row("samples", Text.assemble(*samples))
    if history.teacher_learns:
        grid.add_row("teacher", "it learns first, from the truth; the policy will learn from it")
    if text := self_play(history):
        grid.add_row("self-play", text)
    parts = shares(history).items()
    spent = [f"{name} {100 * share:.0f} %" for name, share in parts if share >= 0.005]
    grid.add_row("time", " · ".join(spent))
    return grid


def update_line(history: TrainingHistory, budget_s: float | None, budget_steps: int | None) -> str:
    """Return the last update as one line of ASCII."""
    row = history.updates[-1]
    parts = [
        f"{duration(history.time_s):>7}",
        f"{row.samples:>9,} samples",
        f"{speed(history):>6,.0f}/s",
        f"reward {figure(row.earned)}",
        f"completion {percent(row.completion)}",
    ]
    if history.teacher_learns:
        parts.append("the teacher learns")
    if history.evaluations:
        last = history.evaluations[-1]
        parts.append(f"evaluation {percent(last.completion)}")
        if last.best_lap_s is not None:
            parts.append(f"best lap {seconds(last.best_lap_s)}")
    if text := self_play(history):
        parts.append(f"self-play: {text}")
    left = left_s(history, budget_s, budget_steps)
    if left is not None:
        parts.append(f"{duration(left)} left")
    return "  ".join(parts)


def _evaluation_line(row: EvaluationRow) -> str:
    parts = [
        f"{duration(row.time_s):>7}",
        f"{row.samples:>9,} samples",
        f"evaluation: {row.complete_laps} of {row.asked} laps, {row.completion:.1f} % completed",
    ]
    if row.best_lap_s is not None:
        parts.append(f"best lap {seconds(row.best_lap_s)}")
    mistakes = f"{row.off_tracks} off-tracks, {row.crashes} crashes"
    parts.append(mistakes if row.off_tracks or row.crashes else "clean")
    if row.best:
        parts.append("(best so far)")
    return "  ".join(parts)


def left_s(
    history: TrainingHistory, budget_s: float | None, budget_steps: int | None
) -> float | None:
    """Return the time until a limit is reached [s]; None without a limit, or without a speed."""
    times = []
    if budget_s is not None:
        times.append(budget_s - history.time_s)
    if budget_steps is not None and history.updates:
        first, last = history.updates[-RECENT:][0], history.updates[-1]
        took, samples = last.time_s - first.time_s, last.samples - first.samples
        if samples <= 0:
            took, samples = last.collect_s + last.learn_s, last.samples
        times.append((budget_steps - last.samples) * took / max(samples, 1))
    return max(min(times), 0.0) if times else None


def speed(history: TrainingHistory) -> float:
    """Return decisions per second of collecting and learning, over the last updates."""
    recent = history.updates[-RECENT:]
    before = history.updates[-RECENT - 1].samples if len(history.updates) > RECENT else 0
    took = sum(row.collect_s + row.learn_s for row in recent)
    return (recent[-1].samples - before) / took if took > 0 else 0.0


def shares(history: TrainingHistory) -> dict[str, float]:
    """Return shares of the wall time, 0 to 1; `worlds` is the rollouts."""
    spent = {
        "worlds": sum(row.collect_s for row in history.updates),
        "learner": sum(row.learn_s for row in history.updates),
        "evaluation": sum(row.took_s for row in history.evaluations),
    }
    whole = max(history.time_s, sum(spent.values()), 1e-9)
    spent["other"] = whole - sum(spent.values())
    return {name: part / whole for name, part in spent.items()}


def self_play(history: TrainingHistory) -> str:
    """Return how self-play comes along as a phrase; empty without self-play."""
    log = history.updates[-1].log
    pace, clean = log.get("/race/pace"), log.get("/race/clean")
    if pace is None or clean is None:
        return ""
    return f"{100 * clean:.0f} % of attacks pass cleanly, on rivals of {pace:.2f} of the top speed"


def resampled(
    at: Sequence[float], values: Sequence[float | None], until: float, width: int
) -> list[float | None]:
    """Return the mean in each of `width` columns of 0 to `until`; empty ones repeat the last.

    `at` are the values' places, rising; None and NaN are skipped.
    """
    columns: list[list[float]] = [[] for _ in range(width)]
    for place, value in zip(at, values, strict=True):
        if value is not None and math.isfinite(value):
            # The right end belongs to the last column.
            columns[min(int(place / max(until, 1e-9) * width), width - 1)].append(value)
    means: list[float | None] = []
    for column in columns:
        last = means[-1] if means else None
        means.append(sum(column) / len(column) if column else last)
    return means


def bars(values: Sequence[float | None], low: float, high: float, height: int) -> list[str]:
    """Return a bar chart as lines of text, the top one first; even the lowest value is visible."""
    steps, span = 8 * height, high - low
    filled = []
    for value in values:
        share = (value - low) / span if value is not None and span > 0 else 0.0
        filled.append(0 if value is None else max(1, min(steps, round(share * steps))))
    return [
        "".join(_BLOCKS[max(0, min(8, eighths - 8 * line))] for eighths in filled)
        for line in reversed(range(height))
    ]


def percent(value: float | None) -> str:
    """Return a percentage, or a dash."""
    return "-" if value is None else f"{value:.0f} %"


def seconds(value: float | None) -> str:
    """Return a lap time, or a dash."""
    return "-" if value is None else f"{value:.2f} s"


def figure(value: float | None) -> str:
    """Return a number with three significant digits, or a dash."""
    if value is None or not math.isfinite(value):
        return "-"
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.3g}"
