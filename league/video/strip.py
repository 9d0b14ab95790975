"""A film strip: a few moments of a race as one car's camera saw them, in one picture."""

from __future__ import annotations

import cv2
import numpy as np

from league.errors import ReplayError
from league.replay import Replay
from league.sim.camera.renderer import PaintRenderer
from league.sim.config import CameraConfig

COLUMNS, ROWS = 4, 2
CAMERA = CameraConfig(width=240, height=180, colour=True, eyes="left")
"""The stock mount and lens, with more pixels than the drivers get, so that people see something."""
QUALITY = 80
"""Of the JPEG."""


def moments(total_s: float, race_s: float) -> list[float]:
    """Return the race times [s] that a strip shows, evenly spread over a car's own race.

    Of a car that was never over the line, `total_s` is infinite.
    """
    count, end_s = COLUMNS * ROWS, min(total_s, race_s)
    return [round(end_s * (number + 0.5) / count, 1) for number in range(count)]


def picture(replay: Replay, car: int) -> bytes:
    """Return what a car (from 0) saw as JPEG, `ROWS` lines of `COLUMNS` pictures, earliest first.

    Raises:
        ReplayError: the race has no such car.
    """
    if not 0 <= car < replay.num_cars:
        raise ReplayError(f"car {car + 1} is not in this race: give 1 to {replay.num_cars}")
    result = replay.result
    driven = next(row for row in result.order if row.car == car)
    times_s = moments(driven.total_s if driven.finished else np.inf, result.race_s)
    renderer = PaintRenderer(replay.tracks, replay.sim, CAMERA)
    planes = renderer.render(replay.at(np.array(times_s)), car)
    cells = planes.transpose(0, 2, 3, 1).reshape(ROWS, COLUMNS, CAMERA.height, CAMERA.width, 3)
    sheet = cells.swapaxes(1, 2).reshape(ROWS * CAMERA.height, COLUMNS * CAMERA.width, 3)
    _, encoded = cv2.imencode(".jpg", sheet[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
    return encoded.tobytes()
