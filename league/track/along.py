"""Compiled: places along a centreline, and how they are sought, for tables on the CPU.

course.py has the same in torch, for any device. Numbers are float32 and are rounded after each
operation, in the same order as there, so both agree to the last bit. Only here what is not a number
stays one; torch refuses to look it up.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import numpy as np

from league.compiled import compiled, inner

_ZERO, _HALF, _ONE, _STEEPEST = (np.float32(number) for number in (0.0, 0.5, 1.0, 0.3))


@compiled
def interpolated(tables, num_points, track, s):  # noqa: ANN001, ANN201
    """Return s wrapped, and the seven columns of the table there, float32 (8, num_places).

    Args:
        tables: of a TrackSet: rows, count, length, spacing, closed.
        num_points: rows of each track.
        track: of each world, int64 (num_worlds,).
        s: places along it [m], float32 (num_places,); of the first world, then of the next, as
            many of each.

    Raises:
        IndexError: a world is on no track of the set, or has fewer places than another.
    """
    out = np.empty((8, len(s)), np.float32)
    each = _places_of_each(len(s), track, tables)
    for point in range(len(s)):
        there = _mixed(tables, num_points, track[point // each], s[point])
        for column in range(8):
            out[column, point] = there[column]
    return out


@compiled
def nearest(tables, num_points, track, told, times):  # noqa: ANN001, ANN201
    """Return the places along the centreline that are nearest to points [m], (num_places,).

    Args:
        tables: as of `interpolated`.
        num_points: as of `interpolated`.
        track: as of `interpolated`.
        told: x, y of the points and where they were last seen along the track [m], float32
            (3, num_places).
        times: steps of Newton's method, see `TrackSet.project`.

    Raises:
        IndexError: as of `interpolated`.
    """
    out = np.empty(told.shape[1], np.float32)
    each = _places_of_each(told.shape[1], track, tables)
    for point in range(told.shape[1]):
        x, y, s = told[0, point], told[1, point], told[2, point]
        for _ in range(times):
            s, cx, cy, cos, sin, curvature, _, _ = _mixed(
                tables, num_points, track[point // each], s
            )
            dx, dy = x - cx, y - cy
            along, across = dx * cos + dy * sin, dy * cos - dx * sin
            slope = _ONE - curvature * across
            step = along / (_STEEPEST if slope < _STEEPEST else slope)
            s = s + _clamp(step, -_HALF, _HALF)
        out[point] = s
    return out


@inner
def _places_of_each(number, track, tables):  # noqa: ANN001, ANN202
    """Return how many places each world has, once it is sure that no table is read beside."""
    for world in range(len(track)):
        if not 0 <= track[world] < len(tables[1]):
            raise IndexError("a world is on a track that the set does not have")
    if number % max(1, len(track)):
        raise IndexError("worlds have different numbers of places")
    return max(1, number // max(1, len(track)))


@inner
def _mixed(tables, num_points, track, s):  # noqa: ANN001, ANN202
    """Return s wrapped, and the seven columns of the table there."""
    rows, count, length, spacing, closed = tables
    if closed[track]:
        wrapped = np.float32(np.fmod(s, length[track]))
        if wrapped < _ZERO:
            wrapped = wrapped + length[track]
        # Rounding can make the remainder of a small negative number equal to the length.
        if wrapped >= length[track]:
            wrapped = _ZERO
    else:
        wrapped = _clamp(s, _ZERO, length[track])
    place = wrapped / spacing[track]
    # What is not a number has no row: it takes the first, and stays what it is.
    low = min(np.int64(place), count[track] - 1) if place >= _ZERO else 0
    part = _clamp(place - np.float32(low), _ZERO, _ONE)
    row = rows[track * num_points + low]
    return (
        wrapped,
        row[0] + row[7] * part,
        row[1] + row[8] * part,
        row[2] + row[9] * part,
        row[3] + row[10] * part,
        row[4] + row[11] * part,
        row[5] + row[12] * part,
        row[6] + row[13] * part,
    )


@inner
def _clamp(value, low, high):  # noqa: ANN001, ANN202
    return low if value < low else (high if value > high else value)
