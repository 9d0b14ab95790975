"""Whether a course is sound: no crossing, no overlap, no bend that nobody can drive.

Also where its waypoints lie along the lap.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from __future__ import annotations

import numpy as np

from league.errors import TrackError
from league.jit import compiled
from league.track.track import Track

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
    if track.waypoints is not None:
        _check_waypoints(track, track.waypoints, where)
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


def _check_waypoints(track: Track, points: np.ndarray, where: str) -> None:
    _, off = _projected(track, points)
    row = int(off.argmax())
    if off[row] > track.width / 2:
        raise TrackError(
            f"{where}: waypoints[{row}] lies {off[row]:.2f} m from the centreline; give points on "
            "it, or leave waypoints out"
        )
    if track.closed and not np.array_equal(points[0], points[-1]):
        raise TrackError(
            f"{where}: the last of the waypoints is not the first once more; on a loop repeat it"
        )
    s = _in_order(track, points)
    limit = s[0] + track.length if track.closed else np.inf
    wrong = (s > limit + track.width / 2) | (np.diff(s, prepend=s[0]) < -track.width / 2)
    wrong[-1] |= bool(track.closed and s[-1] < limit - track.width / 2)
    if wrong.any():
        raise TrackError(
            f"{where}: waypoints[{int(wrong.argmax())}] is out of order; give them in driving "
            "order, once along the track"
        )


def waypoint_places(track: Track) -> np.ndarray:
    """Return how far along the lap each waypoint lies [m], shape (M,): never falling.

    The first lies in [0, length), or [0, length] if open; beyond the start line they count on from
    length, so that those of a loop end one length after they began.
    """
    if track.waypoints is None:
        raise ValueError(f"the track {track.name} has no waypoints of its own")
    s = np.maximum.accumulate(_in_order(track, track.waypoints))
    return np.minimum(s, s[0] + track.length) if track.closed else s


def _in_order(track: Track, points: np.ndarray) -> np.ndarray:
    """Return where points in driving order lie [m], each counted on from the one before it."""
    s, _ = _projected(track, points)
    if not track.closed:
        return s
    # What lies a little behind the point before it has not gone round the whole lap.
    slack = track.width / 2
    steps = (np.diff(s) + slack) % track.length - slack
    return s[0] % track.length + np.concatenate([[0.0], np.cumsum(steps)])


def _projected(track: Track, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return where along the centreline points lie, and how far from it [m], shape (M,) each."""
    center, last = track.center, len(track.center) - 1
    nearest = _nearest(center, points)
    low = np.add.outer(nearest, [0, -1])  # the stretches after and before it, (M, 2)
    low = low % (last + 1) if track.closed else np.clip(low, 0, last - 1)
    begin = center[low]
    edge = center[(low + 1) % (last + 1)] - begin
    part = ((points[:, None] - begin) * edge).sum(axis=-1) / (edge**2).sum(axis=-1)
    part = np.clip(part, 0.0, 1.0)
    off = np.linalg.norm(points[:, None] - begin - part[..., None] * edge, axis=-1)
    rows, best = np.arange(len(points)), off.argmin(axis=1)
    return (low + part)[rows, best] * track.segment_lengths.mean(), off[rows, best]


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
    pairs = _pairs_within(radius, (begin + end) / 2, (begin_2 + end_2) / 2)
    return pairs[:, 0], pairs[:, 1]


@compiled
def _pairs_within(radius, points, others):
    """Return the rows of points that lie within a radius of each other, (num_pairs, 2)."""
    pairs = [(0, 0)]
    for i in range(len(points)):
        x, y = points[i]
        for j in range(len(others)):
            dx, dy = others[j, 0] - x, others[j, 1] - y
            if dx * dx + dy * dy <= radius * radius:
                pairs.append((i, j))
    return np.array(pairs)[1:]


@compiled
def _nearest(line, points):
    """Return the row of a line nearest to each point, (num_points,)."""
    rows = np.zeros(len(points), np.int64)
    for k in range(len(points)):
        least = np.inf
        for row in range(len(line)):
            dx, dy = line[row, 0] - points[k, 0], line[row, 1] - points[k, 1]
            if dx * dx + dy * dy < least:
                rows[k], least = row, dx * dx + dy * dy
    return rows


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
