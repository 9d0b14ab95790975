"""Charts of a race and its laps: positions, gaps, speed, time lost, lines, where a lap was fast."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from league.replay import Replay
from league.web.charts import Chart, Curve, Line, path, plot

STEP = 0.1
"""Distance between the places at which times are compared [m]."""
LEVELS = 6
"""Colours of a speed map."""
PUT_BACK = 1.5
"""A car that moved farther than its speed allows, by this factor and 5 cm, was put back."""
GAP_POINTS = 300
"""Most points of a line of the gap chart."""


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


def of(replay: Replay, number: int | None) -> ComparedLaps | None:
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
        # Ahead of it after a lap is who completed that lap earlier.
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
