"""Random light, colours, noise and blur of pictures, for training; the same for both renderers.

All of it is drawn from each world's own seed, so a world looks the same alone and in a batch.
OpenCV rounds the last bit in its own way on each processor; races and evaluations have no looks.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from league.sim import rng
from league.sim.config import VisualRandomization
from league.sim.records import World

# Purposes of the draws (see league.sim.rng): any numbers that nothing else uses.
_LIGHT, _CHANNEL, _BODY, _BLUR, _NOISE, _PLACE = range(7_310_001, 7_310_007)

NOISE_STEP = 32.0  # levels of a noise sample in one standard deviation
_SPARE = 1 << 16


@dataclass(frozen=True)
class Look:
    """What was drawn for some worlds."""

    # what each channel of a picture is multiplied with, (num_rows, 1) or (num_rows, 3)
    gain: np.ndarray
    tint: np.ndarray  # what the colour of each body is multiplied with, (num_rows, num_bodies, 3)
    leak: np.ndarray  # share of a pixel's light that each neighbour gets, (num_rows,)
    noise: np.ndarray  # standard deviation of a pixel, of 255, (num_rows,)
    place: np.ndarray  # where in the noise this picture begins, int64, (num_rows,)


def draw(cfg: VisualRandomization, world: World, rows: np.ndarray, car: int, colour: bool) -> Look:
    """Draw how the pictures of one car look in some worlds."""
    seed, step = world.worlds["seed"][rows], world.worlds["step"][rows]
    wide = seed[:, None]
    channels = np.arange(3 if colour else 1)
    bodies = np.arange(world.num_cars + world.num_obstacles)

    def around_one(share: float, numbers: np.ndarray) -> np.ndarray:
        return 1 + np.float32(share) * (2 * numbers - 1)

    light = around_one(cfg.light, rng.uniform(wide, _LIGHT))
    channel = rng.uniform(wide, _CHANNEL, channels)
    body = rng.uniform(wide[..., None], _BODY, bodies[:, None], np.arange(3))
    sigma = np.float32(cfg.blur) * rng.uniform(seed, _BLUR)
    return Look(
        gain=light * around_one(cfg.colour if colour else 0.0, channel),
        tint=around_one(cfg.colour, body),
        leak=sigma * sigma / 2,  # a kernel (k, 1 - 2 k, k) has variance 2 k
        noise=np.float32(cfg.noise) * rng.uniform(seed, _NOISE),
        place=rng.bits(seed, _PLACE, step, car) & (_SPARE - 1),
    )


def develop(picture: np.ndarray, look: Look, row: int) -> None:
    """Change a picture of (num_eyes, height, width) or (num_eyes, height, width, 3) in place."""
    leak, sigma = float(look.leak[row]), float(look.noise[row])
    gain = look.gain[row].tolist()
    if leak > 0:
        kernel = np.array([leak, 1 - 2 * leak, leak])
        for eye in picture:
            cv2.sepFilter2D(eye, -1, kernel, kernel, eye, borderType=cv2.BORDER_REPLICATE)
    if any(part != 1 for part in gain):
        flat = picture.reshape(-1, 1, picture.shape[-1]) if len(gain) == 3 else picture.reshape(-1)
        cv2.multiply(flat, np.array([*gain, 0.0, 0.0, 0.0][:4]), flat)
    if sigma > 0:
        flat = picture.reshape(-1)
        place = int(look.place[row])
        noise = grain(flat.size)[place : place + flat.size]
        part = sigma / NOISE_STEP
        cv2.addWeighted(flat, 1.0, noise, part, -128 * part, flat)


@lru_cache(maxsize=8)
def grain(size: int) -> np.ndarray:
    """Return noise around 128 for pictures of this many numbers, uint8."""
    numbers = rng.normal(0, _NOISE, np.arange(size + _SPARE))
    return np.rint(numbers * np.float32(NOISE_STEP) + 128).clip(0, 255).astype(np.uint8)
