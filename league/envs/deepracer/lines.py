"""The courses as numpy tables: waypoints as lists, and points found on the centreline.

Reward functions are Python on the CPU, a few dozen rows at a time, and there a numpy call costs a
third of a torch call; so this repeats TrackSet.project in numpy (a test holds one to the other).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from league.sim import referee
from league.track.course import Track, TrackSet

WAYPOINT_SPACING = 0.15
"""Wished distance between two waypoints [m]: the original's re:Invent 2018 has 119 on 17.7 m."""

Point = tuple[float, float]


@dataclass(frozen=True)
class Places:
    """Where points lie on their tracks, (num_points,)."""

    s: np.ndarray
    """Distance along the centreline [m], in [0, length) on closed tracks."""
    lateral: np.ndarray
    """Distance to the left of the centreline [m]."""
    left: np.ndarray
    """Distance from the centreline to the left border there [m]."""
    right: np.ndarray
    """Distance from the centreline to the right border there [m]."""


@dataclass(frozen=True, eq=False)
class Lines:
    """A TrackSet as reward functions are told of it; arrays have one entry for each track."""

    rows: np.ndarray
    """The table of the set, (num_tracks * num_points, 14); see TrackSet.rows."""
    first_row: np.ndarray
    """Row of each track's first point, int64."""
    count: np.ndarray
    """Points of each track, int64."""
    spacing: np.ndarray
    """Distance between two points [m]."""
    length: np.ndarray
    """Length of the centreline [m]."""
    lap: np.ndarray
    """What counts as a lap [m]: the length, but of an open track a little less."""
    closed: np.ndarray
    """Whether the track is a loop."""
    clockwise: np.ndarray
    """Whether it is driven clockwise."""
    steps: np.ndarray
    """Stretches between two waypoints, int64."""
    waypoints: tuple[list[Point], ...]
    """Each track's centreline in driving order; closed tracks repeat the first point as the last.
    Whoever is handed one gets a copy of the list; its points are tuples, which nobody can change.
    """

    @classmethod
    def of(cls, tracks: TrackSet) -> Lines:
        """Make the tables."""
        number = torch.arange(len(tracks.tracks), device=tracks.device)
        length = tracks.length.cpu().numpy().astype(np.float64)
        return cls(
            rows=tracks.rows.cpu().numpy().astype(np.float64),
            first_row=np.arange(len(tracks.tracks)) * tracks.num_points,
            count=tracks.count.cpu().numpy(),
            spacing=tracks.spacing.cpu().numpy().astype(np.float64),
            length=length,
            lap=referee.lap_length(tracks, number)[:, 0].cpu().numpy().astype(np.float64),
            closed=tracks.closed.cpu().numpy(),
            clockwise=np.array([track.direction == "clockwise" for track in tracks.tracks]),
            steps=np.array([_steps(track) for track in tracks.tracks]),
            waypoints=tuple(_waypoints(track) for track in tracks.tracks),
        )

    def project(self, track: np.ndarray, x: np.ndarray, y: np.ndarray, near: np.ndarray) -> Places:
        """Find points on the centreline by Newton's method from where they were last seen.

        Args:
            track: row of the set each point is on, int64, (num_points,).
            x: [m].
            y: [m].
            near: last known distance along the centreline [m].
        """
        where = _Where(self, track)
        s = near
        for _ in range(3):
            s, mixed = where.at(s)
            cos, sin = mixed[2], mixed[3]
            dx, dy = x - mixed[0], y - mixed[1]
            across = dy * cos - dx * sin
            step = (dx * cos + dy * sin) / np.maximum(1.0 - mixed[4] * across, 0.3)
            s = s + np.clip(step, -0.5, 0.5)
        s, mixed = where.at(s)
        cos, sin = mixed[2], mixed[3]
        lateral = ((y - mixed[1]) * cos - (x - mixed[0]) * sin) / np.sqrt(cos * cos + sin * sin)
        return Places(s=s, lateral=lateral, left=mixed[5], right=mixed[6])

    def ahead(self, track: np.ndarray, s: np.ndarray, of: np.ndarray) -> np.ndarray:
        """Return how far `s` lies ahead of `of` [m]: on a loop in (0, length], else signed."""
        gap = s - of
        length = self.length[track]
        around = np.mod(gap, length)
        around = np.where(around <= 0.0, length, around)
        return np.where(self.closed[track], around, gap)

    def short_way(self, track: np.ndarray, gap: np.ndarray) -> np.ndarray:
        """Return a difference of two places the shorter way round [m]."""
        length = self.length[track]
        return np.where(self.closed[track], gap - np.rint(gap / length) * length, gap)

    def closest_waypoints(self, track: np.ndarray, s: np.ndarray) -> list[list[int]]:
        """Return the waypoint at or behind each place, and the next one; after the last comes 0."""
        steps = self.steps[track]
        # The tiny share keeps a place right at a waypoint from falling behind it by rounding.
        behind = np.floor(s / self.length[track] * steps + 1e-6).astype(np.int64)
        behind = np.clip(behind, 0, steps)
        following = np.where(behind >= steps, 0, behind + 1)
        return np.stack([behind, following], axis=1).tolist()


class _Where:
    """The look-ups of some points, whose tracks do not change while they are sought."""

    def __init__(self, lines: Lines, track: np.ndarray) -> None:
        self._rows, self._first = lines.rows, lines.first_row[track]
        self._length, self._spacing = lines.length[track], lines.spacing[track]
        self._last = lines.count[track] - 1
        self._closed = None if lines.closed.all() else lines.closed[track]

    def at(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return s wrapped, and x, y, cos, sin, curvature, left, right there, (7, num_points)."""
        wrapped = np.mod(s, self._length)
        if self._closed is not None:
            wrapped = np.where(self._closed, wrapped, np.clip(s, 0.0, self._length))
        place = wrapped / self._spacing
        low = np.minimum(place.astype(np.int64), self._last)
        found = self._rows[low + self._first].T  # (14, num_points)
        return wrapped, found[:7] + found[7:] * np.clip(place - low, 0.0, 1.0)


def _steps(track: Track) -> int:
    return max(round(track.length / WAYPOINT_SPACING), 3)


def _waypoints(track: Track) -> list[Point]:
    """Return points evenly spaced along the centreline, the first on the start line."""
    points = np.vstack([track.center, track.center[:1]]) if track.closed else track.center
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    wanted = np.linspace(0.0, along[-1], _steps(track) + 1)
    x, y = (np.interp(wanted, along, points[:, axis]).tolist() for axis in (0, 1))
    line = list(zip(x, y, strict=True))
    return [*line[:-1], line[0]] if track.closed else line
