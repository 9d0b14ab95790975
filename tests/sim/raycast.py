"""RayRenderer: pictures by casting a ray for each pixel, on the CPU."""

from typing import Any

import numba
import numpy as np

from league.sim.camera import visual_randomization
from league.sim.camera.raycast import Describer, cast_pixel, develop_pixel


@numba.njit
def cast(rows: Any, first_thing: Any, scenery: Any, pictures: Any) -> None:
    for number in range(pictures.size // pictures.shape[4]):
        cast_pixel(number, rows, first_thing, scenery, pictures)


@numba.njit
def develop(rows: Any, grain: Any, taken: Any, pictures: Any) -> None:
    for number in range(pictures.size // pictures.shape[4]):
        develop_pixel(number, rows, grain, taken, pictures)


class RayRenderer(Describer):
    """Makes the pictures that its descriptions stand for."""

    def _draw(self, tracks, poses, things, look) -> np.ndarray:
        cfg = self._camera
        rows = super()._draw(tracks, poses, things, look)[:, 0, 0]
        shape = (len(rows), cfg.num_eyes, cfg.height, cfg.width, self.channels)
        pictures = np.zeros(shape, np.uint8)
        cast(rows, self.first_thing, self.scenery(), pictures)
        if look is not None:
            taken, pictures = pictures, np.zeros_like(pictures)
            develop(rows, visual_randomization.grain(pictures[0].size), taken, pictures)
        return pictures.transpose(0, 1, 4, 2, 3).reshape(-1, *cfg.shape)
