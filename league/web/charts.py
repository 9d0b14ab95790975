"""The shapes of the pages' charts, for SVG elements that the templates write.

Of leagues: maps, rating histories, points; of races: positions, gaps, laps over each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from league.matchmaking.scores import HistoryPoint, RaceScore
from league.matchmaking.standings import Row
from league.replay import Replay
from league.track.track import Track

WIDTH, HEIGHT = 520, 180
"""Size of a line chart; margins of 50 on the left and 22 below hold the axes' numbers."""
LEFT, BOTTOM, TOP, RIGHT = 50, 22, 10, 8
MARKS_APART = 26
"""Marks that are closer share one label."""
FLAT = 1e-6
"""Values that differ by less are the same: ratings of the anchor, but for rounding."""
STEP = 0.1
"""Distance between the places at which times are compared [m]."""
LEVELS = 6
"""Colours of a speed map."""
PUT_BACK = 1.5
"""A car that moved farther than its speed allows, by this factor and 5 cm, was put back."""
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
    values: np.ndarray, start: float, end: float, *, whole: bool
) -> tuple[np.ndarray, tuple[Tick, ...]]:
    """Return where values lie on an axis from `start` to `end` in the picture, and its ticks.

    Values that are all the same lie in the middle.
    """
    low, high = float(values.min()), float(values.max())
    if high - low < FLAT:
        low, high, whole = low - 0.5, high + 0.5, True
    span = high - low
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
    return "M" + "L".join(f"{x:.2f} {sign * y:.2f}" for x, y in points.tolist())


@dataclass(frozen=True)
class ComparedLaps:
    """One lap of each car that completed it."""

    laps: dict[int, int]
    """Number of the lap, from 1, by the car's number."""
    speed: Chart
    """Speed [m/s] along the lap [m]."""
    lost: Chart | None
    """Time lost to the fastest of the laps [s] along the lap [m]; None for one car alone."""
    fastest: int
    """Number of the car with the fastest of these laps."""
    lines: tuple[Line, ...]
    """Where each car drove, in the frame of charts.track_map."""


@dataclass(frozen=True)
class Lap:
    """One lap of one car."""

    car: int
    """From 0; decides the colour."""
    driver: str
    """Name."""
    number: int
    """From 1."""
    place: np.ndarray
    """Driven since the start line [m], (frames,)."""
    time_s: np.ndarray
    """Since the lap began [s], (frames,)."""
    speed: np.ndarray
    """[m/s], (frames,)."""
    points: np.ndarray
    """[m], (frames, 2)."""
    yaw: np.ndarray
    """Heading [rad], without jumps at full turns, (frames,)."""

    @property
    def label(self) -> str:
        """Driver and number."""
        return f"{self.driver}, lap {self.number}"

    def reached_s(self, places: np.ndarray) -> np.ndarray:
        """Return when it first reached some places [m], in its own time [s]."""
        front = np.maximum.accumulate(self.place)
        rises = np.concatenate([[True], np.diff(front) > 0])
        return np.interp(places, front[rises], self.time_s[rises])


def compared_laps(replay: Replay, number: int | None) -> ComparedLaps | None:
    """Return a lap (from 1) of each car, or each one's best; None where no car completed it."""
    laps = []
    for row in sorted(replay.result.order, key=lambda row: row.car):
        if number is None and row.lap_times_s:
            laps.append(lap_of(replay, row.car, fastest_lap(row.lap_times_s)))
        elif number is not None and number <= len(row.lap_times_s):
            laps.append(lap_of(replay, row.car, number))
    return compared([lap for lap in laps if len(lap.place) > 1], replay.track.length)


def compared(laps: Sequence[Lap], length: float) -> ComparedLaps | None:
    """Return laps of different cars over each other, on a track of a length [m]; None for none."""
    if not laps:
        return None
    fastest = min(laps, key=lambda lap: lap.time_s[-1])
    return ComparedLaps(
        laps={lap.car + 1: lap.number for lap in laps},
        speed=plot([_curve(lap, lap.place, lap.speed) for lap in laps]),
        lost=_lost(laps, fastest, length) if len(laps) > 1 else None,
        fastest=fastest.car + 1,
        lines=tuple(Line(lap.driver, _line(lap), f"car-{lap.car + 1}") for lap in laps),
    )


def fastest_lap(lap_times_s: Sequence[float]) -> int:
    """Return the number, from 1, of the fastest of a car's laps."""
    return int(np.argmin(lap_times_s)) + 1


def lap_of(replay: Replay, car: int, number: int) -> Lap:
    """Return a complete lap, by car (from 0) and number (from 1)."""
    columns = replay.columns
    ends = np.flatnonzero(np.diff(columns.laps[:, car]) > 0) + 1
    first = ends[number - 2] - 1 if number > 1 else 0
    frames = slice(first, ends[number - 1] + 1)
    length = replay.track.length
    return Lap(
        car=car,
        driver=replay.names[car],
        number=number,
        place=columns.distance[frames, car] - (number - 1) * length,
        time_s=replay.times_s[frames] - replay.times_s[first],
        speed=replay.speeds[frames, car],
        points=np.stack([columns.x[frames, car], columns.y[frames, car]], axis=1),
        yaw=np.unwrap(columns.yaw[frames, car]),
    )


def _lost(laps: Sequence[Lap], fastest: Lap, length: float) -> Chart:
    """Return the time each lap lost to the fastest one since the start line, along the lap."""
    places = np.arange(0.0, length, STEP)
    reached = [lap.reached_s(places) - lap.reached_s(np.zeros(1)) for lap in (fastest, *laps)]
    return plot(
        [
            _curve(lap, places, times - reached[0])
            for lap, times in zip(laps, reached[1:], strict=True)
        ],
        down=True,
    )


def _curve(lap: Lap, x: np.ndarray, y: np.ndarray) -> Curve:
    return Curve(lap.label, f"car-{lap.car + 1}", x, y)


def _line(lap: Lap) -> str:
    """Return the path of a lap, interrupted where the car was put back."""
    moved = np.linalg.norm(np.diff(lap.points, axis=0), axis=1)
    most = np.maximum(lap.speed[1:], lap.speed[:-1]) * PUT_BACK * np.diff(lap.time_s) + 0.05
    parts = np.split(lap.points, np.flatnonzero(moved > most) + 1)
    return "".join(path(part) for part in parts if len(part) > 1)


@dataclass(frozen=True)
class SpeedMap:
    """Where a lap was fast and where it was slow."""

    lines: tuple[Line, ...]
    """The lap's line in pieces, slowest first, each of the class speed-0, speed-1, ..."""
    low: float
    """Speed at which the first piece begins [m/s]."""
    high: float
    """Speed at which the last piece ends [m/s]."""


def speed_map(lap: Lap) -> SpeedMap:
    """Return the line of a lap, cut by speed."""
    speed = (lap.speed[1:] + lap.speed[:-1]) / 2
    low, high = float(speed.min()), float(speed.max())
    level = ((speed - low) / max(high - low, 1e-9) * LEVELS).astype(int).clip(max=LEVELS - 1)
    pieces = np.stack([lap.points[:-1], lap.points[1:]], axis=1)
    width = (high - low) / LEVELS
    return SpeedMap(
        lines=tuple(
            Line(
                f"{low + step * width:.1f} to {low + (step + 1) * width:.1f} m/s",
                "".join(path(piece) for piece in pieces[level == step]),
                f"speed-{step}",
            )
            for step in range(LEVELS)
        ),
        low=low,
        high=high,
    )


def position_chart(order: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Chart:
    """Return each car's position on the grid and after each of its complete laps.

    `order` holds race_spec.CarResult as plain data; `names` are by grid slot.
    """
    by_car = {car["car"]: car["lap_times_s"] for car in order}
    ends = [np.cumsum(by_car[car]) for car in range(len(names))]
    curves = []
    for car, name in enumerate(names):
        # Ahead of it after a lap are cars that completed that lap earlier.
        positions = [
            1 + sum(len(other) > lap and other[lap] < end for other in ends)
            for lap, end in enumerate(ends[car])
        ]
        laps = np.arange(len(positions) + 1.0)
        curves.append(Curve(name, f"car-{car + 1}", laps, np.array([car + 1.0, *positions])))
    return plot(curves, down=True, whole_x=True, whole_y=True, height=70 + 20 * len(names))


def gap_chart(replay: Replay) -> Chart:
    """Return each car's gap to the leader [s] over the race, the leader on top."""
    every = max(1, replay.num_frames // GAP_POINTS)
    gaps = np.minimum(replay.gaps_s[::every], replay.duration_s)
    times = replay.times_s[::every]
    return plot(
        [Curve(n, f"car-{car + 1}", times, gaps[:, car]) for car, n in enumerate(replay.names)],
        down=True,
    )
