"""Curves in block characters, for terminals."""

from __future__ import annotations

import math
from collections.abc import Sequence

BLOCKS = " ▁▂▃▄▅▆▇█"
"""A character cell filled from below, in eighths."""


def resampled(
    at: Sequence[float], values: Sequence[float | None], until: float, width: int
) -> list[float | None]:
    """Return what a curve shows in each column: the mean of what falls there, else what was last.

    Args:
        at: where each value was taken, rising.
        values: what was taken; None is nothing.
        until: right end of the axis, which begins at 0.
        width: columns.
    """
    sums, counts = [0.0] * width, [0] * width
    for place, value in zip(at, values, strict=True):
        if value is None or not math.isfinite(value):
            continue
        # The right end belongs to the last column.
        column = min(int(place / max(until, 1e-9) * width), width - 1)
        sums[column] += value
        counts[column] += 1
    shown: list[float | None] = []
    last: float | None = None
    for total, count in zip(sums, counts, strict=True):
        last = total / count if count else last
        shown.append(last)
    return shown


def rows(values: Sequence[float | None], low: float, high: float, height: int) -> list[str]:
    """Return a curve as lines of text, the top one first; even the lowest value leaves a mark.

    Args:
        values: one for each column; None stays empty.
        low: value at the foot.
        high: value at the top.
        height: lines.
    """
    steps = 8 * height
    span = high - low
    filled = [
        0
        if value is None
        else max(1, min(steps, round((value - low) / span * steps) if span > 0 else 1))
        for value in values
    ]
    return [
        "".join(BLOCKS[max(0, min(8, eighths - 8 * line))] for eighths in filled)
        for line in reversed(range(height))
    ]
