"""PlanarSolver: many worlds at once in torch, on any device; contacts by impulses between boxes.

Semi-implicit Euler: forces change velocities, contacts mend them, velocities move the cars. A
world's result does not depend, to the last bit, on the batch it is in (on the CPU).
"""

from __future__ import annotations

import math
from dataclasses import replace

import torch
from torch import Tensor

from league.geometry import wrap_angle
from league.sim.config import SimConfig
from league.sim.contact import Boxes, Resolver, no_contacts
from league.sim.near import find_rounds
from league.sim.solver import Outcome
from league.sim.vehicle import Vehicle, asked_controls, at_rest
from league.sim.world import Control, Motion, World
from league.track.course import TrackSet


class PlanarSolver:
    """Integrates a batch of worlds; keeps nothing between steps."""

    def __init__(self, cfg: SimConfig, tracks: TrackSet) -> None:
        self.cfg = cfg
        self.tracks = tracks

    def step(self, world: World, control: Control) -> Outcome:
        """Return where `control`, held for one control step, leads from `world`."""
        frozen = world.standing.penalty_s > 0
        held = bool(frozen.any())
        vehicle = Vehicle.of(world.cars, self.cfg.car, self.cfg.physics_dt)
        ease, turn_ease = 1.0 / vehicle.mass, 1.0 / vehicle.inertia
        motion = world.motion
        if held:
            motion = at_rest(motion, frozen)
            ease, turn_ease = torch.where(frozen, 0.0, ease), torch.where(frozen, 0.0, turn_ease)
        resolver = self._resolver(replace(world, motion=motion), frozen, ease, turn_ease)
        for asked in asked_controls(world, control, self.cfg):
            motion = self._advance(motion, asked, vehicle, (ease, turn_ease), resolver)
        # Wrapping rounds, so a yaw in range is left alone: a car at rest keeps its bits.
        yaw = torch.where(motion.yaw.abs() >= math.pi, wrap_angle(motion.yaw), motion.yaw)
        steering = motion.steering
        if held:
            yaw = torch.where(frozen, world.motion.yaw, yaw)
            steering = torch.where(frozen, world.motion.steering, steering)
        return Outcome(
            motion=replace(motion, yaw=yaw, steering=steering),
            contacts=resolver.contacts(world) if resolver else no_contacts(world),
        )

    def reset(self, worlds: list[int] | None = None) -> None:
        """Do nothing: no step leaves anything behind."""

    def close(self) -> None:
        """Do nothing: nothing is held outside Python."""

    def _resolver(
        self, world: World, frozen: Tensor, ease: Tensor, turn_ease: Tensor
    ) -> Resolver | None:
        rounds = find_rounds(world, frozen, self.cfg, self.tracks)
        if not rounds:
            return None
        inverse_mass = ease.reshape(-1)
        cars = Boxes(
            half_length=torch.full_like(inverse_mass, self.cfg.car.length / 2),
            half_width=torch.full_like(inverse_mass, self.cfg.car.width / 2),
            inverse_mass=inverse_mass,
            inverse_inertia=turn_ease.reshape(-1),
        )
        return Resolver(rounds, cars, self.cfg)

    def _advance(
        self,
        motion: Motion,
        asked: Control,
        vehicle: Vehicle,
        eases: tuple[Tensor, Tensor],
        resolver: Resolver | None,
    ) -> Motion:
        """Return the motion one physics step later."""
        dt = self.cfg.physics_dt
        push = vehicle.push(motion, asked.steering, asked.speed)
        speed_up, turn_up = eases[0] * dt, eases[1] * dt
        velocity_x = motion.velocity_x + push.force_x * speed_up
        velocity_y = motion.velocity_y + push.force_y * speed_up
        yaw_rate = motion.yaw_rate + push.torque * turn_up
        after = Motion(
            x=motion.x + velocity_x * dt,
            y=motion.y + velocity_y * dt,
            yaw=motion.yaw + yaw_rate * dt,
            velocity_x=velocity_x,
            velocity_y=velocity_y,
            yaw_rate=yaw_rate,
            steering=push.steering,
        )
        if resolver:
            resolver.part(motion, after)
        return after
