"""The courses as reward functions are told of them: waypoints as lists, tables to look up.

A track's own waypoints are told as they are; the others' are spaced evenly along the centreline.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.deepracer.params_kernels import MEASURES
from league.track import check
from league.track.track import Track, TrackSet

WAYPOINT_SPACING = 0.15
"""Wished distance between two waypoints [m]: the original's re:Invent 2018 has 119 on 17.7 m."""

Point = tuple[float, float]


@dataclass(frozen=True, eq=False)
class Lines:
    """A TrackSet as reward functions are told of it; arrays have one entry for each track."""

    rows: np.ndarray
    """The points of all tracks, as `telling.tell` takes them."""
    measures: np.ndarray
    """MEASURES of each track."""
    places: np.ndarray
    """How far along the lap waypoints lie [m], of one track with its own after another; see
    `check.waypoint_places`."""
    clockwise: list[bool]
    """Whether each is driven clockwise."""
    waypoints: tuple[list[Point], ...]
    """Each track's, in driving order; closed tracks repeat the first point as the last. Whoever is
    handed one gets a copy of the list; its points are tuples, which nobody can change."""

    @classmethod
    def of(cls, tracks: TrackSet) -> Lines:
        """Make the tables."""
        courses = tracks.courses
        measures = np.zeros(len(courses), dtype=MEASURES)
        for name in ("first", "spacing", "length", "closed"):
            measures[name] = courses[name]
        measures["last"] = courses["count"] - 1
        measures["lap"] = tracks.lap_length(np.arange(len(courses)))
        measures["steps"] = [_steps(track) for track in tracks.tracks]
        places = [_places(track) for track in tracks.tracks]
        count = np.array([len(those) for those in places])
        measures["first_place"] = np.where(count > 0, np.cumsum(count) - count, -1)
        return cls(
            rows=tracks.points.view(np.float32).reshape(len(tracks.points), -1).astype(np.float64),
            measures=measures,
            places=np.concatenate(places),
            clockwise=[track.direction == "clockwise" for track in tracks.tracks],
            waypoints=tuple(_waypoints(track) for track in tracks.tracks),
        )


def _places(track: Track) -> np.ndarray:
    """Return where a track's own waypoints lie [m]; nothing if they are evenly spaced."""
    return np.empty(0) if track.waypoints is None else check.waypoint_places(track)


def _steps(track: Track) -> int:
    if track.waypoints is not None:
        return len(track.waypoints) - 1
    return max(round(track.length / WAYPOINT_SPACING), 3)


def _waypoints(track: Track) -> list[Point]:
    """Return a track's own, or else points evenly spaced from the start line on."""
    if track.waypoints is not None:
        return [(x, y) for x, y in track.waypoints.tolist()]
    points = np.vstack([track.center, track.center[:1]]) if track.closed else track.center
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    wanted = np.linspace(0.0, along[-1], _steps(track) + 1)
    x, y = (np.interp(wanted, along, points[:, axis]).tolist() for axis in (0, 1))
    line = list(zip(x, y, strict=True))
    return [*line[:-1], line[0]] if track.closed else line
