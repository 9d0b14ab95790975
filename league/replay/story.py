"""Broadcast data of a race: running order, gaps, and its captions."""

from __future__ import annotations

import numpy as np

from league.replay import commentary
from league.replay.commentary import Line
from league.replay.replay import Replay

AFTER_FINISH_S = 2.0
"""How long a car that has finished is still followed [s]."""


def running_order(replay: Replay) -> np.ndarray:
    """Return the cars by distance in each frame, the leader first, (num_frames, num_cars)."""
    return np.argsort(-replay.columns.distance, axis=1, kind="stable")


def gaps_m(replay: Replay) -> np.ndarray:
    """Return how far each car is behind the leader along the track [m], (num_frames, num_cars)."""
    distance = replay.columns.distance
    return distance.max(axis=1, keepdims=True) - distance


def gaps_s(replay: Replay) -> np.ndarray:
    """Return the time since the leader was where each car is now [s], (num_frames, num_cars)."""
    return seconds_behind(replay.columns.distance, replay.times_s)


def seconds_behind(distance: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Return the time since the one in front was where each car is now [s].

    Args:
        distance: driven along the track [m], (num_frames, num_cars).
        times_s: of the frames [s], (num_frames,).
    """
    lead = distance.max(axis=1)
    front = np.maximum.accumulate(lead)
    # Where the front stands still, its first arrival counts.
    rises = np.concatenate([[True], np.diff(front) > 0])
    first = np.interp(distance, front[rises], times_s[rises])
    return np.maximum(times_s[:, None] - first, 0.0) * (distance < lead[:, None])


def speeds(replay: Replay) -> np.ndarray:
    """Return each car's speed [m/s], (num_frames, num_cars)."""
    return np.hypot(replay.columns.velocity_x, replay.columns.velocity_y)


def decided_s(replay: Replay) -> float:
    """Return when no place can change hands any more: the last car to finish has no rival [s]."""
    fights = replay.result.order[:-1]
    if replay.spec.ranking != "total" or not fights or not all(car.finished for car in fights):
        return replay.duration_s
    return min(max(car.total_s for car in fights), replay.duration_s)


def captions(replay: Replay) -> list[tuple[Line, str]]:
    """Return the story of the race, each line with its sentence."""
    return [(line, line.text) for line in commentary.of_replay(replay)]
