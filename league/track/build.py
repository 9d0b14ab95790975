"""From what a track file says to a Track: curve, borders, and whether the course is sound.

A sound course has no crossing, no overlap and no bend that no car can drive.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from league.errors import TrackError
from league.track import spline
from league.track.projection import pairs_within
from league.track.track import SPACING, Colours, Track, TrackSet

if TYPE_CHECKING:
    from league.track.files import TrackFile

MIN_LENGTH, MAX_LENGTH = 2.0, 300.0  # shortest and longest centreline [m]
MAX_EXTENT = 60.0  # longest side of the rectangle round a centreline [m]
MIN_RADIUS = 0.2
"""Smallest radius of a centreline [m], smoothed over 0.3 m; the car itself turns in 0.284 m."""
MIN_REACH = 0.14  # least room between the centreline and a border [m]; half a car is 0.1 m wide

_MAX_MISSES = 0.1  # share of the rows in which the normal may miss an explicit border


def track(file: TrackFile, text: str, where: str) -> Track:
    """Build and check the course that a file with a YAML text describes; errors name `where`."""
    try:
        return sound(_course(file, text))
    except TrackError as error:
        raise TrackError(f"{where}: {error}") from None


def _course(file: TrackFile, text: str) -> Track:
    points = np.array(file.points, dtype=np.float64)
    _check_points(points, file.closed)
    start = None if file.start is None else np.array(file.start, dtype=np.float64)
    center = spline.resample(points, closed=file.closed, spacing=SPACING, start=start)
    _check_center(center, file)
    normal = spline.left_normal(center, closed=file.closed)
    left, right = _reaches(center, normal, file)
    left = spline.unfold(center, normal, left, closed=file.closed)
    right = spline.unfold(center, -normal, right, closed=file.closed)
    colours: dict[str, Any] = {part: tuple(rgb) for part, rgb in file.colours.items() if rgb}
    return Track(
        name=file.name,
        title=file.title,
        center=center,
        left=center + normal * left[:, None],
        right=center - normal * right[:, None],
        closed=file.closed,
        line_inside=file.line == "inside",
        line_width=file.line_width,
        colours=Colours(**colours),
        origin=file.origin,
        text=text,
        waypoints=None if file.waypoints is None else np.array(file.waypoints, dtype=np.float64),
    )


def _check_points(points: np.ndarray, closed: bool) -> None:
    begin, end = spline.segments(points, closed=closed)
    chord = np.linalg.norm(end - begin, axis=1)
    if chord.min() < 1e-3:
        row = int(chord.argmin())
        also = (row + 1) % len(points)
        raise TrackError(
            f"points[{row}] and points[{also}] are the same place; remove one of them"
            + (" (a loop closes by itself)" if also == 0 else "")
        )
    if chord.sum() > MAX_LENGTH:
        raise TrackError(
            f"the points are {chord.sum():,.0f} m long in all and a track has at most "
            f"{MAX_LENGTH:g} m; coordinates are in metres"
        )


def _check_center(center: np.ndarray, file: TrackFile) -> None:
    steps = np.linalg.norm(np.diff(center, axis=0), axis=1)
    length = steps.sum() + (np.linalg.norm(center[0] - center[-1]) if file.closed else 0.0)
    if not MIN_LENGTH <= length <= MAX_LENGTH:
        limits = f"{MIN_LENGTH:g} to {MAX_LENGTH:g} m"
        raise TrackError(f"the track is {length:.2f} m long; make it {limits}")
    extent = np.ptp(center, axis=0).max()
    if extent > MAX_EXTENT:
        raise TrackError(
            f"the track is {extent:.1f} m across and a room has at most {MAX_EXTENT:g} m; "
            "coordinates are in metres"
        )
    if file.start is not None:
        off = float(np.linalg.norm(center[0] - np.array(file.start)))
        if off > file.width / 2:
            raise TrackError(
                f"start [{file.start[0]:g}, {file.start[1]:g}] lies {off:.2f} m from the "
                "centreline; give a point on it, or omit start to begin at the first point"
            )
    # A figure of eight has no direction; the check of crossings reports it.
    if file.closed and first_crossing(center, closed=True) is None:
        runs = spline.winding(center)
        if runs != file.direction:
            raise TrackError(
                f"direction is {file.direction} but the points run {runs}; "
                f"write `direction: {runs}` or reverse the order of the points"
            )


def _reaches(
    center: np.ndarray, normal: np.ndarray, file: TrackFile
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far the borders lie to the left and right of each row [m]."""
    if file.left is None and file.right is None:
        half = np.full(len(center), file.width / 2)
        return half, half
    if file.left is None or file.right is None:
        one, other = ("right", "left") if file.left is None else ("left", "right")
        raise TrackError(
            f"the {one} border is given and the {other} is not; give both, or neither "
            "and let them follow from width"
        )
    left = _reach(center, normal, np.array(file.left), "left", file)
    right = _reach(center, -normal, np.array(file.right), "right", file)
    usual = float(np.median(left + right))
    if abs(usual - file.width) > 0.1 * file.width:
        raise TrackError(
            f"width is {file.width:g} but the borders lie {usual:.3f} m apart; "
            f"write `width: {usual:.3f}`"
        )
    return left, right


def _reach(
    center: np.ndarray, normal: np.ndarray, border: np.ndarray, side: str, file: TrackFile
) -> np.ndarray:
    crossing = first_crossing(border, closed=file.closed)
    if crossing is not None:
        raise TrackError(
            f"{side}[{crossing[0]}] to {side}[{crossing[0] + 1}] of the {side} border "
            f"crosses {side}[{crossing[1]}] onward; put its points in driving order"
        )
    reach = spline.cast(center, normal, border, closed=file.closed, limit=2 * file.width)
    missed = np.isnan(reach)
    if missed.mean() > _MAX_MISSES:
        row = int(np.flatnonzero(missed)[0])
        raise TrackError(
            f"there is no {side} border next to the centreline near "
            f"({center[row, 0]:.2f}, {center[row, 1]:.2f}) m; give it along the whole track, on "
            "the driver's own left and right"
        )
    count, met = len(center), np.flatnonzero(~missed)
    if file.closed:
        met = np.concatenate([met[-1:] - count, met, met[:1] + count])
    return spline.interpolate(np.arange(count), met, reach[met % count])


def sound(track: Track) -> Track:
    """Return the track; raise a TrackError with what is wrong with it and where."""
    _refuse_crossing(
        "the centreline crosses itself",
        "put the points in driving order and keep the stretches apart",
        track.center,
        closed=track.closed,
    )
    if track.min_radius < MIN_RADIUS:
        row = int(np.abs(track.curvature).argmax())
        raise TrackError(
            f"the bend near {_place(track.center, row)} has a radius of "
            f"{track.min_radius:.2f} m and a car needs {MIN_RADIUS} m; move the points there apart"
        )
    borders = (("left", track.left), ("right", track.right))
    for side, border in borders:
        reach = np.linalg.norm(border - track.center, axis=1)
        row = int(reach.argmin())
        if reach[row] < MIN_REACH:
            raise TrackError(
                f"the {side} border is only {reach[row]:.2f} m from the centreline near "
                f"{_place(track.center, row)}; leave {MIN_REACH} m or more"
            )
    mend = "move the stretches apart or make the road narrower"
    for side, border in borders:
        _refuse_crossing(f"the {side} border crosses itself", mend, border, closed=track.closed)
    lines = track.left, track.right
    _refuse_crossing("the road overlaps itself", mend, *lines, closed=track.closed)
    if track.waypoints is not None:
        _check_waypoints(track, track.waypoints)
    return track


def _refuse_crossing(fault: str, mend: str, *lines: np.ndarray, closed: bool) -> None:
    crossing = first_crossing(*lines, closed=closed)
    if crossing is not None:
        raise TrackError(f"{fault} near {_place(lines[0], crossing[0])}; {mend}")


def _check_waypoints(track: Track, points: np.ndarray) -> None:
    s, off = _in_order(track, points)
    row = int(off.argmax())
    if off[row] > track.width / 2:
        raise TrackError(
            f"waypoints[{row}] lies {off[row]:.2f} m from the centreline; give points on it, or "
            "omit waypoints"
        )
    if track.closed and not np.array_equal(points[0], points[-1]):
        raise TrackError(
            "the last of the waypoints is not the first once more; on a loop repeat it"
        )
    limit = s[0] + track.length if track.closed else np.inf
    wrong = (s > limit + track.width / 2) | (np.diff(s, prepend=s[0]) < -track.width / 2)
    wrong[-1] |= bool(track.closed and s[-1] < limit - track.width / 2)
    if wrong.any():
        raise TrackError(
            f"waypoints[{int(wrong.argmax())}] is out of order; give them in driving "
            "order, once along the track"
        )


def _in_order(track: Track, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how far along the track points in driving order lie, and how far from it [m], (M,)."""
    x, y = points.T[:, None]
    place = TrackSet(track).project(np.zeros(1, np.int64), x, y)
    s, off = place.s[0].astype(np.float64), np.hypot(place.x - x, place.y - y)[0]
    if track.closed:
        # What lies a little behind the point before it has not gone round the whole lap.
        slack = track.width / 2
        steps = (np.diff(s) + slack) % track.length - slack
        s = s[0] + np.concatenate([[0.0], np.cumsum(steps)])
    return s, off


def first_crossing(
    line: np.ndarray, other: np.ndarray | None = None, *, closed: bool
) -> tuple[int, int] | None:
    """Return the first two segments that cross, of one polyline [m] or of two, by their rows."""
    begin, end = spline.segments(line, closed=closed)
    begin_2, end_2 = (begin, end) if other is None else spline.segments(other, closed=closed)
    # Only segments with middles near enough can meet.
    longest = np.linalg.norm(end - begin, axis=1).max()
    longest_2 = np.linalg.norm(end_2 - begin_2, axis=1).max()
    radius = float(longest + longest_2) / 2 * (1 + 1e-9) + 1e-12
    first, second = pairs_within(radius, (begin + end) / 2, (begin_2 + end_2) / 2).T
    if other is None:
        apart = np.abs(first - second)
        apart = np.minimum(apart, len(begin) - apart) if closed else apart
        keep = (first < second) & (apart > 1)
        first, second = first[keep], second[keep]
    cross = _meet(begin[first], end[first], begin_2[second], end_2[second])
    if not cross.any():
        return None
    crossings = np.flatnonzero(cross)
    best = crossings[first[crossings].argmin()]
    return int(first[best]), int(second[best])


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
