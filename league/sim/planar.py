"""PlanarSolver: many worlds at once in torch, on any device; contacts by impulses between boxes.

Semi-implicit Euler: forces change velocities, contacts mend them, velocities move the cars. A world's
result does not depend, to the last bit, on the batch it is in (on the CPU).
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from league.geometry import wrap_angle
from league.sim.config import SimConfig
from league.sim.solver import Outcome
from league.sim.vehicle import Vehicle, asked_controls
from league.sim.world import Contacts, Control, Motion, World
from league.track.course import TrackSet


class PlanarSolver:
    """Integrates a batch of worlds; keeps nothing between steps."""

    def __init__(self, cfg: SimConfig, tracks: TrackSet) -> None:
        self.cfg = cfg
        self.tracks = tracks

    def step(self, world: World, control: Control) -> Outcome:
        """Return where `control`, held for one control step, leads from `world`."""
        dt = self.cfg.physics_dt
        vehicle = Vehicle.of(world.cars, self.cfg.car, dt)
        frozen = world.standing.penalty_s > 0
        held = bool(frozen.any())
        motion = _at_rest(world.motion, frozen) if held else world.motion
        speed_up = dt / vehicle.mass
        turn_up = dt / vehicle.inertia
        if held:
            speed_up = torch.where(frozen, 0.0, speed_up)
            turn_up = torch.where(frozen, 0.0, turn_up)
        shape = motion.x.shape
        contacts = Contacts(
            cars=torch.zeros((*shape, shape[1]), dtype=torch.bool, device=motion.x.device),
            obstacles=torch.zeros(
                (*shape, world.obstacles.x.shape[1]), dtype=torch.bool, device=motion.x.device
            ),
            walls=torch.zeros(shape, dtype=torch.bool, device=motion.x.device),
        )
        for asked in asked_controls(world, control, self.cfg):
            push = vehicle.push(motion, asked.steering, asked.speed)
            velocity_x = motion.velocity_x + push.force_x * speed_up
            velocity_y = motion.velocity_y + push.force_y * speed_up
            yaw_rate = motion.yaw_rate + push.torque * turn_up
            motion = Motion(
                x=motion.x + velocity_x * dt,
                y=motion.y + velocity_y * dt,
                yaw=motion.yaw + yaw_rate * dt,
                velocity_x=velocity_x,
                velocity_y=velocity_y,
                yaw_rate=yaw_rate,
                steering=push.steering,
            )
        motion = replace(motion, yaw=_wrapped(motion.yaw))
        if held:
            motion = replace(
                motion, steering=torch.where(frozen, world.motion.steering, motion.steering)
            )
        return Outcome(motion=motion, contacts=contacts)

    def reset(self, worlds: list[int] | None = None) -> None:
        """Do nothing: no step leaves anything behind."""

    def close(self) -> None:
        """Do nothing: nothing is held outside Python."""


def _at_rest(motion: Motion, frozen: Tensor) -> Motion:
    return replace(
        motion,
        velocity_x=torch.where(frozen, 0.0, motion.velocity_x),
        velocity_y=torch.where(frozen, 0.0, motion.velocity_y),
        yaw_rate=torch.where(frozen, 0.0, motion.yaw_rate),
    )


def _wrapped(yaw: Tensor) -> Tensor:
    # Wrapping rounds, so a yaw in range is left alone: a car at rest keeps its bits.
    return torch.where(yaw.abs() >= math.pi, wrap_angle(yaw), yaw)
