"""A recorded race as the player reads it: whole numbers and their differences, a few kB as gzip."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from league.replay import Replay, commentary
from league.track.track import Track

OUTLINE_SPACING = 3
"""Every third point of a track's borders is drawn: one each 15 cm."""
_ORDERS = {"x": 2, "y": 2, "yaw": 1, "distance": 2, "gap": 1}
"""How often each column is differenced."""


def player_data(replay: Replay) -> dict[str, object]:
    """Return what the player draws: centimetres, hundredths of a radian and of a second.

    Columns are differences along the frames: those of `x`, `y` and `distance` are differenced
    twice, those of `yaw` and `gap` once. player.js undoes that.
    """
    columns = replay.columns
    drawn = {name: getattr(columns, name) for name in ("x", "y", "yaw", "distance")}
    drawn["gap"] = replay.gaps_s
    cars = []
    for car, name in enumerate(replay.names):
        stopped = np.flatnonzero(np.diff(columns.penalty_s[:, car] > 0, prepend=0, append=0))
        laps = np.flatnonzero(np.diff(columns.laps[:, car]) > 0) + 1
        own = drawn_car(car + 1, name, {key: each[:, car] for key, each in drawn.items()}, laps)
        cars.append({**own, "stops": stopped.reshape(-1, 2).tolist()})
    return {
        "step_hz": replay.step_hz,
        "duration_s": round(replay.duration_s, 3),
        "laps": replay.spec.laps,
        "track": drawn_track(replay.track),
        "obstacles": _outline(
            np.stack([replay.columns.obstacle_x[0], replay.columns.obstacle_y[0]], axis=1), every=1
        ),
        "cars": cars,
        "events": events(replay),
    }


def events(replay: Replay) -> list[dict[str, object]]:
    """Return what happens in a race, a sentence each."""
    return [
        {"time_s": line.time_s, "kind": line.kind, "car": line.car + 1, "text": line.text}
        for line in commentary.of_replay(replay)
    ]


def drawn_car(
    number: int, name: str, columns: Mapping[str, np.ndarray], laps: np.ndarray
) -> dict[str, object]:
    """Return what the player draws of a car that never stands a penalty; its number is from 1.

    Columns are x, y [m], yaw [rad], distance along the track [m] and gap, which is the time since
    the leader was there [s], (num_frames,) each; `laps` the frames in which it completed one.
    """
    columns = {**columns, "yaw": np.unwrap(columns["yaw"])}
    whole = {key: _differences(100 * columns[key], order) for key, order in _ORDERS.items()}
    return {"number": number, "name": name, **whole, "lap_frames": laps.tolist(), "stops": []}


def drawn_track(track: Track) -> dict[str, object]:
    """Return what the player draws of a track."""
    return {
        "title": track.title,
        "closed": track.closed,
        "left": _outline(track.left),
        "right": _outline(track.right),
    }


def _differences(column: np.ndarray, order: int) -> list[int]:
    whole = np.rint(column).astype(np.int64)
    for _ in range(order):
        whole = np.diff(whole, prepend=0)
    return whole.tolist()


def _outline(points: np.ndarray, every: int = OUTLINE_SPACING) -> list[int]:
    """Return points as x0, y0, x1, y1, ... [cm]."""
    return np.rint(100 * points[::every]).astype(int).ravel().tolist()
