"""Simtrace: the folder of `*-iteration.csv` files in which community log tools look for traces.

The layout is that of DeepRacer for Cloud with one worker: training-simtrace/N-iteration.csv,
evaluation-TIME/evaluation-simtrace/0-iteration.csv, model/model_metadata.json and
ip/hyperparameters.json.
"""

from __future__ import annotations

import csv
import json
import time
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from league.atomic_file import replacing
from league.deepracer import model_metadata
from league.envs.actions import ActionSpace
from league.envs.rewards import Reward
from league.errors import PolicyError
from league.racing.trace import StepRows, Trace, mistakes, write_rows
from league.sim.config import SensorConfig, SimConfig
from league.sim.records import NOBODY, World
from league.track.track import TrackSet

EPISODES = 20
"""Episodes of a file of training. Log tools count on the same number in each."""
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
        self._step_rows = StepRows(space)
        self._running: list[list[dict[str, Any]]] = []
        self._ended: list[list[dict[str, Any]]] = []
        self._episodes = self._steps = 0

    @property
    def terms(self) -> tuple[str, ...]:
        """Names under which the other reward logs."""
        return self._reward.terms

    @property
    def position(self) -> tuple[int, int]:
        """Episodes that have ended, and steps of the worlds; for `resume`."""
        return self._episodes, self._steps

    def __call__(
        self,
        tracks: TrackSet,
        before: World,
        world: World,
        actions: np.ndarray,
        verdicts: np.ndarray,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return what the other reward pays, and note the step; see Reward."""
        paid = self._reward(tracks, before, world, actions, verdicts)
        self._steps += 1
        now = {
            "tstamp": round(self._steps * self._sim.step_dt, 6),
            "wall_clock": round(time.time(), 3),
        }
        rows = self._step_rows.of(tracks, self._sim, before.cars, world, paid[0])
        flags = mistakes(verdicts[:, 0])
        crashed = verdicts["crashed_obstacle"][:, 0] != NOBODY
        laps = verdicts["lap"][:, 0].tolist()
        if not self._running:
            self._running = [[] for _ in rows]
        for number, (row, running) in enumerate(zip(rows, self._running, strict=True)):
            crashes = running[-1]["obstacle_crash_counter"] if running else 0
            running.append(
                {
                    **row,
                    **now,
                    "steps": len(running) + 1,
                    "done": False,
                    "episode_status": flags[number] or "in_progress",
                    "pause_duration": 0.0,
                    "obstacle_crash_counter": crashes + bool(crashed[number]),
                }
            )
            if laps[number]:
                running[-1] |= {"progress": 100.0, "episode_status": "lap_complete"}
                self._end(number)
        return paid

    def restart(self, world: World, begun: np.ndarray) -> None:
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
                self._ended = _read(path, self._episodes)
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


def _read(path: Path, episodes: int) -> list[list[dict[str, Any]]]:
    """Return the rows of each episode of a file, of those below a number."""
    by_episode: dict[int, list[dict[str, Any]]] = {}
    with path.open(newline="", encoding="utf-8") as file:
        for row in csv.DictReader(file):
            if int(row["episode"]) < episodes:
                by_episode.setdefault(int(row["episode"]), []).append(row)
    return list(by_episode.values())
