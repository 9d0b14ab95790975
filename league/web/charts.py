"""The shapes of the pages' charts, for SVG elements that the templates write."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from league.matchmaking.standings import HistoryPoint, Row
from league.replay import Replay, story
from league.track.track import Track

WIDTH, HEIGHT = 520, 180
"""Size of a line chart; margins of 44 on the left and 22 below hold the axes' numbers."""
LEFT, BOTTOM, TOP, RIGHT = 44, 22, 10, 8
GAP_POINTS = 300
"""Most points of a line of the gap chart."""


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
    """One curve of a chart."""

    label: str
    path: str


@dataclass(frozen=True)
class Tick:
    """A number at an axis."""

    at: float
    label: str


@dataclass(frozen=True)
class Chart:
    """Lines over a common axis, with a band around the first one if it has an interval."""

    lines: tuple[Line, ...]
    x_ticks: tuple[Tick, ...]
    y_ticks: tuple[Tick, ...]
    band: str = ""
    width: int = WIDTH
    height: int = HEIGHT
    left: int = LEFT
    bottom: int = HEIGHT - BOTTOM
    right: int = WIDTH - RIGHT


def track_map(track: Track) -> TrackMap:
    """Return a track from above; y points up in the world and down in a picture."""
    borders = np.concatenate([track.left, track.right])
    (x, y), (width, height) = borders.min(axis=0), np.ptp(borders, axis=0)
    margin = 0.03 * max(width, height)
    box = (x - margin, -(y + height) - margin, width + 2 * margin, height + 2 * margin)
    if track.closed:
        road = f"{_path(track.left[::2])}Z{_path(track.right[::2])}Z"
    else:
        road = f"{_path(np.concatenate([track.left, track.right[::-1]])[::2])}Z"
    return TrackMap(
        view_box=" ".join(f"{number:.2f}" for number in box),
        road=road,
        start=_path(np.stack([track.left[0], track.right[0]])),
    )


def rating_history(points: Sequence[HistoryPoint]) -> Chart:
    """Return an entry's rating over its races, with its 95 % interval."""
    races = np.array([point.races for point in points], float)
    low, elo, high = (
        np.array([getattr(point, name) for point in points]) for name in ("low95", "elo", "high95")
    )
    x, x_ticks = _axis(races, LEFT, WIDTH - RIGHT, whole=True)
    y, y_ticks = _axis(np.concatenate([low, elo, high]), HEIGHT - BOTTOM, TOP)
    low_y, elo_y, high_y = np.split(y, 3)
    band = np.concatenate([np.stack([x, high_y], 1), np.stack([x, low_y], 1)[::-1]])
    return Chart(
        lines=(Line("rating", _path(np.stack([x, elo_y], 1), flip=False)),),
        x_ticks=x_ticks,
        y_ticks=y_ticks,
        band=f"{_path(band, flip=False)}Z",
    )


def gap_chart(replay: Replay) -> Chart:
    """Return each car's gap to the leader [s] over the race, the leader on top."""
    every = max(1, replay.num_frames // GAP_POINTS)
    gaps = np.minimum(story.gaps_s(replay)[::every], replay.duration_s)
    x, x_ticks = _axis(replay.times_s[::every], LEFT, WIDTH - RIGHT)
    y, y_ticks = _axis(gaps.ravel(), TOP, HEIGHT - BOTTOM)
    y = y.reshape(gaps.shape)
    return Chart(
        lines=tuple(
            Line(name, _path(np.stack([x, y[:, car]], 1), flip=False))
            for car, name in enumerate(replay.names)
        ),
        x_ticks=x_ticks,
        y_ticks=y_ticks,
    )


def interval_scale(rows: Sequence[Row]) -> tuple[float, float]:
    """Return the ratings at the ends of the standings' bars [Elo]."""
    known = [row for row in rows if row.connected and row.races] or rows
    low = min((row.low95 for row in known), default=0.0)
    high = max((row.high95 for row in known), default=1.0)
    return low - 20, high + 20


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
        Tick(round(start + (tick - low) * scale, 1), f"{tick:.{decimals}f}") for tick in ticks
    )


def _path(points: np.ndarray, *, flip: bool = True) -> str:
    """Return the SVG path along some points; `flip` turns y downwards, as pictures have it."""
    sign = -1 if flip else 1
    return "M" + "L".join(f"{x:.2f} {sign * y:.2f}" for x, y in points)
