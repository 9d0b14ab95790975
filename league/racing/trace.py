"""Trace: an evaluation step by step, as the 19-column CSV that community log tools read.

Columns and their order are those of the original's `*-iteration.csv`; docs/evaluation.md says what
a number means where the original leaves a choice.
"""

from __future__ import annotations

import csv
import math
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from league.atomic_file import replacing
from league.deepracer import params_kernels
from league.deepracer.params import Roads
from league.envs.actions import ActionSpace, DiscreteActions
from league.errors import ConfigError
from league.racing.evaluate import EvalStep
from league.sim import referee
from league.sim.records import NOBODY
from league.sim.world import is_frozen
from league.track.track import Track

COLUMNS = (
    "episode", "steps", "X", "Y", "yaw", "steer", "throttle", "action", "reward", "done",
    "all_wheels_on_track", "progress", "closest_waypoint", "track_len", "tstamp", "episode_status",
    "pause_duration", "obstacle_crash_counter", "wall_clock",
)  # fmt: skip
"""Of the CSV, in its order."""


def nearer(points: Sequence[tuple[float, float]], pair: Sequence[int], x: float, y: float) -> int:
    """Return which of two waypoints is nearer to a place [m]; the first if neither is."""
    behind, ahead = (math.hypot(points[k][0] - x, points[k][1] - y) for k in pair)
    return pair[1] if ahead < behind else pair[0]


class Trace:
    """Records the steps of an evaluation; give its `add` as `watch`."""

    def __init__(self, space: ActionSpace | None = None, *, started_s: float = 0.0) -> None:
        """Start an empty trace.

        Args:
            space: what the driver chooses from, for the column `action`; None: any numbers.
            started_s: Unix time at which the evaluation began [s], for `wall_clock`.
        """
        self._space, self._started_s = space, started_s
        self._rows: dict[int, list[dict]] = {}
        self._roads: Roads | None = None
        self._crashes: dict[tuple[int, int], int] = {}
        self._step_dt = 0.0

    def add(self, step: EvalStep) -> None:
        """Keep one step of every run that is under way."""
        if self._roads is None:
            self._roads = Roads.of(step.tracks)
        self._step_dt = step.sim.step_dt
        columns = _columns(step)
        for trial in step.trials:
            crash = bool(step.step.verdicts["crashed_obstacle"][trial.row, 0] != NOBODY)
            key = (trial.run, trial.trial)
            self._crashes[key] = self._crashes.get(key, 0) + crash
            row = {name: values[trial.row] for name, values in columns.items()}
            self._rows.setdefault(trial.run, []).append(
                {
                    **row,
                    **self._lap_columns(step.tracks.tracks[0], row),
                    "trial": trial.trial,
                    "steps": trial.step,
                    "action": self._action(row["steer"], row["throttle"]),
                    "done": trial.done,
                    "episode_status": trial.status,
                    "obstacle_crash_counter": self._crashes[key],
                    **({"progress": 100.0} if trial.status == "lap_complete" else {}),
                }
            )

    def rows(self) -> list[dict[str, object]]:
        """Return all rows, run after run, with the columns of the CSV."""
        rows, episodes, steps = [], 0, 0
        for run in sorted(self._rows):
            for row in self._rows[run]:
                steps += 1
                time_s = steps * self._step_dt
                whole = {
                    **row,
                    "episode": episodes + row["trial"],
                    "tstamp": round(time_s, 6),
                    "wall_clock": round(self._started_s + time_s, 6),
                }
                rows.append({name: whole[name] for name in COLUMNS})
            episodes += self._rows[run][-1]["trial"] + 1
        return rows

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the CSV, whole or not at all, and return its path."""
        with (
            replacing(path, "the trace", ConfigError) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(COLUMNS)
            writer.writerows(list(row.values()) for row in self.rows())
        return Path(path)

    def _lap_columns(self, track: Track, row: Mapping[str, float]) -> dict:
        """Return the columns that say where on the lap the car is."""
        roads = self._roads
        assert roads is not None
        place = (row["nose_s"], row["X"], row["Y"])
        pair = params_kernels.closest_waypoints(roads.own_waypoints, roads.records[0], *place)
        # The referee counts laps where the base is; the original's progress is that of the nose.
        on_lap = row["distance"] - row["laps"] * row["lap_length"]
        progress = 100.0 * (on_lap + row["nose_ahead"]) / row["lap_length"]
        return {
            "progress": round(min(max(progress, 0.0), 100.0), 6),
            "closest_waypoint": nearer(roads.waypoints[0], pair, row["X"], row["Y"]),
            "track_len": round(track.length, 6),
            "all_wheels_on_track": bool(row["all_wheels_on_track"]),
        }

    def _action(self, steer: float, throttle: float) -> str | int:
        if isinstance(self._space, DiscreteActions):
            gaps = [
                abs(angle - steer) / 30.0 + abs(speed - throttle)
                for angle, speed in self._space.choices
            ]
            return gaps.index(min(gaps))
        # No comma between the two: readers of the older files count commas.
        return f"[{steer:.4f} {throttle:.4f}]"


def _columns(step: EvalStep) -> dict[str, list]:
    """Return numbers of the evaluated car of each world after a step, by name."""
    tracks, car, world = step.tracks, step.sim.car, step.judged
    now, before, track = world.cars[:, 0], step.before[:, 0], world.track
    x = now["x"] + np.float32(car.nose) * np.cos(now["yaw"])
    y = now["y"] + np.float32(car.nose) * np.sin(now["yaw"])
    nose = tracks.project(track, x, y, now["s"])
    wheels = referee.wheel_positions(car.wheelbase / 2, car.wheel_track / 2, now)
    near_s = np.broadcast_to(now["s"][:, None], wheels.shape[:-1])
    wheel = tracks.project(track, wheels[..., 0], wheels[..., 1], near_s)
    on = (wheel.lateral <= wheel.left) & (wheel.lateral >= -wheel.right)
    columns = {
        "X": x,
        "Y": y,
        "yaw": now["yaw"] * np.float32(180.0 / math.pi),
        "steer": np.round(now["target_steering"] * np.float32(180.0 / math.pi), 4),
        "throttle": now["target_speed"],
        # No reward is paid during a penalty.
        "reward": np.where(is_frozen(before), 0.0, step.step.rewards[:, 0]),
        "all_wheels_on_track": on.all(axis=1),
        "distance": now["distance"],
        "laps": before["laps"],
        "lap_length": tracks.lap_length(track),
        "nose_s": nose.s,
        "nose_ahead": tracks.signed_gap(track, nose.s, now["s"]),
        "pause_duration": step.world.cars["penalty_s"][:, 0],
    }
    return {name: _plain(values) for name, values in columns.items()}


def _plain(values: np.ndarray) -> list:
    if values.dtype.kind == "f":
        return [round(value, 6) for value in values.astype(np.float64).tolist()]
    return values.tolist()
