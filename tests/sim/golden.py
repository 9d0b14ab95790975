"""What the recordings in tests/data hold, and how its scenes are read; imports no simulator."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

DATA = Path(__file__).parents[1] / "data"
DRIVES = ("drives", "drives_of_different_cars")
CONTACTS = ("car", "pile_up", "box", "bot", "wall")
MOTION = ("x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate", "steering")
START = np.dtype([(name, np.float32) for name in (*MOTION, "s", "lateral")] + [("track", np.int64)])
"""How a car begins a drive."""
DRIVEN = np.dtype([(name, np.float32) for name in (*MOTION, "s", "lateral", "distance")])
"""A car of a drive at one moment."""
BUMPED = np.dtype(
    [(name, np.float32) for name in MOTION[:6]]
    + [("touching_cars", np.uint8), ("touching_obstacles", np.uint32), ("wall", np.bool_)]
)
"""A car of a contact after a control step."""
_FLAGS = (
    "off_track", "crashed", "was_hit", "wall", "immobilised", "reversed", "lap", "finished",
    "released", "mistake", "lead_changed",
)  # fmt: skip
_COUNTS = (
    "laps", "still_steps", "backward_steps", "off_tracks", "crashes", "contacts_taken",
    "immobilised", "reversed", "overtakes",
)  # fmt: skip
BOOK_PLACES = ("x", "y", "s", "lateral", "zero_s", "distance", "best_distance")
BOOK_TIMES = ("lap_start_s", "last_lap_s", "best_lap_s", "finish_s", "penalty_s")
BOOK_MASKS = ("touching_cars", "touching_obstacles", "ahead")
VERDICT = np.dtype(
    [("advance", np.float32), ("crashed_car", np.int8), ("crashed_obstacle", np.int8)]
    + [("overtook", np.uint8)]
    + [(name, np.bool_) for name in _FLAGS]
)
"""What the referee found about a car in a control step."""
BOOK = np.dtype(
    [(name, np.float32) for name in (*BOOK_PLACES, *BOOK_TIMES)]
    + [(name, np.int16) for name in _COUNTS]
    + [(name, np.uint32) for name in BOOK_MASKS]
    + [(name, np.bool_) for name in ("ghost", "put_back", "retired")]
    + [("leader", np.int8), ("lead_changes", np.int16), ("place", np.int8)]
    + [("stopped_s", np.float32)]
)
"""A car's book after the step; leader, lead_changes and stopped_s are those of its world."""
ENDS = np.dtype([(name, np.bool_) for name in ("terminated", "truncated", "began")])
"""Which episodes or races ended in a step."""


def described() -> dict:
    """Return the scenes and races to play."""
    return json.loads((DATA / "scenes.json").read_text(encoding="utf-8"))


def masked(members: np.ndarray) -> np.ndarray:
    """Return bit masks of the cars or obstacles named by bool (..., count)."""
    return (members.astype(np.int64) << np.arange(members.shape[-1])).sum(axis=-1)


def sim_settings(scene: dict) -> dict:
    """Return the settings of a scene's SimConfig, classes of settings as dicts."""
    cars, given, settings = scene.get("cars", 1), scene.get("things"), dict(scene.get("sim", {}))
    settings |= {"kind": "head_to_head" if cars > 1 else "time_trial", "num_cars": cars}
    if given:
        settings["kind"] = "obstacle_avoidance"
        settings["obstacles"] = {"count": 4, "kind": given}
        if not isinstance(given, str):
            kind, share, lane = given
            settings["obstacles"] = {
                "count": 1, "kind": kind, "places": ((share, lane),), "lane_change": False,
            }  # fmt: skip
    return settings


def commands(scene: dict) -> Iterator[tuple[list[tuple[float, float] | None], dict]]:
    """Yield where each control step of a scene brings the cars, None to stay, and what touches."""
    last = [(s, lateral) for s, lateral in scene["start"]]
    for step in scene["steps"]:
        for _ in range(step.get("times", 1)):
            places: list[tuple[float, float] | None] = [None] * len(last)
            if "to" in step:
                places = [place and (place[0], place[1]) for place in step["to"]]
            elif "by" in step:
                places = [
                    (s + more, lateral + across)
                    for (s, lateral), (more, across) in zip(last, step["by"], strict=True)
                ]
            last = [now or old for now, old in zip(places, last, strict=True)]
            yield places, step
