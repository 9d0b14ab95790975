"""The shapes of the pages' charts, for SVG elements that the templates write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from league.matchmaking.history import HistoryPoint
from league.matchmaking.scores import RaceScore
from league.matchmaking.standings import Row
from league.track.track import Track

WIDTH, HEIGHT = 520, 180
"""Size of a line chart; margins of 50 on the left and 22 below hold the axes' numbers."""
LEFT, BOTTOM, TOP, RIGHT = 50, 22, 10, 8
MARKS_APART = 26
"""Marks that are closer share one label."""


@dataclass(frozen=True)
class TrackMap:
    """A track from above."""

    view_box: str
    road: str
    """The road, a path filled by the even-odd rule."""
    start: str
    """The start line."""


@dataclass(frozen=True)
class Line:
    """One curve of a chart or map."""

    label: str
    path: str
    kind: str
    """Class of its style sheet: car-1 to car-8, rating or expected."""


@dataclass(frozen=True)
class Tick:
    """A number at an axis."""

    at: float
    label: str


@dataclass(frozen=True)
class Mark:
    """A moment on the axis of x."""

    at: float
    label: str
    """A letter or two that stand at it."""
    title: str
    """What happened then."""


@dataclass(frozen=True)
class Chart:
    """Lines over a common axis, with a band around the first one if it has an interval."""

    lines: tuple[Line, ...]
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    x_range: tuple[float, float]
    """Values at the left and at the right end."""
    band: str = ""
    marks: tuple[Mark, ...] = ()
    width: int = WIDTH
    height: int = HEIGHT
    left: int = LEFT
    top: int = TOP
    right: int = WIDTH - RIGHT

    @property
    def bottom(self) -> int:
        """Where the axis of x lies."""
        return self.height - BOTTOM


@dataclass(frozen=True)
class Curve:
    """Values to be drawn as a line."""

    label: str
    kind: str
    """See Line.kind."""
    x: np.ndarray
    """(points,)."""
    y: np.ndarray
    """(points,)."""


def plot(
    curves: Sequence[Curve],
    *,
    band: tuple[np.ndarray, np.ndarray] | None = None,
    down: bool = False,
    whole_x: bool = False,
    whole_y: bool = False,
    height: int = HEIGHT,
) -> Chart:
    """Return a chart of at least one curve.

    `band` is the lower and the upper end of the first curve's interval, (points,) both; `down` lets
    y grow downwards; of `whole_x` and `whole_y` the axis has whole numbers only.
    """
    xs = [curve.x for curve in curves]
    ys = [*(curve.y for curve in curves), *(band or ())]
    x, x_ticks = _axis(np.concatenate(xs), LEFT, WIDTH - RIGHT, whole=whole_x)
    ends = (TOP, height - BOTTOM) if down else (height - BOTTOM, TOP)
    y, y_ticks = _axis(np.concatenate(ys), *ends, whole=whole_y)
    x_parts = np.split(x, np.cumsum([len(part) for part in xs])[:-1])
    y_parts = np.split(y, np.cumsum([len(part) for part in ys])[:-1])
    area = ""
    if band:
        low, high = y_parts[-2:]
        edges = [np.stack([x_parts[0], high], 1), np.stack([x_parts[0], low], 1)[::-1]]
        area = f"{path(np.concatenate(edges), flip=False)}Z"
    return Chart(
        lines=tuple(
            Line(curve.label, path(np.stack([at, value], 1), flip=False), curve.kind)
            for curve, at, value in zip(curves, x_parts, y_parts, strict=False)
        ),
        x_ticks=x_ticks,
        y_ticks=y_ticks,
        x_range=(min(float(part.min()) for part in xs), max(float(part.max()) for part in xs)),
        band=area,
        height=height,
    )


def track_map(track: Track) -> TrackMap:
    """Return a track from above; y points up in the world and down in a picture."""
    borders = np.concatenate([track.left, track.right])
    (x, y), (width, height) = borders.min(axis=0), np.ptp(borders, axis=0)
    margin = 0.03 * max(width, height)
    box = (x - margin, -(y + height) - margin, width + 2 * margin, height + 2 * margin)
    if track.closed:
        road = f"{path(track.left[::2])}Z{path(track.right[::2])}Z"
    else:
        road = f"{path(np.concatenate([track.left, track.right[::-1]])[::2])}Z"
    return TrackMap(
        view_box=" ".join(f"{number:.2f}" for number in box),
        road=road,
        start=path(np.stack([track.left[0], track.right[0]])),
    )


def rating_history(
    points: Sequence[HistoryPoint], moments: Sequence[tuple[int, str, str]] = ()
) -> Chart:
    """Return an entry's rating over its races, with its 95 % interval.

    Moments are marked, too: number of the newest heat before one, its label and its title.
    """
    races, low, elo, high = (
        np.array([getattr(point, name) for point in points], float)
        for name in ("races", "low95", "elo", "high95")
    )
    chart = plot([Curve("rating", "rating", races, elo)], band=(low, high), whole_x=True)
    heats, scale = [point.heat for point in points], (WIDTH - RIGHT - LEFT) / np.ptp(races)
    marks: list[Mark] = []
    for heat, label, title in sorted(moments):
        at = round(float(LEFT + scale * (np.interp(heat, heats, races) - races[0])), 1)
        if marks and at - marks[-1].at < MARKS_APART:  # labels would lie over each other
            last = marks.pop()
            at, label, title = last.at, f"{last.label} {label}", f"{last.title}; {title}"
        marks.append(Mark(at, label, title))
    return replace(chart, marks=tuple(marks))


def points_chart(scores: Sequence[RaceScore]) -> Chart:
    """Return the points made in some races and those promised, both added up race by race."""
    races = np.arange(len(scores) + 1.0)
    points, expected = (
        np.concatenate([[0.0], np.cumsum([getattr(score, name) for score in scores])])
        for name in ("points", "expected")
    )
    return plot(
        [Curve("expected", "expected", races, expected), Curve("points", "rating", races, points)],
        whole_x=True,
        whole_y=True,
    )


def interval_scale(rows: Sequence[Row]) -> tuple[float, float]:
    """Return the ratings at the ends of the standings' bars [Elo]."""
    known = [row for row in rows if row.connected and row.races] or rows
    low = min((row.low95 for row in known), default=0.0)
    high = max((row.high95 for row in known), default=1.0)
    return low - 20, high + 20


def bar(row: Row, scale: tuple[float, float]) -> tuple[float, float, float]:
    """Return where an entry's interval begins, how wide it is, and its rating, in % of a bar."""
    low, high, middle = (
        min(max(100 * (value - scale[0]) / (scale[1] - scale[0]), 0.0), 100.0)
        for value in (row.low95, row.high95, row.elo)
    )
    return round(low, 2), round(max(high - low, 0.4), 2), round(middle, 2)


def _axis(
    values: np.ndarray, start: float, end: float, *, whole: bool = False
) -> tuple[np.ndarray, tuple[Tick, ...]]:
    """Return where values lie on an axis from `start` to `end` in the picture, and its ticks."""
    low, high = float(values.min()), float(values.max())
    span = max(high - low, 1e-9)
    step = 10.0 ** np.floor(np.log10(span / 3))
    step *= next(factor for factor in (1, 2, 5, 10) if span / (factor * step) <= 5)
    if whole:
        step = max(step, 1.0)
    scale = (end - start) / span
    ticks = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    decimals = max(0, -int(np.floor(np.log10(step))))
    return start + (values - low) * scale, tuple(
        Tick(round(start + (tick - low) * scale, 1), f"{round(tick, decimals) + 0.0:.{decimals}f}")
        for tick in ticks
    )


def path(points: np.ndarray, *, flip: bool = True) -> str:
    """Return the SVG path along some points; `flip` turns y downwards, as pictures have it."""
    sign = -1 if flip else 1
    return "M" + "L".join(f"{x:.2f} {sign * y:.2f}" for x, y in points)
