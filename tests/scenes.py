"""Small real worlds for all tests, made of few numbers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from league.envs import episodes, rewards, scenarios
from league.envs import step as stages
from league.envs.config import EnvConfig, Scenarios
from league.envs.race_env import RaceEnv
from league.envs.state import INDEX
from league.sim import records
from league.sim.config import (
    CameraConfig,
    CarConfig,
    ContactConfig,
    DynamicsRandomization,
    LidarConfig,
    ObstacleConfig,
    RaceRules,
    SensorConfig,
    SimConfig,
    VisualRandomization,
)
from league.sim.physics import planar
from league.sim.records import World
from league.sim.settings import settings
from league.track.track import Track, TrackSet

SETTINGS = (
    CameraConfig, CarConfig, ContactConfig, LidarConfig, VisualRandomization, ObstacleConfig,
    RaceRules, Scenarios, SensorConfig, SimConfig, DynamicsRandomization,
)  # fmt: skip
"""All classes of settings of a world."""
MOTION = ["x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate", "steering"]
"""Fields of a car's movement in the plane."""
RING_LENGTH = 12.0
"""Length of the ring: 240 points, 5 cm apart."""


def make_ring(*, clockwise: bool = False, width: float = 0.8, points: int = 240) -> Track:
    """Return a circle with a centreline of points * 5 cm, starting at (0, 0) heading +x."""
    radius = 0.025 / math.sin(math.pi / points)
    turn = 2 * math.pi * np.arange(points) / points
    side = -1.0 if clockwise else 1.0
    normal = np.stack([-np.sin(turn), side * np.cos(turn)], axis=1)  # towards the middle
    center = np.array([0.0, side * radius]) - radius * normal
    inner, outer = center + 0.5 * width * normal, center - 0.5 * width * normal
    left, right = (outer, inner) if clockwise else (inner, outer)
    return Track(name="ring", title="Ring", center=center, left=left, right=right)


def make_straight(*, length: float = 10.0, width: float = 0.8) -> Track:
    """Return an open track from (0, 0) along +x."""
    x = np.linspace(0.0, length, round(length / 0.05) + 1)
    center = np.stack([x, np.zeros_like(x)], axis=1)
    side = np.array([0.0, 0.5 * width])
    return Track(
        name="straight",
        title="Straight",
        center=center,
        left=center + side,
        right=center - side,
        closed=False,
    )


def make_square(*, side: float = 3.0, corner: float = 0.8, width: float = 0.8) -> Track:
    """Return a square with round corners, driven counter-clockwise from (0, 0) heading +x."""
    quarter = np.linspace(0.0, math.pi / 2, 60, endpoint=False)
    arc = corner * np.stack([np.sin(quarter), 1 - np.cos(quarter)], axis=1)
    line = np.stack([np.linspace(0.0, side, 80, endpoint=False), np.zeros(80)], axis=1)
    leg = np.concatenate([line, arc + np.array([side, 0.0])])
    legs, corner_at = [], np.zeros(2)
    for number in range(4):
        cos, sin = round(math.cos(number * math.pi / 2)), round(math.sin(number * math.pi / 2))
        turn = np.array([[cos, sin], [-sin, cos]])
        legs.append(leg @ turn + corner_at)
        corner_at = corner_at + np.array([side + corner, corner]) @ turn
    return _resampled("square", np.concatenate(legs), width)


def _resampled(name: str, outline: np.ndarray, width: float) -> Track:
    closed = np.vstack([outline, outline[:1]])
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1))])
    wanted = np.linspace(0.0, length[-1], round(length[-1] / 0.05), endpoint=False)
    center = np.stack([np.interp(wanted, length, closed[:, k]) for k in (0, 1)], axis=1)
    bare = Track(name=name, title=name, center=center, left=center, right=center)
    normal = np.stack([-bare.tangent[:, 1], bare.tangent[:, 0]], axis=1)
    return replace(bare, left=center + normal * width / 2, right=center - normal * width / 2)


def start(tracks: TrackSet, sim: SimConfig, seeds: list[int]) -> World:
    """Return worlds on the starting grid."""
    env = RaceEnv(tracks, EnvConfig(sim=sim), num_worlds=len(seeds))
    env.reset(seeds=seeds, track_index=[0] * len(seeds))
    return env.world.copy()


def put_cars(
    tracks: TrackSet,
    sim: SimConfig,
    places: list[tuple[float, float]],
    *,
    num_worlds: int = 1,
    speed: float = 1.0,
    step: int = 0,
) -> World:
    """Return worlds with each car at (distance along the track, lateral), heading along it."""
    world = start(tracks, sim, list(range(1, num_worlds + 1)))
    distance = np.array([[s for s, _ in places]] * num_worlds, np.float32)
    world = go_to(tracks, world, places, speed=speed)
    cars = world.cars
    cars["s"] = tracks.at(world.track, distance).s
    cars["lateral"] = [across for _, across in places]
    cars["distance"] = cars["best_distance"] = distance
    cars["laps"] = np.maximum(np.floor(distance / RING_LENGTH), 0)
    ahead = distance[:, :, None] > distance[:, None, :]
    cars["ahead"] = (ahead << np.arange(len(places))).sum(axis=2)
    world.worlds["leader"] = ahead.sum(axis=2).argmax(axis=1)
    world.worlds["step"] = step
    return world


def stand(
    tracks: TrackSet,
    cars: np.ndarray | np.void,
    s: float,
    lateral: float = 0.0,
    *,
    turn: float = 0.0,
) -> None:
    """Put one or several cars at rest somewhere on the first track, turned from its direction."""
    frame = tracks.at(np.zeros(1, np.int64), np.array([s], np.float32))
    x, y, cos, sin = frame.x[0], frame.y[0], frame.cos[0], frame.sin[0]
    cars["s"], cars["lateral"] = frame.s[0], lateral
    cars["x"], cars["y"] = x - sin * lateral, y + cos * lateral
    cars["yaw"] = np.arctan2(sin, cos) + turn
    for name in ("velocity_x", "velocity_y", "yaw_rate"):
        cars[name] = 0.0


def go_to(
    tracks: TrackSet, world: World, places: list[tuple[float, float]], *, speed: float = 1.0
) -> World:
    """Return the worlds one step later, physics having brought the cars there; the book is old."""
    world = world.copy()
    distance = np.array([[s for s, _ in places]] * world.num_worlds, np.float32)
    lateral = np.array([across for _, across in places], np.float32)
    frame, cars = tracks.at(world.track, distance), world.cars
    cars["x"], cars["y"] = frame.x - frame.sin * lateral, frame.y + frame.cos * lateral
    cars["yaw"] = np.arctan2(frame.sin, frame.cos)
    cars["velocity_x"], cars["velocity_y"] = frame.cos * speed, frame.sin * speed
    world.worlds["step"] += 1
    return world


def touch(
    world: World,
    *pairs: tuple[int, int],
    obstacles: tuple[tuple[int, int], ...] = (),
) -> np.ndarray:
    """Return contacts between these pairs of cars, and of these (car, obstacle), in all worlds."""
    contacts = np.zeros(world.cars.shape, records.CONTACT)
    for one, other in pairs:
        contacts["cars"][:, one] |= 1 << other
        contacts["cars"][:, other] |= 1 << one
    for car, thing in obstacles:
        contacts["obstacles"][:, car] |= 1 << thing
    return contacts


class Stages:
    """The stages of a step, each by itself; they take worlds and return changed copies."""

    def __init__(self, tracks: TrackSet, sim: SimConfig, *, training: bool = False) -> None:
        cfg = EnvConfig(sim=sim, mode="training" if training else "race")
        self._rules = settings(sim), episodes.settings(cfg)
        places = np.array(sim.obstacles.places, np.float32).reshape(-1, 2)
        self._course = tracks.points, tracks.courses, places, planar.schedule(sim.num_cars)

    def aim(self, world: World) -> tuple[World, World]:
        """Return the worlds with the velocity of each bot car, and with the bots at their goals."""
        moving, arrivals = world.copy(), world.obstacles.copy()
        self._run(stages.PREPARE, moving, arrivals=arrivals)
        return moving, World(world.worlds, world.cars, arrivals)

    def drive(self, world: World, controls: np.ndarray) -> tuple[World, np.ndarray]:
        """Return the worlds after the planar physics, and the contacts.

        Args:
            world: before the step.
            controls: target steering [rad] and speed [m/s], float32 (num_worlds, num_cars, 2).
        """
        after, contacts = world.copy(), touch(world)
        self._run(stages.PHYSICS, after, controls=controls, contacts=contacts)
        return after, contacts

    def judge(
        self, before: World, after: World, contacts: np.ndarray | None = None
    ) -> tuple[np.ndarray, World]:
        """Return the verdicts, and the worlds with the book of this step.

        Args:
            before: the worlds before the step.
            after: the worlds after physics, with the old book.
            contacts: what touched what; None: nothing.
        """
        after, verdicts = after.copy(), np.zeros(before.cars.shape, records.VERDICT)
        after.worlds["step"] = before.worlds["step"]
        contacts = touch(after) if contacts is None else contacts
        self._run(
            stages.JUDGE, after, before=before.cars.copy(), contacts=contacts, verdicts=verdicts
        )
        return verdicts, after

    def settle(self, world: World, verdicts: np.ndarray) -> World:
        """Return the worlds after penalties, or in training after new episodes began."""
        world = world.copy()
        self._run(stages.SETTLE, world, verdicts=verdicts)
        return world

    def motions(self, world: World) -> np.ndarray:
        """Return the `motion` group of every car, float32 (num_cars, num_worlds, 5)."""
        out = np.empty((world.num_cars, world.num_worlds, 5), np.float32)
        self._run(stages.SETTLE, world.copy(), motions=out)
        return out

    def _run(self, phase: int, world: World, **given: np.ndarray) -> None:
        cars, shape = world.cars, world.cars.shape
        arrays = {
            "actions": np.stack([cars["action_steering"], cars["action_speed"]], axis=-1),
            "cars": cars,
            "before": cars.copy(),
            "obstacles": world.obstacles,
            "arrivals": world.obstacles.copy(),
            "worlds": world.worlds,
            "controls": np.stack([cars["target_steering"], cars["target_speed"]], axis=-1),
            "contacts": touch(world),
            "verdicts": np.zeros(shape, records.VERDICT),
            "outcomes": np.zeros(shape, stages.OUTCOME),
            "encounters": np.zeros(shape[0], scenarios.ENCOUNTER),
            "terms": np.zeros((*shape, len(rewards.TERMS)), np.float32),
            "motions": np.zeros((shape[1], shape[0], 5), np.float32),
            "weight": np.zeros(0, np.float32),
        }
        inputs = *(arrays | given).values(), *self._course, *self._rules
        assert stages.step(0, shape[0], phase, *inputs) == stages.FINE


def taken(groups_of_cars: Iterable[Mapping[str, np.ndarray]]) -> list[dict[str, np.ndarray]]:
    """Return copies of each car's groups, which the next step does not overwrite."""
    return [{name: np.array(group) for name, group in groups.items()} for groups in groups_of_cars]


def follow_center(
    groups: Mapping[str, np.ndarray], speed: float = 1.5, lateral: float = 0.0
) -> np.ndarray:
    """Return actions that follow the centreline, or a line next to it: a driver for tests."""
    state = groups["state"]
    error = 1.5 * (state[:, INDEX["lateral"]] - lateral) + 2.5 * state[:, INDEX["heading_error"]]
    steering = np.arctan(0.164 * (state[:, INDEX["curvature_0.25m"]] - error)) / 0.5236
    share = np.full_like(steering, (speed - 0.1) / 3.9 * 2 - 1)
    return np.stack([steering.clip(-1, 1), share], axis=1).astype(np.float32)


def assert_same(one: object, other: object, where: str = "") -> None:
    """Fail unless the two are equal to the last bit, field by field."""
    if isinstance(one, np.ndarray):
        assert isinstance(other, np.ndarray), where
        assert one.dtype == other.dtype, where
        for name in one.dtype.names or ():
            assert np.array_equal(one[name], other[name], equal_nan=True), f"{where}.{name}"
        if not one.dtype.names:
            assert np.array_equal(one, other), where
    elif isinstance(one, Mapping):
        assert isinstance(other, Mapping)
        assert list(one) == list(other)
        for name in one:
            assert_same(one[name], other[name], f"{where}.{name}")
    elif isinstance(one, tuple | list):
        assert isinstance(other, tuple | list)
        assert len(one) == len(other), where
        for number, (mine, its) in enumerate(zip(one, other, strict=True)):
            assert_same(mine, its, f"{where}[{number}]")
    else:
        for name in one.__dataclass_fields__:  # pyright: ignore[reportAttributeAccessIssue]
            assert_same(getattr(one, name), getattr(other, name), f"{where}.{name}")
