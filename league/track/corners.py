"""Corners of a track, counted by the curvature of its centreline."""

from __future__ import annotations

import numpy as np

from league.track.track import Track

LEAST_BEND = 0.25
"""Curvature from which on the road bends [1/m]: a radius of 4 m, at which no car has to brake."""
LEAST_TURN = np.radians(20.0)
"""A bend that turns less than this is no corner [rad]."""


def corners(track: Track) -> int:
    """Return the number of corners: stretches that bend to one side and turn enough.

    The curvature is that over 0.3 m of the centreline. A bend that runs over the start line is one.
    """
    side = np.sign(track.curvature) * (np.abs(track.curvature) >= LEAST_BEND)
    turned = track.curvature * track.length / len(track.segment_lengths)
    if track.closed and (side == side[0]).all():
        return int(side[0] != 0)
    if track.closed:
        # Begin where one stretch ends and the next one begins.
        start = int(np.flatnonzero(side != np.roll(side, 1))[0])
        side, turned = np.roll(side, -start), np.roll(turned, -start)
    first = np.flatnonzero(np.diff(side, prepend=np.nan))
    turns = np.abs(np.add.reduceat(turned, first))
    return int(((side[first] != 0) & (turns >= LEAST_TURN)).sum())
