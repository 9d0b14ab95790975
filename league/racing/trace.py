"""Traces for community log tools: an evaluation or a training step by step, as 19-column CSV.

Columns and their order are those of the original's `*-iteration.csv`; docs/evaluation.md says what
a number means where the original leaves a choice. Folders are laid out as by DeepRacer for Cloud
with one worker: training-simtrace/N-iteration.csv, model/model_metadata.json,
ip/hyperparameters.json and evaluation-TIME/evaluation-simtrace/0-iteration.csv.
"""

import csv
import json
import math
import os
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from league.atomic_file import replacing
from league.deepracer import model_metadata, params_kernels
from league.deepracer.params import Roads
from league.envs.actions import ActionSpace, ContinuousActions, DiscreteActions
from league.envs.rewards import Paid, Reward
from league.errors import ConfigError, PolicyError
from league.racing.evaluate import MISTAKES, EvalStep
from league.sim import referee
from league.sim.config import CarConfig, SensorConfig, SimConfig
from league.sim.records import NOBODY, World, is_frozen
from league.track.track import TrackSet

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


def mistakes(verdicts: ndarray) -> list[str]:
    """Return the first mistake of each verdict, VERDICT records (n,); empty where there is none."""
    names = np.full(len(verdicts), "", dtype=object)
    for flag, name in reversed(MISTAKES.items()):
        names[verdicts[flag]] = name
    return names.tolist()


def step_rows(
    tracks: TrackSet,
    car: CarConfig,
    space: ActionSpace,
    before: ndarray,
    world: World,
    rewards: ndarray,
) -> list[dict[str, Any]]:
    """Return the columns that follow from one step alone, a row for car 0 of each world.

    The world is after the step, before any penalty moved a car; CAR records before the step, and
    the rewards of each car, are (num_worlds, num_cars). Column `action` holds a choice of a
    discrete space, or else two numbers.
    """
    columns = _columns(tracks, car, before[:, 0], world, rewards[:, 0])
    rows = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
    for row, index in zip(rows, world.track.tolist(), strict=True):
        row.update(_lap_columns(tracks, index, row))
        row["action"] = _action(space, row["steer"], row["throttle"])
    return rows


def _lap_columns(tracks: TrackSet, index: int, row: Mapping[str, float]) -> dict[str, Any]:
    """Return the columns that say where on the lap the car is."""
    roads = Roads.of(tracks)
    tables = (roads.own_waypoints, tracks.courses[index], roads.records[index])
    pair = params_kernels.closest_waypoints(*tables, row["nose_s"], row["X"], row["Y"])
    # The referee counts laps where the base is; the original's progress is that of the nose.
    on_lap = row["distance"] - row["laps"] * row["lap_length"]
    progress = 100.0 * (on_lap + row["nose_ahead"]) / row["lap_length"]
    return {
        "progress": round(min(max(progress, 0.0), 100.0), 6),
        "closest_waypoint": nearer(roads.waypoints[index], pair, row["X"], row["Y"]),
        "track_len": round(tracks.tracks[index].length, 6),
    }


def _action(space: ActionSpace, steer: float, throttle: float) -> str | int:
    if isinstance(space, DiscreteActions):
        gaps = [abs(angle - steer) / 30.0 + abs(speed - throttle) for angle, speed in space.choices]
        return gaps.index(min(gaps))
    # No comma between the two: readers of the older files count commas.
    return f"[{steer:.4f} {throttle:.4f}]"


class Trace:
    """Records the steps of an evaluation; give its `add` as `watch`."""

    def __init__(
        self,
        space: ActionSpace | None = None,
        sensors: SensorConfig | None = None,
        *,
        started_s: float = 0.0,
    ) -> None:
        """Start an empty trace of a driver with this action space and these sensors.

        `started_s` is the Unix time at which the evaluation began [s], for `wall_clock`.
        """
        self.space, self.started_s = space or ContinuousActions(), started_s
        self.sensors = sensors or SensorConfig()
        self._rows: dict[int, list[dict[str, Any]]] = {}
        self._step_dt = 0.0

    def add(self, step: EvalStep) -> None:
        """Keep one step of every run that is under way."""
        self._step_dt = step.sim.step_dt
        tables = step.tracks, step.sim.car, self.space
        rows = step_rows(*tables, step.before, step.judged, step.step.rewards)
        pauses = _plain(step.world.cars["penalty_s"][:, 0])
        for trial in step.trials:
            run = self._rows.setdefault(trial.run, [])
            row = rows[trial.row] | {"trial": trial.trial, "pause_duration": pauses[trial.row]}
            crash = bool(step.step.verdicts["crashed_obstacle"][trial.row, 0] != NOBODY)
            _add(run, row, trial.step, trial.status, crash, done=trial.done)

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
                    "wall_clock": round(self.started_s + time_s, 6),
                }
                rows.append({name: whole[name] for name in COLUMNS})
            episodes += self._rows[run][-1]["trial"] + 1
        return rows

    def write(self, path: str | os.PathLike[str]) -> Path:
        """Write the CSV, whole or not at all, and return its path."""
        return write_rows(Path(path), self.rows())


def _add(
    rows: list[dict[str, Any]], row: dict[str, Any], step: int, status: str, crash: bool, done: bool
) -> None:
    """Add a step of an episode to rows, its number from 1; `crash` is one with an obstacle."""
    crashes = rows[-1]["obstacle_crash_counter"] if step > 1 else 0
    ending = {"progress": 100.0} if status == "lap_complete" else {}
    counted = {"steps": step, "done": done, "obstacle_crash_counter": crashes + crash}
    rows.append({**row, **counted, "episode_status": status, **ending})


def write_rows(path: Path, rows: Sequence[Mapping[str, object]]) -> Path:
    """Write rows with the columns of the CSV, whole or not at all, and return the path."""
    with (
        replacing(path, "the trace", ConfigError) as temporary,
        temporary.open("w", newline="", encoding="utf-8") as file,
    ):
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        writer.writerows([row[name] for name in COLUMNS] for row in rows)
    return path


def _columns(
    tracks: TrackSet, car: CarConfig, before: ndarray, world: World, rewards: ndarray
) -> dict[str, list[Any]]:
    """Return numbers of car 0 of each world after a step, by name."""
    now, track = world.cars[:, 0], world.track
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
        "reward": np.where(is_frozen(before), 0.0, rewards),
        "all_wheels_on_track": np.all(on, axis=1),
        "distance": now["distance"],
        "laps": before["laps"],
        "lap_length": tracks.lap_length(track),
        "nose_s": nose.s,
        "nose_ahead": tracks.signed_gap(track, nose.s, now["s"]),
    }
    return {name: _plain(values) for name, values in columns.items()}


def _plain(values: ndarray) -> list[Any]:
    if values.dtype.kind == "f":
        return [round(value, 6) for value in values.astype(np.float64).tolist()]
    return values.tolist()


EPISODES = 20  # of a file of training: log tools count on the same number in each
TRAINING = "training-simtrace"


def write_evaluation(trace: Trace, folder: Path) -> Path:
    """Add the trace of an evaluation to the folder of a model, and return the path of its CSV."""
    started_s = trace.started_s
    while True:
        begun = datetime.fromtimestamp(started_s, UTC).strftime("%Y%m%d%H%M%S")
        path = folder / f"evaluation-{begun}" / "evaluation-simtrace" / "0-iteration.csv"
        if not path.exists():
            break
        started_s += 1.0
    if not (folder / "ip" / "hyperparameters.json").exists():
        write_metadata(folder, trace.space, trace.sensors, {})
    return trace.write(path)


def write_metadata(
    folder: Path,
    space: ActionSpace,
    sensors: SensorConfig,
    hyperparameters: Mapping[str, float | str],
) -> None:
    """Write the two JSON files without which log tools refuse a folder."""
    for name, content in (
        ("model/model_metadata.json", model_metadata.content(space, sensors)),
        ("ip/hyperparameters.json", hyperparameters),
    ):
        with replacing(folder / name, "the metadata of the trace", PolicyError) as file:
            file.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")


class TrainingTrace:
    """A reward that pays what another does, and writes the episodes of car 0 of each world.

    A complete lap ends an episode of the trace, as in the original; the car drives on into the
    next one. Episodes are numbered by their ends.
    """

    def __init__(self, reward: Reward, folder: Path, space: ActionSpace, sim: SimConfig) -> None:
        """Prepare; nothing is written before `flush`, or the end of the twentieth episode."""
        self._reward, self._folder, self._sim = reward, folder / TRAINING, sim
        self.terms = reward.terms  # names under which the other reward logs
        self._space = space
        self._running: list[list[dict[str, Any]]] = []
        self._ended: list[list[dict[str, Any]]] = []
        self._episodes = self._steps = 0

    @property
    def position(self) -> tuple[int, int]:
        """Episodes that have ended, and steps of the worlds; for `resume`."""
        return self._episodes, self._steps

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: ndarray, verdicts: ndarray
    ) -> Paid:
        """Return what the other reward pays, and note the step; see Reward."""
        paid = self._reward(tracks, before, world, actions, verdicts)
        self._steps += 1
        now = {
            "tstamp": round(self._steps * self._sim.step_dt, 6),
            "wall_clock": round(time.time(), 3),
            "pause_duration": 0.0,
        }
        rows = step_rows(tracks, self._sim.car, self._space, before.cars, world, paid[0])
        flags = mistakes(verdicts[:, 0])
        crashed = verdicts["crashed_obstacle"][:, 0] != NOBODY
        laps = verdicts["lap"][:, 0].tolist()
        if not self._running:
            self._running = [[] for _ in rows]
        for number, (row, running) in enumerate(zip(rows, self._running, strict=True)):
            status = "lap_complete" if laps[number] else flags[number] or "in_progress"
            _add(running, row | now, len(running) + 1, status, bool(crashed[number]), laps[number])
            if laps[number]:
                self._end(number)
        return paid

    def restart(self, world: World, begun: ndarray) -> None:
        """End the episodes of cars that begin another; see Reward."""
        self._reward.restart(world, begun)
        for number, running in enumerate(self._running):
            if begun[number, 0] and running:
                self._cut_off(number)

    def flush(self) -> None:
        """Write what was driven so far; episodes still under way end here, cut off by time.

        The rows of a run are restarted wherever it is saved.
        """
        for number, running in enumerate(self._running):
            if running:
                self._cut_off(number)
        if self._ended:
            self._write()

    def resume(self, position: Sequence[int]) -> None:
        """Go on behind some position, and forget the episodes after it."""
        self._episodes, self._steps = position
        first = self._episodes // EPISODES
        for path in self._folder.glob("*-iteration.csv"):
            number = path.name.removesuffix("-iteration.csv")
            if not number.isdigit() or int(number) < first:
                continue
            if int(number) == first:
                self._ended = _read_episodes(path, self._episodes)
            path.unlink()
        self.flush()

    def _cut_off(self, number: int) -> None:
        if self._running[number][-1]["episode_status"] == "in_progress":
            self._running[number][-1]["episode_status"] = "time_up"
        self._end(number)

    def _end(self, number: int) -> None:
        rows, self._running[number] = self._running[number], []
        rows[-1]["done"] = True
        for row in rows:
            row["episode"] = self._episodes
        self._episodes += 1
        self._ended.append(rows)
        if self._episodes % EPISODES == 0:
            self._write()
            self._ended = []

    def _write(self) -> None:
        number = (self._episodes - 1) // EPISODES
        rows = [row for episode in self._ended for row in episode]
        write_rows(self._folder / f"{number}-iteration.csv", rows)


def _read_episodes(path: Path, episodes: int) -> list[list[dict[str, Any]]]:
    """Return the rows of each episode of a file, of those below a number."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = [row for row in csv.DictReader(file) if int(row["episode"]) < episodes]
    return [list(episode) for _, episode in groupby(rows, key=lambda row: row["episode"])]
