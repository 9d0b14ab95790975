"""Situations: what the worlds look like to reward functions, one dict of 27 keys for each row.

All rows are worked out by compiled code and handed out as plain Python: floats, bools, ints, lists.
The meaning of each key is told in docs/rewards.md; sources: facts sections 1.2 and 11.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from league.envs.deepracer import telling
from league.envs.deepracer.lines import Lines
from league.errors import ConfigError
from league.sim.config import CameraConfig, CarConfig, SimConfig
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
_OF_OBJECTS = tuple(name for name in KEYS if name.startswith("objects_"))


@dataclass(frozen=True)
class Rows:
    """Some cars of some worlds, and what each is told."""

    world: list[int]
    """World of each row."""
    car: list[int]
    """Car of each row."""
    params: list[Params]
    """What each row's function is called with; nobody else holds any list in it."""


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
        self._step_dt, self._cars = sim.step_dt, tuple(cars)
        self._body, self._eye = _body(sim.car), _eye(CameraConfig())
        self._memory: telling.Memory | None = None
        self._known: TrackSet | None = None

    def restart(self, who: Tensor) -> None:
        """Begin an episode for these cars, bool, (num_worlds, num_cars).

        Raises:
            ConfigError: a paid car that is not there.
        """
        begun = who.cpu().numpy()
        if self._memory is None or self._memory.steps.shape != begun.shape:
            self._memory = self._begun(*begun.shape)
        self._memory.steps[begun] = 0
        self._memory.fresh[begun] = True

    def _begun(self, num_worlds: int, num_cars: int) -> telling.Memory:
        strangers = [car for car in self._cars if not 0 <= car < num_cars]
        if strangers:
            raise ConfigError(
                f"car {strangers[0]} is to be paid: there are {num_cars} cars, from 0"
            )
        shape = (num_worlds, num_cars)
        self._paid = np.zeros(shape, dtype=bool)
        self._paid[:, list(self._cars)] = True
        return telling.Memory(
            steps=np.zeros(shape, dtype=np.int64),
            fresh=np.ones(shape, dtype=bool),
            lead=np.zeros(shape),
            start=np.zeros(shape),
        )

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
        memory, lines, body = self._memory, self._lines, self._body
        assert memory is not None
        book, track = before.standing, _array(world.track)
        asked = telling.whom_to_tell(self._paid, _array(book.penalty_s), _array(book.finish_s))
        if not len(asked):
            return Rows([], [], [])
        if memory.fresh.any():
            telling.note_starts(lines.courses, body, memory, _cars(before), track, asked)
        cars, clock = _cars(world), _array(world.step) * self._step_dt
        own = telling.tell_of_itself(
            *(lines.courses, body, memory, cars, track),
            *(_array(book.laps), _array(verdict.lap), _array(verdict.crashed), clock, asked),
        )
        told = zip(own.tolist(), self._objects(world, cars, track, own, asked), strict=True)
        params = [_params(lines, *row) for row in told]
        return Rows(asked[:, 0].tolist(), asked[:, 1].tolist(), params)

    def _objects(
        self, world: World, cars: np.ndarray, track: np.ndarray, own: np.ndarray, asked: np.ndarray
    ) -> list[Params]:
        """Return what each row is told of boxes, bots and other cars, in this order."""
        if world.obstacles.x.shape[1] + cars.shape[2] == 1:
            return [_no_objects() for _ in asked]
        nose = own[:, telling.PROJECTION].copy()
        told, place, left, closest, seen = telling.tell_of_objects(
            *(self._lines.courses, self._body, self._eye, cars),
            *(_obstacles(world), track, nose, asked),
        )
        rows = (told.tolist(), place.tolist(), left.tolist(), closest.tolist(), seen.tolist())
        return [
            {
                "closest_objects": last_and_next,
                "object_in_camera": in_picture,
                "objects_distance": s,
                "objects_distance_from_center": distance,
                "objects_heading": heading,
                "objects_left_of_center": on_left,
                "objects_location": where,
                "objects_speed": speed,
            }
            for (s, distance, heading, speed), where, on_left, last_and_next, in_picture in zip(
                *rows, strict=True
            )
        ]


def _params(lines: Lines, own: list[float], objects: Params) -> Params:
    """Return what a car is told, of itself and of objects."""
    track = int(own[telling.TRACK])
    return {
        "all_wheels_on_track": own[telling.ALL_ON_ROAD] > 0,
        "closest_waypoints": [int(own[telling.BEHIND]), int(own[telling.FOLLOWING])],
        "distance_from_center": own[telling.DISTANCE],
        "heading": own[telling.HEADING],
        "is_crashed": own[telling.CRASHED] > 0,
        "is_left_of_center": own[telling.IS_LEFT] > 0,
        "is_offtrack": own[telling.NONE_ON_ROAD] > 0,
        "is_reversed": lines.clockwise[track],
        "progress": own[telling.PROGRESS],
        "projection_distance": own[telling.PROJECTION],
        "sim_time": own[telling.SIM_TIME],
        "speed": own[telling.SPEED],
        "steering_angle": own[telling.STEERING],
        "steps": int(own[telling.STEPS]),
        "track_length": own[telling.LENGTH],
        "track_width": own[telling.WIDTH],
        "waypoints": lines.waypoints[track][:],
        "x": own[telling.X],
        "y": own[telling.Y],
        **objects,
    }


def _no_objects() -> Params:
    return {
        "closest_objects": [0, 0],
        "object_in_camera": False,
        **{name: [] for name in _OF_OBJECTS},
    }


def _array(values: Tensor) -> np.ndarray:
    return values.cpu().numpy()


def _cars(world: World) -> np.ndarray:
    """Return the table of all cars, as compiled code takes it."""
    body, book, asked = world.motion, world.standing, world.control
    return _table(
        *(body.x, body.y, body.yaw, body.velocity_x, body.velocity_y, book.s, book.lateral),
        *(book.distance, asked.steering, asked.speed),
    )


def _obstacles(world: World) -> np.ndarray:
    """Return the table of all obstacles, as compiled code takes it."""
    box = world.obstacles
    return _table(
        *(box.x, box.y, box.yaw, box.velocity_x, box.velocity_y, box.s, box.lateral),
        *(box.half_length, box.half_width),
    )


def _table(*rows: Tensor) -> np.ndarray:
    # Stacked first, so that a GPU is asked once.
    return torch.stack(rows).cpu().numpy().astype(np.float64)


def _body(car: CarConfig) -> telling.Body:
    return telling.Body(
        nose=car.nose,
        half_base=car.wheelbase / 2,
        half_track=car.wheel_track / 2,
        half_length=car.length / 2,
        half_width=car.width / 2,
    )


def _eye(camera: CameraConfig) -> telling.Eye:
    return telling.Eye(
        forward=camera.forward,
        up=camera.up,
        dip=math.cos(camera.pitch),
        rise=math.sin(camera.pitch),
        tan=math.tan(camera.field_of_view / 2),
    )
