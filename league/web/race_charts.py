"""The charts of one race, from its recording."""

from __future__ import annotations

import numpy as np

from league.replay import Replay, story
from league.web.charts import Chart, Curve, plot

GAP_POINTS = 300
"""Most points of a line of the gap chart."""


def gap_chart(replay: Replay) -> Chart:
    """Return each car's gap to the leader [s] over the race, the leader on top."""
    every = max(1, replay.num_frames // GAP_POINTS)
    gaps = np.minimum(story.gaps_s(replay)[::every], replay.duration_s)
    return plot(_curves(replay, replay.times_s[::every], gaps), down=True)


def _curves(replay: Replay, x: np.ndarray, y: np.ndarray) -> list[Curve]:
    """Return a curve for each car, y's columns."""
    return [Curve(name, f"car-{car + 1}", x, y[:, car]) for car, name in enumerate(replay.names)]
