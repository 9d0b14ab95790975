"""Renderer: one camera of one kind of race, and what both ways to make its pictures do first."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from league.sim.camera import visual_randomization
from league.sim.camera.ground import Floor, floor_of
from league.sim.camera.lens import Lens
from league.sim.camera.stage import Stage
from league.sim.camera.visual_randomization import Look
from league.sim.config import CameraConfig, LookConfig, SimConfig
from league.sim.world import World
from league.track.track import TrackSet


class Renderer(ABC):
    """Makes the pictures of one camera of one car in many worlds.

    There are two: `PaintRenderer` for the CPU, and `RayRenderer` for any device.
    """

    def __init__(
        self,
        tracks: TrackSet,
        sim: SimConfig,
        camera: CameraConfig,
        looks: LookConfig | None = None,
    ) -> None:
        """Work out the lens.

        Args:
            tracks: the tracks of the worlds.
            sim: settings of the worlds.
            camera: the camera.
            looks: randomisation of the pictures, if any.
        """
        self._tracks, self._sim, self._camera = tracks, sim, camera
        self._looks = None if looks is None or looks.is_plain else looks
        self._lens = Lens.of(camera)
        self._floors: dict[int, Floor] = {}

    def render(self, world: World, car: int, rows: np.ndarray | None = None) -> np.ndarray:
        """Return the pictures of one car; uint8, (num_rows, channels, height, width).

        Channels are left gray, right gray; in colour the left eye's red, green, blue, then the
        right eye's.

        Args:
            world: the batch.
            car: slot of the car that looks.
            rows: worlds to render, int64; None for all.
        """
        look = None
        if self._looks is not None:
            look = visual_randomization.draw(self._looks, world, rows, car, self._camera.colour)
        return self._draw(Stage(self._sim, world, rows, look), car, look)

    @abstractmethod
    def _draw(self, stage: Stage, car: int, look: Look | None) -> np.ndarray:
        """Return the pictures of a car of all worlds of a stage."""

    def _floor(self, track: int) -> Floor:
        """Return the painted floor of a track as this camera needs it."""
        if track not in self._floors:
            cfg, course = self._camera, self._tracks.tracks[track]
            self._floors[track] = floor_of(course, self._lens, cfg.up, cfg.pitch, cfg.colour)
        return self._floors[track]
