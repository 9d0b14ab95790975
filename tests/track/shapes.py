"""Small tracks with numbers that can be worked out by hand."""

import math

import numpy as np

from league.track import build, files
from league.track.track import Track

HEAD = """name: {name}
title: A Test Track
direction: {direction}
width: {width}
line: inside
"""


def text(points: object, *, direction: str = "counter-clockwise", width: object = 0.8) -> str:
    """Write a track file; anything may be put in, sound or not."""
    head = HEAD.format(name="test_track", direction=direction, width=width)
    return f"{head}points: {points}\n"


def circle_points(radius: float = 2.0, count: int = 24) -> list[list[float]]:
    """Points of a circle round the origin, counter-clockwise from its east."""
    angle = np.arange(count) * 2 * math.pi / count
    return files.rounded(radius * np.stack([np.cos(angle), np.sin(angle)], axis=1), 6)


def circle(radius: float = 2.0, width: float = 0.8) -> Track:
    """A circle round the origin, counter-clockwise; s is radius times the angle."""
    return files.parse(text(circle_points(radius), width=width))


def stadium_points(straight: float = 4.0, radius: float = 0.6) -> list[list[float]]:
    """Two straights joined by half circles; starts on the lower straight, eastward."""
    x = straight / 2
    bend = np.linspace(-math.pi / 2, math.pi / 2, 9)
    east = np.stack([x + radius * np.cos(bend), radius + radius * np.sin(bend)], axis=1)
    west = np.stack([-x - radius * np.cos(bend), radius - radius * np.sin(bend)], axis=1)
    along = np.linspace(-x, x, 9)[1:-1]
    lower = np.stack([along, np.zeros_like(along)], axis=1)
    upper = np.stack([along[::-1], np.full_like(along, 2 * radius)], axis=1)
    ring = np.concatenate([lower, east, upper, west])
    return files.rounded(np.roll(ring, -3, axis=0), 4)


def straight(length: float = 6.0) -> Track:
    """An open straight along x from the origin."""
    points = [[part * length / 4, 0.0] for part in range(5)]
    return files.parse(text(points, direction="open"))


def waypoint_places(track: Track) -> np.ndarray:
    """Return how far along the lap each of a track's own waypoints lies [m]: never falling."""
    s = np.maximum.accumulate(build._in_order(track, track.waypoints)[0])
    return np.minimum(s, s[0] + track.length) if track.closed else s
