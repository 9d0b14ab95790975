"""The charts of one race: positions by lap, gaps over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from league.replay import Replay
from league.web.charts import Chart, Curve, plot

GAP_POINTS = 300
"""Most points of a line of the gap chart."""


def position_chart(order: Sequence[Mapping[str, Any]], names: Sequence[str]) -> Chart:
    """Return each car's position on the grid and after each of its complete laps.

    Args:
        order: the cars' results, race_spec.CarResult as plain data.
        names: of the drivers, by grid slot.
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
