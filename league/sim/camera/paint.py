"""PaintRenderer: what the cars of a batch see, painted on the CPU."""

import cv2
import numpy as np
import torch
from torch import Tensor

from league.sim.camera import looks as looks_room
from league.sim.camera.ground import Floor
from league.sim.camera.looks import Look
from league.sim.camera.painter import Painter
from league.sim.camera.renderer import Renderer
from league.sim.camera.stage import Stage
from league.sim.config import CameraConfig, LookConfig, SimConfig
from league.track.course import TrackSet


class PaintRenderer(Renderer):
    """Paints one world after the other."""

    def __init__(
        self,
        tracks: TrackSet,
        sim: SimConfig,
        camera: CameraConfig,
        looks: LookConfig | None = None,
    ) -> None:
        """Build the painter; see Renderer."""
        super().__init__(tracks, sim, camera, looks)
        self._painter = Painter(self._lens, gray=not camera.colour)
        self._floors: dict[int, Floor] = {}
        # OpenCV's own threads cost more than they bring at these sizes.
        cv2.setNumThreads(1)

    def _draw(self, stage: Stage, car: int, look: Look | None) -> Tensor:
        cfg, painter = self._camera, self._painter
        shape = (len(stage.track), cfg.num_eyes, cfg.height, cfg.width)
        pictures = np.empty((*shape, 3) if cfg.colour else shape, np.uint8)
        for row, track in enumerate(stage.track):
            pose = stage.camera(row, car, cfg)
            painter.paint(pictures[row], pose, self._floor(track), stage.things(row, without=car))
            if look is not None:
                looks_room.develop(pictures[row], look, row)
        if cfg.colour:
            channels_first = pictures.transpose(0, 1, 4, 2, 3)  # (rows, eyes, 3, height, width)
            pictures = np.ascontiguousarray(channels_first).reshape(-1, *cfg.shape)
        return torch.from_numpy(pictures)

    def _floor(self, track: int) -> Floor:
        floor = self._floors.get(track)
        if floor is None:
            floor = self._floors[track] = self._painted(track)
        return floor
