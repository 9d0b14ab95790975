"""From what a track file says to a Track: curve, borders, checks."""

from __future__ import annotations

import numpy as np

from league.errors import TrackError
from league.track import check, spline
from league.track.schema import TrackFile
from league.track.track import SPACING, Colours, Track

MIN_LENGTH, MAX_LENGTH = 2.0, 300.0
"""Shortest and longest centreline [m]."""
MAX_EXTENT = 60.0
"""Longest side of the rectangle round a centreline [m]."""

_MAX_MISSES = 0.1  # share of the rows whose normal may miss an explicit border


def track(file: TrackFile, text: str, where: str) -> Track:
    """Build and check the course that a track file describes.

    Args:
        file: what the file says.
        text: its YAML text, kept in the track.
        where: how to call the file in an error message.
    """
    points = np.array(file.points, dtype=np.float64)
    _check_points(points, file.closed, where)
    start = None if file.start is None else np.array(file.start, dtype=np.float64)
    center = spline.resample(points, closed=file.closed, spacing=SPACING, start=start)
    _check_center(center, file, where)
    normal = spline.left_normal(center, closed=file.closed)
    left, right = _reaches(center, normal, file, where)
    left = spline.unfold(center, normal, left, closed=file.closed)
    right = spline.unfold(center, -normal, right, closed=file.closed)
    course = Track(
        name=file.name,
        title=file.title,
        center=center,
        left=center + normal * left[:, None],
        right=center - normal * right[:, None],
        closed=file.closed,
        line_inside=file.line == "inside",
        line_width=file.line_width,
        colours=_colours(file),
        origin=file.origin,
        text=text,
        waypoints=None if file.waypoints is None else np.array(file.waypoints, dtype=np.float64),
    )
    return check.sound(course, where)


def _check_points(points: np.ndarray, closed: bool, where: str) -> None:
    following = np.roll(points, -1, axis=0) if closed else points[1:]
    chord = np.linalg.norm(following - points[: len(following)], axis=1)
    if chord.min() < 1e-3:
        row = int(chord.argmin())
        also = (row + 1) % len(points)
        raise TrackError(
            f"{where}: points[{row}] and points[{also}] are the same place; remove one of them"
            + (" (a loop closes by itself)" if also == 0 else "")
        )
    if chord.sum() > MAX_LENGTH:
        raise TrackError(
            f"{where}: the points are {chord.sum():,.0f} m long in all and a track has at most "
            f"{MAX_LENGTH:g} m; coordinates are in metres"
        )


def _check_center(center: np.ndarray, file: TrackFile, where: str) -> None:
    steps = np.linalg.norm(np.diff(center, axis=0), axis=1)
    length = steps.sum() + (np.linalg.norm(center[0] - center[-1]) if file.closed else 0.0)
    if not MIN_LENGTH <= length <= MAX_LENGTH:
        raise TrackError(
            f"{where}: the track is {length:.2f} m long; make it {MIN_LENGTH:g} to {MAX_LENGTH:g} m"
        )
    extent = np.ptp(center, axis=0).max()
    if extent > MAX_EXTENT:
        raise TrackError(
            f"{where}: the track is {extent:.1f} m across and a room has at most {MAX_EXTENT:g} m; "
            "coordinates are in metres"
        )
    if file.start is not None:
        off = float(np.linalg.norm(center[0] - np.array(file.start)))
        if off > file.width / 2:
            raise TrackError(
                f"{where}: start [{file.start[0]:g}, {file.start[1]:g}] lies {off:.2f} m from the "
                "centreline; give a point on it, or leave start out to begin at the first point"
            )
    if file.closed:
        _check_direction(center, file, where)


def _check_direction(center: np.ndarray, file: TrackFile, where: str) -> None:
    crossing = check.first_crossing(center, closed=True)
    if crossing is not None:
        # A figure of eight has no direction; let the check of crossings say so.
        return
    x, y = center.T
    area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
    found = "counter-clockwise" if area > 0 else "clockwise"
    if found != file.direction:
        raise TrackError(
            f"{where}: direction is {file.direction} but the points run {found}; "
            f"write `direction: {found}` or reverse the order of the points"
        )


def _reaches(
    center: np.ndarray, normal: np.ndarray, file: TrackFile, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return how far the borders lie to the left and right of each row [m]."""
    if file.left is None and file.right is None:
        half = np.full(len(center), file.width / 2)
        return half, half
    if file.left is None or file.right is None:
        given, other = ("right", "left") if file.left is None else ("left", "right")
        raise TrackError(
            f"{where}: the {given} border is given and the {other} is not; give both, or neither "
            "and let them follow from width"
        )
    left = _reach(center, normal, np.array(file.left), "left", file, where)
    right = _reach(center, -normal, np.array(file.right), "right", file, where)
    usual = float(np.median(left + right))
    if abs(usual - file.width) > 0.1 * file.width:
        raise TrackError(
            f"{where}: width is {file.width:g} but the borders lie {usual:.3f} m apart; "
            f"write `width: {usual:.3f}`"
        )
    return left, right


def _reach(
    center: np.ndarray,
    normal: np.ndarray,
    border: np.ndarray,
    side: str,
    file: TrackFile,
    where: str,
) -> np.ndarray:
    crossing = check.first_crossing(border, closed=file.closed)
    if crossing is not None:
        raise TrackError(
            f"{where}: {side}[{crossing[0]}] to {side}[{crossing[0] + 1}] of the {side} border "
            f"crosses {side}[{crossing[1]}] onward; put its points in driving order"
        )
    reach = spline.cast(center, normal, border, closed=file.closed, limit=2 * file.width)
    missed = np.isnan(reach)
    if missed.mean() > _MAX_MISSES:
        row = int(np.flatnonzero(missed)[0])
        raise TrackError(
            f"{where}: there is no {side} border beside the centreline near "
            f"({center[row, 0]:.2f}, {center[row, 1]:.2f}) m; give it along the whole track, on "
            "the driver's own left and right"
        )
    count, met = len(center), np.flatnonzero(~missed)
    if file.closed:
        met = np.concatenate([met[-1:] - count, met, met[:1] + count])
    return spline.interpolate(np.arange(count), met, reach[met % count])


def _colours(file: TrackFile) -> Colours:
    given = file.colours.model_dump(exclude_none=True)
    return Colours(**{part: (rgb[0], rgb[1], rgb[2]) for part, rgb in given.items()})
