"""Poses over time for the viewer, as arrays of translations and quaternions (x, y, z, w)."""

from __future__ import annotations

import numpy as np

from league.replay import Replay
from league.replay.story import speeds
from league.sim.camera.scene import WHEEL_RADIUS, WHEEL_X, WHEEL_Y
from league.sim.config import CameraConfig

WHEEL_PLACES = tuple((x, y, WHEEL_RADIUS) for x in (WHEEL_X, -WHEEL_X) for y in (WHEEL_Y, -WHEEL_Y))
"""Centres of front left, front right, rear left, rear right [m], car frame."""


def about_z(angle: np.ndarray) -> np.ndarray:
    """Return quaternions of turns about z [rad], shape (..., 4)."""
    zero = np.zeros_like(angle)
    return np.stack([zero, zero, np.sin(angle / 2), np.cos(angle / 2)], axis=-1)


def turned(yaw: np.ndarray, pitch: np.ndarray, roll: np.ndarray) -> np.ndarray:
    """Return quaternions of turns about z, then the new y, then the new x [rad], (..., 4)."""
    (sz, cz), (sy, cy), (sx, cx) = (
        (np.sin(angle / 2), np.cos(angle / 2)) for angle in (yaw, pitch, roll)
    )
    return np.stack(
        [
            cz * cy * sx - sz * sy * cx,
            cz * sy * cx + sz * cy * sx,
            sz * cy * cx - cz * sy * sx,
            cz * cy * cx + sz * sy * sx,
        ],
        axis=-1,
    )


def steered_and_spun(steering: np.ndarray, spin: np.ndarray) -> np.ndarray:
    """Return quaternions of a wheel turned about z, then rolled forward about its own axle."""
    # q = q_z(steering) * q_y(spin), written out.
    sz, cz = np.sin(steering / 2), np.cos(steering / 2)
    sy, cy = np.sin(spin / 2), np.cos(spin / 2)
    return np.stack([-sz * sy, cz * sy, sz * cy, cz * cy], axis=-1)


def wheel_spin(replay: Replay) -> np.ndarray:
    """Return how far each car's wheels have rolled [rad], (num_frames, num_cars).

    A frozen car's wheels stand still; a slide is not told apart from rolling.
    """
    ahead = np.cos(replay.columns.yaw) * replay.columns.velocity_x
    ahead = ahead + np.sin(replay.columns.yaw) * replay.columns.velocity_y
    rolled = np.sign(ahead) * speeds(replay)
    turns = np.cumsum((rolled[1:] + rolled[:-1]) / 2, axis=0) / replay.step_hz / WHEEL_RADIUS
    return np.concatenate([np.zeros_like(rolled[:1]), turns])


def places(x: np.ndarray, y: np.ndarray, z: np.ndarray | float = 0.0) -> np.ndarray:
    """Return translations, shape (..., 3)."""
    return np.stack([x, y, np.broadcast_to(z, x.shape)], axis=-1)


def eye_place(camera: CameraConfig, side: str) -> tuple[float, float, float]:
    """Return where an eye sits in the car's frame [m]."""
    offset = camera.baseline / 2 if camera.eyes == "stereo" else 0.0
    return camera.forward, offset if side == "left" else -offset, camera.up


def eye_axes(camera: CameraConfig) -> np.ndarray:
    """Return the rotation whose columns are an eye's right, down and forward in the car's frame."""
    cos, sin = np.cos(camera.pitch), np.sin(camera.pitch)
    right, down, forward = (0.0, -1.0, 0.0), (-sin, 0.0, -cos), (cos, 0.0, -sin)
    return np.array([right, down, forward]).T
