"""A replay as a film: the chase camera with graphics over it."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np
from av.error import FFmpegError

from league.atomic_file import replacing
from league.errors import ReplayError
from league.replay import Replay, story
from league.sim.camera.paint_renderer import PaintRenderer
from league.sim.config import CameraConfig
from league.sim.records import CAR
from league.sim.world import World
from league.video.hud import Hud
from league.video.mp4 import Coding, Mp4, interleaved

SIZE = (1280, 720)
FPS = 30
HOLD_S = 3.0
"""Time at the end for the classification [s]."""
BEHIND, ABOVE, TILT = 1.12, 0.56, 0.27
"""Where the chase camera is: behind its frame [m], above the floor [m], tilted down [rad]."""
VIEW = 1.15
"""Its horizontal field of view [rad]."""
WALL_GAP = 0.06
"""How near to the wall it goes [m]."""
BATCH = 8
CODING = Coding(crf=25, preset="veryfast")


class Film:
    """Pictures of one replay at any moment."""

    def __init__(self, replay: Replay, size: tuple[int, int] = SIZE) -> None:
        """Prepare the camera and the graphics.

        Args:
            replay: the race.
            size: width and height [px], both even.
        """
        width, height = size
        if width % 2 or height % 2 or not (320 <= width <= 1920 and 180 <= height <= 1080):
            raise ReplayError(
                f"a video of {width}x{height} cannot be made: give even sides from 320x180 to "
                "1920x1080"
            )
        self._replay = replay
        camera = CameraConfig(
            width=width,
            height=height,
            colour=True,
            eyes="mono",
            field_of_view=VIEW,
            forward=0.0,
            up=ABOVE,
            pitch=TILT,
        )
        self._renderer = PaintRenderer(replay.tracks, replay.sim, camera)
        self._hud = Hud(replay, width, height)
        self._path = story.chase_path(replay)

    def pictures(self, times_s: np.ndarray) -> list[np.ndarray]:
        """Return the pictures of these moments, RGB uint8, (height, width, 3) each."""
        world = self._replay.at(times_s)
        x, y, yaw = self._eye(np.clip(times_s, 0.0, self._replay.duration_s))
        seen = self._renderer.render(_with_eye(world, x, y, yaw), self._replay.num_cars)
        pictures = []
        for row, time_s in enumerate(times_s):
            picture = interleaved(seen[row])
            self._hud.draw(picture, world, row, float(time_s))
            pictures.append(picture)
        return pictures

    def _eye(self, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the chase camera's position and heading, inside the walls."""
        at = self._replay.times_s
        path = self._path
        yaw = np.interp(times_s, at, path.yaw)
        x = np.interp(times_s, at, path.x) - BEHIND * np.cos(yaw)
        y = np.interp(times_s, at, path.y) - BEHIND * np.sin(yaw)
        x_min, y_min, x_max, y_max = self._replay.track.room
        x = np.clip(x, x_min + WALL_GAP, x_max - WALL_GAP)
        y = np.clip(y, y_min + WALL_GAP, y_max - WALL_GAP)
        return x, y, yaw


def render(
    replay: Replay,
    path_mp4: str | os.PathLike[str],
    *,
    size: tuple[int, int] = SIZE,
    fps: int = FPS,
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Render a replay to an MP4, whole or not at all, and return its path.

    Args:
        replay: the race.
        path_mp4: the file to write.
        size: width and height [px], both even.
        fps: pictures per second; between two steps the cars are drawn on straight lines.
        progress: called with the share that is done, 0 to 1.
    """
    if not 1 <= fps <= 120:
        raise ReplayError(f"a video at {fps} pictures per second cannot be made: give 1 to 120")
    film = Film(replay, size)
    count = round((replay.duration_s + HOLD_S) * fps) + 1
    with (
        replacing(path_mp4, "the video", ReplayError, also=(FFmpegError,)) as file,
        Mp4(str(file), fps, CODING) as video,
        # While one batch is compressed, the next is drawn.
        ThreadPoolExecutor(max_workers=1) as pool,
    ):
        written = pool.submit(video.add_all, [])
        for start in range(0, count, BATCH):
            pictures = film.pictures(np.arange(start, min(start + BATCH, count)) / fps)
            written.result()
            written = pool.submit(video.add_all, pictures)
            if progress is not None:
                progress(min(1.0, (start + BATCH) / count))
        written.result()
    return Path(path_mp4)


def still(replay: Replay, time_s: float, *, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Return the picture of one moment, RGB uint8, (height, width, 3)."""
    return Film(replay, size).pictures(np.array([time_s]))[0]


def _with_eye(world: World, x: np.ndarray, y: np.ndarray, yaw: np.ndarray) -> World:
    """Return the worlds with one more, invisible car, which carries the chase camera.

    So the renderer of the cars' own cameras draws the film.
    """
    cars = np.zeros((world.num_worlds, world.num_cars + 1), CAR)
    cars[:, :-1] = world.cars
    eye = cars[:, -1]
    eye["x"], eye["y"], eye["yaw"] = x, y, yaw
    return replace(world, cars=cars)
