"""A recorded race as the player reads it: whole numbers and their differences, a few kB as gzip."""

from __future__ import annotations

import numpy as np

from league.replay import Replay, commentary

OUTLINE_SPACING = 3
"""Every third point of a track's borders is drawn: one each 15 cm."""


def player_data(replay: Replay) -> dict[str, object]:
    """Return what the player draws: centimetres, hundredths of a radian and of a second.

    Columns are differences along the frames: those of `x`, `y` and `distance` are differenced
    twice, those of `yaw` and `gap` once. player.js undoes that.
    """
    columns, gaps = replay.columns, replay.gaps_s
    cars = []
    for car, name in enumerate(replay.names):
        stopped = np.flatnonzero(np.diff(columns.penalty_s[:, car] > 0, prepend=0, append=0))
        cars.append(
            {
                "number": car + 1,
                "name": name,
                "x": _differences(100 * columns.x[:, car], 2),
                "y": _differences(100 * columns.y[:, car], 2),
                "yaw": _differences(100 * np.unwrap(columns.yaw[:, car]), 1),
                "distance": _differences(100 * columns.distance[:, car], 2),
                "gap": _differences(100 * gaps[:, car], 1),
                "lap_frames": (np.flatnonzero(np.diff(columns.laps[:, car]) > 0) + 1).tolist(),
                "stops": stopped.reshape(-1, 2).tolist(),
            }
        )
    return {
        "step_hz": replay.step_hz,
        "duration_s": round(replay.duration_s, 3),
        "laps": replay.spec.laps,
        "track": {
            "title": replay.track.title,
            "closed": replay.track.closed,
            "left": _outline(replay.track.left),
            "right": _outline(replay.track.right),
        },
        "obstacles": _outline(
            np.stack([replay.columns.obstacle_x[0], replay.columns.obstacle_y[0]], axis=1), every=1
        ),
        "cars": cars,
        "events": [
            {"time_s": line.time_s, "kind": line.kind, "car": line.car + 1, "text": line.text}
            for line in commentary.of_replay(replay)
        ],
    }


def _differences(column: np.ndarray, order: int) -> list[int]:
    whole = np.rint(column).astype(np.int64)
    for _ in range(order):
        whole = np.diff(whole, prepend=0)
    return whole.tolist()


def _outline(points: np.ndarray, every: int = OUTLINE_SPACING) -> list[int]:
    """Return points as x0, y0, x1, y1, ... [cm]."""
    return np.rint(100 * points[::every]).astype(int).ravel().tolist()
