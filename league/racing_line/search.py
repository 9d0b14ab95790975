"""Compiled: how fast a car may go on a line, and the search for the fastest line.

The car is quasi-steady: lateral acceleration v^2 * curvature and longitudinal acceleration share
the tyres' grip, within the limits of drive and brakes; two passes give the speed on a line.

A line is a uniform cubic B-spline along a smoothed centreline. Its control points are moved along
the normals, so place, slope and bend at every point follow from three of them. The search, a
barrier method on offsets and speeds together, minimises TIME, not curvature. Unknowns are the
lateral offset of each control point and the squared speed e at each point. With curvature k and
distance d to the next point, the longitudinal acceleration is a = (e' - e) / 2 d and the lateral
one y = k e. Every iterate keeps all rules; a barrier that falls from round to round keeps it away
from their bounds (J. Nocedal and S. Wright, Numerical Optimization, chapter 19). The two passes
say which line is fastest.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from league.jit import compiled, inner
from league.portable_math import direction
from league.sim.config import CarConfig
from league.sim.settings import GRAVITY
from league.track.projection import frame_at

FOLD = 0.8
"""Largest curvature times lateral offset: beyond, lines across a bend would run backwards."""
SMOOTH = 0.4
"""Width of the average that takes kinks out of the centreline before lines are sought [m]."""
_SAMPLES = 26  # centre points on either side that the average takes

ROAD = np.dtype(
    [
        ("s", np.float64),  # distance along the centreline [m]
        ("x", np.float64),  # smoothed centreline, world frame [m]
        ("y", np.float64),
        ("normal_x", np.float64),  # unit normal of it to the left
        ("normal_y", np.float64),
        ("low", np.float64),  # smallest lateral place, from it [m]
        ("high", np.float64),  # largest lateral place, from it [m]
        ("aside", np.float64),  # where the centreline itself lies, from it [m]
    ]
)
"""A point of the road. An open one has a point more before its start and after its end."""

BEND, SIZE, PLACE = 0, 1, 2
"""What `measure` finds: curvature [1/m], metres for each step between points, lateral place [m]."""

ROUNDS = 120  # most steps of Newton's method
_FIRST_BARRIER, _LAST_BARRIER, _LESS = 1e-2, 1e-6, 0.7
_NEAREST = 0.05  # part of its distance to a bound that a step must leave for every rule
_RISE, _BENT, _TURN, _ASIDE, _ENERGY, _DRIVE, _BRAKE, _RULES = 0, 1, 2, 3, 4, 5, 6, 7
"""Rules at a point, each on a value between two bounds: a, k, its change to the next point, the
lateral place, e, and squared grip used with drive (with y here) and with braking (y there)."""
_CORNERING, _NEXT, _GAP, _ROWS = 7, 8, 9, 10
"""Values without a rule, with derivatives that are needed: y here and at the next point, and d."""
_COLUMNS = 6  # offsets of the points -1, 0, 1, 2 and squared speeds of the points 0, 1
_BAND = 14  # columns of the banded matrix: the diagonal and what is left of it


class CarLimits(NamedTuple):
    """What the car's tyres, drive and steering allow."""

    lateral: float  # largest lateral acceleration [m/s^2]
    acceleration: float  # largest acceleration [m/s^2]
    braking: float  # largest deceleration [m/s^2]
    speed: float  # largest speed [m/s]
    curvature: float  # largest curvature the steering can follow [1/m]
    # share of an axle's load lost for each m/s^2 of drive or braking [s^2/m]; 0: none is
    transfer: float

    @classmethod
    def of(cls, car: CarConfig, share: float = 1.0, *, load_transfer: bool = True) -> CarLimits:
        """Return a car's limits, with only a share of its grip used.

        With load transfer, the axle that braking or drive unloads slides first (each axle takes
        half of either); without, the car is a point with all its grip in every direction.
        """
        lateral = share * car.grip * GRAVITY
        transfer = 2 * car.mass_height / car.wheelbase / GRAVITY if load_transfer else 0.0
        most = spare_grip(0.0, lateral, transfer)
        cos, sin = direction(car.max_steering)
        return cls(
            lateral=lateral,
            acceleration=min(float(car.max_acceleration), most),
            braking=min(float(car.max_braking), most),
            speed=float(car.max_speed),
            curvature=sin / cos / car.wheelbase,
            transfer=transfer,
        )


@compiled
def spare_grip(cornering, lateral, transfer):
    """Return the drive or braking that tyres can give while cornering with y [m/s^2].

    The axle that loses load carries (1 - t a) of its half and pushes a / 2 and y / 2 per mass:
    a^2 + y^2 = Y^2 (1 - t a)^2, solved for a, with the largest lateral acceleration Y [m/s^2] and
    the share of an axle's load t lost for each m/s^2 (`transfer`).
    """
    left = lateral * lateral - cornering * cornering
    if left <= 0.0:
        return 0.0
    loss = lateral * transfer
    square, half = 1.0 - loss * loss, lateral * loss
    return (math.sqrt(half * half + square * left) - half) / square


@compiled(allocates=True)
def speed_profile(curvature, distance, limits, closed):
    """Return the highest speed at each point that grip, drive and brakes allow [m/s].

    A forward pass (drive) and a backward pass (brakes) over the corner speeds, each with what the
    friction ellipse leaves while cornering. `distance` leads from each point to the next [m],
    float64 (N,), or (N - 1,) if open; on a closed line the last speed fits the first.
    """
    count, first = len(curvature), 0
    squared = np.empty(count)
    for i in range(count):
        corner = limits.lateral / max(abs(curvature[i]), 1e-9)
        squared[i] = min(limits.speed * limits.speed, corner)
        # On a loop the slowest corner is never left faster than its corner speed: start there.
        if closed and squared[i] < squared[first]:
            first = i
    for way, start, most in ((1, first, limits.acceleration), (-1, first - 1, limits.braking)):
        start = first if closed else start
        for k in range(count if closed else count - 1):
            i, j = (start + way * k) % count, (start + way * (k + 1)) % count
            spare = spare_grip(curvature[i] * squared[i], limits.lateral, limits.transfer)
            gap = distance[i] if way > 0 else distance[j]
            squared[j] = min(squared[j], squared[i] + 2.0 * gap * min(most, spare))
    for i in range(count):
        squared[i] = math.sqrt(squared[i])
    return squared


@compiled
def travel_time(speed, distance):
    """Return the time along a line with constant acceleration between its points [s]."""
    total = 0.0
    for i in range(len(distance)):
        total += 2.0 * distance[i] / (speed[i] + speed[(i + 1) % len(speed)])
    return total


@compiled(allocates=True)
def sample(points, courses, steps, margin):
    """Return the first of some tracks as ROAD records, (N,).

    `steps`, at least 8, are the pieces between two points of the road; the margin to the borders
    is in m.
    """
    course = courses[0]
    spacing, beyond = course.length / steps, 0 if course.closed else 1
    road = np.zeros(steps if course.closed else steps + 3, ROAD)
    for i in range(len(road)):
        s = (i - beyond) * spacing
        here, turned_x, turned_y, total = road[i], 0.0, 0.0, 0.0
        for k in range(-_SAMPLES, _SAMPLES + 1):
            share = k / (_SAMPLES + 1.0)
            x, y, cos, sin = _along(points, course, s + share * 3.3 * SMOOTH)
            weight = 1.0 - share * share
            weight *= weight
            weight *= weight
            here.x, here.y, total = here.x + weight * x, here.y + weight * y, total + weight
            turned_x, turned_y = turned_x + weight * cos, turned_y + weight * sin
        size = math.sqrt(turned_x * turned_x + turned_y * turned_y)
        here.s, here.x, here.y = s, here.x / total, here.y / total
        here.normal_x, here.normal_y = -turned_y / size, turned_x / size
        x, y, _, _ = _along(points, course, s)
        here.aside = (x - here.x) * here.normal_x + (y - here.y) * here.normal_y
        frame = frame_at(points, course, np.float32(s))
        fold = FOLD / max(abs(frame.curvature), 1e-9)
        right, left = max(frame.right - margin, 0.0), max(frame.left - margin, 0.0)
        here.low = here.aside - (min(right, fold) if frame.curvature < 0.0 else right)
        here.high = here.aside + (min(left, fold) if frame.curvature > 0.0 else left)
    return road


@inner
def _along(points, course, s):
    """Return the centreline's place and direction at s; an open one goes on straight."""
    frame = frame_at(points, course, np.float32(s))
    beyond = 0.0 if course.closed else s - min(max(s, 0.0), course.length)
    return frame.x + beyond * frame.cos, frame.y + beyond * frame.sin, frame.cos, frame.sin


@inner
def measure(road, offset, closed, shape):
    """Measure the B-spline with control points at offsets [m] from the road's points, (N,).

    `closed`: the last point is followed by the first; without, the outer two are not measured.
    `shape` takes BEND, SIZE and PLACE at each point, and their derivatives by the offsets of the
    control points before it, of its own and after it, (N, 3, 4).
    """
    count = len(road)
    for i in range(count):
        h, j, own = (i - 1) % count, (i + 1) % count, road[i]
        x, y = own.x + offset[i] * own.normal_x, own.y + offset[i] * own.normal_y
        hx, hy = road[h].x + offset[h] * road[h].normal_x, road[h].y + offset[h] * road[h].normal_y
        jx, jy = road[j].x + offset[j] * road[j].normal_x, road[j].y + offset[j] * road[j].normal_y
        slope_x, slope_y = 0.5 * (jx - hx), 0.5 * (jy - hy)
        bent_x, bent_y = hx - 2.0 * x + jx, hy - 2.0 * y + jy
        size = math.sqrt(slope_x * slope_x + slope_y * slope_y)
        cube = size * size * size
        bend = (slope_x * bent_y - slope_y * bent_x) / cube
        one = shape[i]
        one[BEND, 0], one[SIZE, 0] = bend, size
        one[PLACE, 0] = offset[i] + (bent_x * own.normal_x + bent_y * own.normal_y) / 6.0
        for k in range(3):
            other = road[(i + k - 1) % count]
            nx, ny = other.normal_x, other.normal_y
            slope, bent = 0.5 * (k - 1), (-2.0 if k == 1 else 1.0)
            along = slope * (slope_x * nx + slope_y * ny) / size
            turned = slope * (nx * bent_y - ny * bent_x) + bent * (slope_x * ny - slope_y * nx)
            one[SIZE, k + 1] = along
            one[BEND, k + 1] = turned / cube - 3.0 * bend * along / size
            shift = bent * (nx * own.normal_x + ny * own.normal_y) / 6.0
            one[PLACE, k + 1] = shift + 1.0 if k == 1 else shift
        if not closed and (i == 0 or i == count - 1):
            one[:] = 0.0
            one[SIZE, 0] = road[1].s - road[0].s


@compiled(allocates=True)
def fastest(road, closed, limits, curvature_rate):
    """Return the offsets of the control points of the fastest line found on a ROAD [m], (N,)."""
    count = len(road)
    offset, squared, new_squared = np.empty(count), np.ones(count), np.empty(count)
    for i in range(count):
        inset = 0.1 * (road[i].high - road[i].low)
        offset[i] = min(max(0.0, road[i].low + inset), road[i].high - inset)
    winner, new_offset, best = offset.copy(), np.empty(count), np.inf
    shape, rows = np.empty((count, 3, 4)), np.empty((count, _ROWS, _COLUMNS))
    values, new_values = np.empty((_ROWS, count)), np.empty((_ROWS, count))
    _evaluate(road, offset, squared, closed, limits, shape, values, rows)
    low, high = np.full((_RULES, count), -1e9), np.full((_RULES, count), 1e9)
    turn = curvature_rate * (road[1].s - road[0].s)
    matrix, step = np.empty((2 * count, _BAND)), np.empty(2 * count)
    barrier, calm = _FIRST_BARRIER, 1e-4
    for _ in range(ROUNDS):
        _tighten(low, high, values, road, limits, turn)
        sound = False
        while not sound and calm < 1e6:
            _linearise(values, rows, low, high, barrier, calm, limits, matrix, step)
            sound = _factorise(matrix)
            calm = calm if sound else 8.0 * calm
        _solve(matrix, step)
        part, sound = 1.0, False
        while not sound and part > 1e-4:
            for i in range(count):
                column = _column(i, count)
                new_offset[i] = offset[i] + part * step[column]
                new_squared[i] = squared[i] + part * step[column + 1]
            _evaluate(road, new_offset, new_squared, closed, limits, shape, new_values, rows)
            sound = _is_inside(values, new_values, low, high)
            part = part if sound else 0.7 * part
        if not sound:
            break
        offset, new_offset = new_offset, offset
        squared, new_squared = new_squared, squared
        values, new_values = new_values, values
        time = travel_time(speed_profile(values[_BENT], values[_GAP], limits, closed), values[_GAP])
        for i in range(count):  # too tight bends have their price
            time += max(abs(values[_BENT, i]) - limits.curvature, 0.0)
        if time < best:
            winner, best = offset.copy(), time
        if part > 0.3:
            barrier, calm = max(_LAST_BARRIER, _LESS * barrier), max(1e-9, 0.5 * calm)
    return winner


@inner
def _tighten(low, high, values, road, limits, turn):
    """Draw the bounds in to the limits: a value beyond may stay where it is, not get worse."""
    grip = limits.lateral * limits.lateral
    for i in range(len(road)):
        for c, least, most in (
            (_RISE, -limits.braking, limits.acceleration),
            (_BENT, -limits.curvature, limits.curvature),
            (_TURN, -turn, turn),
            (_ASIDE, road[i].low, road[i].high),
            (_ENERGY, 0.0, limits.speed * limits.speed),
            (_DRIVE, -1e9, grip),
            (_BRAKE, -1e9, grip),
        ):
            slack = 0.05 * abs(values[c, i]) + 1e-3
            low[c, i] = min(least, max(low[c, i], values[c, i] - slack))
            high[c, i] = max(most, min(high[c, i], values[c, i] + slack))


@inner
def _is_inside(values, new_values, low, high):
    """Return whether new values keep a part of the old ones' distance to every bound."""
    for c in range(_RULES):
        for i in range(values.shape[1]):
            below = (new_values[c, i] - low[c, i]) / (values[c, i] - low[c, i])
            above = (high[c, i] - new_values[c, i]) / (high[c, i] - values[c, i])
            if not min(below, above) > _NEAREST:
                return False
    return True


@inner
def _evaluate(road, offset, squared, closed, limits, shape, values, rows):
    """Work out shape (see `measure`), values (_ROWS, N) and their derivatives rows, (N, ...)."""
    count = len(road)
    measure(road, offset, closed, shape)
    # Squared grip (spare_grip): (1 - Y^2 t^2) a^2 + 2 Y^2 t |a| + y^2 <= Y^2.
    loss = limits.lateral * limits.lateral * limits.transfer
    square = 1.0 - loss * limits.transfer
    for i in range(count):
        j = (i + 1) % count
        here, after, value, row = shape[i], shape[j], values[:, i], rows[i]
        gap = 0.5 * (here[SIZE, 0] + after[SIZE, 0])
        rise = 0.5 * (squared[j] - squared[i]) / gap
        bend, next_bend = here[BEND, 0], after[BEND, 0]
        value[_RISE], value[_BENT], value[_TURN] = rise, bend, next_bend - bend
        value[_ASIDE], value[_ENERGY], value[_GAP] = here[PLACE, 0], squared[i], gap
        value[_CORNERING], value[_NEXT] = bend * squared[i], next_bend * squared[j]
        row[:] = 0.0
        for k in range(3):
            row[_BENT, k], row[_ASIDE, k] = here[BEND, k + 1], here[PLACE, k + 1]
            row[_TURN, k] -= here[BEND, k + 1]
            row[_TURN, k + 1] += after[BEND, k + 1]
            row[_GAP, k] += 0.5 * here[SIZE, k + 1]
            row[_GAP, k + 1] += 0.5 * after[SIZE, k + 1]
            row[_CORNERING, k] = squared[i] * here[BEND, k + 1]
            row[_NEXT, k + 1] = squared[j] * after[BEND, k + 1]
        row[_ENERGY, 4], row[_CORNERING, 4], row[_NEXT, 5] = 1.0, bend, next_bend
        row[_RISE, 4], row[_RISE, 5] = -0.5 / gap, 0.5 / gap
        for k in range(_COLUMNS):
            row[_RISE, k] -= rise / gap * row[_GAP, k]
        for side, across in ((1.0, _CORNERING), (-1.0, _NEXT)):
            c, push, pull = across - 2, square * rise + side * loss, value[across]
            value[c] = (push + side * loss) * rise + pull * pull
            for k in range(_COLUMNS):
                row[c, k] = 2.0 * (push * row[_RISE, k] + pull * row[across, k])
        if not closed and j == 0:  # nothing comes after the last point of an open line
            for c in range(_ROWS):
                if c not in (_BENT, _ASIDE, _ENERGY):
                    value[c] = 0.0
                    for k in range(_COLUMNS):
                        row[c, k] = 0.0


@inner(allocates=True)
def _linearise(values, rows, low, high, barrier, calm, limits, matrix, step):
    """Set up Newton's equations about a line: a banded symmetric matrix and the right side."""
    count = len(rows)
    matrix[:] = 0.0
    step[:] = 0.0
    second, first, factor = np.empty((_COLUMNS, _COLUMNS)), np.empty(_COLUMNS), np.zeros(_ROWS)
    columns = np.empty(_COLUMNS, np.int64)
    grip = limits.lateral * limits.transfer
    for i in range(count):
        j = (i + 1) % count
        row = rows[i]
        second[:] = 0.0
        first[:] = 0.0
        for c in range(_RULES):
            below = 1.0 / (values[c, i] - low[c, i])
            above = 1.0 / (high[c, i] - values[c, i])
            factor[c] = barrier * (below * below + above * above)
            for k in range(_COLUMNS):
                first[k] += barrier * (above - below) * row[c, k]
        drive = 2.0 * barrier / (high[_DRIVE, i] - values[_DRIVE, i])
        brake = 2.0 * barrier / (high[_BRAKE, i] - values[_BRAKE, i])
        factor[_RISE] += max(0.0, 1.0 - grip * grip) * (drive + brake)
        factor[_BENT] += calm
        factor[_CORNERING], factor[_NEXT] = drive, brake
        for c in range(_GAP):
            for k in range(_COLUMNS):
                for m in range(k + 1):
                    second[k, m] += factor[c] * row[c, k] * row[c, m]
        second[1, 1] += calm
        for k in range(4):
            second[4, k] += drive * values[_BENT, i] * row[_CORNERING, k]
            second[5, k] += brake * values[_BENT, j] * row[_NEXT, k]
            columns[k] = _column((i - 1 + k) % count, count)
        columns[4], columns[5] = columns[1] + 1, columns[2] + 1
        # The time of a piece is 2 d / (v + v').
        one, two = math.sqrt(values[_ENERGY, i]), math.sqrt(values[_ENERGY, j])
        both = one + two
        slope = -2.0 * values[_GAP, i] / (both * both)
        bent = -2.0 * slope / both
        for k in range(_COLUMNS):
            first[k] += 2.0 / both * row[_GAP, k]
        first[4] += 0.5 * slope / one
        first[5] += 0.5 * slope / two
        second[4, 4] += 0.25 * (bent - slope / one) / (one * one)
        second[5, 5] += 0.25 * (bent - slope / two) / (two * two)
        second[5, 4] += 0.25 * bent / (one * two)
        for k in range(_COLUMNS):
            step[columns[k]] -= first[k]
            for m in range(k + 1):
                line, column = max(columns[k], columns[m]), min(columns[k], columns[m])
                if second[k, m] != 0.0:
                    matrix[line, line - column] += second[k, m]


@inner
def _column(i, count):
    """Return the column of a point's offset, which that of its squared speed follows.

    Points are taken from both ends in turn, so that a loop's neighbours stay within the band.
    """
    return 4 * i if 2 * i < count else 4 * (count - 1 - i) + 2


@inner
def _factorise(matrix):
    """Replace a matrix by its Cholesky factor; False if it is not positive definite."""
    for row in range(len(matrix)):
        for k in range(min(_BAND - 1, row), -1, -1):
            total = matrix[row, k]
            for m in range(k + 1, min(_BAND, row + 1)):
                total -= matrix[row, m] * matrix[row - k, m - k]
            if k > 0:
                matrix[row, k] = total / matrix[row - k, 0]
            elif total > 0.0:
                matrix[row, 0] = math.sqrt(total)
            else:
                return False
    return True


@inner
def _solve(matrix, step):
    """Solve the equations of a factorised matrix, in place."""
    for row in range(len(matrix)):
        for k in range(1, min(_BAND, row + 1)):
            step[row] -= matrix[row, k] * step[row - k]
        step[row] /= matrix[row, 0]
    for row in range(len(matrix) - 1, -1, -1):
        step[row] /= matrix[row, 0]
        for k in range(1, min(_BAND, row + 1)):
            step[row - k] -= matrix[row, k] * step[row]
