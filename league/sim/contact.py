"""Contacts of the planar solver: what impulses part boxes that touch.

Cars, obstacles and walls are all oriented boxes. A pair touches at up to two points, whose normal
impulses are solved together and exactly (the block solver of E. Catto's Box2D), and rubs at one.
Only pairs that touch cost anything: a pair that does not touch would have received an impulse of
exactly zero, so skipping it changes no bit.

Vectors over pairs have shape (num_pairs,); those over both contact points (2, num_pairs). Bodies
are the cars of all pairs, each once, followed by the obstacle or wall of each pair that has one.
Arrays are numpy's on the CPU and torch's elsewhere (see the room `manifold`); in a round no body
occurs twice, so `array[:, bodies] += change` misses nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from league.sim.config import SimConfig
from league.sim.manifold import Array, Manifold, Pose, find_manifold, module_of, rows
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

    half_length: Array
    """[m]."""
    half_width: Array
    """[m]."""
    inverse_mass: Array
    """[1/kg]; 0 for what cannot be pushed."""
    inverse_inertia: Array
    """[1/(kg m^2)]; 0 for what cannot be pushed."""


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
        firsts = [_array(part.first) for part in rounds]
        # Rounds between cars come before those against fixed bodies.
        seconds = [_array(part.second) for part in rounds if part.second is not None]
        fixed = [_array(part.fixed) for part in rounds if part.fixed is not None]
        xp = module_of(firsts[0])
        self._near, seats = xp.unique(xp.concat(firsts + seconds), return_inverse=True)
        self._ends = np.cumsum([len(first) for first in firsts])
        num_pairs = int(self._ends[-1])
        boxes = rows(
            tuple(
                _array(field)[self._near]
                for field in (
                    cars.half_length, cars.half_width, cars.inverse_mass, cars.inverse_inertia
                )
            )
        )  # fmt: skip
        bodies = xp.concat(fixed, 1) if fixed else xp.zeros_like(boxes[:1, :0])
        num_fixed = bodies.shape[1]
        self._num_bodies = len(self._near) + num_fixed
        self._first, self._second = seats[:num_pairs], seats[num_pairs:]
        if fixed:
            # A fixed body sits behind the cars, has no inverse mass and turns as it did.
            numbers = xp.zeros_like(bodies[0], dtype=seats.dtype) + len(self._near)
            self._second = xp.concat(
                (self._second, numbers + xp.cumsum(xp.ones_like(numbers), 0) - 1)
            )
            boxes = xp.concat((boxes, xp.concat((bodies[5:], xp.zeros_like(bodies[5:])))), 1)
            x, y, yaw, velocity_x, velocity_y = bodies[:5]
            bodies = rows((x, y, *_turned(yaw), velocity_x, velocity_y, xp.zeros_like(x)))
            self._drift = bodies[4:6] * self._dt
        self._fixed = bodies
        self._first_box = Boxes(*boxes[:, self._first])
        self._second_box = Boxes(*boxes[:, self._second])
        self._masses = xp.concat((boxes[2:, self._first], boxes[2:, self._second]))
        self._touched = xp.zeros_like(self._first, dtype=bool if xp is np else torch.bool)
        # Which rows of impulses act along the same direction: both normals, and the tangent.
        linear = torch.zeros((3, 3, 1), dtype=cars.half_length.dtype)
        linear[:2, :2] = linear[2, 2] = 1.0
        self._linear = _array(linear.to(cars.half_length.device))

    def part(self, before: Motion, motion: Motion) -> None:
        """Change how the cars that touch move in a physics step, and mend their overlap.

        Args:
            before: the motion before the step.
            motion: the motion after a step without contacts; changed in place.
        """
        # The point of a face that faces nothing may divide by zero; `exists` discards it.
        with np.errstate(all="ignore"):
            place, bodies = self._bodies(before, motion)
            first, second = bodies[:, self._first], bodies[:, self._second]
            manifold = find_manifold(_pose(first, self._first_box), _pose(second, self._second_box))
            goal, hit = self._goals(manifold, first, second)
            deepest = module_of(goal).minimum(*manifold.gap)
            self._touched |= hit | (manifold.exists & (deepest <= 0))
            act = hit | (manifold.exists & (deepest < -SLOP))
            if bool(act.any()):
                shift = self._work(bodies[4:], act, manifold, goal)
                self._move(place, bodies[4:], shift, motion)

    def contacts(self, world: World) -> Contacts:
        """Return what has touched what so far."""
        return _contacts(world, self._rounds, torch.as_tensor(self._touched))

    def _bodies(self, before: Motion, motion: Motion) -> tuple[Array, Array]:
        """Return where cars are, x, y, yaw (3, num_near); and all bodies, (7, num_bodies).

        A body's rows are x, y, cos, sin of its heading, velocities and yaw rate.
        """
        x, y, yaw, *velocity = (
            _array(field).take(self._near)
            for field in (
                before.x, before.y, before.yaw,
                motion.velocity_x, motion.velocity_y, motion.yaw_rate,
            )
        )  # fmt: skip
        bodies = rows((x, y, *_turned(yaw), *velocity))
        if self._fixed.shape[1]:
            bodies = module_of(bodies).concat((bodies, self._fixed), 1)
            self._fixed[:2] += self._drift
        return rows((x, y, yaw)), bodies

    def _move(self, place: Array, velocity: Array, shift: Array, motion: Motion) -> None:
        """Put the cars' new velocities, and where they lead, into `motion`."""
        velocity = velocity[:, : len(self._near)]
        place = (place + shift[:, : len(self._near)]) + velocity * self._dt
        fields = (motion.x, motion.y, motion.yaw)
        fields += (motion.velocity_x, motion.velocity_y, motion.yaw_rate)
        for field, new in zip(fields, (*place, *velocity), strict=True):
            _put(field, self._near, new)

    def _goals(self, m: Manifold, first: Array, second: Array) -> tuple[Array, Array]:
        """Return the least speed of parting asked at each point [m/s], and which pairs lack it."""
        xp = module_of(m.gap)
        a_vx, a_vy, a_w = first[4:]
        b_vx, b_vy, b_w = second[4:]
        speed_x = b_vx - b_w * m.second_y - (a_vx - a_w * m.first_y)
        speed_y = b_vy + b_w * m.second_x - (a_vy + a_w * m.first_x)
        parting = speed_x * m.normal_x + speed_y * m.normal_y
        # Bodies that would meet within this step bounce now; slow ones just close the gap.
        bounce = (parting < -RESTITUTION_FROM) & (m.gap + parting * self._dt < 0)
        closing = xp.maximum(m.gap, xp.zeros_like(m.gap)) * (-1.0 / self._dt)
        goal = xp.where(bounce, parting * -self._contact.restitution, closing)
        low, high = parting < goal
        return goal, m.exists & (low | high)

    def _work(self, velocity: Array, act: Array, m: Manifold, goal: Array) -> Array:
        """Work the pairs that act, changing `velocity` (3, num_bodies).

        Returns how far overlap moves them: x, y and yaw, (3, num_bodies).
        """
        xp = module_of(velocity)
        (mine,) = xp.where(act)
        table = xp.concat(
            (
                m.normal_x[None], m.normal_y[None], m.first_x, m.first_y, m.second_x, m.second_y,
                self._masses, m.gap, goal,
            )
        )[:, mine]  # fmt: skip
        one, two = self._first[mine], self._second[mine]
        ends = np.searchsorted(np.asarray(mine.tolist()), self._ends).tolist()
        cuts = [slice(*cut) for cut in zip([0, *ends], ends, strict=False) if cut[1] > cut[0]]
        batches = [
            _Batch(table[:, cut], one[cut], two[cut], self._linear, self._contact.friction)
            for cut in cuts
        ]
        for batch in batches:
            batch.push(velocity)
        if len(batches) > 1:
            # Pairs whose cars touch more than one body are worked again. Which they are does not
            # depend on other worlds, so neither do their bits.
            count = xp.bincount(xp.concat((one, two)), minlength=self._num_bodies)
            again = (count[one] > 1) | (count[two] > 1)
            for _ in range(REPEATS if bool(again.any()) else 0):
                for batch, cut in zip(batches, cuts, strict=True):
                    batch.push(velocity, again[cut])
        shift = xp.zeros_like(velocity)
        for batch in batches:
            batch.mend(shift)
        return shift


class _Batch:
    """Touching pairs of one round, and the impulses they have exchanged in this physics step.

    Three rows: both points along the normal, and the nearer one along the tangent (-n_y, n_x). Both
    normal rows are solved together and exactly; friction is solved as if they followed at once.
    """

    def __init__(
        self, table: Array, one: Array, two: Array, linear: Array, friction: float
    ) -> None:
        self._xp = xp = module_of(table)
        self._normal = n_x, n_y = tuple(table[:2])
        self._masses, self._gap, self._goal = tuple(table[10:14]), table[14:16], table[16:18]
        self._one, self._two, self._friction = one, two, friction
        first_x, first_y, second_x, second_y = table[2:10].reshape(4, 2, -1)
        self._turn_a = xp.concat((first_x * n_y - first_y * n_x, self._tangent(first_x, first_y)))
        self._turn_b = xp.concat(
            (second_x * n_y - second_y * n_x, self._tangent(second_x, second_y))
        )
        mass_a, inertia_a, mass_b, inertia_b = self._masses
        self._shared_a, self._shared_b = self._turn_a * inertia_a, self._turn_b * inertia_b
        # How an impulse along one row changes the speed along another: (3, 3, num_pairs).
        response = (
            linear * (mass_a + mass_b)
            + self._turn_a[:, None] * self._shared_a
            + self._turn_b[:, None] * self._shared_b
        )
        (a, b, c), (_, d, e), (_, _, f) = response
        # Its halves may differ in the last bit; the upper one counts.
        self._response = response[0], rows((b, d, e)), response[:, 2]
        self._a, self._d, self._mutual, self._minus_own = a, d, b, -rows((a, d))
        self._det = a * d - b * b
        # Two points that almost coincide cannot share the load.
        self._two_points = self._det > 1e-3 * a * d
        # The tangent's response while neither, the first, the second or both points press.
        both = f - (c * c * d - 2 * b * c * e + e * e * a) / xp.where(
            self._two_points, self._det, 1.0
        )
        self._tangent_responses = f, f - c * c / a, f - e * e / d, both
        self._nones = xp.zeros_like(self._gap)
        self._none = self._nones[0]
        self._impulse = None

    def push(self, velocity: Array, only: Array | None = None) -> None:
        """Exchange impulses, changing `velocity` (3, num_bodies); later of some pairs only."""
        n_x, n_y = self._normal
        a_x, a_y, a_w = velocity[:, self._one]
        b_x, b_y, b_w = velocity[:, self._two]
        x, y = b_x - a_x, b_y - a_y
        along, across = x * n_x + y * n_y, y * n_x - x * n_y
        speed = rows((along, along, across)) + self._turn_b * b_w - self._turn_a * a_w
        before = self._impulse
        if before is None:
            first, second, across = self._impulse = self._solve(speed, self._none)
        else:
            of_1, of_2, of_3 = self._response
            first, second, across = before
            free = speed - (of_1 * first + of_2 * second + of_3 * across)
            solved = self._solve(free, across)
            after = tuple(self._xp.where(only, x, y) for x, y in zip(solved, before, strict=True))
            first, second, across = (x - y for x, y in zip(after, before, strict=True))
            self._impulse = after
        along = first + second
        x, y = along * n_x - across * n_y, along * n_y + across * n_x
        mass_a, _, mass_b, _ = self._masses
        turn_1, turn_2, turn_3 = self._shared_a
        turned = turn_1 * first + turn_2 * second + turn_3 * across
        velocity[:, self._one] -= rows((x * mass_a, y * mass_a, turned))
        turn_1, turn_2, turn_3 = self._shared_b
        turned = turn_1 * first + turn_2 * second + turn_3 * across
        velocity[:, self._two] += rows((x * mass_b, y * mass_b, turned))

    def mend(self, shift: Array) -> None:
        """Move boxes that overlap apart, by their masses, changing `shift` (3, num_bodies)."""
        depth = -self._xp.minimum(*self._gap) - SLOP
        amount = self._xp.clip(depth * MENDED, 0.0, FASTEST_MEND)
        mass_a, _, mass_b, _ = self._masses
        move = rows(self._normal) * (amount / (mass_a + mass_b))
        shift[:2, self._one] -= move * mass_a
        shift[:2, self._two] += move * mass_b

    def _tangent(self, x: Array, y: Array) -> Array:
        """Return the tangent's lever at the nearer point, (1, num_pairs)."""
        n_x, n_y = self._normal
        lever = x * n_x + y * n_y
        return self._xp.where(self._gap[0] <= self._gap[1], lever[0], lever[1])[None]

    def _solve(self, free: Array, across: Array) -> tuple[Array, Array, Array]:
        """Return the impulses that part the pair.

        Args:
            free: speeds of parting had no impulse been exchanged [m/s], (3, num_pairs).
            across: the first guess of the impulse along the tangent.
        """
        xp = self._xp
        by_tangent = self._response[2][:2]
        c, e, f = self._response[2]
        lack, slip = free[:2] - self._goal, free[2]
        first, second = self._press(lack + by_tangent * across)
        for _ in range(SWEEPS):
            none, one, other, both = self._tangent_responses
            press_1, press_2 = first > self._none, second > self._none
            response = xp.where(
                press_1, xp.where(press_2, both, one), xp.where(press_2, other, none)
            )
            most = (first + second) * self._friction
            now = slip + c * first + e * second + f * across
            across = xp.minimum(xp.maximum(across - now / response, -most), most)
            first, second = self._press(lack + by_tangent * across)
        return first, second, across

    def _press(self, lack: Array) -> tuple[Array, Array]:
        """Return the two normal impulses: neither pulls, and no point is left short of its goal.

        Args:
            lack: how much speed of parting each point lacks [m/s], (2, num_pairs).
        """
        xp, none, b = self._xp, self._none, self._mutual
        lack_1, lack_2 = lack
        both_1 = (b * lack_2 - self._d * lack_1) / self._det
        both_2 = (b * lack_1 - self._a * lack_2) / self._det
        both = self._two_points & (both_1 >= none) & (both_2 >= none)
        only_1, only_2 = xp.maximum(lack / self._minus_own, self._nones)
        enough = b * only_1 + lack_2 >= none
        first = xp.where(both, both_1, xp.where(enough, only_1, none))
        second = xp.where(both, both_2, xp.where(enough, none, only_2))
        return first, second


def _array(tensor: Tensor) -> Array:
    """Return the tensor itself or, on the CPU, numpy's view of it."""
    return tensor.detach().numpy() if tensor.device.type == "cpu" else tensor


def _put(tensor: Tensor, places: Array, values: Array) -> None:
    """Change elements of the tensor, counted as if it had a single axis, in place."""
    array = _array(tensor)
    (array.put if isinstance(array, np.ndarray) else array.put_)(places, values)


def _turned(yaw: Array) -> tuple[Array, Array]:
    """Return cosine and sine; torch's, since numpy's may depend on an element's place."""
    turn = torch.as_tensor(yaw)
    return _array(torch.cos(turn)), _array(torch.sin(turn))


def _pose(state: Array, box: Boxes) -> Pose:
    x, y, cos, sin, *_ = state
    return Pose(x, y, cos, sin, box.half_length, box.half_width)


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
