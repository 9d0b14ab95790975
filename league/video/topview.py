"""The whole track from above with the cars on it, small enough for a corner of the picture."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from league.replay import Replay
from league.sim.camera.stage import Stage
from league.sim.camera.top_view import draw_things
from league.sim.world import World
from league.track.markings import Plan

_MARGIN = 0.35
"""How much of the room round the road is shown [m]."""
_LARGER = 1.6
"""Cars are drawn this much larger than they are, to be seen."""
_DIMMED = 0.62


class TopView:
    """A track's floor at the right size, onto which cars are drawn."""

    def __init__(self, replay: Replay, width: int, height: int) -> None:
        """Paint the floor once, at most `width` pixels across and `height` down."""
        track = replay.track
        across, down = np.ptp(np.concatenate([track.left, track.right]), axis=0) + 2 * _MARGIN
        # A tall track lies on its side: the inset is wide.
        sideways = bool(down > 1.15 * across)
        across, down = (down, across) if sideways else (across, down)
        pixel = float(max(across / width, down / height))
        plan = Plan.of(track, pixel, _MARGIN, sideways=sideways)
        self._plan = replace(plan, picture=(plan.picture * _DIMMED).astype(np.uint8))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the picture [px]."""
        return self._plan.picture.shape[1], self._plan.picture.shape[0]

    def draw(self, replay: Replay, world: World, row: int) -> np.ndarray:
        """Return the picture of one world of a batch, RGB."""
        plan = replace(self._plan, picture=self._plan.picture.copy())
        draw_things(plan, Stage(replay.sim, world.row(row)), size=_LARGER)
        return plan.picture
