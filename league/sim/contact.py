"""Contacts of the planar solver: the pairs of a control step, and who touched whom.

Cars, obstacles and walls are all oriented boxes; collision.py finds where they touch and what
impulses part them. Pairs that may touch are few and go one by one, which a compiled loop on the
CPU does best: on another device the cars' motion comes over for it, and goes back.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import torch
from torch import Tensor

from league.sim.config import SimConfig
from league.sim.near import Round
from league.sim.world import Contacts, Motion, World


@dataclass(frozen=True)
class Boxes:
    """What stays the same of all cars over a control step, each (num_worlds * num_cars,)."""

    half_length: Tensor
    """[m]."""
    half_width: Tensor
    """[m]."""
    inverse_mass: Tensor
    """[1/kg]; 0 for what cannot be pushed."""
    inverse_inertia: Tensor
    """[1/(kg m^2)]; 0 for what cannot be pushed."""


class Resolver:
    """Parts touching bodies through one control step, and keeps who touched whom."""

    def __init__(self, rounds: list[Round], cars: Boxes, cfg: SimConfig) -> None:
        """Gather what stays the same.

        Args:
            rounds: the pairs that may touch, at least one.
            cars: all cars, flattened.
            cfg: contact settings and the physics step.
        """
        from league.sim import collision  # late: Numba takes a while

        self._part, self._rounds = collision.part, rounds
        # Rounds between cars come before those against fixed bodies.
        firsts = [_host(part.first) for part in rounds]
        seconds = [_host(part.second) for part in rounds if part.second is not None]
        fixed = [_host(part.fixed) for part in rounds if part.fixed is not None]
        self._near, seats = np.unique(np.concatenate(firsts + seconds), return_inverse=True)
        boxes = np.stack([_host(getattr(cars, item.name))[self._near] for item in fields(cars)], 1)
        self._fixed = np.zeros((0, 6), boxes.dtype)
        num_pairs = sum(len(first) for first in firsts)
        self._first, self._second = seats[:num_pairs], seats[num_pairs:]
        if fixed:
            # A fixed body sits behind the cars, has no inverse mass and turns as it did.
            # Row by row in memory: for another order all would be compiled anew.
            things = np.ascontiguousarray(np.concatenate(fixed, 1).T)
            numbers = np.arange(len(things)) + len(self._near)
            self._second = np.concatenate((self._second, numbers))
            self._fixed = np.pad(things[:, :5], ((0, 0), (0, 1)))
            boxes = np.concatenate((boxes, np.pad(things[:, 5:], ((0, 0), (0, 2)))))
        self._boxes = np.ascontiguousarray(boxes)
        self._touched = np.zeros(num_pairs, np.bool_)
        settings = (cfg.physics_dt, cfg.contact.restitution, cfg.contact.friction)
        self._settings = np.array(settings, boxes.dtype)

    def part(self, before: Motion, motion: Motion) -> None:
        """Change how the cars that touch move in a physics step, and mend their overlap.

        Args:
            before: the motion before the step.
            motion: the motion after a step without contacts; changed in place.
        """
        near, velocities = self._near, (motion.velocity_x, motion.velocity_y, motion.yaw_rate)
        told = (before.x, before.y, before.yaw, *velocities)
        cars = np.stack([_host(field).take(near) for field in told], 1)
        bodies = np.concatenate((cars, self._fixed))
        acted, shift = self._part(
            bodies, self._boxes, self._first, self._second, self._touched, self._settings
        )
        self._fixed[:, :2] += self._fixed[:, 3:5] * self._settings[0]
        if acted:
            cars = bodies[: len(near)]
            place = (cars[:, :3] + shift[: len(near)]) + cars[:, 3:] * self._settings[0]
            places = (motion.x, motion.y, motion.yaw)
            for field, column in zip(places, place.T, strict=True):
                _put(field, near, column)
            for field, column in zip(velocities, cars[:, 3:].T, strict=True):
                _put(field, near, column)

    def contacts(self, world: World) -> Contacts:
        """Return what has touched what so far."""
        touched = torch.from_numpy(self._touched).to(world.motion.x.device)
        return _contacts(world, self._rounds, touched)


def _host(tensor: Tensor) -> np.ndarray:
    """Return numpy's view of a tensor, or of its copy on the CPU."""
    return tensor.detach().cpu().numpy()


def _put(tensor: Tensor, places: np.ndarray, values: np.ndarray) -> None:
    """Change elements of the tensor, counted as if it had a single axis, in place."""
    if tensor.device.type == "cpu":
        tensor.detach().numpy().put(places, values)
    else:
        where = torch.from_numpy(places).to(tensor.device)
        tensor.put_(where, torch.from_numpy(np.ascontiguousarray(values)).to(tensor.device))


def no_contacts(world: World) -> Contacts:
    """Return that nothing touched anything."""
    shape, device = world.motion.x.shape, world.motion.x.device
    return Contacts(
        cars=torch.zeros((*shape, shape[1]), dtype=torch.bool, device=device),
        obstacles=torch.zeros(
            (*shape, world.obstacles.x.shape[1]), dtype=torch.bool, device=device
        ),
        walls=torch.zeros(shape, dtype=torch.bool, device=device),
    )


def _contacts(world: World, rounds: list[Round], touched: Tensor) -> Contacts:
    contacts, num_cars, start = no_contacts(world), world.num_cars, 0
    for part in rounds:
        mine = touched[start : start + part.first.numel()]
        start += part.first.numel()
        if not bool(mine.any()):
            continue
        first = part.first[mine]
        row, car = first // num_cars, first % num_cars
        if part.second is not None:
            other = part.second[mine] % num_cars
            contacts.cars[row, car, other] = True
            contacts.cars[row, other, car] = True
        elif part.obstacle is not None:
            contacts.obstacles[row, car, part.obstacle] = True
        else:
            contacts.walls[row, car] = True
    return contacts
