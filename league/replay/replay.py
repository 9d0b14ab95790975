"""Replay: one race that was kept, and any of its moments as a world for the renderers."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from league.race_spec import RaceResult, RaceSpec
from league.replay.columns import Columns
from league.sim.config import ObstacleConfig, SimConfig
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
    league_version: str = ""
    """Version of the league that drove the race; empty if it was not kept yet."""

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
