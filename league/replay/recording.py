"""Recorder, which is told each step of a race, and Replay, the race it kept."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from league.errors import ReplayError
from league.race_spec import RaceResult, RaceSpec
from league.replay.columns import NUM_ACTIONS, Columns
from league.sim.world import (
    CarParameters,
    Control,
    Motion,
    Obstacles,
    Standing,
    World,
)
from league.track.course import Track, TrackSet

PARAMETERS = ("grip", "mass", "latency_s", "steering_offset", "camera_up", "camera_pitch")
"""The fields of CarParameters, in the order they are kept."""
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
        return TrackSet.of(self.track)

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
    columns = replay.columns
    high = np.minimum(low + 1, replay.num_frames - 1)
    moved = np.hypot(columns.x[high] - columns.x[low], columns.y[high] - columns.y[low])
    share = np.where(moved < JUMP, part[:, None], 0.0)  # (num_worlds, num_cars)

    def between(column: np.ndarray) -> Tensor:
        return _float(column[low] + (column[high] - column[low]) * share)

    turn = (columns.yaw[high] - columns.yaw[low] + np.pi) % (2 * np.pi) - np.pi
    yaw = (columns.yaw[low] + turn * share + np.pi) % (2 * np.pi) - np.pi
    motion = Motion(
        x=between(columns.x),
        y=between(columns.y),
        yaw=_float(yaw),
        velocity_x=between(columns.velocity_x),
        velocity_y=between(columns.velocity_y),
        yaw_rate=between(columns.yaw_rate),
        steering=between(columns.steering),
    )
    none = torch.zeros_like(motion.x)
    shape = motion.x.shape
    return World(
        seed=torch.full((len(low),), replay.spec.seed, dtype=torch.int64),
        step=torch.from_numpy(low.copy()),
        track=torch.zeros(len(low), dtype=torch.int64),
        motion=motion,
        control=Control(steering=none, speed=none),
        cars=CarParameters(
            **{
                name: torch.from_numpy(replay.parameters[:, place].copy())
                .expand(shape)
                .contiguous()
                for place, name in enumerate(PARAMETERS)
            }
        ),
        obstacles=_obstacles(replay, low, high, part),
        standing=_standing(replay, low, motion),
    )


def _obstacles(replay: Replay, low: np.ndarray, high: np.ndarray, part: np.ndarray) -> Obstacles:
    columns = replay.columns
    if len(columns.obstacle_x) == 1:  # none ever moves
        low = high = np.zeros_like(low)

    def between(column: np.ndarray) -> Tensor:
        return _float(column[low] + (column[high] - column[low]) * part[:, None])

    x = between(columns.obstacle_x)
    none = torch.zeros_like(x)
    sizes = torch.from_numpy(replay.obstacle_sizes.copy())
    return Obstacles(
        x=x,
        y=between(columns.obstacle_y),
        yaw=_float(columns.obstacle_yaw[low]),
        velocity_x=_float((columns.obstacle_x[high] - columns.obstacle_x[low]) * replay.step_hz),
        velocity_y=_float((columns.obstacle_y[high] - columns.obstacle_y[low]) * replay.step_hz),
        s=none,
        lateral=none,
        half_length=sizes[:, 0].expand(x.shape).contiguous(),
        half_width=sizes[:, 1].expand(x.shape).contiguous(),
        stopped_s=none,
    )


def _standing(replay: Replay, low: np.ndarray, motion: Motion) -> Standing:
    columns = replay.columns
    index = torch.zeros(len(low), dtype=torch.int64)
    place = replay.tracks.locate(index, motion.x, motion.y)
    none = torch.zeros_like(motion.x)
    count = torch.zeros(motion.x.shape, dtype=torch.int64)
    never = torch.full_like(motion.x, torch.inf)
    distance = _float(columns.distance[low])
    cars, obstacles = columns.num_cars, columns.num_obstacles
    return Standing(
        s=place.s,
        lateral=place.lateral,
        zero_s=none,
        distance=distance,
        best_distance=distance,
        laps=torch.from_numpy(np.rint(columns.laps[low]).astype(np.int64)),
        lap_start_s=none,
        last_lap_s=none,
        best_lap_s=never,
        finish_s=never,
        penalty_s=_float(columns.penalty_s[low]),
        ghost=torch.from_numpy(columns.ghost[low] > 0.5),
        put_back=torch.zeros(motion.x.shape, dtype=torch.bool),
        still_steps=count,
        backward_steps=count,
        touching_cars=torch.zeros((len(low), cars, cars), dtype=torch.bool),
        touching_obstacles=torch.zeros((len(low), cars, obstacles), dtype=torch.bool),
        off_tracks=count,
        crashes=count,
        contacts_taken=count,
        immobilised=count,
        reversed=count,
        overtakes=count,
        lead_changes=torch.zeros(len(low), dtype=torch.int64),
        ahead=distance.unsqueeze(2) > distance.unsqueeze(1),
        leader=torch.from_numpy(replay.leader[low].copy()),
    )


def _float(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32))


class Recorder:
    """Keeps the steps of one race as it is told them; it looks at the race and never touches it."""

    def __init__(
        self,
        spec: RaceSpec,
        tracks: TrackSet,
        names: Sequence[str] | None = None,
        step_hz: int = 15,
    ) -> None:
        """Make a recorder for one race.

        Args:
            spec: what was asked.
            tracks: the tracks the world's `track` index points into.
            names: who drives each car, by grid slot; by default the spec's entries.
            step_hz: control steps per second.
        """
        self._tracks = tracks
        self._names = tuple(names or [entry.name for entry in spec.entries])
        self._step_hz = step_hz
        self._first: World | None = None
        # Tensors only, on the race's device; all arithmetic waits for `finish`.
        self._motion: list[Tensor] = []
        self._book: list[Tensor] = []
        self._counts: list[Tensor] = []
        self._actions: list[Tensor] = []
        self._obstacles: list[Tensor] = []

    def start(self, world: World) -> None:
        """Keep the world on the grid, before the first step."""
        if world.num_worlds != 1:
            raise ValueError(f"a recorder keeps one race, not a batch of {world.num_worlds} worlds")
        if self._first is not None:
            raise ValueError("this recorder has started already: make a new one for each race")
        self._first = world
        self._keep(world, torch.zeros((world.num_cars, NUM_ACTIONS)))

    def add(self, world: World, actions: Tensor) -> None:
        """Keep the world after one control step and the actions that led to it.

        Args:
            world: one race, num_worlds == 1.
            actions: in [-1, 1], (1, num_cars, 2) or (num_cars, 2).
        """
        if self._first is None:
            raise ValueError("tell the recorder the grid with start(world) before the first step")
        self._keep(world, actions)

    def _keep(self, world: World, actions: Tensor) -> None:
        # Stacking copies, so nothing that happens to the race later can reach the recording.
        m, standing, obstacles = world.motion, world.standing, world.obstacles
        self._motion.append(
            torch.stack((m.x, m.y, m.yaw, m.velocity_x, m.velocity_y, m.yaw_rate, m.steering))
        )
        self._book.append(torch.stack((standing.penalty_s, standing.distance)))
        self._counts.append(torch.stack((standing.laps, standing.ghost.to(torch.int64))))
        self._actions.append(actions.detach().reshape(-1, NUM_ACTIONS).clone())
        if obstacles.x.shape[1]:
            self._obstacles.append(torch.stack((obstacles.x, obstacles.y, obstacles.yaw)))

    def finish(self, result: RaceResult) -> Replay:
        """Return the race that was recorded.

        The columns are rounded here as on disk, so a replay does not change by being written.
        """
        if self._first is None:
            raise ValueError("nothing was recorded: tell the recorder the grid with start(world)")
        world = self._first
        track = self._tracks.tracks[int(world.track[0])]
        columns = self._columns(world.num_cars, world.obstacles.x.shape[1])
        if not columns.all_finite():
            raise ReplayError("the race left the numbers (NaN or infinity), so it cannot be kept")
        obstacles = world.obstacles
        return Replay(
            result=result,
            track=track,
            names=self._names,
            step_hz=self._step_hz,
            parameters=np.stack(
                [getattr(world.cars, name)[0].cpu().numpy() for name in PARAMETERS], axis=1
            ).astype(np.float32),
            obstacle_sizes=np.stack(
                [obstacles.half_length[0].cpu().numpy(), obstacles.half_width[0].cpu().numpy()],
                axis=1,
            ).astype(np.float32),
            columns=columns.rounded(),
        )

    def _columns(self, num_cars: int, num_obstacles: int) -> Columns:
        frames = len(self._motion)
        motion = _array(self._motion).reshape(frames, 7, num_cars)
        book = _array(self._book).reshape(frames, 2, num_cars)
        counts = _array(self._counts).reshape(frames, 2, num_cars)
        actions = _array([a.to(torch.float32) for a in self._actions])
        actions = actions.reshape(frames, num_cars, NUM_ACTIONS)
        places = np.zeros((frames, 3, 0), dtype=np.float32)
        if num_obstacles:
            places = _array(self._obstacles).reshape(frames, 3, num_obstacles)
        checksum = _checksums(motion, book, counts, actions, places)
        if (places == places[:1]).all():
            places = places[:1]
        x, y, yaw, velocity_x, velocity_y, yaw_rate, steering = motion.astype(np.float64).swapaxes(
            0, 1
        )
        return Columns(
            x=x,
            y=y,
            yaw=yaw,
            velocity_x=velocity_x,
            velocity_y=velocity_y,
            yaw_rate=yaw_rate,
            steering=steering,
            actions=actions.astype(np.float64),
            penalty_s=book[:, 0].astype(np.float64),
            ghost=counts[:, 1].astype(np.float64),
            laps=counts[:, 0].astype(np.float64),
            distance=book[:, 1].astype(np.float64),
            obstacle_x=places[:, 0].astype(np.float64),
            obstacle_y=places[:, 1].astype(np.float64),
            obstacle_yaw=places[:, 2].astype(np.float64),
            checksum=checksum,
        )


def _array(steps: list[Tensor]) -> np.ndarray:
    return torch.stack(steps).cpu().numpy()


def _checksums(*parts: np.ndarray) -> np.ndarray:
    """Return the CRC-32 of each frame's exact bits and number, uint32, (num_frames,)."""
    frames = len(parts[0])
    number = np.arange(frames, dtype="<i8").reshape(frames, 1)
    rows = [np.ascontiguousarray(part.reshape(frames, -1)) for part in (number, *parts)]
    row_bytes = np.concatenate([row.view(np.uint8).reshape(frames, -1) for row in rows], axis=1)
    return np.array([zlib.crc32(row.tobytes()) for row in row_bytes], dtype=np.uint32)


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
