"""Contacts of the planar solver: what impulses part boxes that touch.

Cars, obstacles and walls are all oriented boxes. A pair touches at up to two points, whose normal
impulses are solved together and exactly (the block solver of E. Catto's Box2D), and rubs at one.
Only pairs that touch cost anything: a pair that does not touch would have received an impulse of
exactly zero, so skipping it changes no bit.

Vectors over pairs have shape (num_pairs,); those over both contact points (2, num_pairs).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import torch
from torch import Tensor

from league.sim.config import SimConfig
from league.sim.manifold import Manifold, Pose, find_manifold
from league.sim.near import Round
from league.sim.world import Contacts, Motion, World

RESTITUTION_FROM = 0.05
"""Slowest approach that bounces [m/s]."""
SLOP = 0.0005
"""Overlap that is left alone [m]."""
MENDED = 0.2
"""Share of the overlap beyond it that is mended in a physics step."""
FASTEST_MEND = 0.005
"""Largest mend of a physics step [m]."""
SWEEPS = 2
"""Times friction and pressure answer each other when a pair is worked."""
REPEATS = 2
"""Further times that pairs are worked which share a car with another touching pair."""


@dataclass(frozen=True)
class Boxes:
    """What stays the same of a batch of boxes over a control step."""

    half_length: Tensor
    """[m]."""
    half_width: Tensor
    """[m]."""
    inverse_mass: Tensor
    """[1/kg]; 0 for what cannot be pushed."""
    inverse_inertia: Tensor
    """[1/(kg m^2)]; 0 for what cannot be pushed."""


@dataclass(frozen=True)
class Parted:
    """What contacts change in a physics step, flattened cars, (num_worlds * num_cars,)."""

    velocity_x: Tensor
    """New velocity [m/s]."""
    velocity_y: Tensor
    """New velocity [m/s]."""
    yaw_rate: Tensor
    """New yaw rate [rad/s]."""
    shift_x: Tensor
    """Move that mends overlap [m]."""
    shift_y: Tensor
    """Move that mends overlap [m]."""


class Resolver:
    """Parts touching bodies through one control step, and keeps who touched whom."""

    def __init__(self, rounds: list[Round], cars: Boxes, cfg: SimConfig) -> None:
        """Gather what stays the same.

        Args:
            rounds: the pairs that may touch, at least one.
            cars: all cars, flattened to (num_worlds * num_cars,).
            cfg: contact settings and the physics step.
        """
        self._rounds = rounds
        self._contact = cfg.contact
        self._dt = cfg.physics_dt
        self._first = torch.cat([part.first for part in rounds])
        # Rounds between cars come before those against fixed bodies.
        moving = [part.second for part in rounds if part.second is not None]
        fixed = [part.fixed for part in rounds if part.fixed is not None]
        self._second = torch.cat(moving) if moving else self._first[:0]
        table = torch.stack(
            (cars.half_length, cars.half_width, cars.inverse_mass, cars.inverse_inertia)
        )
        bodies = torch.cat(fixed, dim=1) if fixed else table.new_zeros((7, 0))
        self._fixed = torch.cat((bodies[:5], torch.zeros_like(bodies[:1])))
        self._drift = torch.zeros_like(self._fixed)
        self._drift[:2] = bodies[3:5] * self._dt
        sides = torch.cat((bodies[5:], torch.zeros_like(bodies[5:])))
        self._first_box = Boxes(*table.index_select(1, self._first).unbind())
        self._second_box = Boxes(
            *torch.cat((table.index_select(1, self._second), sides), dim=1).unbind()
        )
        self._touched = torch.zeros_like(self._first, dtype=torch.bool)
        sizes = torch.tensor([part.first.numel() for part in rounds], device=self._first.device)
        self._ends = sizes.cumsum(0)
        # Which rows of impulses act along the same direction: both normals, and the tangent.
        self._linear = torch.zeros((3, 3, 1), dtype=table.dtype, device=table.device)
        self._linear[:2, :2] = self._linear[2, 2] = 1.0

    def part(self, motion: Motion) -> Parted | None:
        """Return what contacts change in a physics step; None when nothing touches.

        Args:
            motion: positions before, velocities after the step's forces.
        """
        state = torch.stack(
            (
                motion.x,
                motion.y,
                motion.yaw,
                motion.velocity_x,
                motion.velocity_y,
                motion.yaw_rate,
            )
        ).reshape(6, -1)
        first = state.index_select(1, self._first)
        second = torch.cat((state.index_select(1, self._second), self._fixed), dim=1)
        self._fixed = self._fixed + self._drift
        manifold = find_manifold(_pose(first, self._first_box), _pose(second, self._second_box))
        goal, hit = self._goals(manifold, first, second)
        deepest = torch.minimum(*manifold.gap.unbind())
        self._touched |= hit | (manifold.exists & (deepest <= 0))
        act = hit | (manifold.exists & (deepest < -SLOP))
        if not bool(act.any()):
            return None
        return self._work(state, act.nonzero().squeeze(1), manifold, goal)

    def contacts(self, world: World) -> Contacts:
        """Return what has touched what so far."""
        return _contacts(world, self._rounds, self._touched)

    def _goals(self, m: Manifold, first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
        """Return the least speed of parting asked at each point [m/s], and which pairs lack it."""
        _, _, _, a_vx, a_vy, a_w = first.unbind()
        _, _, _, b_vx, b_vy, b_w = second.unbind()
        speed_x = b_vx - b_w * m.second_y - (a_vx - a_w * m.first_y)
        speed_y = b_vy + b_w * m.second_x - (a_vy + a_w * m.first_x)
        parting = speed_x * m.normal_x + speed_y * m.normal_y
        # Bodies that would meet within this step bounce now; slow ones just close the gap.
        bounce = (parting < -RESTITUTION_FROM) & (m.gap + parting * self._dt < 0)
        closing = torch.clamp_min(m.gap, 0.0) * (-1.0 / self._dt)
        goal = torch.where(bounce, parting * -self._contact.restitution, closing)
        low, high = (parting < goal).unbind()
        return goal, m.exists & (low | high)

    def _work(self, state: Tensor, rows: Tensor, m: Manifold, goal: Tensor) -> Parted:
        """Work the pairs in these rows, round by round."""
        normal = torch.stack((m.normal_x, m.normal_y))
        arms = torch.cat((m.first_x, m.first_y, m.second_x, m.second_y))
        a, b = self._first_box, self._second_box
        masses = torch.stack((a.inverse_mass, a.inverse_inertia, b.inverse_mass, b.inverse_inertia))
        table = torch.cat((normal, arms, masses, m.gap, goal)).index_select(1, rows)
        velocity, shift = state[3:].clone(), torch.zeros_like(state[:2])
        batches = list(self._batches(rows, table))
        for batch in batches:
            batch.push(velocity)
        if len(batches) > 1:
            _repeat(batches, velocity)
        for batch in batches:
            batch.mend(shift)
        return Parted(*velocity.unbind(), *shift.unbind())

    def _batches(self, rows: Tensor, table: Tensor) -> Iterator[_Batch]:
        """Cut the pairs in these rows into their rounds."""
        low = 0
        for part, high in zip(
            self._rounds, torch.searchsorted(rows, self._ends).tolist(), strict=True
        ):
            mine, numbers = rows[low:high], table[:, low:high]
            if high > low:
                one, two, still = self._first.index_select(0, mine), None, None
                if part.second is None:
                    still = self._fixed[3:].index_select(1, mine - self._second.numel())
                else:
                    two = self._second.index_select(0, mine)
                yield _Batch(numbers, one, two, still, self._linear, self._contact.friction)
            low = high


def _repeat(batches: list[_Batch], velocity: Tensor) -> None:
    """Work the pairs again whose cars touch more than one body.

    Which they are does not depend on other worlds, so neither do their bits.
    """
    count = torch.zeros_like(velocity[0], dtype=torch.int64)
    for batch in batches:
        batch.count(count)
    again = [batch.is_shared(count) for batch in batches]
    if any(bool(pairs.any()) for pairs in again):
        for _ in range(REPEATS):
            for batch, pairs in zip(batches, again, strict=True):
                batch.push(velocity, pairs)


class _Batch:
    """Touching pairs of one round, and the impulses they have exchanged in this physics step.

    Three rows: both points along the normal, and the nearer one along the tangent (-n_y, n_x). Both
    normal rows are solved together and exactly; friction is solved as if they followed at once.
    """

    def __init__(
        self,
        table: Tensor,
        one: Tensor,
        two: Tensor | None,
        still: Tensor | None,
        linear: Tensor,
        friction: float,
    ) -> None:
        self._normal = (n_x, n_y) = table[:2].unbind()
        self._masses, self._gap = table[10:14].unbind(), table[14:16]
        self._goal = table[16:18].unbind()
        self._one, self._two, self._still, self._friction = one, two, still, friction
        first_x, first_y, second_x, second_y = table[2:10].unflatten(0, (4, 2)).unbind()
        self._turn_a = torch.cat((first_x * n_y - first_y * n_x, self._tangent(first_x, first_y)))
        self._turn_b = torch.cat(
            (second_x * n_y - second_y * n_x, self._tangent(second_x, second_y))
        )
        mass_a, inertia_a, mass_b, inertia_b = self._masses
        self._shared_a, self._shared_b = self._turn_a * inertia_a, self._turn_b * inertia_b
        # How an impulse along one row changes the speed along another: (3, 3, num_pairs).
        response = (
            linear * (mass_a + mass_b)
            + self._turn_a.unsqueeze(1) * self._shared_a
            + self._turn_b.unsqueeze(1) * self._shared_b
        )
        self._response = (a, b, c), (_, d, e), (_, _, f) = [row.unbind() for row in response]
        self._det = a * d - b * b
        # Two points that almost coincide cannot share the load.
        self._two_points = self._det > 1e-3 * a * d
        # The tangent's response while neither, the first, the second or both points press.
        both = f - (c * c * d - 2 * b * c * e + e * e * a) / torch.where(
            self._two_points, self._det, 1.0
        )
        self._tangent_responses = f, f - c * c / a, f - e * e / d, both
        self._none = torch.zeros_like(a)
        self._impulse = (self._none, self._none, self._none)

    def count(self, seats: Tensor) -> None:
        """Count these pairs at their cars, changing `seats` (num_cars,) in place."""
        for car in (self._one, self._two):
            if car is not None:
                seats.index_add_(0, car, torch.ones_like(car))

    def is_shared(self, seats: Tensor) -> Tensor:
        """Return the pairs with a car that is counted more than once."""
        shared = seats.index_select(0, self._one) > 1
        return shared if self._two is None else shared | (seats.index_select(0, self._two) > 1)

    def push(self, velocity: Tensor, only: Tensor | None = None) -> None:
        """Exchange impulses (of some pairs), changing `velocity` (3, num_cars) in place."""
        n_x, n_y = self._normal
        a = velocity.index_select(1, self._one)
        b = velocity.index_select(1, self._two) if self._two is not None else self._still
        assert b is not None
        (a_x, a_y, a_w), (b_x, b_y, b_w) = a.unbind(), b.unbind()
        x, y = b_x - a_x, b_y - a_y
        along, across = x * n_x + y * n_y, y * n_x - x * n_y
        speed = torch.stack((along, along, across)) + self._turn_b * b_w - self._turn_a * a_w
        before = self._impulse
        after = self._solve(speed, *before)
        if only is not None:
            after = tuple(torch.where(only, x, y) for x, y in zip(after, before, strict=True))
        first, second, across = (x - y for x, y in zip(after, before, strict=True))
        self._impulse = after
        along = first + second
        x, y = along * n_x - across * n_y, along * n_y + across * n_x
        mass_a, _, mass_b, _ = self._masses
        turn_1, turn_2, turn_3 = self._shared_a.unbind()
        turned = turn_1 * first + turn_2 * second + turn_3 * across
        velocity.index_add_(1, self._one, -torch.stack((x * mass_a, y * mass_a, turned)))
        if self._two is not None:
            turn_1, turn_2, turn_3 = self._shared_b.unbind()
            turned = turn_1 * first + turn_2 * second + turn_3 * across
            velocity.index_add_(1, self._two, torch.stack((x * mass_b, y * mass_b, turned)))

    def mend(self, shift: Tensor) -> None:
        """Move boxes that overlap apart, by their masses, changing `shift` (2, num_cars)."""
        depth = -torch.minimum(*self._gap.unbind()) - SLOP
        amount = torch.clamp(depth * MENDED, 0.0, FASTEST_MEND)
        mass_a, _, mass_b, _ = self._masses
        move = torch.stack(self._normal) * (amount / (mass_a + mass_b))
        shift.index_add_(1, self._one, -move * mass_a)
        if self._two is not None:
            shift.index_add_(1, self._two, move * mass_b)

    def _tangent(self, x: Tensor, y: Tensor) -> Tensor:
        """Return the tangent's lever at the nearer point, (1, num_pairs)."""
        n_x, n_y = self._normal
        lever = x * n_x + y * n_y
        return torch.where(self._gap[0] <= self._gap[1], lever[0], lever[1]).unsqueeze(0)

    def _solve(
        self, speed: Tensor, first: Tensor, second: Tensor, across: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return the impulses that part the pair, given those already at work in `speed`."""
        (a, b, c), (_, d, e), (_, _, f) = self._response
        free_1, free_2, free_3 = speed.unbind()
        lack_1 = free_1 - (a * first + b * second + c * across) - self._goal[0]
        lack_2 = free_2 - (b * first + d * second + e * across) - self._goal[1]
        slip = free_3 - (c * first + e * second + f * across)
        first, second = self._press(lack_1 + c * across, lack_2 + e * across)
        for _ in range(SWEEPS):
            none, one, other, both = self._tangent_responses
            press_1, press_2 = first > self._none, second > self._none
            response = torch.where(
                press_1, torch.where(press_2, both, one), torch.where(press_2, other, none)
            )
            most = (first + second) * self._friction
            now = slip + c * first + e * second + f * across
            across = torch.clamp(across - now / response, -most, most)
            first, second = self._press(lack_1 + c * across, lack_2 + e * across)
        return first, second, across

    def _press(self, lack_1: Tensor, lack_2: Tensor) -> tuple[Tensor, Tensor]:
        """Return the two normal impulses: neither pulls, and no point is left short of its goal."""
        (a, b, _), (_, d, _), _ = self._response
        both_1, both_2 = (
            (b * lack_2 - d * lack_1) / self._det,
            (b * lack_1 - a * lack_2) / self._det,
        )
        none = self._none
        both = self._two_points & (both_1 >= none) & (both_2 >= none)
        only_1, only_2 = torch.clamp_min(-lack_1 / a, 0.0), torch.clamp_min(-lack_2 / d, 0.0)
        enough = b * only_1 + lack_2 >= none
        first = torch.where(both, both_1, torch.where(enough, only_1, none))
        second = torch.where(both, both_2, torch.where(enough, none, only_2))
        return first, second


def _pose(state: Tensor, box: Boxes) -> Pose:
    x, y, yaw, *_ = state.unbind()
    return Pose(x, y, torch.cos(yaw), torch.sin(yaw), box.half_length, box.half_width)


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
