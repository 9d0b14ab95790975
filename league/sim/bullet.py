"""BulletSolver: the same pushes on rigid bodies in PyBullet, contacts by Bullet.

Each world is a simulation of its own, without gravity and without ground: cars are upright boxes
that nothing can tip. The records are the truth: every control step starts from them.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false

from __future__ import annotations

import contextlib
import importlib
import math
import os
import sys
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np

from league.errors import ConfigError
from league.jit import compiled
from league.portable_math import heading_of, wrap_angle
from league.sim.config import SimConfig
from league.sim.settings import settings
from league.sim.vehicle import frozen, late_steps, push
from league.sim.world import is_frozen

MAX_WORLDS = 1000
"""PyBullet keeps at most 1,024 simulations in a process."""
HALF_HEIGHT = 2.0
"""Half the height of every box [m]: far more than its sides, so that overlap never ends upwards."""
HEAVY = 1e7
"""Mass of what moves and cannot be pushed [kg]: Bullet takes a body of mass 0 to be standing."""
HALF_WALL = 5.0
"""Half the thickness of a wall [m]."""
ITERATIONS = 20
"""Rounds of Bullet's impulse solver in a physics step."""
RESTITUTION_FROM = 0.05
"""Slowest approach that bounces [m/s]."""

_CAR, _OBSTACLE, _WALL, _GHOST = 1, 2, 4, 8
_MEETS = {_CAR: _CAR | _OBSTACLE | _WALL, _OBSTACLE: _CAR, _WALL: _CAR | _GHOST, _GHOST: _WALL}


def _load_pybullet() -> ModuleType:
    """Import PyBullet without the line that it writes to stderr, from C, when it is loaded."""
    if "pybullet" in sys.modules:
        return sys.modules["pybullet"]
    sys.stderr.flush()
    kept, null = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(null, 2)
        return importlib.import_module("pybullet")
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(null)


pybullet = _load_pybullet()


@compiled
def _pushes(cars, controls, sim, k, out):  # noqa: ANN001, ANN202
    """Turn every car's wheels by one physics step, and write the force and torque on it.

    Args:
        cars: CAR records (num_worlds, num_cars).
        controls: target steering [rad] and speed [m/s], float32 (num_worlds, num_cars, 2).
        sim: SETTINGS record, shape (1,).
        k: number of the physics step in its control step.
        out: force along x and y [N] and torque [N m], float64 (num_worlds, num_cars, 3).
    """
    for w in range(cars.shape[0]):
        for c in range(cars.shape[1]):
            car = cars[w, c]
            if frozen(car):
                continue
            late = late_steps(car, sim[0]) > k
            steering = car.target_steering if late else controls[w, c, 0]
            speed = car.target_speed if late else controls[w, c, 1]
            acting = push(car, sim[0], steering, speed)
            out[w, c, 0], out[w, c, 1] = acting.force_x, acting.force_y
            out[w, c, 2] = acting.torque
            car.steering = acting.steering


@compiled
def _read_back(cars, bodies):  # noqa: ANN001, ANN202
    """Write where Bullet's bodies are into the records.

    Args:
        cars: CAR records (num_worlds, num_cars).
        bodies: x, y, z and w of the quaternion, velocity along x and y, yaw rate, float64
            (num_worlds, num_cars, 7).
    """
    for w in range(cars.shape[0]):
        for c in range(cars.shape[1]):
            car, body = cars[w, c], bodies[w, c]
            if frozen(car):
                continue
            car.x, car.y = np.float32(body[0]), np.float32(body[1])
            half = heading_of(np.float32(body[3]), np.float32(body[2]))
            car.yaw = wrap_angle(np.float32(2.0) * half)
            car.velocity_x, car.velocity_y = np.float32(body[4]), np.float32(body[5])
            car.yaw_rate = np.float32(body[6])


@dataclass(frozen=True)
class _Body:
    """A box to build."""

    half_length: float
    half_width: float
    mass: float
    inertia: float


@dataclass(frozen=True)
class _Plan:
    """What a world's bodies are built from; another plan, other bodies."""

    track: int
    masses: list[float]
    held: list[bool]
    """Cars that stand frozen without being ghosts: nothing can push them."""
    sizes: list[list[float]]
    """Half length and half width of each obstacle [m]."""


@dataclass(frozen=True)
class _Stage:
    """One world's bodies, and what they were built from."""

    plan: _Plan
    cars: list[int]
    obstacles: list[int]
    ghosts: list[bool]


class BulletSolver:
    """Integrates each world in a Bullet simulation of its own."""

    def __init__(self, cfg: SimConfig, rooms: np.ndarray, num_worlds: int) -> None:
        """Connect to Bullet.

        Args:
            cfg: settings.
            rooms: walls of each track, x_min, y_min, x_max, y_max [m], (num_tracks, 4).
            num_worlds: races in the batch.

        Raises:
            ConfigError: more worlds than Bullet keeps.
        """
        self._clients: list[int] = []
        if num_worlds > MAX_WORLDS:
            raise ConfigError(
                f"{num_worlds} worlds are too many for the bullet solver: "
                f"give at most {MAX_WORLDS}, or choose the planar solver"
            )
        self.cfg, self._rooms, self._settings = cfg, rooms.tolist(), settings(cfg)
        self._stages: list[_Stage | None] = [None] * num_worlds
        for _ in range(num_worlds):
            client = pybullet.connect(pybullet.DIRECT)
            if client < 0:
                self.close()
                raise ConfigError(
                    f"PyBullet refused simulation {len(self._clients) + 1} of {num_worlds}: close "
                    "other environments of this process, or choose the planar solver"
                )
            self._clients.append(client)

    def step(
        self,
        cars: np.ndarray,
        obstacles: np.ndarray,
        worlds: np.ndarray,
        controls: np.ndarray,
        contacts: np.ndarray,
    ) -> None:
        """Move the cars through one control step, and note what touched what; see planar.py.

        Args:
            cars: CAR records (num_worlds, num_cars); their motion is changed.
            obstacles: OBSTACLE records (num_worlds, num_obstacles).
            worlds: WORLD records (num_worlds,).
            controls: target steering [rad] and speed [m/s], (num_worlds, num_cars, 2).
            contacts: CONTACT records (num_worlds, num_cars); overwritten.
        """
        held = is_frozen(cars)
        for name in ("velocity_x", "velocity_y", "yaw_rate"):
            cars[name][held] = 0.0
        stages = self._set(cars, obstacles, worlds, held)
        contacts["cars"], contacts["obstacles"], contacts["wall"] = 0, 0, False
        pushes = np.zeros((*cars.shape, 3))
        bodies = np.zeros((*cars.shape, 7))
        free = [np.flatnonzero(~row).tolist() for row in held]
        for k in range(self.cfg.decimation):
            _pushes(cars, controls, self._settings, k, pushes)
            loads: Any = pushes.tolist()
            for index, stage in enumerate(stages):
                client = self._clients[index]
                for car in free[index]:
                    _push(client, stage.cars[car], loads[index][car])
                pybullet.stepSimulation(physicsClientId=client)
                points = pybullet.getContactPoints(physicsClientId=client)
                _note(stage, points, contacts[index])
                for car in free[index]:
                    bodies[index, car] = _state(client, stage.cars[car])
            _read_back(cars, bodies)

    def reset(self, worlds: list[int] | None = None) -> None:
        """Tear these worlds down (None: all); the next step builds them again."""
        for index in range(len(self._stages)) if worlds is None else worlds:
            self._stages[index] = None

    def close(self) -> None:
        """Disconnect from Bullet."""
        while self._clients:
            # At the interpreter's end PyBullet may have gone first.
            with contextlib.suppress(pybullet.error):
                pybullet.disconnect(physicsClientId=self._clients.pop())

    def __del__(self) -> None:
        self.close()

    def _set(
        self, cars: np.ndarray, obstacles: np.ndarray, worlds: np.ndarray, frozen: np.ndarray
    ) -> list[_Stage]:
        """Build what changed in kind, and put every body where the records say."""
        ghosts = cars["ghost"].tolist()
        held = (frozen & ~cars["ghost"]).tolist()
        mass, track = cars["mass"].tolist(), worlds["track"].tolist()
        sizes = _rows(obstacles, "half_length", "half_width")
        moving = _rows(obstacles, "x", "y", "yaw", "velocity_x", "velocity_y")
        driven = _rows(cars, "x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate")
        stages = []
        for index, client in enumerate(self._clients):
            plan = _Plan(track[index], mass[index], held[index], sizes[index])
            stage = self._stages[index]
            if stage is None or stage.plan != plan:
                stage = self._build(client, plan)
            stage = _filter(client, stage, ghosts[index])
            for body, state in zip(stage.cars, driven[index], strict=True):
                _place(client, body, state)
            for body, state in zip(stage.obstacles, moving[index], strict=True):
                _place(client, body, [*state, 0.0])
            self._stages[index] = stage
            stages.append(stage)
        return stages

    def _build(self, client: int, plan: _Plan) -> _Stage:
        pybullet.resetSimulation(physicsClientId=client)
        pybullet.setGravity(0, 0, 0, physicsClientId=client)
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=self.cfg.physics_dt,
            numSolverIterations=ITERATIONS,
            restitutionVelocityThreshold=RESTITUTION_FROM,
            # Overlap is pushed apart without adding speed.
            useSplitImpulse=1,
            splitImpulsePenetrationThreshold=0.0,
            physicsClientId=client,
        )
        car = self.cfg.car
        cars, obstacles = [], []
        for mass, held in zip(plan.masses, plan.held, strict=True):
            inertia = mass * (car.yaw_inertia / car.mass)
            weight = (HEAVY, HEAVY) if held else (mass, inertia)
            cars.append(self._box(client, len(cars), _Body(car.length / 2, car.width / 2, *weight)))
        for half_length, half_width in plan.sizes:
            place = len(cars) + len(obstacles)
            body = _Body(half_length, half_width, HEAVY, HEAVY)
            obstacles.append(self._box(client, place, body, _OBSTACLE))
        # Bullet takes a body's new inertia into use when it moves it.
        pybullet.stepSimulation(physicsClientId=client)
        self._build_walls(client, *self._rooms[plan.track])
        return _Stage(plan, cars, obstacles, [False] * len(cars))

    def _build_walls(
        self, client: int, x_min: float, y_min: float, x_max: float, y_max: float
    ) -> None:
        half_x, half_y = (x_max - x_min) / 2 + 2 * HALF_WALL, (y_max - y_min) / 2
        mid_x, mid_y = (x_min + x_max) / 2, (y_min + y_max) / 2
        boxes = (
            (x_max + HALF_WALL, mid_y, HALF_WALL, half_y),
            (x_min - HALF_WALL, mid_y, HALF_WALL, half_y),
            (mid_x, y_max + HALF_WALL, half_x, HALF_WALL),
            (mid_x, y_min - HALF_WALL, half_x, HALF_WALL),
        )
        for x, y, half_length, half_width in boxes:
            wall = self._box(client, 0, _Body(half_length, half_width, 0.0, 0.0), _WALL)
            _place(client, wall, [x, y, 0.0, 0.0, 0.0, 0.0])

    def _box(self, client: int, place: int, body: _Body, group: int = _CAR) -> int:
        shape = pybullet.createCollisionShape(
            pybullet.GEOM_BOX,
            halfExtents=[body.half_length, body.half_width, HALF_HEIGHT],
            physicsClientId=client,
        )
        box = pybullet.createMultiBody(
            baseMass=body.mass,
            baseCollisionShapeIndex=shape,
            basePosition=[1e3 * (place + 1), 0, 0],
            # A btRigidBody: the only kind with one finite inertia and with split impulses.
            useMaximalCoordinates=1,
            physicsClientId=client,
        )
        contact = self.cfg.contact
        pybullet.changeDynamics(
            box,
            -1,
            mass=body.mass,
            # 0 stands for infinite: no impulse rolls or pitches the box.
            localInertiaDiagonal=[0, 0, body.inertia],
            linearDamping=0,
            angularDamping=0,
            # Bullet multiplies the two bodies' coefficients.
            lateralFriction=math.sqrt(contact.friction),
            restitution=math.sqrt(contact.restitution),
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        pybullet.setCollisionFilterGroupMask(box, -1, group, _MEETS[group], physicsClientId=client)
        return box


def _push(client: int, body: int, load: list[float]) -> None:
    force_x, force_y, torque = load
    frame = pybullet.WORLD_FRAME
    # At the centre of mass, or the force would turn the body too.
    centre, _ = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    pybullet.applyExternalForce(
        body, -1, [force_x, force_y, 0], centre, frame, physicsClientId=client
    )
    pybullet.applyExternalTorque(body, -1, [0, 0, torque], frame, physicsClientId=client)


def _state(client: int, body: int) -> tuple[float, ...]:
    """Return a body's state as `_read_back` takes it."""
    place, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    velocity, spin = pybullet.getBaseVelocity(body, physicsClientId=client)
    return (place[0], place[1], turn[2], turn[3], velocity[0], velocity[1], spin[2])


def _note(stage: _Stage, points: tuple, contacts: np.ndarray) -> None:
    """Write down what touched what in one world in a physics step."""
    for point in points:
        first, second, distance, force = point[1], point[2], point[8], point[9]
        if distance > 0 and force <= 0:
            continue  # Bullet keeps points of a contact that has just ended
        for one, other in ((first, second), (second, first)):
            if one not in stage.cars:
                continue
            mine = contacts[stage.cars.index(one)]
            if other in stage.cars:
                mine["cars"] |= 1 << stage.cars.index(other)
            elif other in stage.obstacles:
                mine["obstacles"] |= 1 << stage.obstacles.index(other)
            else:
                mine["wall"] = True


def _filter(client: int, stage: _Stage, ghosts: list[bool]) -> _Stage:
    """Let ghosts through, and no longer those who have ceased to be."""
    if stage.ghosts == ghosts:
        return stage
    for body, ghost in zip(stage.cars, ghosts, strict=True):
        group = _GHOST if ghost else _CAR
        pybullet.setCollisionFilterGroupMask(body, -1, group, _MEETS[group], physicsClientId=client)
    return replace(stage, ghosts=ghosts)


def _place(client: int, body: int, state: list[float]) -> None:
    """Set x, y, yaw and their rates."""
    x, y, yaw, velocity_x, velocity_y, yaw_rate = state
    pybullet.resetBasePositionAndOrientation(
        body, [x, y, 0], [0, 0, math.sin(yaw / 2), math.cos(yaw / 2)], physicsClientId=client
    )
    pybullet.resetBaseVelocity(
        body, [velocity_x, velocity_y, 0], [0, 0, yaw_rate], physicsClientId=client
    )


def _rows(records: np.ndarray, *fields: str) -> list[list[list[float]]]:
    """Return fields of (num_worlds, num_bodies) records as nested lists, the fields innermost."""
    return np.stack([records[name] for name in fields], axis=-1).tolist()
