"""Random light, colours, noise and blur of pictures, for training; the same for both renderers.

All of it is drawn from each world's own seed, so a world looks the same alone and in a batch.
"""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
import torch
from torch import Tensor

from league.sim import draws
from league.sim.config import LookConfig
from league.sim.world import World

# Purposes of the draws (see league.sim.draws): any numbers that nothing else uses.
_LIGHT, _CHANNEL, _BODY, _BLUR, _NOISE, _PLACE = range(7_310_001, 7_310_007)

_NOISE_STEP = 32.0
"""Levels of a noise sample in one standard deviation."""
_SPARE = 1 << 16


@dataclass(frozen=True)
class Look:
    """What was drawn for some worlds."""

    gain: Tensor
    """What each channel of a picture is multiplied with, (num_rows, 1) or (num_rows, 3)."""
    tint: Tensor
    """What the colour of each body is multiplied with, (num_rows, num_bodies, 3)."""
    leak: Tensor
    """Share of a pixel's light that each neighbour gets, (num_rows,)."""
    noise: Tensor
    """Standard deviation of a pixel, of 255, (num_rows,)."""
    place: Tensor
    """Where in the noise this picture begins, int64, (num_rows,)."""


def draw(cfg: LookConfig, world: World, rows: Tensor | None, car: int, colour: bool) -> Look:
    """Draw how the pictures of one car look in some worlds."""
    seed = world.seed if rows is None else world.seed[rows]
    step = world.step if rows is None else world.step[rows]
    wide = seed.unsqueeze(1)
    channels = torch.arange(3 if colour else 1, device=seed.device)
    bodies = torch.arange(world.num_cars + world.obstacles.x.shape[1], device=seed.device)

    def around_one(share: float, numbers: Tensor) -> Tensor:
        return 1 + share * (2 * numbers - 1)

    light = around_one(cfg.light, draws.uniform(wide, _LIGHT))
    channel = draws.uniform(wide, _CHANNEL, channels)
    body = draws.uniform(wide.unsqueeze(2), _BODY, bodies.unsqueeze(1), torch.arange(3).to(bodies))
    sigma = cfg.blur * draws.uniform(seed, _BLUR)
    return Look(
        gain=light * around_one(cfg.colour if colour else 0.0, channel),
        tint=around_one(cfg.colour, body),
        leak=sigma * sigma / 2,  # a kernel (k, 1 - 2 k, k) has variance 2 k
        noise=cfg.noise * draws.uniform(seed, _NOISE),
        place=draws.bits(seed, _PLACE, step, car) & (_SPARE - 1),
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
        grain = _grain(flat.size)[place : place + flat.size]
        part = sigma / _NOISE_STEP
        cv2.addWeighted(flat, 1.0, grain, part, -128 * part, flat)


def developed(pictures: Tensor, look: Look, rows: range) -> Tensor:
    """Return float pictures of (num_rows, num_eyes, height, width, channels), changed alike."""
    part = slice(rows.start, rows.stop)
    leak = look.leak[part].reshape(-1, 1, 1, 1, 1)
    for axis in (2, 3):
        size = pictures.shape[axis]
        before = torch.cat([pictures.narrow(axis, 0, 1), pictures.narrow(axis, 0, size - 1)], axis)
        after = torch.cat(
            [pictures.narrow(axis, 1, size - 1), pictures.narrow(axis, size - 1, 1)], axis
        )
        pictures = pictures + leak * (before + after - 2 * pictures)
    pictures = torch.clamp(pictures * look.gain[part, None, None, None, :], 0, 255)
    size = pictures[0].numel()
    grain = torch.from_numpy(_grain(size)).to(pictures.device)
    places = look.place[part].unsqueeze(1) + torch.arange(size, device=pictures.device)
    noise = grain[places].reshape(pictures.shape).to(pictures.dtype) - 128
    return pictures + noise * (look.noise[part] / _NOISE_STEP).reshape(-1, 1, 1, 1, 1)


@lru_cache(maxsize=8)
def _grain(size: int) -> np.ndarray:
    """Return noise around 128 for pictures of this many numbers, uint8."""
    seed = torch.zeros(1, dtype=torch.int64)
    numbers = draws.normal(seed, _NOISE, torch.arange(size + _SPARE))
    return torch.round(numbers * _NOISE_STEP + 128).clamp(0, 255).to(torch.uint8).numpy()
