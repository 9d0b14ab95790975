"""Cars alone with a solver of Bullet on a wide floor, for tests of the physics."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from league.sim import records
from league.sim.config import SimConfig
from league.sim.physics.bullet import BulletSolver

WALL = 20.0
"""Distance of each wall from the middle [m]."""
ROOM = np.array([[-WALL, -WALL, WALL, WALL]])


@dataclass
class Floor:
    """Worlds of one kind on an empty floor, stepped by Bullet and nothing else."""

    sim: SimConfig
    num_worlds: int = 1
    num_obstacles: int = 0
    touched: np.ndarray = field(init=False)
    """CONTACT records of the last step."""

    def __post_init__(self) -> None:
        shape = (self.num_worlds, self.sim.num_cars)
        self.cars = np.zeros(shape, records.CAR)
        self.cars["grip"], self.cars["mass"] = self.sim.car.grip, self.sim.car.mass
        self.obstacles = np.zeros((self.num_worlds, self.num_obstacles), records.OBSTACLE)
        self.worlds = np.zeros(self.num_worlds, records.WORLD)
        self.touched = np.zeros(shape, records.CONTACT)
        self.solver = BulletSolver(self.sim, ROOM, self.num_worlds)

    def put(self, **fields: Any) -> Floor:
        """Set fields of the cars; return the floor."""
        for name, value in fields.items():
            self.cars[name] = value
        return self

    def drive(self, steps: int, steering: Any = 0.0, speed: Any = 0.0) -> np.ndarray:
        """Hold a control for some steps; return the cars after each, (steps, worlds, cars)."""
        controls = np.zeros((*self.cars.shape, 2), np.float32)
        controls[..., 0], controls[..., 1] = steering, speed
        seen, notes = [], []
        world = records.World(self.worlds, self.cars, self.obstacles)
        for _ in range(steps):
            self.solver.step(world, controls, self.touched)
            self.cars["target_steering"] = controls[..., 0]
            self.cars["target_speed"] = controls[..., 1]
            seen.append(self.cars.copy())
            notes.append(self.touched.copy())
        self.notes = np.array(notes)
        return np.array(seen)


def settings(num_cars: int = 1, **changes: Any) -> SimConfig:
    """Return the settings of a race of some cars."""
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    return SimConfig(kind=kind, num_cars=num_cars, **changes)
