"""Broadcast data of a race: running order, gaps, captions of events, and the chase camera."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.race_spec import Event
from league.replay.replay import Replay

PACK = 3.0
"""Cars this close behind the leader [m] are kept in the chase camera's picture."""
AFTER_FINISH_S = 2.0
"""How long a car that has finished is still followed [s]."""
CHASE_SMOOTHING_S = 0.45
"""How slowly the chase camera turns and changes its subject [s]."""


@dataclass(frozen=True)
class ChasePath:
    """Where a chase camera's frame stands in each frame of a replay, (num_frames,)."""

    x: np.ndarray
    """[m]."""
    y: np.ndarray
    """[m]."""
    yaw: np.ndarray
    """Unwrapped [rad]."""


def running_order(replay: Replay) -> np.ndarray:
    """Return the cars by distance in each frame, the leader first, (num_frames, num_cars)."""
    return np.argsort(-replay.columns.distance, axis=1, kind="stable")


def gaps_m(replay: Replay) -> np.ndarray:
    """Return how far each car is behind the leader along the track [m], (num_frames, num_cars)."""
    distance = replay.columns.distance
    return distance.max(axis=1, keepdims=True) - distance


def gaps_s(replay: Replay) -> np.ndarray:
    """Return the time since the leader was where each car is now [s], (num_frames, num_cars)."""
    front = np.maximum.accumulate(replay.columns.distance.max(axis=1))
    times = replay.times_s
    # Where the front stands still, its first arrival counts.
    rises = np.concatenate([[True], np.diff(front) > 0])
    first = np.interp(replay.columns.distance, front[rises], times[rises])
    return np.maximum(times[:, None] - first, 0.0) * (gaps_m(replay) > 0)


def speeds(replay: Replay) -> np.ndarray:
    """Return each car's speed [m/s], (num_frames, num_cars)."""
    return np.hypot(replay.columns.velocity_x, replay.columns.velocity_y)


def chase_path(replay: Replay) -> ChasePath:
    """Return where to chase from: the last of those close behind the leader, to see them all.

    In a pursuit, where a gap of nothing may be half a lap of road, the winner is followed.
    """
    from scipy.ndimage import gaussian_filter1d  # late: SciPy takes a while

    columns = replay.columns
    distance = np.where(_watched(replay), columns.distance, -np.inf)
    gap = distance.max(axis=1, keepdims=True) - distance
    subject = np.where(gap <= PACK, columns.distance, np.inf).argmin(axis=1)
    if replay.spec.format == "pursuit":
        subject[:] = replay.result.order[0].car
    rows = np.arange(replay.num_frames)
    heading = columns.yaw[rows, subject]
    sigma = CHASE_SMOOTHING_S * replay.step_hz
    return ChasePath(
        x=gaussian_filter1d(columns.x[rows, subject], sigma / 3, mode="nearest"),
        y=gaussian_filter1d(columns.y[rows, subject], sigma / 3, mode="nearest"),
        yaw=gaussian_filter1d(np.unwrap(heading), sigma, mode="nearest"),
    )


def _watched(replay: Replay) -> np.ndarray:
    """Return the cars to follow: those that still race; the winner when none does."""
    until = np.full(replay.num_cars, np.inf)
    for car in replay.result.order:
        if car.finished:
            until[car.car] = car.total_s + AFTER_FINISH_S
    watched = replay.times_s[:, None] <= until
    watched[~watched.any(axis=1), replay.result.order[0].car] = True
    return watched


def decided_s(replay: Replay) -> float:
    """Return when no place can change hands any more: the last car to finish has no rival [s]."""
    fights = replay.result.order[:-1]
    if replay.spec.ranking != "total" or not fights or not all(car.finished for car in fights):
        return replay.duration_s
    return min(max(car.total_s for car in fights), replay.duration_s)


def captions(replay: Replay) -> list[tuple[Event, str]]:
    """Return the events, each with a sentence."""
    events = replay.result.events
    # A crash names the car that was hit, and an overtake for the lead names the leader.
    said = {(e.time_s, "contact", e.other) for e in events if e.kind in ("crash", "touch")}
    said |= {(e.time_s, "lead_change", e.car) for e in events if e.kind == "overtake"}
    return [
        (event, caption(replay, event))
        for event in events
        if (event.time_s, event.kind, event.car) not in said
    ]


def caption(replay: Replay, event: Event) -> str:
    """Return one event as a sentence."""
    name = replay.names[event.car]
    other = _other(replay, event)
    value = event.value
    penalty = f", {value:g} s penalty" if value else ""
    if event.kind == "lap":
        return f"{name} completes a lap" + (f" in {value:.2f} s" if value else "")
    if event.kind == "finish":
        return f"{name} finishes" + (f" after {value:.2f} s" if value else "")
    sentences = {
        "start": "The race is on",
        "off_track": f"{name} leaves the track{penalty}",
        "crash": f"{name} runs into {other or 'another car'}{penalty}",
        "touch": f"{name} touches {other or 'another car'}",
        "forced_off": f"{name} pushes {other or 'another car'} off the road{penalty}",
        "contact": f"{name} is hit" + (f" by {other}" if other else ""),
        "obstacle_contact": f"{name} hits an obstacle{penalty}",
        "wall_contact": f"{name} hits the wall{penalty}",
        "immobilised": f"{name} is stuck{penalty}",
        "reversed": f"{name} drives backwards{penalty}",
        "put_back": f"{name} is back on the track",
        "overtake": f"{name} passes {other or 'another car'}",
        "lead_change": f"{name} takes the lead",
        "driver_fault": f"{name} gives no valid action",
    }
    return sentences.get(event.kind, event.kind)


def _other(replay: Replay, event: Event) -> str:
    if event.other is None or event.kind == "obstacle_contact":
        return ""
    return replay.names[event.other] if 0 <= event.other < replay.num_cars else ""
