"""How a car drives: servos, steering and tyres turned into a planar push; one model, both solvers.

Single-track model with the centre of mass midway between the axles and four driven wheels. Each
axle pushes along its wheels with half of the drive, and across them with a brush tyre (E. Fiala,
1954; H. Pacejka, Tire and Vehicle Dynamics, chapter 3) whose grip is what the drive leaves of the
friction circle.

No force may do more in one physics step than stop the motion it opposes: each is held to `cap` =
min(mass, inertia / b^2) / (2 dt) times its speed. The four directions together then only ever take
energy out of the car, at every speed, down to rest. docs/physics.md has equations and proof.

Written twice: in torch for any device, and in tyres.py, to the same bits, as a compiled loop for
the CPU, where torch would spend most of a race of few cars on calling itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from league.sim.config import CarConfig, SimConfig
from league.sim.world import CarParameters, Control, Motion, World

GRAVITY = 9.81
"""[m/s^2]."""
DRIVE_SHARE = 0.95
"""Largest share of an axle's grip that drive or brakes may take; the rest still steers."""
SLIP_FLOOR = 0.05
"""Slowest rolling speed a slip is counted against [m/s]."""


@dataclass(frozen=True)
class Push:
    """What acts on each car in one physics step, (num_worlds, num_cars)."""

    force_x: Tensor
    """World frame, at the base [N]."""
    force_y: Tensor
    """World frame, at the base [N]."""
    torque: Tensor
    """About the vertical [N m]."""
    steering: Tensor
    """Angle of the front wheels at the end of the step [rad]."""


@dataclass(frozen=True)
class Vehicle:
    """The cars' constants over a control step, worked out once for all its physics steps."""

    cfg: CarConfig
    steering_offset: Tensor
    """[rad]."""
    mass: Tensor
    """[kg]."""
    inertia: Tensor
    """About the vertical [kg m^2]."""
    grip: Tensor
    """Friction coefficient of the tyres."""
    half_weight: Tensor
    """Load of one axle at rest [N]."""
    half_mass: Tensor
    """[kg]."""
    transfer: Tensor
    """Load moved from front to rear axle for each m/s^2 of drive [kg]."""
    slope: Tensor
    """Brush tyre's z for each unit of slip, times lateral grip over grip and load."""
    cap: Tensor
    """Largest force for each m/s it opposes [kg/s]."""
    max_turn: float
    """Largest change of the steering angle in a physics step [rad]."""
    gain: float
    """Acceleration asked per unit of speed error [1/s]."""

    @classmethod
    def of(cls, cars: CarParameters, cfg: CarConfig, dt: float) -> Vehicle:
        """Prepare cars for physics steps of dt [s]."""
        arm = cfg.wheelbase / 2
        # Inertia grows with mass, so min(mass, inertia / arm^2) is a fixed share of the mass.
        share = 0.5 * min(1.0, cfg.yaw_inertia / cfg.mass / arm**2)
        return cls(
            cfg=cfg,
            steering_offset=cars.steering_offset,
            mass=cars.mass,
            inertia=cars.mass * (cfg.yaw_inertia / cfg.mass),
            grip=cars.grip,
            half_weight=cars.mass * (GRAVITY / 2),
            half_mass=cars.mass * 0.5,
            transfer=cars.mass * (cfg.mass_height / cfg.wheelbase),
            slope=cfg.cornering_stiffness / 3 / cars.grip,
            cap=cars.mass * (share / dt),
            max_turn=cfg.steering_rate * dt,
            # A servo that asks for more than the whole error in one step would swing about it.
            gain=min(cfg.speed_gain, 1 / dt),
        )

    def push(self, motion: Motion, steering_target: Tensor, speed_target: Tensor) -> Push:
        """Return what acts on the cars for one physics step."""
        if motion.yaw.is_cpu:
            return self._compiled.push(motion, steering_target, speed_target)
        return self._push_in_torch(motion, steering_target, speed_target)

    @cached_property
    def _compiled(self) -> _Compiled:
        return _Compiled.of(self)

    def _push_in_torch(self, motion: Motion, steering_target: Tensor, speed_target: Tensor) -> Push:
        """Return the same, on any device."""
        cfg, arm = self.cfg, self.cfg.wheelbase / 2
        steering = self._steer(motion.steering, steering_target)
        angles = torch.stack((motion.yaw, steering))
        (cos, cos_wheel), (sin, sin_wheel) = torch.cos(angles).unbind(), torch.sin(angles).unbind()
        ahead = cos * motion.velocity_x + sin * motion.velocity_y
        left = cos * motion.velocity_y - sin * motion.velocity_x
        swing = motion.yaw_rate * arm
        left_front, left_rear = left + swing, left - swing
        # Front and rear axle stacked: (2, num_worlds, num_cars).
        rolling = torch.stack((cos_wheel * ahead + sin_wheel * left_front, ahead))
        sliding = torch.stack((cos_wheel * left_front - sin_wheel * ahead, left_rear))
        asked = (speed_target - ahead) * self.gain
        asked = torch.clamp(asked, -cfg.max_braking, cfg.max_acceleration)
        drive, lateral = self._tyres(asked, rolling, sliding)
        drive_front, drive_rear = drive.unbind()
        lateral_front, lateral_rear = lateral.unbind()
        push_ahead = cos_wheel * drive_front - sin_wheel * lateral_front + drive_rear
        push_front = sin_wheel * drive_front + cos_wheel * lateral_front
        push_left = push_front + lateral_rear
        return Push(
            force_x=cos * push_ahead - sin * push_left,
            force_y=sin * push_ahead + cos * push_left,
            torque=(push_front - lateral_rear) * arm,
            steering=steering,
        )

    def _steer(self, steering: Tensor, target: Tensor) -> Tensor:
        limit = self.cfg.max_steering
        target = torch.clamp(target, -limit, limit) + self.steering_offset
        return steering + torch.clamp(target - steering, -self.max_turn, self.max_turn)

    def _tyres(self, asked: Tensor, rolling: Tensor, sliding: Tensor) -> tuple[Tensor, Tensor]:
        """Return forces along and across the wheels of each axle [N], (2, num_worlds, num_cars)."""
        moved = asked * self.transfer
        load = torch.stack((self.half_weight - moved, self.half_weight + moved))
        grip = torch.clamp_min(load, 1e-3) * self.grip
        most = grip * DRIVE_SHARE
        drive = torch.minimum(asked * self.half_mass, most)
        # Brakes act against rolling ahead only, and at most stop it.
        stop = torch.clamp_min(rolling, 0.0) * self.cap
        drive = torch.maximum(drive, -torch.minimum(most, stop))
        # What the drive leaves of the friction circle; rsqrt, unlike sqrt, wakes no second thread.
        rest = grip * grip - drive * drive
        ease = torch.rsqrt(rest)
        # Brush tyre: F = grip (3 z - 3 z |z| + z^3), z = stiffness load slip / (3 grip), |z| <= 1.
        slip = sliding / torch.clamp_min(rolling.abs(), SLIP_FLOOR)
        z = torch.clamp(slip * grip * self.slope * ease, -1.0, 1.0)
        size = z.abs()
        force = rest * ease * z * (size * (size - 3.0) + 3.0)
        most = sliding.abs() * self.cap
        return drive, torch.clamp(-force, -most, most)


@dataclass(frozen=True)
class _Compiled:
    """A Vehicle as tables, and who works with them."""

    cars: np.ndarray
    """As `tyres.push` takes them."""
    steering: tuple[np.float32, np.float32]
    """As `tyres.steer` takes them."""
    settings: np.ndarray
    """As `tyres.push` takes them."""

    @classmethod
    def of(cls, vehicle: Vehicle) -> _Compiled:
        cfg = vehicle.cfg
        rows = (vehicle.steering_offset, vehicle.grip, vehicle.half_weight, vehicle.half_mass)
        rows = (*rows, vehicle.transfer, vehicle.slope, vehicle.cap)
        limits = (cfg.max_braking, cfg.max_acceleration, DRIVE_SHARE, SLIP_FLOOR)
        return cls(
            cars=torch.stack(rows).numpy().reshape(len(rows), -1),
            steering=(np.float32(cfg.max_steering), np.float32(vehicle.max_turn)),
            settings=np.array((cfg.wheelbase / 2, vehicle.gain, *limits), np.float32),
        )

    def push(self, motion: Motion, steering_target: Tensor, speed_target: Tensor) -> Push:
        from league.sim import tyres  # late: Numba takes a while

        told = (motion.yaw, motion.velocity_x, motion.velocity_y, motion.yaw_rate, motion.steering)
        told = (*told, steering_target, speed_target)
        rows = torch.stack(told).numpy().reshape(len(told), -1)
        if rows.shape != self.cars.shape:
            raise ValueError(f"{rows.shape[1]} cars move, of {self.cars.shape[1]} cars' parameters")
        angles = torch.from_numpy(tyres.steer(rows, self.cars, *self.steering))
        cos, sin = torch.cos(angles).numpy(), torch.sin(angles).numpy()
        pushed = torch.from_numpy(tyres.push(rows, cos, sin, self.cars, self.settings))
        return Push(*torch.cat((pushed, angles[1:])).reshape(4, *motion.yaw.shape).unbind())


def forces(
    motion: Motion,
    steering_target: Tensor,
    speed_target: Tensor,
    cars: CarParameters,
    cfg: CarConfig,
    dt: float,
) -> Push:
    """Return what acts on the cars for one physics step of dt [s].

    Args:
        motion: where the cars are and how they move.
        steering_target: asked angle of the front wheels [rad], clipped to the largest.
        speed_target: asked speed [m/s].
        cars: what differs from car to car.
        cfg: what all cars share.
        dt: length of the physics step [s].
    """
    return Vehicle.of(cars, cfg, dt).push(motion, steering_target, speed_target)


def asked_controls(world: World, control: Control, cfg: SimConfig) -> list[Control]:
    """Return what the servos hear in each physics step: late cars, first, the last control."""
    late = torch.round(world.cars.latency_s / cfg.physics_dt)
    if not bool((late > 0).any()):
        return [control] * cfg.decimation
    return [
        Control(
            steering=torch.where(late > step, world.control.steering, control.steering),
            speed=torch.where(late > step, world.control.speed, control.speed),
        )
        for step in range(cfg.decimation)
    ]


def at_rest(motion: Motion, frozen: Tensor) -> Motion:
    """Return the motion with these cars standing still."""
    return replace(
        motion,
        velocity_x=torch.where(frozen, 0.0, motion.velocity_x),
        velocity_y=torch.where(frozen, 0.0, motion.velocity_y),
        yaw_rate=torch.where(frozen, 0.0, motion.yaw_rate),
    )
