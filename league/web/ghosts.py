"""Two laps against each other, as if they had been driven at the same time."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from league import times
from league.replay.replay import seconds_behind
from league.track.track import Track
from league.web.lap_charts import Lap
from league.web.replay_data import drawn_car, drawn_track

STEP_HZ = 15
"""Frames in a second of what the player gets."""
CLEAR = 0.15
"""A ghost leads once it is so far ahead [m]: half a car's length, as in a race."""


def player_data(laps: Sequence[Lap], track: Track) -> dict[str, object]:
    """Return what the player draws of laps that begin together.

    A lap begins where its car crosses the line, the first one of a race with the start signal.
    """
    begins = [0.0 if lap.number == 1 else _crossed_s(lap, 0.0) for lap in laps]
    takes = [_crossed_s(lap, track.length) - begin for lap, begin in zip(laps, begins, strict=True)]
    frames = math.ceil(max(takes) * STEP_HZ) + 1
    times_s = np.arange(frames) / STEP_HZ
    distance = np.stack(
        [
            np.where(times_s < take, np.interp(begin + times_s, lap.time_s, lap.place), np.inf)
            for lap, begin, take in zip(laps, begins, takes, strict=True)
        ],
        axis=1,
    )
    # Over the line a lap goes on at its speed, so that the gap is the difference of the times.
    over = track.length + np.array([lap.speed[-1] for lap in laps]) * (
        times_s[:, None] - np.array(takes)
    )
    distance = np.where(np.isfinite(distance), distance, over)
    gaps_s = seconds_behind(distance, times_s)
    cars: list[dict[str, object]] = []
    for car, (lap, begin, take) in enumerate(zip(laps, begins, takes, strict=True)):
        moments = np.minimum(begin + times_s, lap.time_s[-1])
        x, y, yaw = (
            np.interp(moments, lap.time_s, column)
            for column in (lap.points[:, 0], lap.points[:, 1], lap.yaw)
        )
        cars.append(
            drawn_car(
                car + 1,
                lap.label,
                x=x,
                y=y,
                yaw=yaw,
                distance=distance[:, car],
                gap_s=gaps_s[:, car],
                laps=np.array([min(math.ceil(take * STEP_HZ), frames - 1)]),
            )
        )
    return {
        "step_hz": STEP_HZ,
        "duration_s": round((frames - 1) / STEP_HZ, 3),
        "laps": 1,
        "track": drawn_track(track),
        "obstacles": [],
        "cars": cars,
        "events": _events(laps, takes, times_s, distance),
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
