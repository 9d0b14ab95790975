"""PaintRenderer: what the cars of a batch see, painted on the CPU."""

from functools import cached_property

import cv2
import numpy as np

from league.sim.camera import visual_randomization
from league.sim.camera.painter import Painter
from league.sim.camera.renderer import Renderer
from league.sim.camera.stage import Stage
from league.sim.camera.visual_randomization import Look


class PaintRenderer(Renderer):
    """Paints one world after the other."""

    @cached_property
    def _painter(self) -> Painter:
        # OpenCV's own threads cost more than they bring at these sizes.
        cv2.setNumThreads(1)
        return Painter(self._lens, gray=not self._camera.colour)

    def _draw(self, stage: Stage, car: int, look: Look | None) -> np.ndarray:
        cfg, painter = self._camera, self._painter
        shape = (len(stage.track), cfg.num_eyes, cfg.height, cfg.width)
        pictures = np.empty((*shape, 3) if cfg.colour else shape, np.uint8)
        for row, track in enumerate(stage.track):
            pose = stage.camera(row, car, cfg)
            painter.paint(pictures[row], pose, self._floor(track), stage.things(row, without=car))
            if look is not None:
                visual_randomization.develop(pictures[row], look, row)
        if cfg.colour:
            channels_first = pictures.transpose(0, 1, 4, 2, 3)  # (rows, eyes, 3, height, width)
            pictures = np.ascontiguousarray(channels_first).reshape(-1, *cfg.shape)
        return pictures
