"""Worlds on a wide open floor, for tests of the physics: the track is a ring far from the cars."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from league.sim import records
from league.sim.config import SimConfig
from league.sim.records import World
from league.track.track import Track, TrackSet
from tests.scenes import Stages, start, touch

WALL = 21.24
"""Distance of each wall from the middle [m]."""


@dataclass(frozen=True)
class Outcome:
    """What one control step of physics brought."""

    cars: np.ndarray
    """CAR records (num_worlds, num_cars)."""
    contacts: np.ndarray
    """CONTACT records (num_worlds, num_cars)."""


Physics = Callable[[World, np.ndarray], Outcome]


@lru_cache
def floor() -> TrackSet:
    turn = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring = Track(
        name="ring",
        title="Ring",
        center=20.0 * direction,
        left=19.6 * direction,
        right=(WALL - 0.84) * direction,
    )
    return TrackSet(ring)


def settings(num_cars: int = 1, **changes) -> SimConfig:
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    return SimConfig(kind=kind, num_cars=num_cars, **changes)


def world(sim: SimConfig, num_worlds: int = 1, **motion: list) -> World:
    """Cars at rest in the middle, heading along +x, but for the fields given.

    A field is a row of numbers, one for each car, or such a row for each world.
    """
    made = start(floor(), sim, list(range(num_worlds)))
    for name in ("x", "y", "yaw"):
        made.cars[name] = 0.0
    for name, rows in motion.items():
        made.cars[name] = rows
    return made


def with_obstacle(now: World, **fields: float) -> World:
    """Put one obstacle into every world."""
    obstacles = np.zeros((now.num_worlds, 1), records.OBSTACLE)
    for name, value in fields.items():
        obstacles[name] = value
    return World(now.worlds, now.cars, obstacles)


def slippery(now: World) -> World:
    """Take the tyres' grip away, so that only contacts change momentum."""
    now = now.copy()
    now.cars["grip"] = 1e-9
    return now


def control(now: World, steering: list, speed: list) -> np.ndarray:
    """One control for all cars, or one for each of a world, or a row for each world."""
    asked = np.zeros((*now.cars.shape, 2), np.float32)
    asked[..., 0], asked[..., 1] = steering, speed
    return asked


def drive(physics: Physics, now: World, asked: np.ndarray, steps: int) -> list[Outcome]:
    """Hold a control for some steps; return each step's Outcome."""
    outcomes = []
    for _ in range(steps):
        outcome = physics(now, asked)
        outcomes.append(outcome)
        now = later(now, outcome, asked)
    return outcomes


def later(now: World, outcome: Outcome, asked: np.ndarray) -> World:
    """Return the worlds after a step; the obstacles are where they were."""
    cars = outcome.cars.copy()
    cars["target_steering"], cars["target_speed"] = asked[..., 0], asked[..., 1]
    return World(now.worlds, cars, now.obstacles)


def make(name: str, sim: SimConfig, num_worlds: int = 1) -> Physics:
    """Return a control step of the solver of this name."""
    if name == "bullet":
        from league.sim.physics.bullet import BulletSolver

        return bullet(BulletSolver(sim, floor().rooms, num_worlds))
    stages = Stages(floor(), sim)

    def step(now: World, asked: np.ndarray) -> Outcome:
        after, contacts = stages.drive(now, asked)
        return Outcome(after.cars, contacts)

    return step


def bullet(solver) -> Physics:
    """Return a control step of a BulletSolver."""

    def step(now: World, asked: np.ndarray) -> Outcome:
        after, contacts = now.copy(), touch(now)
        solver.step(after, asked, contacts)
        return Outcome(after.cars, contacts)

    return step
