"""Situations: what the worlds look like to reward functions, one dict of 27 keys for each row.

All rows are worked out at once in numpy and handed out as plain Python: floats, bools, ints, lists.
The meaning of each key is told in docs/rewards.md; sources: facts sections 1.2 and 11.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from league.envs.deepracer.camera import seen
from league.envs.deepracer.lines import Lines, Places
from league.errors import ConfigError
from league.sim.config import CarConfig, SimConfig
from league.sim.referee import Verdict
from league.sim.world import World
from league.track.course import TrackSet

KEYS = (
    "all_wheels_on_track",
    "closest_objects",
    "closest_waypoints",
    "distance_from_center",
    "heading",
    "is_crashed",
    "is_left_of_center",
    "is_offtrack",
    "is_reversed",
    "object_in_camera",
    "objects_distance",
    "objects_distance_from_center",
    "objects_heading",
    "objects_left_of_center",
    "objects_location",
    "objects_speed",
    "progress",
    "projection_distance",
    "sim_time",
    "speed",
    "steering_angle",
    "steps",
    "track_length",
    "track_width",
    "waypoints",
    "x",
    "y",
)
"""Every key of `params`, by name."""

Params = dict[str, object]
_BELOW_100 = math.nextafter(100.0, 0.0)
_DEGREES = 180.0 / math.pi


@dataclass(frozen=True)
class Rows:
    """Some cars of some worlds, and what each is told."""

    world: np.ndarray
    """World of each row, int64, (num_rows,)."""
    car: np.ndarray
    """Car of each row, int64, (num_rows,)."""
    params: list[Params]
    """What each row's function is called with; nobody else holds any list in it."""


@dataclass(frozen=True)
class _Cars:
    """All cars as arrays, (num_worlds, num_cars)."""

    x: np.ndarray
    y: np.ndarray
    yaw: np.ndarray
    velocity_x: np.ndarray
    velocity_y: np.ndarray
    s: np.ndarray
    lateral: np.ndarray
    distance: np.ndarray
    steering: np.ndarray
    speed: np.ndarray

    @classmethod
    def of(cls, world: World) -> _Cars:
        body, book, asked = world.motion, world.standing, world.control
        # Stacked first, so that a GPU is asked once.
        both = torch.stack(
            (
                body.x,
                body.y,
                body.yaw,
                body.velocity_x,
                body.velocity_y,
                book.s,
                book.lateral,
                book.distance,
                asked.steering,
                asked.speed,
            )
        )
        return cls(*both.cpu().numpy().astype(np.float64))


class Situations:
    """Makes each paid car's params; remembers when its episode began, and where.

    An episode begins at a restart, and with each lap: then `steps` counts from 1 and `progress`
    from 0 again.
    """

    def __init__(self, sim: SimConfig, cars: Sequence[int]) -> None:
        """Make the memory; `restart` fits it to the worlds.

        Args:
            sim: the world's settings.
            cars: which cars are paid.
        """
        self._car, self._step_dt, self._cars = sim.car, sim.step_dt, tuple(cars)
        self._steps = np.zeros((0, 0), dtype=np.int64)
        self._known: TrackSet | None = None

    def restart(self, who: Tensor) -> None:
        """Begin an episode for these cars, bool, (num_worlds, num_cars).

        Raises:
            ConfigError: a paid car that is not there.
        """
        begun = who.cpu().numpy()
        if self._steps.shape != begun.shape:
            self._fit(*begun.shape)
        self._steps[begun] = 0
        self._fresh |= begun

    def _fit(self, num_worlds: int, num_cars: int) -> None:
        strangers = [car for car in self._cars if not 0 <= car < num_cars]
        if strangers:
            raise ConfigError(
                f"car {strangers[0]} is to be paid: there are {num_cars} cars, from 0"
            )
        shape = (num_worlds, num_cars)
        self._steps = np.zeros(shape, dtype=np.int64)
        self._fresh = np.ones(shape, dtype=bool)
        self._lead, self._start = np.zeros(shape), np.zeros(shape)
        self._paid = np.zeros(shape, dtype=bool)
        self._paid[:, list(self._cars)] = True
        others = [[other for other in range(num_cars) if other != car] for car in range(num_cars)]
        self._others = np.array(others, dtype=np.int64).reshape(num_cars, num_cars - 1)

    def rows(self, tracks: TrackSet, before: World, world: World, verdict: Verdict) -> Rows:
        """Return what each paid car is told of a step; cars that stand a penalty are left out.

        Args:
            tracks: the courses.
            before: the worlds before the step.
            world: the worlds after it, before any penalty or restart moved a car.
            verdict: what happened in the step.
        """
        if tracks is not self._known:
            self._lines, self._known = Lines.of(tracks), tracks
        book = before.standing
        stopped = ((book.penalty_s > 0) | (book.finish_s < torch.inf)).cpu().numpy()
        where, which = (self._paid & ~stopped).nonzero()
        if not len(where):
            return Rows(where, which, [])
        track = world.track.cpu().numpy()[where]
        self._note_starts(before, where, which, track)
        self._steps[where, which] += 1
        cars, crashed = _Cars.of(world), verdict.crashed.cpu().numpy()[where, which]
        lap = verdict.lap.cpu().numpy()[where, which]
        nose, wheels = self._project(cars, where, which, track)
        columns = self._own(cars, where, which, track, nose)
        columns |= {
            "is_crashed": crashed.tolist(),
            "progress": self._progress(before, cars, where, which, track, nose, lap),
            "sim_time": (world.step.cpu().numpy()[where] * self._step_dt).tolist(),
            "steps": self._steps[where, which].tolist(),
            **_on_road(wheels, len(where)),
            **self._objects(world, cars, where, which, track, nose),
        }
        self._steps[where[lap], which[lap]] = 0
        told = [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
        return Rows(where, which, told)

    def _note_starts(
        self, before: World, where: np.ndarray, which: np.ndarray, track: np.ndarray
    ) -> None:
        """Note where an episode began: how far the base had driven, and the nose before it."""
        fresh = self._fresh[where, which]
        if not fresh.any():
            return
        where, which, track = where[fresh], which[fresh], track[fresh]
        cars = _Cars.of(before)
        nose, _ = self._project(cars, where, which, track)
        gap = nose.s - cars.s[where, which]
        self._lead[where, which] = self._lines.short_way(track, gap)
        self._start[where, which] = cars.distance[where, which]
        self._fresh[where, which] = False

    def _project(
        self, cars: _Cars, where: np.ndarray, which: np.ndarray, track: np.ndarray
    ) -> tuple[Places, Places]:
        """Find each row's nose, (num_rows,), and its four wheels, (4 * num_rows,)."""
        along, across = _points(self._car)
        x, y, yaw = (getattr(cars, name)[where, which] for name in ("x", "y", "yaw"))
        cos, sin = np.cos(yaw), np.sin(yaw)
        point_x = (x + np.outer(along, cos) - np.outer(across, sin)).reshape(-1)
        point_y = (y + np.outer(along, sin) + np.outer(across, cos)).reshape(-1)
        many = len(along)
        near = np.tile(cars.s[where, which], many)
        found = self._lines.project(np.tile(track, many), point_x, point_y, near)
        rows = len(where)
        nose, wheels = (
            Places(*(getattr(found, name)[part] for name in ("s", "lateral", "left", "right")))
            for part in (slice(0, rows), slice(rows, None))
        )
        return nose, wheels

    def _own(
        self,
        cars: _Cars,
        where: np.ndarray,
        which: np.ndarray,
        track: np.ndarray,
        nose: Places,
    ) -> dict[str, list]:
        """Return the columns about the car itself and its track."""
        lines = self._lines
        yaw = cars.yaw[where, which]
        heading = yaw * _DEGREES
        return {
            # Rounded to where single precision ends, so that a choice of 15 deg is told as 15.0.
            "steering_angle": np.round(cars.steering[where, which] * _DEGREES, 4).tolist(),
            "speed": np.round(cars.speed[where, which], 4).tolist(),
            "x": (cars.x[where, which] + self._car.nose * np.cos(yaw)).tolist(),
            "y": (cars.y[where, which] + self._car.nose * np.sin(yaw)).tolist(),
            "heading": np.where(heading <= -180.0, 180.0, heading).tolist(),
            "distance_from_center": np.abs(nose.lateral).tolist(),
            "projection_distance": nose.s.tolist(),
            "is_left_of_center": (nose.left - nose.lateral < nose.right + nose.lateral).tolist(),
            "track_width": (nose.left + nose.right).tolist(),
            "track_length": lines.length[track].tolist(),
            "is_reversed": lines.clockwise[track].tolist(),
            "waypoints": [lines.waypoints[one][:] for one in track.tolist()],
            "closest_waypoints": lines.closest_waypoints(track, nose.s),
        }

    def _progress(
        self,
        before: World,
        cars: _Cars,
        where: np.ndarray,
        which: np.ndarray,
        track: np.ndarray,
        nose: Places,
        lap: np.ndarray,
    ) -> list[float]:
        """Return how much of a lap the nose has driven since the episode began [%].

        Held just below 100 until the referee has counted the lap, so that 100 is told once.
        """
        lead = self._lines.short_way(track, nose.s - cars.s[where, which])
        driven = cars.distance[where, which] - self._start[where, which]
        length = self._lines.lap[track]
        share = 100.0 * (driven + lead - self._lead[where, which]) / length
        if lap.any():
            laps = before.standing.laps.cpu().numpy()[where, which] + 1
            begins = np.where(lap, laps * length, self._start[where, which])
            self._start[where, which] = begins
        return np.where(lap, 100.0, np.minimum(share, _BELOW_100)).tolist()

    def _objects(
        self,
        world: World,
        cars: _Cars,
        where: np.ndarray,
        which: np.ndarray,
        track: np.ndarray,
        nose: Places,
    ) -> dict[str, list]:
        """Return the columns about boxes, bots and other cars, in this order."""
        things, lines = world.obstacles, self._lines
        rows, count = len(where), things.x.shape[1] + self._others.shape[1]
        if not count:
            return _no_objects(rows)
        names = ("x", "y", "yaw", "velocity_x", "velocity_y", "s", "lateral")
        boxes = torch.stack([getattr(things, name) for name in names]).cpu().numpy()
        rivals = self._others[which]  # (num_rows, num_cars - 1)
        x, y, yaw, velocity_x, velocity_y, s, lateral = (
            np.concatenate([boxes[place][where], getattr(cars, name)[where[:, None], rivals]], 1)
            for place, name in enumerate(names)
        )  # (num_rows, count)
        wide = np.broadcast_to(track[:, None], s.shape)
        s = np.where(lines.closed[wide], np.mod(s, lines.length[wide]), s)
        nose_s = nose.s[:, None]
        ahead = lines.ahead(wide, s, nose_s)
        # On a loop everything is somewhere ahead; on a straight what is behind comes last.
        following = np.where(ahead > 0, ahead, np.inf).argmin(axis=1)
        behind = lines.ahead(wide, nose_s, s)
        behind = np.where(ahead == lines.length[wide], 0.0, behind)
        last = np.where(behind >= 0, behind, np.inf).argmin(axis=1)
        heading = yaw * _DEGREES
        half_length = np.full(s.shape, self._car.length / 2)
        half_width = np.full(s.shape, self._car.width / 2)
        boxed = things.x.shape[1]
        if boxed:
            half_length[:, :boxed] = things.half_length.cpu().numpy()[where]
            half_width[:, :boxed] = things.half_width.cpu().numpy()[where]
        pick = (np.arange(rows), following)
        in_camera = seen(
            *(getattr(cars, name)[where, which] for name in ("x", "y", "yaw")),
            *(one[pick] for one in (x, y, yaw, half_length, half_width)),
        )
        return {
            "closest_objects": np.stack([last, following], axis=1).tolist(),
            "object_in_camera": in_camera.tolist(),
            "objects_distance": s.tolist(),
            "objects_distance_from_center": np.abs(lateral).tolist(),
            "objects_heading": np.where(heading <= -180.0, 180.0, heading).tolist(),
            "objects_left_of_center": (lateral > 0).tolist(),
            "objects_location": np.stack([x, y], axis=2).tolist(),
            "objects_speed": np.sqrt(velocity_x**2 + velocity_y**2).tolist(),
        }


def _points(car: CarConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return nose and wheel centres in the body frame: ahead and to the left [m], (5,)."""
    half_base, half_track = car.wheelbase / 2, car.wheel_track / 2
    along = np.array([car.nose, half_base, half_base, -half_base, -half_base])
    return along, np.array([0.0, half_track, -half_track, half_track, -half_track])


def _on_road(wheels: Places, rows: int) -> dict[str, list]:
    on = (wheels.lateral <= wheels.left) & (wheels.lateral >= -wheels.right)
    on = np.reshape(on, (4, rows))
    return {
        "all_wheels_on_track": np.all(on, axis=0).tolist(),
        "is_offtrack": np.logical_not(np.any(on, axis=0)).tolist(),
    }


def _no_objects(rows: int) -> dict[str, list]:
    lists = [name for name in KEYS if name.startswith("objects_")]
    return {
        "closest_objects": [[0, 0] for _ in range(rows)],
        "object_in_camera": [False] * rows,
        **{name: [[] for _ in range(rows)] for name in lists},
    }
