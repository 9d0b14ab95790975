"""Compiled: where oriented boxes touch, or would, and which impulses part them.

Touching is found by separating axes and edge clipping after E. Catto's Box2D-Lite: the face that
separates the boxes best is the reference, the other box's face that looks at it most is clipped to
its width, and the clipped edge's two ends are the contact points. Points exist before the boxes
touch, so that the solver can look one step ahead. The normal impulses at both points are solved
together and exactly (the block solver of Box2D); friction acts at the nearer one.

All numbers are float32. A body is a row X, Y, YAW, VX, VY, TURN; its box a row of half length, half
width [m], inverse mass [1/kg], inverse inertia [1/(kg m^2)] and distance of its corners [m].
"""

import math

import numpy as np

from league.jit import inner
from league.portable_math import sincos
from league.sim.settings import RESTITUTION_FROM

X, Y, YAW, VX, VY, TURN = range(6)
"""Columns of a body: world frame [m, rad], velocity [m/s] and yaw rate [rad/s]."""

_RESTITUTION_FROM = np.float32(RESTITUTION_FROM)
SLOP = np.float32(0.0005)  # overlap that is left alone [m]
MENDED = np.float32(0.2)  # share of the overlap beyond it that is mended in a physics step
FASTEST_MEND = np.float32(0.005)  # largest mend of a physics step [m]
SWEEPS = 2  # times friction and pressure answer each other when a pair is worked
REPEATS = 2  # further times that pairs are worked which share a car with another acting pair
_UNKNOWN = np.float32(2.0)  # stands for a cosine that has not been worked out
_TOGETHER = np.float32(1e-3)  # two points that almost coincide cannot share the load
_ZERO, _HALF, _ONE, _TWO = (np.float32(number) for number in (0.0, 0.5, 1.0, 2.0))


@inner(allocates=True)
def arrays_of(count):
    """Return arrays for `part`, which `views_of` takes apart; row k is of body k, and of pair k.

    Made once a control step, and only two: making one takes as long as some sines.
    """
    return np.empty((count, 32), np.float32), np.empty((count, 5), np.int64)


@inner
def views_of(arrays):
    """Return bodies, boxes, shift, pairs, touched and scratch, as `part` has them."""
    numbers, marks = arrays
    bodies, boxes, shift = numbers[:, :6], numbers[:, 6:11], numbers[:, 11:13]
    turn, touch, impulse = numbers[:, 13:15], numbers[:, 15:29], numbers[:, 29:]
    return (
        bodies,
        boxes,
        shift,
        marks[:, :2],
        marks[:, 2],
        (turn, marks[:, 3], marks[:, 4], touch, impulse),
    )


@inner
def part(bodies, boxes, shift, pairs, touched, scratch, dt, restitution, friction):
    """Change how bodies that touch move in a physics step; return whether any exchanged impulses.

    Pairs are worked in their order, one after the other. Which of them are worked again does not
    depend on other worlds, so neither do a world's bits.

    Args:
        bodies: where they are and how they would move, float32 (num_bodies, 6); the velocities
            are changed in place.
        boxes: their sizes and what they resist with, float32 (num_bodies, 5).
        shift: set to how far overlap moves each body of a pair, float32 (num_bodies, 2) [m].
        pairs: the bodies of each pair, int64 (num_pairs, 2).
        touched: set to 1 where a pair touches, int64 (num_pairs,).
        scratch: of `views_of`.
        dt: the physics step [s].
        restitution: share of the approach speed that comes back.
        friction: coefficient between two bodies.
    """
    turn, busy, acting, touch, impulse = scratch
    for pair in range(len(pairs)):
        for body in (pairs[pair, 0], pairs[pair, 1]):
            shift[body, 0], shift[body, 1], busy[body] = _ZERO, _ZERO, 0
            turn[body, 0] = _UNKNOWN
    number = 0
    for pair in range(len(pairs)):
        one, two = pairs[pair, 0], pairs[pair, 1]
        if _are_apart(bodies[one], boxes[one], bodies[two], boxes[two], dt):
            continue
        for body in (one, two):
            if turn[body, 0] == _UNKNOWN:
                turn[body, 1], turn[body, 0] = sincos(bodies[body, YAW])
        meeting = touch[number]
        if not manifold(
            bodies[one], turn[one], boxes[one], bodies[two], turn[two], boxes[two], meeting
        ):
            continue
        hit = _goals(bodies[one], bodies[two], meeting, dt, restitution)
        deepest = min(meeting[2], meeting[3])
        if hit or deepest <= _ZERO:
            touched[pair] = 1
        if hit or deepest < -SLOP:
            acting[number] = pair
            number += 1
    if number == 0:
        return False
    for k in range(number):
        impulse[k, 0], impulse[k, 1], impulse[k, 2] = _ZERO, _ZERO, _ZERO
        one, two = pairs[acting[k], 0], pairs[acting[k], 1]
        busy[one] += 1
        busy[two] += 1
        _push(bodies, boxes, one, two, touch[k], impulse[k], friction)
    for _ in range(REPEATS):
        for k in range(number):
            one, two = pairs[acting[k], 0], pairs[acting[k], 1]
            if busy[one] > 1 or busy[two] > 1:
                _push(bodies, boxes, one, two, touch[k], impulse[k], friction)
    for k in range(number):
        _mend(shift, boxes, pairs[acting[k], 0], pairs[acting[k], 1], touch[k])
    return True


@inner
def _are_apart(one, box_one, two, box_two, dt):
    """Return whether two boxes are too far apart, whatever their yaw, to meet in this step."""
    closing = abs(two[VX] - one[VX]) + abs(two[VY] - one[VY])
    closing += abs(one[TURN]) * box_one[4] + abs(two[TURN]) * box_two[4]
    room = box_one[4] + box_two[4] + closing * dt + SLOP  # more than rounding takes away
    dx, dy = two[X] - one[X], two[Y] - one[Y]
    return dx * dx + dy * dy > room * room


@inner
def manifold(one, turn_one, box_one, two, turn_two, box_two, out):
    """Find where two boxes touch, or would; return whether their faces lie opposite at all.

    Each is a body, cosine and sine of its yaw, and its box. `out` is set to the unit vector from
    the first box to the second; at each of both points the distance between the boxes along it [m],
    negative in overlap; and the points, relative to the first box's centre and to the second's,
    world frame [m]: two x, two y, two x, two y.
    """
    a_cos, a_sin, b_cos, b_sin = turn_one[0], turn_one[1], turn_two[0], turn_two[1]
    a_length, a_width, b_length, b_width = box_one[0], box_one[1], box_two[0], box_two[1]
    dx, dy = two[X] - one[X], two[Y] - one[Y]
    a_x, a_y = a_cos * dx + a_sin * dy, a_cos * dy - a_sin * dx
    b_x, b_y = b_cos * dx + b_sin * dy, b_cos * dy - b_sin * dx
    cos = a_cos * b_cos + a_sin * b_sin
    sin = a_cos * b_sin - a_sin * b_cos
    c, s = abs(cos), abs(sin)
    gap_length = abs(a_x) - a_length - (b_length * c + b_width * s)
    gap_width = abs(a_y) - a_width - (b_length * s + b_width * c)
    other_length = abs(b_x) - b_length - (a_length * c + a_width * s)
    other_width = abs(b_y) - b_width - (a_length * s + a_width * c)
    # The box with the face that separates best is the reference; its face's normal is the normal.
    flip = max(other_length, other_width) > max(gap_length, gap_width)
    x, y, ref_cos, ref_sin = a_x, a_y, a_cos, a_sin
    length, width, i_length, i_width = a_length, a_width, b_length, b_width
    if flip:
        x, y, sin, ref_cos, ref_sin = -b_x, -b_y, -sin, b_cos, b_sin
        length, width, i_length, i_width = b_length, b_width, a_length, a_width
        gap_length, gap_width = other_length, other_width
    # Face frame of the reference: n outward, t = n turned left.
    if gap_length > gap_width:
        n_x, n_y, half_n, half_t, along = math.copysign(_ONE, x), _ZERO, length, width, abs(x)
    else:
        n_x, n_y, half_n, half_t, along = _ZERO, math.copysign(_ONE, y), width, length, abs(y)
    # Incident box's length axis u in that frame, and its face that looks at the reference most.
    u_n, u_t = n_x * cos + n_y * sin, n_x * sin - n_y * cos
    if abs(u_n) > abs(u_t):
        f_n, f_t, deep, half = u_n, u_t, i_length, i_width
    else:
        f_n, f_t, deep, half = -u_t, u_n, i_width, i_length
    deep = math.copysign(deep, f_n)
    edge_n, edge_t = along - deep * f_n, n_x * y - n_y * x - deep * f_t
    # The edge is (edge_n, edge_t) + q (run_n, run_t), run_t > 0; clip it to the face.
    run_n, run_t = -f_t * math.copysign(_ONE, f_n), abs(f_n)
    low = max(-half, (-half_t - edge_t) / run_t)
    high = min(half, (half_t - edge_t) / run_t)
    if not low <= high:
        return False
    sign, from_x, from_y = _ONE, _ZERO, _ZERO
    if flip:
        sign, from_x, from_y = -_ONE, dx, dy
    out[0] = sign * (ref_cos * n_x - ref_sin * n_y)
    out[1] = sign * (ref_sin * n_x + ref_cos * n_y)
    for k in range(2):
        q = high if k else low
        gap = edge_n + q * run_n - half_n
        # Contact points lie midway between face and edge.
        p_n, p_t = half_n + gap * _HALF, edge_t + q * run_t
        p_x, p_y = n_x * p_n - n_y * p_t, n_y * p_n + n_x * p_t
        out[2 + k] = gap
        out[4 + k] = ref_cos * p_x - ref_sin * p_y + from_x
        out[6 + k] = ref_sin * p_x + ref_cos * p_y + from_y
        out[8 + k], out[10 + k] = out[4 + k] - dx, out[6 + k] - dy
    return True


@inner
def _goals(one, two, touch, dt, restitution):
    """Add the least speed of parting asked at each point [m/s]; return whether any lacks it."""
    n_x, n_y = touch[0], touch[1]
    lacking = False
    for k in range(2):
        gap = touch[2 + k]
        speed_x = two[VX] - two[TURN] * touch[10 + k] - (one[VX] - one[TURN] * touch[6 + k])
        speed_y = two[VY] + two[TURN] * touch[8 + k] - (one[VY] + one[TURN] * touch[4 + k])
        parting = speed_x * n_x + speed_y * n_y
        # Bodies that would meet within this step bounce now; slow ones just close the gap.
        if parting < -_RESTITUTION_FROM and gap + parting * dt < _ZERO:
            goal = parting * -restitution
        else:
            goal = max(gap, _ZERO) * (-_ONE / dt)
        touch[12 + k] = goal
        lacking |= parting < goal
    return lacking


@inner
def _push(bodies, boxes, one, two, touch, impulse, friction):
    """Exchange what a pair's impulses lack, changing both velocities.

    Three rows: both points along the normal n, and the nearer one along the tangent (-n_y, n_x).
    Both normal rows are solved together and exactly, friction as if they followed at once.
    """
    n_x, n_y = touch[0], touch[1]
    near = 0 if touch[2] <= touch[3] else 1
    mass_a, inertia_a = boxes[one, 2], boxes[one, 3]
    mass_b, inertia_b = boxes[two, 2], boxes[two, 3]
    a_1, a_2 = touch[4] * n_y - touch[6] * n_x, touch[5] * n_y - touch[7] * n_x
    b_1, b_2 = touch[8] * n_y - touch[10] * n_x, touch[9] * n_y - touch[11] * n_x
    a_3 = touch[4 + near] * n_x + touch[6 + near] * n_y
    b_3 = touch[8 + near] * n_x + touch[10 + near] * n_y
    # How an impulse along one row changes the speed along another, a symmetric 3 x 3:
    mass = mass_a + mass_b
    a = mass + a_1 * (a_1 * inertia_a) + b_1 * (b_1 * inertia_b)
    b = mass + a_1 * (a_2 * inertia_a) + b_1 * (b_2 * inertia_b)
    c = a_1 * (a_3 * inertia_a) + b_1 * (b_3 * inertia_b)
    d = mass + a_2 * (a_2 * inertia_a) + b_2 * (b_2 * inertia_b)
    e = a_2 * (a_3 * inertia_a) + b_2 * (b_3 * inertia_b)
    f = mass + a_3 * (a_3 * inertia_a) + b_3 * (b_3 * inertia_b)
    x, y = bodies[two, VX] - bodies[one, VX], bodies[two, VY] - bodies[one, VY]
    along, across = x * n_x + y * n_y, y * n_x - x * n_y
    a_w, b_w = bodies[one, TURN], bodies[two, TURN]
    old_1, old_2, old_3 = impulse[0], impulse[1], impulse[2]
    # Speeds had no impulse been exchanged yet.
    free_1 = along + b_1 * b_w - a_1 * a_w - (a * old_1 + b * old_2 + c * old_3)
    free_2 = along + b_2 * b_w - a_2 * a_w - (b * old_1 + d * old_2 + e * old_3)
    free_3 = across + b_3 * b_w - a_3 * a_w - (c * old_1 + e * old_2 + f * old_3)
    first, second, third = _solved(
        (a, b, c, d, e, f), free_1 - touch[12], free_2 - touch[13], free_3, old_3, friction
    )
    impulse[0], impulse[1], impulse[2] = first, second, third
    first, second, third = first - old_1, second - old_2, third - old_3
    along = first + second
    x, y = along * n_x - third * n_y, along * n_y + third * n_x
    bodies[one, VX] -= x * mass_a
    bodies[one, VY] -= y * mass_a
    bodies[one, TURN] -= (a_1 * first + a_2 * second + a_3 * third) * inertia_a
    bodies[two, VX] += x * mass_b
    bodies[two, VY] += y * mass_b
    bodies[two, TURN] += (b_1 * first + b_2 * second + b_3 * third) * inertia_b


@inner
def _solved(response, lack_1, lack_2, slip, third, friction):
    """Return the impulses that part a pair: both normal ones and friction.

    `response` is the upper half of the matrix (a b c; b d e; c e f), `lack` how much speed of
    parting each point lacks [m/s], negative if it does, `slip` the speed along the tangent [m/s],
    and `third` the first guess of friction's impulse.
    """
    a, b, c, d, e, f = response
    det = a * d - b * b
    two_points = det > _TOGETHER * a * d
    first, second = _pressed(a, b, d, det, two_points, lack_1 + c * third, lack_2 + e * third)
    for _ in range(SWEEPS):
        # The tangent's response while neither, the first, the second or both points press.
        answer = f
        if first > _ZERO and second > _ZERO:
            part = c * c * d - _TWO * b * c * e + e * e * a
            answer = f - (part / det if two_points else part)
        elif first > _ZERO:
            answer = f - c * c / a
        elif second > _ZERO:
            answer = f - e * e / d
        most = (first + second) * friction
        now = slip + c * first + e * second + f * third
        third = min(max(third - now / answer, -most), most)
        first, second = _pressed(a, b, d, det, two_points, lack_1 + c * third, lack_2 + e * third)
    return first, second, third


@inner
def _pressed(a, b, d, det, two_points, lack_1, lack_2):
    """Return the two normal impulses: neither pulls, and no point is left short of its goal."""
    if two_points:
        first, second = (b * lack_2 - d * lack_1) / det, (b * lack_1 - a * lack_2) / det
        if first >= _ZERO and second >= _ZERO:
            return first, second
    alone = max(lack_1 / -a, _ZERO)
    if b * alone + lack_2 >= _ZERO:
        return alone, _ZERO
    return _ZERO, max(lack_2 / -d, _ZERO)


@inner
def _mend(shift, boxes, one, two, touch):
    """Move boxes that overlap apart, by their masses."""
    depth = -min(touch[2], touch[3]) - SLOP
    amount = min(max(depth * MENDED, _ZERO), FASTEST_MEND)
    mass_a, mass_b = boxes[one, 2], boxes[two, 2]
    for axis in range(2):
        move = touch[axis] * (amount / (mass_a + mass_b))
        shift[one, axis] -= move * mass_a
        shift[two, axis] += move * mass_b
