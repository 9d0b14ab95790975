"""What all benchmarks print: headings, figures next to their goals, tables; and as Markdown."""

import math
import os
import platform
import re
import statistics
import sys
import time
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from importlib.metadata import version
from itertools import takewhile

from league.errors import LeagueError

FIGURE = ("figure", "measured", "goal", "met")
"""Columns of the table that figures stand in."""
_lines: list[str] = []
"""What was printed since it was last taken, as Markdown."""


@contextmanager
def without_traceback() -> Generator[None]:
    """End the program with the sentence of a LeagueError."""
    try:
        yield
    except LeagueError as error:
        sys.exit(str(error))


def heading(title: str) -> None:
    """Print a benchmark's title."""
    print(f"\n## {title}\n", flush=True)
    _lines.extend(("", f"### {title}", ""))


def note(text: str) -> None:
    """Print a remark."""
    print(text, flush=True)
    _lines.extend(("", text, ""))


def figure(
    name: str, value: float, unit: str, goal: float | None = None, *, most: bool = False
) -> bool:
    """Print one figure next to its goal; return whether the goal is met.

    Args:
        name: what was measured.
        value: the figure.
        unit: its unit.
        goal: what was aimed at, if anything.
        most: True when the goal is an upper bound.
    """
    met = goal is None or (value <= goal if most else value >= goal)
    sign = "<=" if most else ">="
    aim = "" if goal is None else f"  goal {sign} {goal:g}"
    verdict = "" if goal is None else ("  met" if met else "  NOT MET")
    print(f"{name:62s} {value:12,.4g} {unit:18s}{aim}{verdict}", flush=True)
    open_table = list(takewhile(lambda line: line.startswith("| "), reversed(_lines)))
    if not open_table or open_table[-1] != _row(FIGURE):
        _lines.extend(("", *_head(FIGURE)))
    written = "" if goal is None else f"{'≤' if most else '≥'} {_number(goal)}"
    _lines.append(_row((name, f"{_number(value)} {unit}", written, verdict.strip().lower())))
    return met


def _number(value: float) -> str:
    """Return a number with four digits, and never with an exponent."""
    digits = max(0, 3 - math.floor(math.log10(abs(value)))) if value else 0
    text = f"{value:,.{min(digits, 6)}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def table(*columns: str) -> Callable[..., None]:
    """Print the head of a table; return what prints a row of it, a cell for each column."""
    lines = list(_head(columns))
    print("\n" + "\n".join(lines), flush=True)
    _lines.extend(("", *lines))

    def row(*cells: object) -> None:
        assert len(cells) == len(columns)
        line = _row(str(cell) for cell in cells)
        print(line, flush=True)
        _lines.append(line)

    return row


def _head(columns: Iterable[str]) -> tuple[str, str]:
    columns = tuple(columns)
    return _row(columns), _row(("---", *("--:" for _ in columns[1:])))


def _row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def taken() -> str:
    """Return what was printed since the last call as Markdown."""
    text = "\n".join(_lines)
    _lines.clear()
    return re.sub(r"\n{3,}", "\n\n", text).strip()


def machine() -> str:
    """Describe the machine in one line."""
    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.split(":", 1)[1].strip() for line in lines if "model name" in line]
        model = names[0] if names else model
    except OSError:
        pass
    return (
        f"{os.cpu_count()} cores of {model}, Python {platform.python_version()}, "
        f"Numba {version('numba')}, torch {version('torch')}"
    )


def seconds(action: Callable[[], object], repeats: int = 5) -> float:
    """Return the median wall time of an action [s], after one call to warm up."""
    return statistics.median(_times(action, repeats))


def fastest(action: Callable[[], object], repeats: int = 40) -> float:
    """Return the least wall time of an action [s]: what it costs when nothing else runs."""
    return min(_times(action, repeats))


def _times(action: Callable[[], object], repeats: int) -> list[float]:
    action()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        taken.append(time.perf_counter() - start)
    return taken


def product(num_worlds: int, num_cars: int) -> float:
    """Return the time of one elementwise product of that shape [s], the yardstick of tables."""
    import numpy as np

    one = np.random.default_rng(0).random((num_worlds, num_cars), np.float32)
    return fastest(lambda: [one * one for _ in range(20)], 30) / 20
