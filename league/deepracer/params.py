"""The `params` of reward functions: one dict of 27 keys for each paid car.

Compiled code computes all rows, which are then plain Python: floats, bools, ints, lists.
docs/rewards.md says what each key means.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from league.deepracer import params_kernels
from league.errors import ConfigError
from league.sim.config import CameraConfig, CarConfig, SimConfig
from league.sim.records import World
from league.track import spline
from league.track.track import Track, TrackSet

WAYPOINT_SPACING = 0.15
"""Wished distance between two waypoints [m]: the original's re:Invent 2018 has 119 on 17.7 m."""

KEYS = (
    "all_wheels_on_track", "closest_objects", "closest_waypoints", "distance_from_center",
    "heading", "is_crashed", "is_left_of_center", "is_offtrack", "is_reversed", "object_in_camera",
    "objects_distance", "objects_distance_from_center", "objects_heading", "objects_left_of_center",
    "objects_location", "objects_speed", "progress", "projection_distance", "sim_time", "speed",
    "steering_angle", "steps", "track_length", "track_width", "waypoints", "x", "y",
)  # fmt: skip
"""Every key of `params`, by name."""

Params = dict[str, object]
Point = tuple[float, float]


class ParamsBuilder:
    """Makes each paid car's params; remembers when and where its episode began.

    An episode begins at a restart, and with each lap: then `steps` counts from 1 and `progress`
    from 0 again.
    """

    def __init__(self, sim: SimConfig, cars: Sequence[int]) -> None:
        """Set up for the paid cars; `restart` fits the memory to the worlds."""
        self._step_dt, self._cars = sim.step_dt, tuple(cars)
        self._body = _body(sim.car, CameraConfig())
        self.memory = np.zeros((0, 0), params_kernels.MEMORY)  # (num_worlds, num_cars)

    def restart(self, begun: np.ndarray) -> None:
        """Begin an episode for these cars, bool, (num_worlds, num_cars).

        ConfigError if a paid car does not exist.
        """
        if self.memory.shape != begun.shape:
            missing = [car for car in self._cars if not 0 <= car < begun.shape[1]]
            if missing:
                raise ConfigError(
                    f"car {missing[0]} is to be paid: there are {begun.shape[1]} cars, from 0"
                )
            self.memory = np.zeros(begun.shape, params_kernels.MEMORY)
            self.memory["paid"][:, list(self._cars)] = True
            self.memory["fresh"] = True
        self.memory["steps"][begun] = 0
        self.memory["fresh"][begun] = True

    def rows(
        self, tracks: TrackSet, before: World, world: World, verdicts: np.ndarray
    ) -> list[tuple[int, int, Params]]:
        """Return world, car and params of each paid car; no two params share a list.

        Cars that stand a penalty or have finished are left out. The arguments are those of a
        Reward.
        """
        roads = Roads.of(tracks)
        own, objects = params_kernels.build(
            *(tracks.points, tracks.courses, roads.records, self._body, self.memory),
            *(roads.own_waypoints, before.cars, world.cars, world.obstacles, world.worlds),
            *(verdicts, self._step_dt),
        )
        return [_row(roads, *row) for row in zip(own.tolist(), objects.tolist(), strict=True)]


def _row(roads: Roads, own: list[float], objects: list[list[float]]) -> tuple[int, int, Params]:
    """Return world, car and params, from the columns and rows of `params_kernels.build`."""
    # Unpacked in the order of the columns: looking each up by name takes twice as long.
    (world, car, steering, speed, x, y, heading, distance, projection, width, length, progress,
     sim_time, steps, is_left, all_on_road, none_on_road, crashed, track, behind, following,
     last_object, next_object, sees_next) = own  # fmt: skip
    objects_s, from_center, headings, speeds, objects_x, objects_y, on_left = objects
    params: Params = {
        "all_wheels_on_track": all_on_road > 0,
        "closest_objects": [int(last_object), int(next_object)],
        "closest_waypoints": [int(behind), int(following)],
        "distance_from_center": distance,
        "heading": heading,
        "is_crashed": crashed > 0,
        "is_left_of_center": is_left > 0,
        "is_offtrack": none_on_road > 0,
        "is_reversed": roads.clockwise[int(track)],
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
        "waypoints": roads.waypoints[int(track)][:],
        "x": x,
        "y": y,
    }
    return int(world), int(car), params


@dataclass(frozen=True, eq=False)
class Roads:
    """A TrackSet as reward functions see it; arrays have one entry for each track.

    A track's own waypoints are kept as they are; others are spaced evenly along the centreline.
    """

    records: np.ndarray  # ROAD of each track.
    own_waypoints: np.ndarray  # Of the tracks that have their own [m], one after another, (n, 2).
    clockwise: list[bool]  # Whether each is driven clockwise.
    waypoints: tuple[list[Point], ...]
    """Each track's, in driving order; closed tracks repeat the first point as the last. A reward
    function gets a copy of the list; its points are tuples, which it cannot change."""

    @classmethod
    @lru_cache(maxsize=8)
    def of(cls, tracks: TrackSet) -> Roads:
        """Make the tables, once for tracks in use."""
        records = np.zeros(len(tracks.courses), dtype=params_kernels.ROAD)
        waypoints = tuple(_waypoints(track) for track in tracks.tracks)
        records["steps"] = [len(points) - 1 for points in waypoints]
        none = np.empty((0, 2))
        own = [none if one.waypoints is None else one.waypoints for one in tracks.tracks]
        count = np.array([len(each) for each in own])
        records["first_waypoint"] = np.where(count > 0, np.cumsum(count) - count, -1)
        return cls(
            records=records,
            own_waypoints=np.concatenate(own).astype(np.float64),
            clockwise=[track.direction == "clockwise" for track in tracks.tracks],
            waypoints=waypoints,
        )


def _waypoints(track: Track) -> list[Point]:
    if track.waypoints is not None:
        return [(x, y) for x, y in track.waypoints.tolist()]
    points = np.vstack([track.center, track.center[:1]]) if track.closed else track.center
    along, steps = spline.travelled(points), max(round(track.length / WAYPOINT_SPACING), 3)
    places = np.linspace(0.0, along[-1], steps + 1)
    x, y = (np.interp(places, along, points[:, axis]).tolist() for axis in (0, 1))
    line = list(zip(x, y, strict=True))
    return [*line[:-1], line[0]] if track.closed else line


def _body(car: CarConfig, camera: CameraConfig) -> np.ndarray:
    half_sizes = (one / 2 for one in (car.wheelbase, car.wheel_track, car.length, car.width))
    dip, rise = math.cos(camera.pitch), math.sin(camera.pitch)
    eye = camera.forward, camera.up, dip, rise, math.tan(camera.field_of_view / 2)
    return np.array([(car.nose, *half_sizes, *eye)], dtype=params_kernels.BODY)
