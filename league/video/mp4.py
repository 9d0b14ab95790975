"""Pictures to an MP4 file, H.264, as every browser and the Rerun viewer play it."""

from __future__ import annotations

import io
from collections.abc import Iterable
from dataclasses import dataclass
from fractions import Fraction

import av
import cv2
import numpy as np


@dataclass(frozen=True)
class Coding:
    """How pictures are compressed."""

    crf: int = 23
    """Constant rate factor of x264: smaller is finer and larger."""
    preset: str = "veryfast"
    """Speed of x264, ultrafast to placebo."""
    keyframe_s: float = 2.0
    """Longest time between two key frames [s]: what a viewer decodes at most when it seeks."""


def encode(
    pictures: Iterable[np.ndarray], target: str | io.BytesIO, fps: int, coding: Coding | None = None
) -> int:
    """Write pictures to an MP4 and return how many they were.

    Args:
        pictures: RGB uint8, (height, width, 3), all of one size with even sides.
        target: a path, or memory.
        fps: pictures per second.
        coding: how to compress.
    """
    coding = coding or Coding()
    count = 0
    # In a file the index stands in front, so that a player can begin before it has the whole.
    options = {"movflags": "+faststart"} if isinstance(target, str) else {}
    with av.open(target, "w", format="mp4", options=options) as container:
        stream = None
        for picture in pictures:
            if stream is None:
                stream = _stream(container, picture, fps, coding)
            planes = cv2.cvtColor(picture, cv2.COLOR_RGB2YUV_I420)
            frame = av.VideoFrame.from_ndarray(planes, format="yuv420p")
            frame.pts = count
            for packet in stream.encode(frame):
                container.mux(packet)
            count += 1
        if stream is None:
            raise ValueError("a video needs at least one picture")
        for packet in stream.encode():
            container.mux(packet)
    return count


def _stream(container, picture: np.ndarray, fps: int, coding: Coding) -> av.VideoStream:  # noqa: ANN001
    height, width = picture.shape[:2]
    if height % 2 or width % 2:
        raise ValueError(f"a video's sides must be even, not {width}x{height}")
    stream = container.add_stream("libx264", rate=fps)
    stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
    stream.time_base = stream.codec_context.time_base = Fraction(1, fps)
    stream.codec_context.gop_size = max(1, round(fps * coding.keyframe_s))
    stream.codec_context.max_b_frames = 0
    # cv2's planes are BT.601 at studio range; untagged, players would guess by the size.
    stream.codec_context.colorspace = av.video.reformatter.Colorspace.ITU601
    stream.codec_context.color_range = av.video.reformatter.ColorRange.MPEG
    stream.options = {"crf": str(coding.crf), "preset": coding.preset, "bf": "0"}
    return stream
