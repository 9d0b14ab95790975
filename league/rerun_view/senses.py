"""What the cars sense, for the viewer: their lidar's points and their eyes' films."""

from __future__ import annotations

import io
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import rerun as rr

from league.replay import Replay
from league.rerun_view import paths
from league.sim import lidar
from league.sim.camera.paint_renderer import PaintRenderer
from league.sim.camera.scene import CAR_COLOURS
from league.sim.config import CameraConfig, LidarConfig
from league.video.mp4 import Coding, Mp4, interleaved

EYE_CAMERA = CameraConfig(width=288, height=216, colour=True)
"""How the cars' eyes are shown, whatever their drivers were given."""
EYE_CODING = Coding(crf=29, preset="ultrafast", keyframe_s=2.0)
BATCH = 16
"""Frames rendered at a time; few, so that they stay in the cache."""
LIDAR_BATCH = 1024
LIDAR_EVERY = 2
"""One scan for so many frames (7.5 Hz of 15; the sensor's own clock is 10 Hz)."""


def times_of(replay: Replay, every: int = 1) -> list[rr.TimeColumn]:
    """Return the column of race times, for every frame or each n-th."""
    return [rr.TimeColumn(paths.TIMELINE, duration=replay.times_s[::every])]


def send_lidar(recording: rr.RecordingStream, replay: Replay) -> None:
    """Send what each car's rear lidar meets, as points in the car's frame."""
    cfg = LidarConfig(noise=0.0)
    times = replay.times_s[::LIDAR_EVERY]
    angles = np.array(lidar.beam_angles(cfg), dtype=np.float32)
    for slot in range(replay.num_cars):
        ranges = []
        for start in range(0, len(times), LIDAR_BATCH):
            world = replay.at(times[start : start + LIDAR_BATCH])
            ranges.append(lidar.scan(replay.tracks, replay.sim, cfg, world, slot))
        found = np.concatenate(ranges)  # (num_scans, beams)
        hit = found < cfg.max_range
        points = np.stack(
            [
                cfg.forward + found * np.cos(angles),
                found * np.sin(angles),
                np.full_like(found, cfg.up),
            ],
            axis=-1,
        )[hit]
        recording.log(
            paths.lidar(slot),
            rr.Points3D.from_fields(colors=[_bright(CAR_COLOURS[slot])], radii=[0.009]),
            static=True,
        )
        recording.send_columns(
            paths.lidar(slot),
            times_of(replay, LIDAR_EVERY),
            rr.Points3D.columns(positions=points.astype(np.float32)).partition(hit.sum(axis=1)),
        )


def _bright(colour: tuple[int, int, int]) -> tuple[int, ...]:
    return tuple((part + 255) // 2 for part in colour)


def send_eyes(recording: rr.RecordingStream, replay: Replay) -> None:
    """Send each eye's film and which of its pictures belongs to which frame."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        films = list(pool.map(lambda slot: _film(replay, slot), range(replay.num_cars)))
    for slot, pair in enumerate(films):
        for side, content in zip(paths.EYES, pair, strict=True):
            video = rr.AssetVideo(contents=content, media_type="video/mp4")
            recording.log(paths.eye(slot, side), video, static=True)
            stamps = video.read_frame_timestamps_nanos()
            recording.send_columns(
                paths.eye(slot, side),
                times_of(replay),
                rr.VideoFrameReference.columns_nanos(stamps),
            )


def _film(replay: Replay, slot: int) -> tuple[bytes, bytes]:
    """Return what a car's left and right eye saw, as two MP4 files."""
    renderer = PaintRenderer(replay.tracks, replay.sim, EYE_CAMERA)
    films = (io.BytesIO(), io.BytesIO())
    with (
        Mp4(films[0], replay.step_hz, EYE_CODING) as left,
        Mp4(films[1], replay.step_hz, EYE_CODING) as right,
    ):
        for start in range(0, replay.num_frames, BATCH):
            world = replay.at(replay.times_s[start : start + BATCH])
            pictures = renderer.render(world, slot)
            for planes in pictures:  # (6, height, width)
                left.add(interleaved(planes[:3]))
                right.add(interleaved(planes[3:]))
    return films[0].getvalue(), films[1].getvalue()
