"""Setting: what a renderer of either path is made for, and what both do first."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from league.sim.camera import looks as looks_room
from league.sim.camera.ground import Floor, floor_of
from league.sim.camera.lens import Lens
from league.sim.camera.looks import Look
from league.sim.camera.stage import Stage
from league.sim.config import CameraConfig, LookConfig, SimConfig
from league.sim.world import World
from league.track.course import TrackSet


@dataclass(frozen=True, eq=False)
class Setting:
    """One camera of one kind of race, wherever its pictures are made."""

    tracks: TrackSet
    """The tracks of the worlds."""
    sim: SimConfig
    """Settings of the worlds."""
    camera: CameraConfig
    """The camera."""
    looks: LookConfig | None
    """Randomisation of the pictures, if there is any."""
    lens: Lens
    """The camera's geometry."""

    @classmethod
    def of(
        cls, tracks: TrackSet, sim: SimConfig, camera: CameraConfig, looks: LookConfig | None
    ) -> Setting:
        """Work out the lens; looks that draw nothing are none."""
        drawn = None if looks is None or looks.is_plain else looks
        return cls(tracks, sim, camera, drawn, Lens.of(camera))

    def stage(self, world: World, rows: Tensor | None, car: int) -> tuple[Stage, Look | None]:
        """Return the worlds to be looked at and how their pictures are drawn away.

        Args:
            world: the batch.
            rows: worlds to render, int64; None for all.
            car: slot of the car that looks.
        """
        look = None
        if self.looks is not None:
            look = looks_room.draw(self.looks, world, rows, car, self.camera.colour)
        return Stage(self.sim, world, rows, look), look

    def floor(self, track: int) -> Floor:
        """Return the painted floor of a track as this camera needs it."""
        cfg = self.camera
        return floor_of(self.tracks.tracks[track], self.lens, cfg.up, cfg.pitch, cfg.colour)
