"""What the player reads of a race, or of two laps: whole numbers and their differences."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from league import times
from league.replay import Replay, broadcast
from league.replay.replay import seconds_behind
from league.track.track import Track
from league.web.charts import Lap

OUTLINE_SPACING = 3
"""Every third point of a track's borders is drawn: one each 15 cm."""
STEP_HZ = 15
"""Frames in a second of two laps."""
CLEAR = 0.15
"""A lap leads once it is so far ahead [m]: half a car's length, as in a race."""
_ORDERS = {"x": 2, "y": 2, "yaw": 1, "distance": 2, "gap": 1}
"""How often each column is differenced."""


def player_data(replay: Replay, *, over: bool = True) -> dict[str, object]:
    """Return what the player draws: centimetres, hundredths of a radian and of a second.

    A race that is not `over` goes on after the recording.

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
        own = _drawn_car(car + 1, name, {key: each[:, car] for key, each in drawn.items()}, laps)
        cars.append({**own, "stops": stopped.reshape(-1, 2).tolist()})
    return {
        "step_hz": replay.step_hz,
        "duration_s": round(replay.duration_s, 3),
        "laps": replay.spec.laps,
        "track": _drawn_track(replay.track),
        "obstacles": _outline(
            np.stack([replay.columns.obstacle_x[0], replay.columns.obstacle_y[0]], axis=1), every=1
        ),
        "cars": cars,
        "events": events(replay, over=over),
        "over": over,
    }


def events(replay: Replay, *, over: bool = True) -> list[dict[str, object]]:
    """Return what happens in a race, a sentence each; its end only if it is `over`."""
    return [
        {"time_s": line.time_s, "kind": line.kind, "car": line.car + 1, "text": line.text}
        for line in broadcast.of_replay(replay, over=over)
    ]


def _drawn_car(
    number: int, name: str, columns: Mapping[str, np.ndarray], laps: np.ndarray
) -> dict[str, object]:
    """Return what the player draws of a car that never stands a penalty; its number is from 1.

    Columns are x, y [m], yaw [rad], distance along the track [m] and gap, which is the time since
    the leader was there [s], (num_frames,) each; `laps` the frames in which it completed one.
    """
    columns = {**columns, "yaw": np.unwrap(columns["yaw"])}
    whole = {key: _differences(100 * columns[key], order) for key, order in _ORDERS.items()}
    return {"number": number, "name": name, **whole, "lap_frames": laps.tolist(), "stops": []}


def _drawn_track(track: Track) -> dict[str, object]:
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


def ghosts_data(laps: Sequence[Lap], track: Track) -> dict[str, object]:
    """Return what the player draws of laps that begin together.

    A lap begins where its car crosses the line, the first one of a race with the start signal.
    """
    begins = [0.0 if lap.number == 1 else _crossed_s(lap, 0.0) for lap in laps]
    takes = [_crossed_s(lap, track.length) - begin for lap, begin in zip(laps, begins, strict=True)]
    frames = math.ceil(max(takes) * STEP_HZ) + 1
    times_s = np.arange(frames) / STEP_HZ
    # Over the line a lap goes on at its speed, so that the gap is the difference of the times.
    distance = np.stack(
        [
            np.where(
                times_s < take,
                np.interp(begin + times_s, lap.time_s, lap.place),
                track.length + lap.speed[-1] * (times_s - take),
            )
            for lap, begin, take in zip(laps, begins, takes, strict=True)
        ],
        axis=1,
    )
    gaps_s = seconds_behind(distance, times_s)
    cars: list[dict[str, object]] = []
    for car, (lap, begin, take) in enumerate(zip(laps, begins, takes, strict=True)):
        moments = np.minimum(begin + times_s, lap.time_s[-1])
        poses = {"x": lap.points[:, 0], "y": lap.points[:, 1], "yaw": lap.yaw}
        drawn = {name: np.interp(moments, lap.time_s, values) for name, values in poses.items()}
        drawn |= {"distance": distance[:, car], "gap": gaps_s[:, car]}
        over_line = np.array([min(math.ceil(take * STEP_HZ), frames - 1)])
        cars.append(_drawn_car(car + 1, lap.label, drawn, over_line))
    return {
        "step_hz": STEP_HZ,
        "duration_s": round((frames - 1) / STEP_HZ, 3),
        "laps": 1,
        "track": _drawn_track(track),
        "obstacles": [],
        "cars": cars,
        "events": _events(laps, takes, times_s, distance),
        "over": True,
    }


def _crossed_s(lap: Lap, place: float) -> float:
    return float(lap.reached_s(np.array([place]))[0])


def _events(
    laps: Sequence[Lap], takes: Sequence[float], times_s: np.ndarray, distance: np.ndarray
) -> list[dict[str, object]]:
    """Return who takes the lead when, and the times over the line."""
    events: list[dict[str, object]] = []
    leader = None
    for time_s, row in zip(times_s.tolist(), distance, strict=True):
        first = int(row.argmax())
        if first == leader or np.sort(row)[-1] - np.sort(row)[-2] < CLEAR or time_s > min(takes):
            continue
        verb = "leads" if leader is None else "takes the lead"
        events.append(_event(time_s, "lead_change", first, f"{laps[first].label} {verb}"))
        leader = first
    for car, (lap, take) in enumerate(zip(laps, takes, strict=True)):
        text = f"{lap.label} is over the line in {times.clock(take)}"
        events.append(_event(round(take, 3), "finish", car, text))
    return sorted(events, key=lambda event: float(str(event["time_s"])))


def _event(time_s: float, kind: str, car: int, text: str) -> dict[str, object]:
    return {"time_s": round(time_s, 3), "kind": kind, "car": car + 1, "text": text}
