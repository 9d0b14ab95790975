"""Whether the next object is in the camera's picture, as `object_in_camera` tells it."""

from __future__ import annotations

import math

import numpy as np

from league.sim.config import CameraConfig

NEAR, FAR = 0.2, 300.0
"""Depths between which the original looks [m]."""
_HEIGHT = 0.2
"""How tall an object is taken to be [m]: a car is 0.19, a box 0.25."""
_CAMERA = CameraConfig()


def seen(
    x: np.ndarray,
    y: np.ndarray,
    yaw: np.ndarray,
    object_x: np.ndarray,
    object_y: np.ndarray,
    object_yaw: np.ndarray,
    half_length: np.ndarray,
    half_width: np.ndarray,
) -> np.ndarray:
    """Return whether the centre or a corner of an object is inside the view, bool, (num_rows,).

    The view is that of one camera in the middle at 4:3, whatever the car carries; what hides behind
    another object is seen all the same, as in the original.

    Args:
        x: base of each car [m], (num_rows,).
        y: [m].
        yaw: heading of each car [rad].
        object_x: centre of each row's object [m].
        object_y: [m].
        object_yaw: its heading [rad].
        half_length: half of its length [m].
        half_width: half of its width [m].
    """
    along = np.array([0.0, 1.0, 1.0, -1.0, -1.0])[:, None] * half_length
    across = np.array([0.0, 1.0, -1.0, 1.0, -1.0])[:, None] * half_width
    cos, sin = np.cos(object_yaw), np.sin(object_yaw)
    dx = object_x + along * cos - across * sin - x  # (5, num_rows)
    dy = object_y + along * sin + across * cos - y
    cos, sin = np.cos(yaw), np.sin(yaw)
    forward = dx * cos + dy * sin - _CAMERA.forward
    left = dy * cos - dx * sin
    tan = math.tan(_CAMERA.field_of_view / 2)
    dip, rise = math.cos(_CAMERA.pitch), math.sin(_CAMERA.pitch)
    found = np.zeros(len(x), dtype=bool)
    for height in (0.0, _HEIGHT / 2, _HEIGHT):
        up = height - _CAMERA.up
        depth = forward * dip - up * rise
        above = forward * rise + up * dip
        inside = (depth > NEAR) & (depth < FAR) & (np.abs(left) <= depth * tan)
        found |= (inside & (np.abs(above) <= depth * tan * 0.75)).any(axis=0)
    return found
