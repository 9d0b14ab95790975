"""BulletSolver: the same pushes on rigid bodies in PyBullet, contacts by Bullet.

Each world is a simulation of its own, without gravity and without ground: cars are upright boxes
that nothing can tip. The World's tensors are the truth: every control step starts from them.
"""

from __future__ import annotations

import contextlib
import importlib
import math
import os
import sys
from dataclasses import dataclass, replace
from types import ModuleType

import torch
from torch import Tensor

from league.errors import ConfigError
from league.sim.config import SimConfig
from league.sim.solver import Outcome
from league.sim.vehicle import Push, Vehicle, asked_controls, at_rest
from league.sim.world import Contacts, Control, Motion, World
from league.track.course import TrackSet

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

    def __init__(self, cfg: SimConfig, tracks: TrackSet, num_worlds: int) -> None:
        self._clients: list[int] = []
        if num_worlds > MAX_WORLDS:
            raise ConfigError(
                f"{num_worlds} worlds are too many for the bullet solver: "
                f"give at most {MAX_WORLDS}, or choose the planar solver"
            )
        self.cfg = cfg
        self.tracks = tracks
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

    def step(self, world: World, control: Control) -> Outcome:
        """Return where `control`, held for one control step, leads from `world`."""
        frozen = world.standing.penalty_s > 0
        stages = self._set(world, frozen)
        vehicle = Vehicle.of(world.cars, self.cfg.car, self.cfg.physics_dt)
        motion = world.motion
        touching = _Touching(world)
        pushed = [[not car for car in row] for row in frozen.tolist()]
        for asked in asked_controls(world, control, self.cfg):
            push = vehicle.push(motion, asked.steering, asked.speed)
            self._apply(stages, push, pushed)
            for index, stage in enumerate(stages):
                client = self._clients[index]
                pybullet.stepSimulation(physicsClientId=client)
                touching.add(index, stage, pybullet.getContactPoints(physicsClientId=client))
            motion = self._read(stages, push.steering)
        return Outcome(motion=_hold(frozen, world.motion, motion), contacts=touching.contacts())

    def reset(self, worlds: list[int] | None = None) -> None:
        """Tear these worlds down (None: all); the next step builds them anew."""
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

    def _set(self, world: World, frozen: Tensor) -> list[_Stage]:
        """Build what changed in kind, and put every body where the world says."""
        ghosts = world.standing.ghost.tolist()
        held = (frozen & ~world.standing.ghost).tolist()
        mass, track = world.cars.mass.tolist(), world.track.tolist()
        fixed, cars = world.obstacles, at_rest(world.motion, frozen)
        sizes = _rows(fixed.half_length, fixed.half_width)
        still = torch.zeros_like(fixed.x)
        moving = _rows(fixed.x, fixed.y, fixed.yaw, fixed.velocity_x, fixed.velocity_y, still)
        driven = _rows(cars.x, cars.y, cars.yaw, cars.velocity_x, cars.velocity_y, cars.yaw_rate)
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
                _place(client, body, state)
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
        self._build_walls(client, self.tracks.tracks[plan.track].room)
        return _Stage(plan, cars, obstacles, [False] * len(cars))

    def _build_walls(self, client: int, room: tuple[float, float, float, float]) -> None:
        x_min, y_min, x_max, y_max = room
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

    def _apply(self, stages: list[_Stage], push: Push, pushed: list[list[bool]]) -> None:
        loads = _rows(push.force_x, push.force_y, push.torque)
        frame = pybullet.WORLD_FRAME
        for client, stage, row, free in zip(self._clients, stages, loads, pushed, strict=True):
            for body, (force_x, force_y, torque), mine in zip(stage.cars, row, free, strict=True):
                if not mine:
                    continue
                # At the centre of mass, or the force would turn the body too.
                centre, _ = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
                pybullet.applyExternalForce(
                    body, -1, [force_x, force_y, 0], centre, frame, physicsClientId=client
                )
                pybullet.applyExternalTorque(
                    body, -1, [0, 0, torque], frame, physicsClientId=client
                )

    def _read(self, stages: list[_Stage], steering: Tensor) -> Motion:
        rows = []
        for client, stage in zip(self._clients, stages, strict=True):
            for body in stage.cars:
                place, turn = pybullet.getBasePositionAndOrientation(body, physicsClientId=client)
                velocity, spin = pybullet.getBaseVelocity(body, physicsClientId=client)
                yaw = math.remainder(2 * math.atan2(turn[2], turn[3]), math.tau)
                rows.append((place[0], place[1], yaw, velocity[0], velocity[1], spin[2]))
        table = torch.tensor(rows, dtype=torch.float32).T.contiguous()
        x, y, yaw, velocity_x, velocity_y, yaw_rate = (
            table.to(steering.device).reshape(6, *steering.shape).unbind()
        )
        return Motion(
            x=x,
            y=y,
            yaw=yaw,
            velocity_x=velocity_x,
            velocity_y=velocity_y,
            yaw_rate=yaw_rate,
            steering=steering,
        )


class _Touching:
    """Gathers what touched what over a control step."""

    def __init__(self, world: World) -> None:
        shape, device = world.motion.x.shape, world.motion.x.device
        self._cars = torch.zeros((*shape, shape[1]), dtype=torch.bool, device=device)
        self._obstacles = torch.zeros(
            (*shape, world.obstacles.x.shape[1]), dtype=torch.bool, device=device
        )
        self._walls = torch.zeros(shape, dtype=torch.bool, device=device)

    def add(self, index: int, stage: _Stage, points: tuple) -> None:
        for point in points:
            first, second, distance, force = point[1], point[2], point[8], point[9]
            if distance > 0 and force <= 0:
                continue  # Bullet keeps points of a contact that has just ended
            for one, other in ((first, second), (second, first)):
                if one not in stage.cars:
                    continue
                car = stage.cars.index(one)
                if other in stage.cars:
                    self._cars[index, car, stage.cars.index(other)] = True
                elif other in stage.obstacles:
                    self._obstacles[index, car, stage.obstacles.index(other)] = True
                else:
                    self._walls[index, car] = True

    def contacts(self) -> Contacts:
        return Contacts(cars=self._cars, obstacles=self._obstacles, walls=self._walls)


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


def _rows(*fields: Tensor) -> list[list[list[float]]]:
    """Return (num_worlds, num_bodies) fields as nested lists, the fields innermost."""
    return torch.stack(fields, dim=-1).tolist()


def _hold(frozen: Tensor, before: Motion, after: Motion) -> Motion:
    """Return frozen cars where they were, at rest."""
    return replace(
        at_rest(after, frozen),
        x=torch.where(frozen, before.x, after.x),
        y=torch.where(frozen, before.y, after.y),
        yaw=torch.where(frozen, before.yaw, after.yaw),
        steering=torch.where(frozen, before.steering, after.steering),
    )
