"""Replay: one recorded race, its columns, and any of its moments as a world for the renderers."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Literal

import numpy as np

from league.race_spec import RaceResult, RaceSpec
from league.sim import records
from league.sim.config import ObstacleConfig, SimConfig
from league.sim.records import World
from league.track.track import Track, TrackSet

PARAMETERS = ("grip", "mass", "latency_s", "steering_offset", "camera_up", "camera_pitch")
"""A car's parameters, in the order of the file."""
JUMP = 0.5
"""A car that moved farther than this in one step [m] was put back: nothing is drawn between."""
Axis = Literal["cars", "actions", "obstacles", "frames"]
NUM_ACTIONS = 2
TURN_STEP = 2 * np.pi / 65536
"""A heading is kept in 65,536ths of a turn (9.6e-5 rad), so that it wraps by itself."""


@dataclass(frozen=True)
class Grain:
    """How one column is rounded to whole numbers and differenced."""

    name: str
    axis: Axis
    """A row has one number for each of these."""
    step: float
    """One whole number's worth, in the column's unit."""
    order: int
    """How often differences along the frames are taken: 1 keeps changes, 2 changes of changes.
    Chosen on recorded races, whichever was smallest."""
    wraps: bool = False
    """Whether the numbers are angles, kept in 16 bits that wrap with the turn."""
    since: int = 1
    """First version of the file format with it; zero in older replays."""


GRAINS = (
    Grain("x", "cars", 1e-3, 2),
    Grain("y", "cars", 1e-3, 2),
    Grain("yaw", "cars", TURN_STEP, 2, wraps=True),
    Grain("velocity_x", "cars", 1e-3, 1),
    Grain("velocity_y", "cars", 1e-3, 1),
    Grain("yaw_rate", "cars", 1e-3, 1),
    Grain("steering", "cars", 1e-4, 1),
    Grain("actions", "actions", 1e-4, 1),
    Grain("penalty_s", "cars", 1e-3, 1),
    Grain("ghost", "cars", 1.0, 1),
    Grain("laps", "cars", 1.0, 1),
    Grain("distance", "cars", 1e-3, 2),
    Grain("obstacle_x", "obstacles", 1e-3, 2),
    Grain("obstacle_y", "obstacles", 1e-3, 2),
    Grain("obstacle_yaw", "obstacles", TURN_STEP, 2, wraps=True),
    Grain("z", "cars", 1e-3, 1, since=2),
    Grain("roll", "cars", TURN_STEP, 1, wraps=True, since=2),
    Grain("pitch", "cars", TURN_STEP, 1, wraps=True, since=2),
)
"""Every column but the checksums, in the order of the file."""


@dataclass(frozen=True, eq=False)
class Columns:
    """Each step of a race as float64 arrays, num_frames first."""

    x: np.ndarray
    """Position of the base, world frame [m], (num_frames, num_cars)."""
    y: np.ndarray
    """Position of the base, world frame [m], (num_frames, num_cars)."""
    yaw: np.ndarray
    """Heading in [-pi, pi) [rad], (num_frames, num_cars)."""
    velocity_x: np.ndarray
    """Velocity, world frame [m/s], (num_frames, num_cars)."""
    velocity_y: np.ndarray
    """Velocity, world frame [m/s], (num_frames, num_cars)."""
    yaw_rate: np.ndarray
    """[rad/s], (num_frames, num_cars)."""
    steering: np.ndarray
    """Angle of the front wheels, positive to the left [rad], (num_frames, num_cars)."""
    actions: np.ndarray
    """The drivers' actions in the step that led here, (num_frames, num_cars, 2)."""
    penalty_s: np.ndarray
    """Seconds of penalty still to stand [s], (num_frames, num_cars); above 0 the car is frozen."""
    ghost: np.ndarray
    """1 while the car cannot collide, (num_frames, num_cars)."""
    laps: np.ndarray
    """Complete laps, (num_frames, num_cars)."""
    distance: np.ndarray
    """Driven along the track since the start line [m], (num_frames, num_cars)."""
    obstacle_x: np.ndarray
    """Centre [m], (num_frames, num_obstacles), or (1, num_obstacles) if none ever moves."""
    obstacle_y: np.ndarray
    """Centre [m], like obstacle_x."""
    obstacle_yaw: np.ndarray
    """[rad], like obstacle_x."""
    z: np.ndarray
    """Height of the base above where it stands at rest [m], (num_frames, num_cars)."""
    roll: np.ndarray
    """About the car's own x, positive to the right [rad], (num_frames, num_cars)."""
    pitch: np.ndarray
    """About the car's own y, positive nose down [rad], (num_frames, num_cars)."""
    checksum: np.ndarray
    """CRC-32 of the exact bits of each step before rounding, uint32, (num_frames,)."""

    @property
    def num_frames(self) -> int:
        """Steps kept, the start included."""
        return len(self.checksum)

    @property
    def num_cars(self) -> int:
        """Cars in the race."""
        return self.x.shape[1]

    @property
    def num_obstacles(self) -> int:
        """Obstacles in the race."""
        return self.obstacle_x.shape[1]

    def rounded(self) -> Columns:
        """Return the columns as a file would keep them."""
        kept = {g.name: from_whole(g, to_whole(g, getattr(self, g.name))) for g in GRAINS}
        return Columns(checksum=self.checksum, **kept)

    def all_finite(self) -> bool:
        """Whether no number is NaN or infinite."""
        return all(bool(np.isfinite(getattr(self, item.name)).all()) for item in fields(self))


def to_whole(grain: Grain, column: np.ndarray) -> np.ndarray:
    """Round a column to whole numbers, int64."""
    whole = np.rint(np.asarray(column, dtype=np.float64) / grain.step).astype(np.int64)
    return _wrapped(whole) if grain.wraps else whole


def from_whole(grain: Grain, whole: np.ndarray) -> np.ndarray:
    """Return the column that these whole numbers stand for, float64."""
    return (_wrapped(whole) if grain.wraps else whole) * grain.step


def _wrapped(whole: np.ndarray) -> np.ndarray:
    return (whole + 32768) % 65536 - 32768


@dataclass(frozen=True, eq=False)
class Replay:
    """One race: its spec, its result, and where everything was at each step."""

    result: RaceResult
    """The classification, with the spec and all events."""
    track: Track
    """The track."""
    names: tuple[str, ...]
    """Of the drivers, by grid slot."""
    step_hz: int
    """Control steps per second."""
    parameters: np.ndarray
    """Each car's parameters, (num_cars, 6) float32, in the order of `PARAMETERS`."""
    obstacle_sizes: np.ndarray
    """Half length and half width of each obstacle [m], (num_obstacles, 2) float32."""
    columns: Columns
    """All steps."""
    league_version: str = ""
    """Version of the league that drove the race; empty in the oldest replays."""
    physics: str = ""
    """Version of the physics that drove it (league/sim/__init__.py); empty before version 4."""

    @property
    def spec(self) -> RaceSpec:
        """The race that was asked for."""
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
        """Settings of the world that renderers use."""
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

    @property
    def running_order(self) -> np.ndarray:
        """The cars by distance in each frame, the leader first, (num_frames, num_cars)."""
        return np.argsort(-self.columns.distance, axis=1, kind="stable")

    @property
    def gaps_m(self) -> np.ndarray:
        """How far each car is behind the leader along the track [m], (num_frames, num_cars)."""
        distance = self.columns.distance
        return distance.max(axis=1, keepdims=True) - distance

    @property
    def gaps_s(self) -> np.ndarray:
        """The time since the leader was where each car is now [s], (num_frames, num_cars)."""
        return seconds_behind(self.columns.distance, self.times_s)

    @property
    def speeds(self) -> np.ndarray:
        """Each car's speed [m/s], (num_frames, num_cars)."""
        return np.hypot(self.columns.velocity_x, self.columns.velocity_y)

    @property
    def decided_s(self) -> float:
        """When no place can change hands any more: the last car to finish has no rival [s]."""
        fights = self.result.order[:-1]
        if self.spec.ranking != "total" or not fights or not all(car.finished for car in fights):
            return self.duration_s
        return min(max(car.total_s for car in fights), self.duration_s)

    def worlds(self) -> World:
        """Return all frames as one batch of worlds, for the ordinary renderers."""
        return self.at(self.times_s)

    def at(self, times_s: np.ndarray) -> World:
        """Return the race at times [s], (num_worlds,) and held within it, as a batch of worlds.

        Between two frames, poses are interpolated; counts come from the earlier frame. Fields that
        a replay does not keep are zero.
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
    for index, name in enumerate(PARAMETERS):
        cars[name] = replay.parameters[:, index]
    place = replay.tracks.project(worlds["track"], cars["x"], cars["y"])
    cars["s"], cars["lateral"] = place.s, place.lateral
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
        """The comparison as a sentence."""
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


def seconds_behind(distance: np.ndarray, times_s: np.ndarray) -> np.ndarray:
    """Return the time since the one in front was where each car is now [s].

    Distances along the track [m] are (num_frames, num_cars), times [s] (num_frames,).
    """
    lead = distance.max(axis=1)
    front = np.maximum.accumulate(lead)
    # Where the front stands still, its first arrival counts.
    rises = np.concatenate([[True], np.diff(front) > 0])
    first = np.interp(distance, front[rises], times_s[rises])
    return np.maximum(times_s[:, None] - first, 0.0) * (distance < lead[:, None])
