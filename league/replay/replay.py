"""Replay: one recorded race, any of its moments as a world for the renderers, and its recorder."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Literal, get_type_hints

import numpy as np

from league import __version__
from league.errors import ReplayError
from league.race_spec import RaceResult, RaceSpec
from league.sim import PHYSICS, records
from league.sim.config import ObstacleConfig, SimConfig
from league.sim.records import World
from league.track.track import Track, TrackSet

PARAMETERS = ("grip", "mass", "latency_s", "steering_offset", "camera_up", "camera_pitch")
"""A car's parameters, in the order of the file."""
JUMP = 0.5
"""A car that moved farther than this in one step [m] was put back: nothing is drawn between."""
Axis = Literal["cars", "actions", "obstacles"]
TURN_STEP = 2 * np.pi / 65536
"""A heading is kept in 65,536ths of a turn (9.6e-5 rad), so that it wraps by itself."""


@dataclass(frozen=True)
class Grain:
    """How one column is rounded to whole numbers and differenced."""

    axis: Axis  # a row has one number for each of these
    step: float  # one whole number's worth, in the column's unit
    # how often differences along the frames are taken: 1 keeps changes, 2 changes of changes;
    # chosen on recorded races, whichever was smallest
    order: int
    wraps: bool = False  # whether the numbers are angles, kept in 16 bits that wrap with the turn
    since: int = 1  # first version of the file format with it; zero in older replays


@dataclass(frozen=True, eq=False)
class Columns:
    """Each step of a race as float64 arrays, in the order of the file; world frame.

    Columns of cars are (num_frames, num_cars); those of obstacles (num_frames, num_obstacles), or
    (1, num_obstacles) if none ever moves.
    """

    x: Annotated[np.ndarray, Grain("cars", 1e-3, 2)]  # of the base [m]
    y: Annotated[np.ndarray, Grain("cars", 1e-3, 2)]
    yaw: Annotated[np.ndarray, Grain("cars", TURN_STEP, 2, wraps=True)]  # in [-pi, pi) [rad]
    velocity_x: Annotated[np.ndarray, Grain("cars", 1e-3, 1)]  # [m/s]
    velocity_y: Annotated[np.ndarray, Grain("cars", 1e-3, 1)]
    yaw_rate: Annotated[np.ndarray, Grain("cars", 1e-3, 1)]  # [rad/s]
    steering: Annotated[np.ndarray, Grain("cars", 1e-4, 1)]  # of front wheels, to the left [rad]
    # the drivers' in the step that led here, (num_frames, num_cars, 2)
    actions: Annotated[np.ndarray, Grain("actions", 1e-4, 1)]
    # seconds of penalty still to stand [s]; above 0 the car is frozen
    penalty_s: Annotated[np.ndarray, Grain("cars", 1e-3, 1)]
    ghost: Annotated[np.ndarray, Grain("cars", 1.0, 1)]  # 1 while the car cannot collide
    laps: Annotated[np.ndarray, Grain("cars", 1.0, 1)]  # complete ones
    # driven along the track since the start line [m]
    distance: Annotated[np.ndarray, Grain("cars", 1e-3, 2)]
    obstacle_x: Annotated[np.ndarray, Grain("obstacles", 1e-3, 2)]  # of the centre [m]
    obstacle_y: Annotated[np.ndarray, Grain("obstacles", 1e-3, 2)]
    obstacle_yaw: Annotated[np.ndarray, Grain("obstacles", TURN_STEP, 2, wraps=True)]  # [rad]
    # height of the base above where it stands at rest [m]
    z: Annotated[np.ndarray, Grain("cars", 1e-3, 1, since=2)]
    # about the car's own x, positive to the right, and about its y, positive nose down [rad]
    roll: Annotated[np.ndarray, Grain("cars", TURN_STEP, 1, wraps=True, since=2)]
    pitch: Annotated[np.ndarray, Grain("cars", TURN_STEP, 1, wraps=True, since=2)]
    # CRC-32 of the exact bits of each step before rounding, uint32, (num_frames,)
    checksum: np.ndarray

    @property
    def num_obstacles(self) -> int:
        """Obstacles in the race."""
        return self.obstacle_x.shape[1]

    def rounded(self) -> Columns:
        """Return the columns as a file would keep them."""
        kept = {
            name: from_whole(grain, to_whole(grain, getattr(self, name)))
            for name, grain in GRAINS.items()
        }
        return Columns(checksum=self.checksum, **kept)

    def all_finite(self) -> bool:
        """Whether no number is NaN or infinite."""
        return all(bool(np.isfinite(getattr(self, item.name)).all()) for item in fields(self))


GRAINS: dict[str, Grain] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(Columns, include_extras=True).items()
    if hasattr(hint, "__metadata__")
}
"""Of every column but the checksums, in the order of the file."""


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

    result: RaceResult  # the classification, with the spec and all events
    track: Track
    names: tuple[str, ...]  # of the drivers, by grid slot
    step_hz: int  # control steps per second
    parameters: np.ndarray  # each car's, (num_cars, 6) float32, in the order of `PARAMETERS`
    # half length and half width of each obstacle [m], (num_obstacles, 2) float32
    obstacle_sizes: np.ndarray
    columns: Columns  # all steps
    league_version: str = ""  # of the league that drove the race; empty in the oldest replays
    # of the physics that drove it (league/sim/__init__.py); empty before version 4
    physics: str = ""

    @property
    def spec(self) -> RaceSpec:
        """The race that was asked for."""
        return self.result.spec

    @property
    def num_frames(self) -> int:
        """Steps kept, the start included."""
        return len(self.columns.checksum)

    @property
    def num_cars(self) -> int:
        """Cars in the race."""
        return len(self.names)

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
        a replay does not keep are zero. ReplayError: a time is NaN.
        """
        times_s = np.asarray(times_s)
        if np.isnan(times_s).any():
            raise ReplayError("a time is NaN: give seconds since the start of the race")
        place = np.clip(times_s * self.step_hz, 0, self.num_frames - 1)
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
    worlds["leader"] = columns.distance[low].argmax(axis=1)
    cars = np.zeros((number, replay.num_cars), records.CAR)
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
    cars["ahead"] = (ahead << np.arange(replay.num_cars)).sum(axis=2)
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

    steps: int  # frames compared, the start included
    first_difference: int | None  # the first step that differs, or None; a missing step differs
    same_result: bool  # whether spec, classification and events are equal

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


_FOR_GOOD_S = 1e5  # penalty in a replay of a car that is out of the race: longer than any race [s]
_KEPT = (
    *("x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate", "steering"),
    *("penalty_s", "distance", "laps", "ghost", "z", "roll", "pitch"),
)
"""Fields of a car that a replay keeps."""
_CHECKED = (*_KEPT, "retired")  # fields of a car that a frame's checksum covers


class Recorder:
    """Keeps copies of the steps of one race."""

    def __init__(self, spec: RaceSpec, tracks: TrackSet) -> None:
        """Start without a step; the world's `track` is an index of `tracks`."""
        self._tracks = tracks
        self._names = tuple(entry.name for entry in spec.entries)
        self._first: World | None = None
        # Records as they are; all arithmetic waits for `finish`.
        self._cars: list[np.ndarray] = []
        self._obstacles: list[np.ndarray] = []

    def add(self, world: World) -> None:
        """Keep a race, a batch of one: first on the grid, and then after each control step."""
        if self._first is None:
            self._first = world.copy()
        # Copies, so nothing that happens to the race later can reach the recording.
        self._cars.append(world.cars[0].copy())
        self._obstacles.append(world.obstacles[0].copy())

    def finish(self, result: RaceResult) -> Replay:
        """Return the race that was recorded.

        The columns are rounded here as on disk, so a replay does not change by being written.
        """
        if self._first is None:
            raise ValueError("nothing was recorded: add(world) the grid, and then each step")
        world, columns = self._first, self._columns()
        if not columns.all_finite():
            raise ReplayError("the race left the numbers (NaN or infinity), so it cannot be kept")
        sizes = [world.obstacles[name][0] for name in ("half_length", "half_width")]
        return Replay(
            result=result,
            track=self._tracks.tracks[int(world.track[0])],
            names=self._names,
            step_hz=SimConfig().step_hz,
            parameters=np.stack([world.cars[name][0] for name in PARAMETERS], axis=1),
            obstacle_sizes=np.stack(sizes, axis=1),
            columns=columns.rounded(),
            league_version=__version__,
            physics=PHYSICS,
        )

    def _columns(self) -> Columns:
        cars, obstacles = _stacked(self._cars), _stacked(self._obstacles)
        actions = np.stack([cars["action_steering"], cars["action_speed"]], axis=-1)
        places = [obstacles[name] for name in ("x", "y", "yaw")]
        checksum = _checksums(*(cars[name] for name in _CHECKED), actions, *places)
        if all((place == place[:1]).all() for place in places):
            places = [place[:1] for place in places]
        kept = {name: cars[name].astype(np.float64) for name in _KEPT}
        # NaN stays NaN.
        penalty_s = np.where(cars["retired"], _FOR_GOOD_S, kept.pop("penalty_s"))
        names = ("obstacle_x", "obstacle_y", "obstacle_yaw")
        kept |= {name: place.astype(np.float64) for name, place in zip(names, places, strict=True)}
        kept |= {"actions": actions.astype(np.float64), "penalty_s": penalty_s}
        return Columns(**kept, checksum=checksum)


def _stacked(frames: list[np.ndarray]) -> np.ndarray:
    """Return records of all frames as one array; np.stack would compare their fields each time."""
    records = np.empty((len(frames), *frames[0].shape), frames[0].dtype)
    for number, frame in enumerate(frames):
        records[number] = frame
    return records


def _checksums(*parts: np.ndarray) -> np.ndarray:
    """Return the CRC-32 of each frame's exact bits and number, uint32, (num_frames,)."""
    frames = len(parts[0])
    number = np.arange(frames, dtype="<i8").reshape(frames, 1)
    rows = [np.ascontiguousarray(part.reshape(frames, -1)) for part in (number, *parts)]
    row_bytes = np.concatenate([row.view(np.uint8).reshape(frames, -1) for row in rows], axis=1)
    return np.array([zlib.crc32(row.tobytes()) for row in row_bytes], dtype=np.uint32)
