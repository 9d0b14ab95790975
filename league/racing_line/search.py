"""Compiled: the search for the fastest line, an interior-point method on offsets and speeds.

It minimises TIME, not curvature. Unknowns are the lateral offset of each control point and the
squared speed e at each point. With curvature k and distance d to the next point, the longitudinal
acceleration is a = (e' - e) / 2 d and the lateral one y = k e. Every iterate keeps all rules; a
weight that falls from round to round keeps it away from them (J. Nocedal and S. Wright, Numerical
Optimization, chapter 19). The exact forward-backward pass says which round's line is the fastest.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from __future__ import annotations

import math

import numpy as np

from league.jit import compiled, inner
from league.racing_line.road import BEND, PLACE, SIZE, measure
from league.racing_line.speed_profile import speed_profile, travel_time

ROUNDS = 60
"""Most steps of Newton's method."""
_FIRST_WEIGHT, _LAST_WEIGHT, _LESS = 1e-2, 1e-6, 0.5
_NEAREST = 0.05
"""Part of its room that a step must leave to every rule."""
_RULES, _ACCELERATION, _CORNERING, _NEXT = 11, 11, 12, 13
"""Rules at a point, and rows of `rows` after theirs: how a, y and the next point's y change."""
_COLUMNS = 6
"""Offsets of the points -1, 0, 1, 2 and squared speeds of the points 0, 1."""
_BAND = 14
"""Columns of the banded matrix: the diagonal and what is left of it."""


@compiled
def fastest(road, low, high, closed, limits, curvature_rate):
    """Return the offsets of the control points of the fastest line found [m], float64 (N,).

    Args:
        road: see Road.reference.
        low: smallest lateral place [m], float64 (N,).
        high: largest lateral place [m], float64 (N,).
        closed: whether the line is a loop.
        limits: what the car can do.
        curvature_rate: largest change of curvature along the line [1/m per m].
    """
    count = len(low)
    offset = np.empty(count)
    for i in range(count):
        offset[i] = min(max(0.0, 0.9 * low[i] + 0.1 * high[i]), 0.1 * low[i] + 0.9 * high[i])
    shape, tried = np.zeros((count, 3, 4)), np.zeros((count, 3, 4))
    measure(road, offset, closed, shape)
    turn, pieces = 0.0, (count if closed else count - 1)
    for i in range(pieces):
        turn += shape[i, SIZE, 0] * curvature_rate / pieces
    best, speed = _judged(shape, limits, closed)
    squared, winner = 0.8 * speed * speed, offset.copy()
    bounds = np.empty((count, 4))
    for i in range(count):
        bounds[i, 0] = bounds[i, 1] = bounds[i, 3] = 1e9
        bounds[i, 2] = -1e9
    _tighten(bounds, shape, limits.curvature, turn, low, high)
    room, new_room = np.empty((count, _RULES)), np.empty((count, _RULES))
    _rooms(shape, squared, bounds, limits, closed, room)
    weight, calm = _FIRST_WEIGHT, 1e-4
    price = weight / room
    matrix, step = np.empty((2 * count, _BAND)), np.empty(2 * count)
    new_offset, new_squared = offset.copy(), squared.copy()
    for _ in range(ROUNDS):
        sound = False
        while not sound and calm < 1e6:
            _linearise(shape, squared, bounds, limits, closed, price, weight, calm, matrix, step)
            sound = _factorise(matrix)
            if not sound:
                calm = max(8.0 * calm, 1e-6)
        if not sound:
            break
        _solve(matrix, step)
        part, sound = 1.0, False
        while not sound and part > 1e-4:
            sound = True
            for i in range(count):
                column = _column(i, count, closed)
                new_offset[i] = offset[i] + part * step[column]
                new_squared[i] = squared[i] + part * step[column + 1]
                sound = sound and new_squared[i] > 0.1 * squared[i]
            if sound:
                measure(road, new_offset, closed, tried)
                _rooms(tried, new_squared, bounds, limits, closed, new_room)
                for i in range(count):
                    for c in range(_RULES):
                        sound = sound and new_room[i, c] > _NEAREST * room[i, c]
            if not sound:
                part *= 0.7
        if not sound:
            break
        for i in range(count):
            for c in range(_RULES):
                fewer = (room[i, c] - new_room[i, c]) / part
                wanted = (weight + price[i, c] * fewer) / room[i, c]
                found = price[i, c] + part * (wanted - price[i, c])
                usual = weight / new_room[i, c]
                price[i, c] = min(max(found, 0.03 * usual), 30.0 * usual)
        offset, new_offset = new_offset, offset
        squared, new_squared = new_squared, squared
        shape, tried = tried, shape
        time, _ = _judged(shape, limits, closed)
        if time < best:
            best = time
            winner[:] = offset
        _tighten(bounds, shape, limits.curvature, turn, low, high)
        _rooms(shape, squared, bounds, limits, closed, room)
        if part > 0.3:
            weight, calm = max(_LAST_WEIGHT, _LESS * weight), max(0.5 * calm, 1e-9)
        elif part < 0.1:
            calm *= 4.0
    return winner


@inner
def _judged(shape, limits, closed):
    """Return the time of a line [s], with a price on too tight bends, and its speeds [m/s]."""
    count = len(shape)
    bend, gap = np.empty(count), np.empty(count if closed else count - 1)
    excess = 0.0
    for i in range(count):
        bend[i] = shape[i, BEND, 0]
        excess += max(abs(bend[i]) - limits.curvature, 0.0)
    for i in range(len(gap)):
        gap[i] = 0.5 * (shape[i, SIZE, 0] + shape[(i + 1) % count, SIZE, 0])
    speed = speed_profile(bend, gap, limits, closed)
    return travel_time(speed, gap) + excess, speed


@inner
def _tighten(bounds, shape, curvature, turn, low, high):
    """Set the rules' bounds: a line that breaks one may stay as it is, but not get worse."""
    count = len(shape)
    for i in range(count):
        bend, place = shape[i, BEND, 0], shape[i, PLACE, 0]
        turned = shape[(i + 1) % count, BEND, 0] - bend
        bounds[i, 0] = max(curvature, min(bounds[i, 0], 1.05 * abs(bend) + 0.01))
        bounds[i, 1] = max(turn, min(bounds[i, 1], 1.05 * abs(turned) + 0.01))
        bounds[i, 2] = min(low[i], max(bounds[i, 2], place - 1e-3))
        bounds[i, 3] = max(high[i], min(bounds[i, 3], place + 1e-3))


@inner
def _rooms(shape, squared, bounds, limits, closed, room):
    """Work out what is left to every rule, (N, _RULES)."""
    rows = np.empty((_NEXT + 1, _COLUMNS))
    for i in range(len(squared)):
        _rules(i, shape, squared, bounds, limits, closed, room[i], rows)


@inner
def _rules(i, shape, squared, bounds, limits, closed, room, rows):
    """Work out what is left to every rule at a point, and how the use of it changes.

    Args:
        i: the point.
        shape: of the line, see `measure`.
        squared: speeds [m^2/s^2].
        bounds: most curvature and change of it, least and most lateral place.
        limits: what the car can do.
        closed: whether the line is a loop.
        room: takes what is left, (_RULES,).
        rows: takes the derivatives of what is used, (_NEXT + 1, _COLUMNS).
    """
    j = (i + 1) % len(squared)
    here, after = shape[i], shape[j]
    gap = 0.5 * (here[SIZE, 0] + after[SIZE, 0])
    rise = 0.5 * (squared[j] - squared[i]) / gap
    across, next_across = here[BEND, 0] * squared[i], after[BEND, 0] * squared[j]
    rows[:] = 0.0
    for k in range(3):
        rows[4, k], rows[5, k] = here[BEND, k + 1], -here[BEND, k + 1]
        rows[6, k] -= here[BEND, k + 1]
        rows[6, k + 1] += after[BEND, k + 1]
        rows[8, k], rows[9, k] = here[PLACE, k + 1], -here[PLACE, k + 1]
        rows[_ACCELERATION, k] -= 0.5 * rise / gap * here[SIZE, k + 1]
        rows[_ACCELERATION, k + 1] -= 0.5 * rise / gap * after[SIZE, k + 1]
        rows[_CORNERING, k] = squared[i] * here[BEND, k + 1]
        rows[_NEXT, k + 1] = squared[j] * after[BEND, k + 1]
    rows[10, 4] = 1.0
    rows[_ACCELERATION, 4], rows[_ACCELERATION, 5] = -0.5 / gap, 0.5 / gap
    rows[_CORNERING, 4], rows[_NEXT, 5] = here[BEND, 0], after[BEND, 0]
    # Squared grip (spare_grip): (1 - Y^2 t^2) a^2 + 2 Y^2 t |a| + y^2 <= Y^2.
    grip = limits.lateral * limits.lateral
    loss = grip * limits.transfer
    square = 1.0 - loss * limits.transfer
    for k in range(_COLUMNS):
        along = rows[_ACCELERATION, k]
        rows[0, k], rows[1, k], rows[7, k] = along, -along, -rows[6, k]
        rows[2, k] = 2.0 * ((square * rise + loss) * along + across * rows[_CORNERING, k])
        rows[3, k] = 2.0 * ((square * rise - loss) * along + next_across * rows[_NEXT, k])
    turn = after[BEND, 0] - here[BEND, 0]
    room[0], room[1] = limits.acceleration - rise, limits.braking + rise
    room[2] = grip - (square * rise + 2.0 * loss) * rise - across * across
    room[3] = grip - (square * rise - 2.0 * loss) * rise - next_across * next_across
    room[4], room[5] = bounds[i, 0] - here[BEND, 0], bounds[i, 0] + here[BEND, 0]
    room[6], room[7] = bounds[i, 1] - turn, bounds[i, 1] + turn
    room[8], room[9] = bounds[i, 3] - here[PLACE, 0], here[PLACE, 0] - bounds[i, 2]
    room[10] = limits.speed * limits.speed - squared[i]
    if not closed and j == 0:  # nothing comes after the last point of an open line
        for c in (0, 1, 2, 3, 6, 7, _ACCELERATION, _CORNERING, _NEXT):
            rows[c] = 0.0
            if c < _RULES:
                room[c] = 1.0


@inner
def _linearise(shape, squared, bounds, limits, closed, price, weight, calm, matrix, step):
    """Set up Newton's equations about a line: a banded symmetric matrix and the right side."""
    count = len(squared)
    matrix[:] = 0.0
    step[:] = 0.0
    room, rows = np.empty(_RULES), np.empty((_NEXT + 1, _COLUMNS))
    second, first = np.empty((_COLUMNS, _COLUMNS)), np.empty(_COLUMNS)
    columns = np.empty(_COLUMNS, np.int64)
    grip = limits.lateral * limits.transfer
    square = max(0.0, 1.0 - grip * grip)
    for i in range(count):
        j = (i + 1) % count
        _rules(i, shape, squared, bounds, limits, closed, room, rows)
        second[:] = 0.0
        first[:] = 0.0
        for c in range(_RULES):
            _add(second, rows[c], price[i, c] / room[c])
            for k in range(_COLUMNS):
                first[k] += weight / room[c] * rows[c, k]
        _add(second, rows[_ACCELERATION], 2.0 * square * (price[i, 2] + price[i, 3]))
        _add(second, rows[_CORNERING], 2.0 * price[i, 2])
        _add(second, rows[_NEXT], 2.0 * price[i, 3])
        _add(second, rows[4], calm)
        second[1, 1] += calm
        if closed or j > 0:
            _add_time(shape[i], shape[j], squared[i], squared[j], first, second)
            for k in range(3):
                bend, after = shape[i, BEND], shape[j, BEND]
                second[4, k] += 2.0 * price[i, 2] * bend[0] * squared[i] * bend[k + 1]
                second[5, k + 1] += 2.0 * price[i, 3] * after[0] * squared[j] * after[k + 1]
        for k in range(4):
            columns[k] = _column((i - 1 + k) % count, count, closed)
        columns[4], columns[5] = columns[1] + 1, columns[2] + 1
        for k in range(_COLUMNS):
            step[columns[k]] -= first[k]
            for m in range(k + 1):
                row, column = max(columns[k], columns[m]), min(columns[k], columns[m])
                if second[k, m] != 0.0:
                    matrix[row, row - column] += second[k, m]


@inner
def _add(second, row, factor):
    """Add a row times itself to the lower half of a matrix."""
    for k in range(_COLUMNS):
        for m in range(k + 1):
            second[k, m] += factor * row[k] * row[m]


@inner
def _add_time(here, after, squared, next_squared, first, second):
    """Add the derivatives of a piece's time 2 d / (v + v')."""
    gap = 0.5 * (here[SIZE, 0] + after[SIZE, 0])
    one, two = math.sqrt(squared), math.sqrt(next_squared)
    both = one + two
    slope = -2.0 * gap / (both * both)
    bent = -2.0 * slope / both
    first[4] += 0.5 * slope / one
    first[5] += 0.5 * slope / two
    second[4, 4] += 0.25 * (bent - slope / one) / squared
    second[5, 5] += 0.25 * (bent - slope / two) / next_squared
    second[5, 4] += 0.25 * bent / (one * two)
    for k in range(3):
        first[k] += here[SIZE, k + 1] / both
        first[k + 1] += after[SIZE, k + 1] / both


@inner
def _column(i, count, closed):
    """Return the column of a point's offset; its squared speed follows.

    A loop's points are taken from both ends in turn, so that neighbours stay within the band.
    """
    if not closed:
        return 2 * i
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
    """Solve the equations whose matrix is factorised, in place."""
    for row in range(len(matrix)):
        for k in range(1, min(_BAND, row + 1)):
            step[row] -= matrix[row, k] * step[row - k]
        step[row] /= matrix[row, 0]
    for row in range(len(matrix) - 1, -1, -1):
        step[row] /= matrix[row, 0]
        for k in range(1, min(_BAND, row + 1)):
            step[row - k] -= matrix[row, k] * step[row]
