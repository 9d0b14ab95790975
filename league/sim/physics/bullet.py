"""BulletSolver: cars as sprung rigid bodies in space; PyBullet integrates them and their contacts.

Each world is a simulation of its own. A car is a rigid body of three boxes; its
weight and its wheels act as one force and one torque from suspension.py before each step of Bullet,
so a car squats, leans, lifts wheels and turns over; then its body lies on the ground. The records
are the truth: every control step starts from them.
"""

import contextlib
import importlib
import math
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from types import ModuleType
from typing import Any

import numpy as np

from league.errors import ConfigError
from league.sim.config import SimConfig
from league.sim.physics import suspension
from league.sim.records import World, is_frozen
from league.sim.settings import HALF_WALL, RESTITUTION_FROM, settings

MAX_WORLDS = 1000  # PyBullet keeps at most 1,024 simulations in a process
LONGEST_STEP = 1 / 240  # longest step of Bullet [s]; a physics step is split until none is longer
WALL_HEIGHT = 2.0  # height of the walls [m]: no car gets over them
HEAVY = 1e7
"""Mass of what moves and cannot be pushed [kg]: Bullet takes a body of mass 0 to be standing."""
ITERATIONS = 20  # rounds of Bullet's impulse solver in a physics step

_PARTS = ((0.74, -0.74, 0.96), (1.0, -1.0, 1.0), (0.28, -0.68, 0.66))
"""Skirt, shell and cabin of a car, much as they are drawn: where each begins and ends along the
car, as shares of half its length, and its share of the width. The shell, which hits others first,
lies above the centre of mass: so cars lean on each other, climb and turn over."""
_LEVELS = (0.0, 0.25, 0.53, 1.0)
"""Where these begin and end, as shares of the height above the clearance."""
_UNTURNED = (HEAVY, HEAVY, HEAVY)
_RATES = ("velocity_x", "velocity_y", "velocity_z", "yaw_rate", "roll_rate", "pitch_rate")
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


Triple = tuple[float, float, float]
pybullet = _load_pybullet()


@dataclass(frozen=True)
class _Body:
    """A rigid body of upright boxes to build."""

    half_sizes: list[Triple]  # of each of its boxes, ahead, to the side and upwards [m]
    mass: float = 0.0  # [kg]; 0 for what never moves
    inertia: Triple = (0.0, 0.0, 0.0)  # about the same three axes [kg m^2]
    # of each box, from the centre of mass [m]
    middles: list[Triple] = field(default_factory=lambda: [(0.0, 0.0, 0.0)])


@dataclass(frozen=True)
class _Plan:
    """What a world's bodies are built from; another plan, other bodies."""

    track: int
    masses: list[float]
    held: list[bool]  # cars that stand frozen without being ghosts: nothing can push them
    sizes: list[list[float]]  # half length and half width of each obstacle [m]


@dataclass(frozen=True)
class _Stage:
    """One world's bodies, and what they were built from."""

    plan: _Plan
    cars: list[int]
    obstacles: list[int]
    walls: list[int]
    ghosts: list[bool]


class BulletSolver:
    """Integrates each world in a Bullet simulation of its own."""

    def __init__(self, cfg: SimConfig, rooms: np.ndarray, num_worlds: int) -> None:
        """Connect to Bullet; `rooms` are x_min, y_min, x_max, y_max [m], (num_tracks, 4)."""
        self._clients = []
        if num_worlds > MAX_WORLDS:
            raise ConfigError(
                f"{num_worlds} worlds are too many for the bullet solver: "
                f"give at most {MAX_WORLDS}, or choose the planar solver"
            )
        steps = math.ceil(cfg.physics_dt / LONGEST_STEP - 1e-9)
        self.cfg = cfg = replace(cfg, decimation=cfg.decimation * steps)
        self._rooms, self._settings = rooms.tolist(), settings(cfg)
        self._chassis = suspension.chassis(cfg.car, cfg.physics_dt)
        self._height = cfg.car.height if cfg.obstacles.kind == "bot" else cfg.obstacles.height
        self._connect(num_worlds)

    def _connect(self, num_worlds: int) -> None:
        """Connect to a simulation for each world; the next step builds them."""
        self._clients: list[int] = []
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

    def step(self, world: World, controls: np.ndarray, contacts: np.ndarray) -> None:
        """Move the cars through one control step, and note what touched what; see planar.py.

        Controls are target steering [rad] and speed [m/s], (num_worlds, num_cars, 2); contacts are
        CONTACT records (num_worlds, num_cars), overwritten.
        """
        cars, obstacles = world.cars, world.obstacles
        held = is_frozen(cars)
        for name in _RATES:
            cars[name][held] = 0.0
        placed, boxes = np.empty((*cars.shape, 13)), np.empty((*obstacles.shape, 13))
        suspension.place(cars, self._chassis, placed)
        suspension.place_boxes(obstacles, self._height / 2, boxes)
        stages = self._set(world, held, placed.tolist(), boxes.tolist())
        contacts["cars"], contacts["obstacles"], contacts["wall"] = 0, 0, False
        bodies, acting = placed.copy(), np.zeros((*cars.shape, 6))
        free = [np.flatnonzero(~row).tolist() for row in held]
        states: Any = placed.tolist()
        for k in range(self.cfg.decimation):
            suspension.loads(cars, bodies, controls, self._settings, self._chassis, k, acting)
            forces: Any = acting.tolist()
            for index, stage in enumerate(stages):
                client, state = self._clients[index], states[index]
                for car in free[index]:
                    _push(client, stage.cars[car], forces[index][car], state[car])
                pybullet.stepSimulation(physicsClientId=client)
                points = pybullet.getContactPoints(physicsClientId=client)
                if points:
                    _note(stage, points, contacts[index])
                for car in free[index]:
                    state[car] = _state(client, stage.cars[car])
            bodies = np.array(states).reshape(bodies.shape)
        suspension.read_back(cars, self._chassis, placed, bodies)

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

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle keeps: it gets simulations of its own.

        These remember no contacts, from which Bullet begins its next solution, and in their first
        physics step bodies have the inertia of unturned ones. So a copy does not go on to the same
        bits; docs/observations.md has the differences.
        """
        state = {**vars(self), "num_worlds": len(self._clients)}
        del state["_clients"], state["_stages"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        num_worlds = state.pop("num_worlds")
        vars(self).update(state)
        self._connect(num_worlds)

    def __del__(self) -> None:
        self.close()

    def _set(
        self, world: World, frozen: np.ndarray, placed: list[Any], boxes: list[Any]
    ) -> list[_Stage]:
        """Build what changed in kind, and put every body where the records say."""
        cars, obstacles = world.cars, world.obstacles
        ghosts = cars["ghost"].tolist()
        held = (frozen & ~cars["ghost"]).tolist()
        mass, track = cars["mass"].tolist(), world.track.tolist()
        sizes = np.stack([obstacles["half_length"], obstacles["half_width"]], axis=-1).tolist()
        stages = []
        for index, client in enumerate(self._clients):
            plan = _Plan(track[index], mass[index], held[index], sizes[index])
            stage = self._stages[index]
            if stage is None or stage.plan != plan:
                stage = self._build(client, plan)
            stage = _filter(client, stage, ghosts[index])
            for body, state in zip(stage.cars, placed[index], strict=True):
                _place(client, body, state)
            for body, state in zip(stage.obstacles, boxes[index], strict=True):
                _place(client, body, state)
            self._stages[index] = stage
            stages.append(stage)
        return stages

    def _build(self, client: int, plan: _Plan) -> _Stage:
        pybullet.resetSimulation(physicsClientId=client)
        # The weight of the cars is among the forces of suspension.py; all else stands or is held.
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
        cars, obstacles = [], []
        for mass, held in zip(plan.masses, plan.held, strict=True):
            cars.append(self._box(client, len(cars), self._car(mass, held=held)))
        for half_length, half_width in plan.sizes:
            body = _Body([(half_length, half_width, self._height / 2)], HEAVY, _UNTURNED)
            place = len(cars) + len(obstacles)
            obstacles.append(self._box(client, place, body, _OBSTACLE))
        # Bullet takes a body's new inertia into use when it moves it.
        pybullet.stepSimulation(physicsClientId=client)
        walls = self._build_walls(client, self._rooms[plan.track])
        ground = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        self._body(client, ground, _Body([]), [0, 0, 0], _WALL)
        return _Stage(plan, cars, obstacles, walls, [False] * len(cars))

    def _car(self, mass: float, *, held: bool) -> _Body:
        car = self.cfg.car
        share = mass / car.mass
        inertia = (share * car.roll_inertia, share * car.pitch_inertia, share * car.yaw_inertia)
        heights = [car.clearance + share * (car.height - car.clearance) for share in _LEVELS]
        half_sizes, middles = [], []
        for (front, back, side), (low, high) in zip(_PARTS, pairwise(heights), strict=True):
            half_length, ahead = (front - back) * car.length / 4, (front + back) * car.length / 4
            half_sizes.append((half_length, side * car.width / 2, (high - low) / 2))
            middles.append((ahead, 0.0, (low + high) / 2 - car.mass_height))
        weight = (HEAVY, _UNTURNED) if held else (mass, inertia)
        return _Body(half_sizes, *weight, middles)

    def _build_walls(self, client: int, room: list[float]) -> list[int]:
        x_min, y_min, x_max, y_max = room
        half_x, half_y = (x_max - x_min) / 2 + 2 * HALF_WALL, (y_max - y_min) / 2
        mid_x, mid_y = (x_min + x_max) / 2, (y_min + y_max) / 2
        boxes = (
            (x_max + HALF_WALL, mid_y, HALF_WALL, half_y),
            (x_min - HALF_WALL, mid_y, HALF_WALL, half_y),
            (mid_x, y_max + HALF_WALL, half_x, HALF_WALL),
            (mid_x, y_min - HALF_WALL, half_x, HALF_WALL),
        )
        walls = []
        for x, y, half_length, half_width in boxes:
            body = _Body([(half_length, half_width, WALL_HEIGHT)])
            walls.append(self._box(client, 0, body, _WALL))
            _place(client, walls[-1], [x, y, 0.0, 0.0, 0.0, 0.0, 1.0, *[0.0] * 6])
        return walls

    def _box(self, client: int, place: int, body: _Body, group: int = _CAR) -> int:
        """Build a box, out of the way of others."""
        shape = pybullet.createCollisionShapeArray(
            shapeTypes=[pybullet.GEOM_BOX] * len(body.half_sizes),
            halfExtents=body.half_sizes,
            collisionFramePositions=body.middles,
            physicsClientId=client,
        )
        return self._body(client, shape, body, [1e3 * (place + 1), 0, 10], group)

    def _body(self, client: int, shape: int, body: _Body, at: list[float], group: int) -> int:
        made = pybullet.createMultiBody(
            baseMass=body.mass,
            baseCollisionShapeIndex=shape,
            basePosition=at,
            # A btRigidBody: the only kind with split impulses.
            useMaximalCoordinates=1,
            physicsClientId=client,
        )
        contact = self.cfg.contact
        pybullet.changeDynamics(
            made,
            -1,
            mass=body.mass,
            localInertiaDiagonal=body.inertia,
            linearDamping=0,
            angularDamping=0,
            # Bullet multiplies the two bodies' coefficients.
            lateralFriction=math.sqrt(contact.friction),
            restitution=math.sqrt(contact.restitution),
            activationState=pybullet.ACTIVATION_STATE_DISABLE_SLEEPING,
            physicsClientId=client,
        )
        pybullet.setCollisionFilterGroupMask(made, -1, group, _MEETS[group], physicsClientId=client)
        return made


def _push(client: int, body: int, acting: list[float], state: Sequence[float]) -> None:
    frame = pybullet.WORLD_FRAME
    pybullet.applyExternalForce(body, -1, acting[:3], state[:3], frame, physicsClientId=client)
    pybullet.applyExternalTorque(body, -1, acting[3:], frame, physicsClientId=client)


def _state(client: int, body: int) -> tuple[float, ...]:
    place, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
    velocity, spin = pybullet.getBaseVelocity(body, physicsClientId=client)
    return place + turn + velocity + spin


def _note(stage: _Stage, points: tuple[Any, ...], contacts: np.ndarray) -> None:
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
            elif other in stage.walls:
                mine["wall"] = True


def _filter(client: int, stage: _Stage, ghosts: list[bool]) -> _Stage:
    """Set what each car of a world collides with: ghosts meet the walls alone."""
    if stage.ghosts == ghosts:
        return stage
    for body, ghost in zip(stage.cars, ghosts, strict=True):
        group = _GHOST if ghost else _CAR
        pybullet.setCollisionFilterGroupMask(body, -1, group, _MEETS[group], physicsClientId=client)
    return replace(stage, ghosts=ghosts)


def _place(client: int, body: int, state: list[float]) -> None:
    pybullet.resetBasePositionAndOrientation(body, state[:3], state[3:7], physicsClientId=client)
    pybullet.resetBaseVelocity(body, state[7:10], state[10:], physicsClientId=client)
