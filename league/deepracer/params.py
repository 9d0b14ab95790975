"""Situations: what the worlds look like to reward functions, one dict of 27 keys for each row.

All rows are worked out by compiled code and handed out as plain Python: floats, bools, ints, lists.
docs/rewards.md says what each key means.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from league.deepracer import params_kernels
from league.deepracer.waypoints import Lines
from league.errors import ConfigError
from league.sim.config import CameraConfig, CarConfig, SimConfig
from league.sim.world import World
from league.track.track import TrackSet

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


class Rows(NamedTuple):
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
        self._body = _body(sim.car, CameraConfig())
        self._memory: np.ndarray | None = None
        self._to_note = False
        self._known: TrackSet | None = None

    def restart(self, begun: np.ndarray) -> None:
        """Begin an episode for these cars, bool, (num_worlds, num_cars).

        Raises:
            ConfigError: a paid car that is not there.
        """
        if self._memory is None or self._memory.shape != begun.shape:
            self._memory = self._begun(*begun.shape)
        self._memory["steps"][begun] = 0
        self._memory["fresh"][begun] = True
        self._to_note = True

    def _begun(self, num_worlds: int, num_cars: int) -> np.ndarray:
        strangers = [car for car in self._cars if not 0 <= car < num_cars]
        if strangers:
            raise ConfigError(
                f"car {strangers[0]} is to be paid: there are {num_cars} cars, from 0"
            )
        memory = np.zeros((num_worlds, num_cars), dtype=params_kernels.MEMORY)
        memory["paid"][:, list(self._cars)] = True
        memory["fresh"] = True
        return memory

    def rows(self, tracks: TrackSet, before: World, world: World, verdicts: np.ndarray) -> Rows:
        """Return what each paid car is told of a step; cars that stand a penalty are left out.

        Args:
            tracks: the courses.
            before: the cars before the step.
            world: the worlds after it, before any penalty or restart moved a car.
            verdicts: VERDICT records of the step.
        """
        if tracks is not self._known:
            self._lines, self._known = Lines.of(tracks), tracks
        memory, lines = self._memory, self._lines
        assert memory is not None
        known = (lines.rows, lines.measures, self._body, memory)
        if self._to_note:
            self._to_note = params_kernels.note_starts(*known, before.cars, world.worlds)
        own, others = params_kernels.tell(
            *(*known, lines.places, before.cars, world.cars, world.obstacles, world.worlds),
            *(verdicts, self._step_dt),
        )
        told = own.tolist()
        return Rows(
            world=[int(row[params_kernels.WORLD]) for row in told],
            car=[int(row[params_kernels.CAR]) for row in told],
            params=[_params(lines, *row) for row in zip(told, others.tolist(), strict=True)],
        )


def _params(lines: Lines, own: list[float], others: list[list[float]]) -> Params:
    """Return what a car is told: of itself, and of boxes, bots and other cars, in this order."""
    # Unpacked in the order of telling's columns: looking each up by name takes twice as long.
    (_, _, steering, speed, x, y, heading, distance, projection, width, length, progress, sim_time,
     steps, is_left, all_on_road, none_on_road, crashed, track, behind, following, last_object,
     next_object, sees_next) = own  # fmt: skip
    objects_s, from_center, headings, speeds, objects_x, objects_y, on_left = others
    return {
        "all_wheels_on_track": all_on_road > 0,
        "closest_objects": [int(last_object), int(next_object)],
        "closest_waypoints": [int(behind), int(following)],
        "distance_from_center": distance,
        "heading": heading,
        "is_crashed": crashed > 0,
        "is_left_of_center": is_left > 0,
        "is_offtrack": none_on_road > 0,
        "is_reversed": lines.clockwise[int(track)],
        "object_in_camera": sees_next > 0,
        "objects_distance": objects_s,
        "objects_distance_from_center": from_center,
        "objects_heading": headings,
        "objects_left_of_center": list(map(bool, on_left)),
        "objects_location": list(map(list, zip(objects_x, objects_y, strict=True))),
        "objects_speed": speeds,
        "progress": progress,
        "projection_distance": projection,
        "sim_time": sim_time,
        "speed": speed,
        "steering_angle": steering,
        "steps": int(steps),
        "track_length": length,
        "track_width": width,
        "waypoints": lines.waypoints[int(track)][:],
        "x": x,
        "y": y,
    }


def _body(car: CarConfig, camera: CameraConfig) -> np.ndarray:
    body = np.zeros(1, dtype=params_kernels.BODY)
    body["nose"] = car.nose
    body["half_base"], body["half_track"] = car.wheelbase / 2, car.wheel_track / 2
    body["half_length"], body["half_width"] = car.length / 2, car.width / 2
    body["eye_forward"], body["eye_up"] = camera.forward, camera.up
    body["eye_dip"], body["eye_rise"] = math.cos(camera.pitch), math.sin(camera.pitch)
    body["eye_tan"] = math.tan(camera.field_of_view / 2)
    return body
