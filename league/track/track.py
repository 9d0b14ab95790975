"""Track, one fixed course, and TrackSet, many of them as tables for a batch of worlds.

Frames: world x, y [m]; s [m] runs along the centreline in driving order from the start line;
lateral [m] is positive to the driver's left. The centreline is resampled at a uniform spacing of
about 5 cm, so a point's neighbours are found by dividing s.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np

from league.track import spline

SPACING = 0.05  # wished distance between two points of a resampled centreline [m]

ROOM_MARGIN = 0.84
"""From the road's bounding box to the room's wall [m]; the original's is 0.76 to 0.92."""
LEAST_BEND = 0.25
"""Curvature from which on the road bends [1/m]: a radius of 4 m, at which no car has to brake."""
LEAST_TURN = np.radians(20.0)  # a bend that turns less than this is no corner [rad]

Rgb = tuple[int, int, int]


@dataclass(frozen=True)
class Colours:
    """What the floor is painted with, sRGB 0-255 (defaults: re:Invent 2018)."""

    road: Rgb = (36, 49, 64)
    field: Rgb = (95, 136, 104)
    line: Rgb = (194, 194, 190)
    dash: Rgb = (194, 117, 0)
    wall: Rgb = (36, 70, 81)


@dataclass(frozen=True, eq=False)
class Track:
    """One course, resampled; made by `league.track.files` or `league.track.generate`."""

    name: str  # short name: letters, digits, underscore
    title: str  # what a person calls it
    # centreline [m], shape (N, 2) float64, uniform spacing, driving order, row 0 on the start line;
    # a closed track does not repeat row 0
    center: np.ndarray
    # border on the driver's left [m], shape (N, 2): where the centreline's normal meets it
    left: np.ndarray
    right: np.ndarray  # border on the driver's right [m], shape (N, 2)
    closed: bool = True  # False for a straight that ends at its last row
    line_inside: bool = True  # whether the border is the white line's outer edge, or its inner one
    line_width: float = 0.076  # width of the white border lines [m]
    colours: Colours = field(default_factory=Colours)
    origin: str = ""  # where the shape comes from
    text: str = ""  # the YAML text it was made from, so that a replay can carry its track
    # `waypoints` of reward functions [m], shape (M, 2), driving order; a closed track repeats row 0
    # as the last. None: points evenly spaced along the centreline
    waypoints: np.ndarray | None = None

    @cached_property
    def length(self) -> float:
        """Length of the centreline [m]."""
        return math.fsum(self.segment_lengths)

    @cached_property
    def segment_lengths(self) -> np.ndarray:
        """Distance from each centre point to the next [m]; shape (N,), or (N - 1,) if open."""
        begin, end = spline.segments(self.center, closed=self.closed)
        return np.linalg.norm(end - begin, axis=1)

    @cached_property
    def width(self) -> float:
        """Usual distance between the borders [m]: the median, for bends may clip one."""
        return float(np.median(np.linalg.norm(self.left - self.right, axis=1)))

    @cached_property
    def tangent(self) -> np.ndarray:
        """Unit driving direction at each centre point, shape (N, 2), by central differences."""
        return spline.tangent(self.center, closed=self.closed)

    @cached_property
    def curvature(self) -> np.ndarray:
        """Signed curvature [1/m] over a window of about 0.3 m, shape (N,); positive turns left."""
        turns = spline.turns(self.tangent, np.roll(self.tangent, -1, axis=0))
        heading = np.concatenate([[0.0], np.cumsum(turns[:-1])])
        spacing = self.length / len(self.segment_lengths)
        reach = max(1, round(0.15 / spacing))
        if self.closed:
            turn = heading[-1] + turns[-1]
            padded = np.concatenate([heading[-reach:] - turn, heading, heading[:reach] + turn])
        else:
            padded = np.pad(heading, reach, mode="edge")
        return (padded[2 * reach :] - padded[: -2 * reach]) / (2 * reach * spacing)

    @property
    def min_radius(self) -> float:
        """Smallest radius of the centreline [m], smoothed over 0.3 m."""
        return float(1.0 / max(np.abs(self.curvature).max(), 1e-9))

    @property
    def bends(self) -> str:
        """The smallest radius in words, or "straight"."""
        return f"smallest radius {self.min_radius:.2f} m" if self.min_radius < 1000 else "straight"

    @cached_property
    def num_corners(self) -> int:
        """Number of stretches that bend to one side and turn enough; over the start line, one."""
        side = np.sign(self.curvature) * (np.abs(self.curvature) >= LEAST_BEND)
        turned = self.curvature * self.length / len(self.segment_lengths)
        if self.closed and (side == side[0]).all():
            return int(side[0] != 0)
        if self.closed:
            # Begin where one stretch ends and the next one begins.
            start = int(np.flatnonzero(side != np.roll(side, 1))[0])
            side, turned = np.roll(side, -start), np.roll(turned, -start)
        first = np.flatnonzero(np.diff(side, prepend=np.nan))
        turns = np.abs(np.add.reduceat(turned, first))
        return int(((side[first] != 0) & (turns >= LEAST_TURN)).sum())

    @cached_property
    def direction(self) -> Literal["counter-clockwise", "clockwise", "open"]:
        """Which way round it is driven."""
        return spline.winding(self.center) if self.closed else "open"

    @cached_property
    def room(self) -> tuple[float, float, float, float]:
        """The wall round the field: x_min, y_min, x_max, y_max [m]."""
        outline = np.concatenate([self.left, self.right])
        low, high = outline.min(axis=0) - ROOM_MARGIN, outline.max(axis=0) + ROOM_MARGIN
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def reversed(self) -> Track:
        """Return the same course driven the other way, from the same start line."""
        order = np.roll(np.arange(len(self.center))[::-1], 1 if self.closed else 0)
        waypoints = None if self.waypoints is None else self.waypoints[::-1]
        return self._turned("reversed", lambda line: line[order], waypoints)

    def mirrored(self) -> Track:
        """Return the course as a mirror along x shows it: left bends turn right."""
        flip = np.array([1.0, -1.0])
        waypoints = None if self.waypoints is None else self.waypoints * flip
        return self._turned("mirrored", lambda line: line * flip, waypoints)

    def _turned(
        self, how: str, turn: Callable[[np.ndarray], np.ndarray], waypoints: np.ndarray | None
    ) -> Track:
        """Return the course with all of its lines turned, so that left is right."""
        return replace(
            self,
            name=f"{self.name}_{how}",
            title=f"{self.title}, {how}",
            center=turn(self.center),
            left=turn(self.right),
            right=turn(self.left),
            text="",
            waypoints=waypoints,
        )


@dataclass(frozen=True)
class Projection:
    """Where points lie on their track; every field is float32 of the points' shape."""

    s: np.ndarray  # distance along the centreline from the start line, on a loop below length [m]
    x: np.ndarray  # centreline there, world frame [m]
    y: np.ndarray
    cos: np.ndarray  # cosine and sine of the track's heading there
    sin: np.ndarray
    curvature: np.ndarray  # signed curvature there [1/m], positive to the left
    left: np.ndarray  # distance from the centreline to either border [m], positive
    right: np.ndarray
    lateral: np.ndarray  # distance of the point to the left of the centreline [m]


class TrackSet:
    """Several tracks as tables for compiled code; `index` says which track each world races on.

    Wherever `index` is an argument it is int64 of shape (num_worlds,), and the other arguments
    have shape (num_worlds, ...).
    """

    def __init__(self, *tracks: Track) -> None:
        """Build the tables of one track or more."""
        from league.track.projection import COURSE, POINT  # late: Numba takes a while

        if not tracks:
            raise ValueError("a TrackSet needs at least one track")
        self.tracks = tracks
        tables = [_points(track) for track in tracks]
        # POINT records of all tracks, one track after the other
        self.points = np.concatenate(tables).view(POINT)[:, 0]
        self.courses = np.zeros(len(tracks), COURSE)  # COURSE record of each track
        first = 0
        for course, track, table in zip(self.courses, tracks, tables, strict=True):
            course["first"], course["count"] = first, len(table)
            course["length"] = track.length
            course["spacing"] = track.length / len(track.segment_lengths)
            for name, wall in zip(("x_min", "y_min", "x_max", "y_max"), track.room, strict=True):
                course[name] = wall
            course["inner"] = -1.0 if track.direction == "clockwise" else 1.0
            course["closed"] = track.closed
            first += len(table)
        self.length = self.courses["length"]  # of each track [m], float32 (num_tracks,)
        self.closed = self.courses["closed"]  # whether each track is a loop, bool (num_tracks,)
        # wall of each track, x_min, y_min, x_max, y_max [m], float32 (num_tracks, 4)
        self.rooms = np.array([track.room for track in tracks], np.float32)

    def lap_length(self, index: np.ndarray) -> np.ndarray:
        """Return what counts as a lap [m]: the loop, or an open track but its end."""
        from league.track.projection import OPEN_TRACK_MARGIN

        length = self.length[index]
        return np.where(self.closed[index], length, length - OPEN_TRACK_MARGIN)

    def at(self, index: np.ndarray, s: np.ndarray) -> Projection:
        """Return the track's frame at distance s [m], wrapped or held at the ends if open."""
        from league.track import projection

        s = np.asarray(s, np.float32)
        index = self._spread(index, s)
        frames = projection.frames_at(self.points, self.courses, index, s.ravel())
        return _projection(frames, s.shape)

    def project(
        self, index: np.ndarray, x: np.ndarray, y: np.ndarray, near_s: np.ndarray | None = None
    ) -> Projection:
        """Project points [m] to the centreline.

        A point is sought from its last known s, `near_s` [m], so a car stays on its own stretch
        where two run side by side. None searches the whole centreline.
        """
        from league.track import projection

        near_s = np.full(np.shape(x), np.nan) if near_s is None else near_s
        x, y, near_s = np.broadcast_arrays(
            *(np.asarray(given, np.float32) for given in (x, y, near_s))
        )
        places = self._spread(index, x), x.ravel(), y.ravel(), near_s.ravel()
        frames = projection.projections(self.points, self.courses, *places)
        return _projection(frames, x.shape)

    def signed_gap(self, index: np.ndarray, ahead: np.ndarray, behind: np.ndarray) -> np.ndarray:
        """Return how far `ahead` lies in front of `behind` along the track [m].

        On closed tracks the shorter way round is taken, in [-length / 2, length / 2).
        """
        from league.track import projection

        ahead, behind = np.broadcast_arrays(
            np.asarray(ahead, np.float32), np.asarray(behind, np.float32)
        )
        track = self._spread(index, ahead)
        gaps = projection.gaps(self.courses, track, ahead.ravel(), behind.ravel())
        return gaps.reshape(ahead.shape)

    def _spread(self, index: np.ndarray, places: np.ndarray) -> np.ndarray:
        """Return the track of each place, int64 (places.size,)."""
        index, number = np.asarray(index, np.int64), len(self.tracks)
        # Compiled code would read whatever lies in memory there.
        known = index.size == 0 or (index.min() >= 0 and index.max() < number)
        if not known or index.shape != places.shape[: index.ndim]:
            raise IndexError(
                f"the worlds are on tracks {index.tolist()}, and the places have shape "
                f"{places.shape}: give the track of each world, 0 to {number - 1}"
            )
        shape = index.shape + (1,) * (places.ndim - index.ndim)
        return np.broadcast_to(index.reshape(shape), places.shape).ravel()


def _projection(frames: np.ndarray, shape: tuple[int, ...]) -> Projection:
    return Projection(*(column.reshape(shape) for column in frames.T))


def _points(track: Track) -> np.ndarray:
    """Return the rows of one track's table, float32 (num_points, 14); see POINT."""
    reaches = [np.linalg.norm(side - track.center, axis=1) for side in (track.left, track.right)]
    columns = np.column_stack([track.center, track.tangent, track.curvature, *reaches])
    following = np.roll(columns, -1, axis=0)
    if not track.closed:
        following[-1] = columns[-1]
    table = np.concatenate([columns, following - columns], axis=1)
    return np.ascontiguousarray(table, dtype=np.float32)
