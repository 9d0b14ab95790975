"""Whether a course is sound: no crossing, no overlap, no bend that nobody can drive."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from league.errors import TrackError
from league.track.course import Track

MIN_RADIUS = 0.2
"""Smallest radius of a centreline [m], smoothed over 0.3 m; the car itself turns in 0.284 m."""
MIN_REACH = 0.14
"""Least room between the centreline and a border [m]; half a car is 0.1 m wide."""


def sound(track: Track, where: str) -> Track:
    """Return the track, or say in one sentence what is wrong with it and where."""
    crossing = first_crossing(track.center, closed=track.closed)
    if crossing is not None:
        raise TrackError(
            f"{where}: the centreline crosses itself near {_place(track.center, crossing[0])}; "
            "put the points in driving order and keep the stretches apart"
        )
    _check_bends(track, where)
    for side, border in (("left", track.left), ("right", track.right)):
        _check_reach(track, border, side, where)
    _check_borders(track, where)
    return track


def _check_bends(track: Track, where: str) -> None:
    if track.min_radius >= MIN_RADIUS:
        return
    row = int(np.abs(track.curvature).argmax())
    raise TrackError(
        f"{where}: the bend near {_place(track.center, row)} has a radius of "
        f"{track.min_radius:.2f} m and a car needs {MIN_RADIUS} m; move the points there apart"
    )


def _check_reach(track: Track, border: np.ndarray, side: str, where: str) -> None:
    reach = np.linalg.norm(border - track.center, axis=1)
    row = int(reach.argmin())
    if reach[row] < MIN_REACH:
        raise TrackError(
            f"{where}: the {side} border is only {reach[row]:.2f} m from the centreline near "
            f"{_place(track.center, row)}; leave {MIN_REACH} m or more"
        )


def _check_borders(track: Track, where: str) -> None:
    for side, border in (("left", track.left), ("right", track.right)):
        crossing = first_crossing(border, closed=track.closed)
        if crossing is not None:
            raise TrackError(
                f"{where}: the {side} border crosses itself near {_place(border, crossing[0])}; "
                "move the stretches apart or make the road narrower"
            )
    crossing = first_crossing(track.left, track.right, closed=track.closed)
    if crossing is not None:
        raise TrackError(
            f"{where}: the road overlaps itself near {_place(track.left, crossing[0])}; "
            "move the stretches apart or make the road narrower"
        )


def first_crossing(
    line: np.ndarray, other: np.ndarray | None = None, *, closed: bool
) -> tuple[int, int] | None:
    """Return the first two segments that cross, of one polyline or of two, by their rows.

    Args:
        line: polyline [m], shape (N, 2).
        other: a second polyline; without it the first is held against itself.
        closed: whether they return to their first points.
    """
    begin, end = _segments(line, closed=closed)
    begin_2, end_2 = (begin, end) if other is None else _segments(other, closed=closed)
    first, second = _near_pairs(begin, end, begin_2, end_2)
    if other is None:
        apart = np.abs(first - second)
        apart = np.minimum(apart, len(begin) - apart) if closed else apart
        keep = (first < second) & (apart > 1)
        first, second = first[keep], second[keep]
    cross = _meet(begin[first], end[first], begin_2[second], end_2[second])
    if not cross.any():
        return None
    found = np.flatnonzero(cross)
    best = found[first[found].argmin()]
    return int(first[best]), int(second[best])


def _segments(line: np.ndarray, *, closed: bool) -> tuple[np.ndarray, np.ndarray]:
    return (line, np.roll(line, -1, axis=0)) if closed else (line[:-1], line[1:])


def _near_pairs(
    begin: np.ndarray, end: np.ndarray, begin_2: np.ndarray, end_2: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of segments whose middles are near enough for them to meet."""
    longest = np.linalg.norm(end - begin, axis=1).max()
    longest_2 = np.linalg.norm(end_2 - begin_2, axis=1).max()
    radius = float(longest + longest_2) / 2 * (1 + 1e-9) + 1e-12
    tree, tree_2 = KDTree((begin + end) / 2), KDTree((begin_2 + end_2) / 2)
    near = tree.sparse_distance_matrix(tree_2, radius, output_type="ndarray")
    return near["i"], near["j"]


def _meet(p: np.ndarray, q: np.ndarray, r: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return whether segments pq and rs meet; segments on one line do not count."""
    sides = _side(p, q, r), _side(p, q, s), _side(r, s, p), _side(r, s, q)
    across = (sides[0] * sides[1] <= 0) & (sides[2] * sides[3] <= 0)
    in_line = (sides[0] == 0) & (sides[1] == 0) & (sides[2] == 0) & (sides[3] == 0)
    return across & ~in_line


def _side(p: np.ndarray, q: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Return -1, 0 or 1: on which side of the line pq a point lies, 0 within rounding."""
    area = (q[:, 0] - p[:, 0]) * (point[:, 1] - p[:, 1]) - (q[:, 1] - p[:, 1]) * (
        point[:, 0] - p[:, 0]
    )
    return np.where(np.abs(area) < 1e-13, 0, np.sign(area)).astype(int)


def _place(line: np.ndarray, row: int) -> str:
    return f"({line[row, 0]:.2f}, {line[row, 1]:.2f}) m"
