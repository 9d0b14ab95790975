"""Pictures to an MP4 file, H.264, as every browser and the Rerun viewer play it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from fractions import Fraction

import av
import cv2
import numpy as np
from av.video.reformatter import ColorRange, Colorspace


@dataclass(frozen=True)
class Coding:
    """How pictures are compressed."""

    crf: int = 23
    """Constant rate factor of x264: smaller is finer and larger."""
    preset: str = "veryfast"
    """Speed of x264, ultrafast to placebo."""
    keyframe_s: float = 2.0
    """Longest time between two key frames [s]: what a viewer decodes at most when it seeks."""


def interleaved(planes: np.ndarray) -> np.ndarray:
    """Return a picture of three planes, (3, height, width), as (height, width, 3)."""
    return cv2.merge(list(planes))


class Mp4:
    """A video being written: add pictures, then close it, best in a with block."""

    def __init__(self, target: str | io.BytesIO, fps: int, coding: Coding | None = None) -> None:
        """Open a video in a file or in memory, at `fps` pictures per second."""
        self._fps, self._coding = fps, coding or Coding()
        # In a file the index stands in front, so that a player can start before it has all of it.
        options = {"movflags": "+faststart"} if isinstance(target, str) else {}
        self._container = av.open(target, "w", format="mp4", options=options)
        self._stream: av.VideoStream | None = None
        self.count = 0

    def __enter__(self) -> Mp4:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def add(self, picture: np.ndarray) -> None:
        """Append a picture: RGB uint8, (height, width, 3), all of one size with even sides."""
        if self._stream is None:
            self._stream = self._begin(picture.shape[1], picture.shape[0])
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
            if self._stream is not None:
                for packet in self._stream.encode():
                    self._container.mux(packet)
        finally:
            self._container.close()

    def _begin(self, width: int, height: int) -> av.VideoStream:
        if height % 2 or width % 2:
            raise ValueError(f"a video's sides must be even, not {width}x{height}")
        stream = self._container.add_stream("libx264", rate=self._fps)
        context = stream.codec_context
        stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
        stream.time_base = context.time_base = Fraction(1, self._fps)
        context.gop_size = max(1, round(self._fps * self._coding.keyframe_s))
        context.max_b_frames = 0
        # One thread a video: several videos are made side by side, and the bytes stay the same.
        context.thread_count = 1
        # OpenCV's planes are BT.601 at studio range; untagged, players would guess by the size.
        context.colorspace = Colorspace.ITU601
        context.color_range = ColorRange.MPEG
        stream.options = {"crf": str(self._coding.crf), "preset": self._coding.preset, "bf": "0"}
        return stream
