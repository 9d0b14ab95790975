"""Replay: one race that was kept, and any of its moments as a world for the renderers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from league.race_spec import RaceResult, RaceSpec
from league.replay.columns import Columns
from league.sim import records
from league.sim.config import ObstacleConfig, SimConfig
from league.sim.world import World
from league.track.track import Track, TrackSet

PARAMETERS = ("grip", "mass", "latency_s", "steering_offset", "camera_up", "camera_pitch")
"""The fields of a car's parameters, in the order they are kept."""
JUMP = 0.5
"""A car that moved farther than this in one step [m] was put back: nothing is drawn between."""


@dataclass(frozen=True, eq=False)
class Replay:
    """One race: what was asked, what came of it, and where everything was at each step."""

    result: RaceResult
    """The classification, with the spec and all events."""
    track: Track
    """The track as it was raced on."""
    names: tuple[str, ...]
    """Who drove each car, by grid slot."""
    step_hz: int
    """Control steps per second."""
    parameters: np.ndarray
    """Each car's parameters, (num_cars, 6) float32, in the order of `PARAMETERS`."""
    obstacle_sizes: np.ndarray
    """Half length and half width of each obstacle [m], (num_obstacles, 2) float32."""
    columns: Columns
    """All steps."""
    league_version: str = ""
    """Version of the league that drove the race; empty if it was not kept yet."""
    physics: str = ""
    """Version of the physics that drove it (league/sim/version.py); empty before version 4."""

    @property
    def spec(self) -> RaceSpec:
        """What was asked."""
        return self.result.spec

    @property
    def num_frames(self) -> int:
        """Steps kept, the start included."""
        return self.columns.num_frames

    @property
    def num_cars(self) -> int:
        """Cars in the race."""
        return self.columns.num_cars

    @property
    def duration_s(self) -> float:
        """Race time of the last frame [s]."""
        return (self.num_frames - 1) / self.step_hz

    @cached_property
    def times_s(self) -> np.ndarray:
        """Race time of each frame [s], (num_frames,)."""
        return np.arange(self.num_frames) / self.step_hz

    @cached_property
    def tracks(self) -> TrackSet:
        """The track as the one row of a set."""
        return TrackSet(self.track)

    @cached_property
    def sim(self) -> SimConfig:
        """Settings of the world, as far as the renderers ask for them."""
        return SimConfig(
            kind=self.spec.kind,
            num_cars=self.num_cars,
            step_hz=self.step_hz,
            obstacles=ObstacleConfig(
                count=self.columns.num_obstacles, kind=self.spec.obstacle_kind
            ),
        )

    @cached_property
    def leader(self) -> np.ndarray:
        """The car in front in each frame, (num_frames,)."""
        return self.columns.distance.argmax(axis=1)

    def worlds(self) -> World:
        """Return all frames as one batch of worlds, for the ordinary renderers."""
        return self.at(self.times_s)

    def at(self, times_s: np.ndarray) -> World:
        """Return the race at any moments, as one batch of worlds.

        Between two frames, poses are drawn on straight lines; what is counted comes from the
        earlier frame. What a replay does not keep is zero.

        Args:
            times_s: race times [s], held within the race; shape (num_worlds,).
        """
        place = np.clip(np.asarray(times_s) * self.step_hz, 0, self.num_frames - 1)
        # A time that is a frame up to rounding is that frame.
        near = np.rint(place)
        place = np.where(np.abs(place - near) < 1e-6, near, place)
        low = np.floor(place).astype(np.int64)
        return _worlds(self, low, place - low)


def _worlds(replay: Replay, low: np.ndarray, part: np.ndarray) -> World:
    columns, number = replay.columns, len(low)
    high = np.minimum(low + 1, replay.num_frames - 1)
    moved = np.hypot(columns.x[high] - columns.x[low], columns.y[high] - columns.y[low])
    share = np.where(moved < JUMP, part[:, None], 0.0)  # (num_worlds, num_cars)
    worlds = np.zeros(number, records.WORLD)
    worlds["seed"], worlds["step"] = replay.spec.seed, low
    worlds["leader"] = replay.leader[low]
    cars = np.zeros((number, columns.num_cars), records.CAR)
    for name in ("x", "y", "velocity_x", "velocity_y", "yaw_rate", "steering", "z"):
        column = getattr(columns, name)
        cars[name] = column[low] + (column[high] - column[low]) * share
    for name in ("yaw", "roll", "pitch"):
        column = getattr(columns, name)
        turn = (column[high] - column[low] + np.pi) % (2 * np.pi) - np.pi
        cars[name] = (column[low] + turn * share + np.pi) % (2 * np.pi) - np.pi
    for place, name in enumerate(PARAMETERS):
        cars[name] = replay.parameters[:, place]
    found = replay.tracks.project(worlds["track"], cars["x"], cars["y"])
    cars["s"], cars["lateral"] = found.s, found.lateral
    cars["distance"] = cars["best_distance"] = columns.distance[low]
    cars["laps"], cars["penalty_s"] = np.rint(columns.laps[low]), columns.penalty_s[low]
    cars["ghost"] = columns.ghost[low] > 0.5
    cars["best_lap_s"] = cars["finish_s"] = np.inf
    ahead = cars["distance"][:, :, None] > cars["distance"][:, None, :]
    cars["ahead"] = (ahead << np.arange(columns.num_cars)).sum(axis=2)
    return World(worlds, cars, _obstacles(replay, low, high, part))


def _obstacles(replay: Replay, low: np.ndarray, high: np.ndarray, part: np.ndarray) -> np.ndarray:
    columns, part = replay.columns, part[:, None]
    things = np.zeros((len(low), columns.num_obstacles), records.OBSTACLE)
    if len(columns.obstacle_x) == 1:  # none ever moves
        low = high = np.zeros_like(low)
    moved_x = columns.obstacle_x[high] - columns.obstacle_x[low]
    moved_y = columns.obstacle_y[high] - columns.obstacle_y[low]
    things["x"] = columns.obstacle_x[low] + moved_x * part
    things["y"] = columns.obstacle_y[low] + moved_y * part
    things["yaw"] = columns.obstacle_yaw[low]
    things["velocity_x"] = moved_x * replay.step_hz
    things["velocity_y"] = moved_y * replay.step_hz
    things["half_length"], things["half_width"] = replay.obstacle_sizes.T
    return things


@dataclass(frozen=True)
class Agreement:
    """Whether two recordings of a race are the same, to the last bit."""

    steps: int
    """Frames compared, the start included."""
    first_difference: int | None
    """The first step that differs, or None; a missing step differs."""
    same_result: bool
    """Whether spec, classification and events are equal."""

    @property
    def agrees(self) -> bool:
        """Whether everything is the same."""
        return self.first_difference is None and self.same_result

    @property
    def sentence(self) -> str:
        """What was found, for people."""
        if self.first_difference is not None:
            when = "the start" if self.first_difference == 0 else f"step {self.first_difference}"
            return f"The races differ from {when} on, of {self.steps - 1} steps."
        if not self.same_result:
            return f"All {self.steps - 1} steps agree, but the results differ."
        return f"All {self.steps - 1} steps agree to the last bit, and so does the result."


def compare(replay: Replay, other: Replay) -> Agreement:
    """Compare two replays step by step by the checksums of their exact states."""
    ours, theirs = replay.columns.checksum, other.columns.checksum
    common = min(len(ours), len(theirs))
    different = np.flatnonzero(ours[:common] != theirs[:common])
    first = int(different[0]) if len(different) else None
    if first is None and len(ours) != len(theirs):
        first = common
    return Agreement(
        steps=max(len(ours), len(theirs)),
        first_difference=first,
        same_result=replay.result == other.result,
    )
