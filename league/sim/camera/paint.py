"""PaintRenderer: what the cars of a batch see, painted on the CPU."""

import cv2
import numpy as np
import torch
from torch import Tensor

from league.sim.camera import looks as looks_room
from league.sim.camera.ground import Floor
from league.sim.camera.painter import Painter
from league.sim.camera.setting import Setting
from league.sim.config import CameraConfig, LookConfig, SimConfig
from league.sim.world import World
from league.track.course import TrackSet


class PaintRenderer:
    """Renders one camera of one car in many worlds, one world after the other.

    Args:
        tracks: the tracks of the worlds.
        sim: settings of the worlds.
        camera: the camera.
        looks: randomisation of the pictures, if any.
    """

    def __init__(
        self,
        tracks: TrackSet,
        sim: SimConfig,
        camera: CameraConfig,
        looks: LookConfig | None = None,
    ) -> None:
        self._setting = Setting.of(tracks, sim, camera, looks)
        self._painter = Painter(self._setting.lens, gray=not camera.colour)
        self._floors: dict[int, Floor] = {}
        # OpenCV's own threads cost more than they bring at these sizes.
        cv2.setNumThreads(1)

    def render(self, world: World, car: int, rows: Tensor | None = None) -> Tensor:
        """Return the pictures of one car; uint8, (num_rows, channels, height, width).

        Channels are left gray, right gray; in colour the left eye's red, green, blue, then the
        right eye's.

        Args:
            world: the batch.
            car: slot of the car that looks.
            rows: worlds to render, int64; None for all.
        """
        cfg, painter = self._setting.camera, self._painter
        stage, look = self._setting.stage(world, rows, car)
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
        found = torch.from_numpy(pictures)
        return found if world.motion.x.is_cpu else found.to(world.motion.x.device)

    def _floor(self, track: int) -> Floor:
        floor = self._floors.get(track)
        if floor is None:
            floor = self._floors[track] = self._setting.floor(track)
        return floor
