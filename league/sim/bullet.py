"""BulletSolver: the same pushes on rigid bodies in PyBullet, contacts by Bullet.

Each world is a simulation of its own, without gravity and without ground: cars are upright boxes that
nothing can tip. The World's tensors are the truth: every control step starts from them.
"""

from __future__ import annotations

import contextlib
import ctypes
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
from league.sim.vehicle import Push, Vehicle, asked_controls
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
    """Import PyBullet without the line it prints from C, which would spoil a command's own output."""
    if "pybullet" in sys.modules or os.name != "posix":
        return importlib.import_module("pybullet")
    libc = ctypes.CDLL(None)
    with contextlib.ExitStack() as stack:
        sys.stdout.flush()
        libc.fflush(None)
        kept, null = os.dup(1), os.open(os.devnull, os.O_WRONLY)
        stack.callback(os.close, kept)
        stack.callback(os.close, null)
        os.dup2(null, 1)
        stack.callback(os.dup2, kept, 1)
        stack.callback(libc.fflush, None)
        return importlib.import_module("pybullet")


pybullet = _load_pybullet()


@dataclass(frozen=True)
class _Body:
    """A box to build."""

    half_length: float
    half_width: float
    mass: float
    inertia: float


@dataclass(frozen=True)
class _Stage:
    """One world's bodies, and what they were built from."""

    plan: tuple
    cars: list[int]
    obstacles: list[int]
    walls: list[int]
    ghosts: list[bool]


class BulletSolver:
    """Integrates each world in a Bullet simulation of its own."""

    def __init__(self, cfg: SimConfig, tracks: TrackSet, num_worlds: int) -> None:
        self._clients: list[int] = []
        if num_worlds > MAX_WORLDS:
            raise ConfigError(
                f"{num_worlds} worlds are too many for the bullet solver: give at most {MAX_WORLDS}, "
                "or choose the planar solver"
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
        solid = (frozen & ~world.standing.ghost).tolist()
        mass, track = world.cars.mass.tolist(), world.track.tolist()
        obstacles = world.obstacles
        sizes = torch.stack((obstacles.half_length, obstacles.half_width), dim=-1).tolist()
        moving = torch.stack(
            (obstacles.x, obstacles.y, obstacles.yaw, obstacles.velocity_x, obstacles.velocity_y),
            dim=-1,
        ).tolist()
        motion = world.motion
        resting = torch.where(frozen, 0.0, 1.0)
        cars = torch.stack(
            (
                motion.x,
                motion.y,
                motion.yaw,
                motion.velocity_x * resting,
                motion.velocity_y * resting,
                motion.yaw_rate * resting,
            ),
            dim=-1,
        ).tolist()
        stages = []
        for index, client in enumerate(self._clients):
            plan = (track[index], mass[index], solid[index], sizes[index])
            stage = self._stages[index]
            if stage is None or stage.plan != plan:
                stage = self._build(client, plan)
            stage = _filter(client, stage, ghosts[index])
            for body, state in zip(stage.cars, cars[index], strict=True):
                _place(client, body, *state)
            for body, state in zip(stage.obstacles, moving[index], strict=True):
                _place(client, body, *state, 0.0)
            self._stages[index] = stage
            stages.append(stage)
        return stages

    def _build(self, client: int, plan: tuple) -> _Stage:
        track, masses, solid, sizes = plan
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
        cars = [
            self._box(
                client,
                place,
                _Body(
                    car.length / 2,
                    car.width / 2,
                    HEAVY if held else mass,
                    HEAVY if held else mass * (car.yaw_inertia / car.mass),
                ),
                _CAR,
            )
            for place, (mass, held) in enumerate(zip(masses, solid, strict=True))
        ]
        obstacles = [
            self._box(client, len(cars) + place, _Body(*size, HEAVY, HEAVY), _OBSTACLE)
            for place, size in enumerate(sizes)
        ]
        # Bullet takes a body's new inertia into use when it moves it.
        pybullet.stepSimulation(physicsClientId=client)
        walls = self._walls(client, self.tracks.tracks[track].room)
        return _Stage(plan, cars, obstacles, walls, [False] * len(cars))

    def _walls(self, client: int, room: tuple[float, float, float, float]) -> list[int]:
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
            wall = self._box(client, 0, _Body(half_length, half_width, 0.0, 0.0), _WALL)
            _place(client, wall, x, y, 0.0, 0.0, 0.0, 0.0)
            walls.append(wall)
        return walls

    def _box(self, client: int, place: int, body: _Body, group: int) -> int:
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
        loads = torch.stack((push.force_x, push.force_y, push.torque), dim=-1).tolist()
        for client, stage, row, free in zip(self._clients, stages, loads, pushed, strict=True):
            for body, (force_x, force_y, torque), mine in zip(stage.cars, row, free, strict=True):
                if mine:
                    # In the link frame's origin the point of action is the centre of mass; torque
                    # about the vertical is the same in either frame.
                    pybullet.applyExternalForce(
                        body,
                        -1,
                        [force_x, force_y, 0],
                        pybullet.getBasePositionAndOrientation(body, physicsClientId=client)[0],
                        pybullet.WORLD_FRAME,
                        physicsClientId=client,
                    )
                    pybullet.applyExternalTorque(
                        body, -1, [0, 0, torque], pybullet.WORLD_FRAME, physicsClientId=client
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


def _place(
    client: int,
    body: int,
    x: float,
    y: float,
    yaw: float,
    velocity_x: float,
    velocity_y: float,
    yaw_rate: float,
) -> None:
    pybullet.resetBasePositionAndOrientation(
        body, [x, y, 0], [0, 0, math.sin(yaw / 2), math.cos(yaw / 2)], physicsClientId=client
    )
    pybullet.resetBaseVelocity(
        body, [velocity_x, velocity_y, 0], [0, 0, yaw_rate], physicsClientId=client
    )


def _hold(frozen: Tensor, before: Motion, after: Motion) -> Motion:
    """Return frozen cars where they were, at rest."""
    return replace(
        after,
        x=torch.where(frozen, before.x, after.x),
        y=torch.where(frozen, before.y, after.y),
        yaw=torch.where(frozen, before.yaw, after.yaw),
        velocity_x=torch.where(frozen, 0.0, after.velocity_x),
        velocity_y=torch.where(frozen, 0.0, after.velocity_y),
        yaw_rate=torch.where(frozen, 0.0, after.yaw_rate),
        steering=torch.where(frozen, before.steering, after.steering),
    )
