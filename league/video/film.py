"""A replay as a film, the chase camera with graphics over it; and pictures to an MP4 file."""

from __future__ import annotations

import io
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
from av.error import FFmpegError
from av.video.reformatter import ColorRange, Colorspace

from league.atomic_file import replacing
from league.errors import ReplayError
from league.portable_math import direction
from league.replay import Replay, broadcast
from league.sim.camera import painting
from league.sim.camera.ground import floor_of
from league.sim.camera.renderer import Painter
from league.sim.camera.scene import CAR, FAR_CAR, MODELS, SUN
from league.sim.camera.scene_state import Lens, things_of
from league.sim.camera.tables import SHADE, Floor, Pose
from league.sim.records import World
from league.track.markings import placed
from league.track.track import Rgb
from league.video.hud import Hud
from league.video.pixels import draw_shadow

SIZE = (1280, 720)
FPS = 30
AFTER_FINISH_S = 2.0  # how long a car that has finished is still followed [s]
HOLD_S = 4.0  # time at the end for the classification [s]
DARK = 0.3  # brightness above the walls, as a share of theirs: a hall and not a strip of sky
LABEL_UP, LABEL_REACH = 0.24, 5.0
"""Where a car's name is: above the floor, and this far from the camera at most [m]."""
BEHIND, ABOVE, TILT = 1.12, 0.56, 0.27
"""Where the chase camera is: behind its frame [m], above the floor [m], tilted down [rad]."""
VIEW = 1.15  # its horizontal field of view [rad]
WALL_GAP = 0.06  # how near to the wall it goes [m]
SHADOW_EDGE, SHADOW_KEPT = 0.025, 0.45
"""Half the width of a shadow's soft edge [m]; the brightness that is left in it, as a share."""
BATCH = 8
CRF, PRESET = 25, "superfast"
"""Of x264: as fine as "veryfast" in three fifths of its time; the file is half as large again."""
KEYFRAME_S = 2.0
"""Longest time between two key frames [s]: what a viewer decodes at most when it seeks."""


class Mp4:
    """A video being written, H.264, as every browser and the Rerun viewer play it.

    Add pictures, then close it, best in a with block.
    """

    def __init__(
        self,
        target: str | io.BytesIO,
        size: tuple[int, int],
        fps: int,
        crf: int = CRF,
        preset: str = PRESET,
    ) -> None:
        """Open a video in a file or in memory, at `fps` pictures per second.

        `size` is width and height [px], both even; `crf` and `preset` are fineness and speed of
        x264.
        """
        # In a file the index stands in front, so that a player can start before it has all of it.
        options = {"movflags": "+faststart"} if isinstance(target, str) else {}
        self._container = av.open(target, "w", format="mp4", options=options)
        self._stream = stream = self._container.add_stream("libx264", rate=fps)
        self.count = 0
        context = stream.codec_context
        stream.width, stream.height = size
        stream.pix_fmt = "yuv420p"
        stream.time_base = context.time_base = Fraction(1, fps)
        context.gop_size = round(fps * KEYFRAME_S)
        context.max_b_frames = 0
        # One thread a video: several videos are made side by side, and the bytes stay the same.
        context.thread_count = 1
        # OpenCV's planes are BT.601 at studio range; untagged, players would guess by the size.
        context.colorspace = Colorspace.ITU601
        context.color_range = ColorRange.MPEG
        stream.options = {"crf": str(crf), "preset": preset, "bf": "0"}

    def __enter__(self) -> Mp4:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, picture: np.ndarray) -> None:
        """Append a picture: RGB uint8, (height, width, 3)."""
        planes = np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2YUV_I420), dtype=np.uint8)
        frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
        frame.pts = self.count
        for packet in self._stream.encode(frame):
            self._container.mux(packet)
        self.count += 1

    def add_all(self, pictures: list[np.ndarray]) -> None:
        """Append pictures in their order."""
        for picture in pictures:
            self.add(picture)

    def close(self) -> None:
        """Write what is still held and the index."""
        try:
            for packet in self._stream.encode():
                self._container.mux(packet)
        finally:
            self._container.close()


class Film:
    """Pictures of one replay at any moment."""

    def __init__(self, replay: Replay, size: tuple[int, int] = SIZE) -> None:
        """Prepare the camera and the graphics; `size` is width and height [px], both even."""
        width, height = size
        if width % 2 or height % 2 or not (320 <= width <= 1920 and 180 <= height <= 1080):
            raise ReplayError(
                f"a video of {width}x{height} cannot be made: give even sides from 320x180 to "
                "1920x1080"
            )
        self._replay = replay
        red, green, blue = (round(DARK * part) for part in replay.track.colours.wall)
        cos, sin = direction(VIEW / 2)
        lens = Lens(width, height, width / 2 * cos / sin)
        floor = floor_of(replay.track, lens, ABOVE, TILT, colour=True)
        self._painter = _ShadowPainter(lens, floor, (red, green, blue))
        # OpenCV's own threads cost more than they bring at these sizes.
        cv2.setNumThreads(1)
        self._size = size
        self.ends_s = min(replay.decided_s + AFTER_FINISH_S, replay.duration_s)
        """When the classification is shown: shortly after the last fight is decided [s]."""
        self._path = broadcast.chase_path(replay)
        self._hud = Hud(replay, width, height, self._path.fights)

    def pictures(self, times_s: np.ndarray) -> list[np.ndarray]:
        """Return the pictures of these moments, RGB uint8, (height, width, 3) each."""
        world = self._replay.at(times_s)
        x, y, yaw = self._eye(np.clip(times_s, 0.0, self._replay.duration_s))
        things, pictures = things_of(self._replay.sim, world, gray=False), []
        tilt_cos, tilt_sin = direction(TILT)
        for row, time_s in enumerate(times_s):
            east, north = np.array([x[row], y[row]], np.float32).tolist()
            cos, sin = direction(yaw[row])
            pose = Pose(east, north, ABOVE, cos, sin, tilt_cos, tilt_sin)
            picture = self._painter.picture(pose, things[row])
            if time_s > self.ends_s:
                self._hud.draw_result(picture)
            else:
                self._hud.draw_names(picture, self._labels(world, row, x[row], y[row], yaw[row]))
                self._hud.draw(picture, world, row, float(time_s))
            pictures.append(picture)
        return pictures

    def _labels(
        self, world: World, row: int, x: float, y: float, yaw: float
    ) -> list[tuple[int, int, int]]:
        """Return the cars in front of the camera and their names' pixels, the farthest first."""
        cars = world.cars[row]
        ahead = (cars["x"] - x) * np.cos(yaw) + (cars["y"] - y) * np.sin(yaw)
        right = (cars["x"] - x) * np.sin(yaw) - (cars["y"] - y) * np.cos(yaw)
        below = ABOVE - LABEL_UP
        depth = ahead * np.cos(TILT) + below * np.sin(TILT)
        down = below * np.cos(TILT) - ahead * np.sin(TILT)
        width, height = self._size
        focal = width / 2 / np.tan(VIEW / 2)
        seen = np.flatnonzero((depth > 0.3) & (depth < LABEL_REACH))
        return [
            (
                int(car),
                round(width / 2 + focal * float(right[car] / depth[car])),
                round(height / 2 + focal * float(down[car] / depth[car])),
            )
            for car in seen[np.argsort(-depth[seen])]
        ]

    def _eye(self, times_s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the chase camera's position and heading, inside the walls."""
        x, y, yaw = self._path.at(times_s * self._replay.step_hz)
        x, y = x - BEHIND * np.cos(yaw), y - BEHIND * np.sin(yaw)
        x_min, y_min, x_max, y_max = self._replay.track.room
        x = np.clip(x, x_min + WALL_GAP, x_max - WALL_GAP)
        y = np.clip(y, y_min + WALL_GAP, y_max - WALL_GAP)
        return x, y, yaw


class _ShadowPainter(Painter):
    """Paints whole pictures in colour of one track, with shadows on the floor."""

    def __init__(self, lens: Lens, floor: Floor, sky: Rgb) -> None:
        super().__init__(lens, gray=False, sky=sky)
        self._floor = floor

    def picture(self, pose: Pose, things: np.ndarray) -> np.ndarray:
        """Return what is seen from a place, RGB uint8, (height, width, 3).

        `things` are those of a world, lit; see `things_of`.
        """
        pictures = np.empty((1, 1, self._lens.height, self._lens.width, 3), np.uint8)
        seen = np.zeros(1, np.int64), pictures, np.array([pose]), things[None], self._floor
        top = self.paint(*seen, painting.FLOOR)
        flat = pictures.reshape(self._lens.height, -1)
        for thing in things:
            shadow = shadow_of(thing)
            draw_shadow(flat, top, shadow, SHADOW_EDGE, SHADOW_KEPT, self._optics, pose)
        self.paint(*seen, painting.ROOM)
        return pictures[0, 0]


def shadow_of(thing: np.ndarray) -> np.ndarray:
    """Return the outline of what keeps the sun from the floor, as sides for `draw_shadow`.

    It is the hull of all corners, each moved along the light down to the floor: (sides, 3). The
    thing is a row of `things_of`.
    """
    kind, x, y, cos, sin, _, *scale = thing[:SHADE].tolist()
    model = FAR_CAR if MODELS[int(kind)] is CAR else MODELS[int(kind)]  # with wheels as one block
    corners = np.concatenate([solid.vertices for solid in model.solids]) * scale
    places = placed(corners[:, :2], x, y, cos, sin)
    places -= corners[:, 2:] * np.array(SUN[:2]) / SUN[2]
    hull = cv2.convexHull(places.astype(np.float32)).reshape(-1, 2).astype(float)
    along = np.roll(hull, -1, axis=0) - hull
    normals = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    if np.einsum("ij,ij->i", normals, hull - hull.mean(axis=0)).mean() < 0:
        normals = -normals
    return np.column_stack([normals, np.einsum("ij,ij->i", normals, hull)])


def render(
    replay: Replay,
    path_mp4: str | os.PathLike[str],
    *,
    size: tuple[int, int] = SIZE,
    fps: int = FPS,
    progress: Callable[[float], None] | None = None,
) -> Path:
    """Render a replay to an MP4, whole or not at all, and return its path.

    The size is width and height [px], both even. Between two steps the cars are drawn on straight
    lines. `progress` is called with the share that is done, 0 to 1.
    """
    if not 1 <= fps <= 120:
        raise ReplayError(f"a video at {fps} pictures per second cannot be made: give 1 to 120")
    film = Film(replay, size)
    count = round((film.ends_s + HOLD_S) * fps) + 1
    with (
        replacing(path_mp4, "the video", ReplayError, also=(FFmpegError,)) as file,
        Mp4(str(file), size, fps) as video,
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
