"""The floor of a track as textures of falling resolution, and which rows of a picture read them."""

import math
from functools import lru_cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from league.sim.camera.scene import SUN, WALL_HEIGHT, lit
from league.sim.camera.scene_state import Lens
from league.sim.camera.tables import Floor, Room
from league.track import markings
from league.track.track import Track

LEVELS = 5  # textures of one floor; each has half the resolution of the one before
BLUR = 1.6  # how many texels lie side by side in one pixel at most; more would flicker
MAX_TEXELS = 6_000_000  # largest texture; the floor of a larger room is painted coarser

_FINEST = ((40, 0.02), (240, 0.01), (10**9, 0.005))
_WALL_NORMALS = ((0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0))


class Band(NamedTuple):
    """Rows of a picture that read one texture."""

    start: int
    stop: int
    level: int


_Ground = tuple[tuple[np.ndarray, ...], np.ndarray, Room]
"""A track's floor and the wall round it: the first fields of a Floor."""

_grounds: WeakKeyDictionary[Track, dict[tuple[float, bool], _Ground]] = WeakKeyDictionary()


def floor_of(track: Track, lens: Lens, height: float, pitch: float, colour: bool) -> Floor:
    """Return a track's floor for a camera at about this height [m] and downward tilt [rad].

    It is painted on first use and kept as long as the track is.
    """
    x_min, y_min, x_max, y_max = track.room
    finest = next(size for limit, size in _FINEST if lens.width < limit)  # side of a texel [m]
    while (x_max - x_min) * (y_max - y_min) > MAX_TEXELS * finest**2:
        finest *= 2
    kept = _grounds.setdefault(track, {})
    if (finest, colour) not in kept:
        kept[finest, colour] = _paint(track, finest, colour)
    bands = np.array(_bands(lens, height, pitch, finest), np.int64)
    return Floor(*kept[finest, colour], bands)


@lru_cache(maxsize=256)
def _bands(lens: Lens, height: float, pitch: float, finest: float) -> tuple[Band, ...]:
    """Return which texture each row of a picture reads, from the top row down."""
    levels = []
    for row in range(lens.height):
        wished = lens.metres_per_pixel(row, height, pitch) / BLUR / finest
        level = math.ceil(math.log2(wished)) if 0 < wished < math.inf else LEVELS - 1
        levels.append(min(max(level, 0), LEVELS - 1))
    edges = [row for row in range(1, lens.height) if levels[row] != levels[row - 1]]
    starts, stops = [0, *edges], [*edges, lens.height]
    bands = [Band(a, b, levels[a]) for a, b in zip(starts, stops, strict=True)]
    horizon = int(min(max(lens.horizon(pitch), 0), lens.height))
    limit = max(2, lens.height // 80)
    while len(bands) > limit:
        seen = [min(band.stop - horizon, band.stop - band.start) for band in bands]
        thin = seen.index(min(seen[:-1]))
        # A thin band joins the one below and reads what the taller of the two reads.
        one, below = bands[thin], bands[thin + 1]
        level = one.level if seen[thin] > seen[thin + 1] else below.level
        bands[thin : thin + 2] = [Band(one.start, below.stop, level)]
    return tuple(bands)


def _paint(track: Track, metres_per_pixel: float, colour: bool) -> _Ground:
    floor = markings.floor(track, metres_per_pixel, colour=colour)
    image = np.ascontiguousarray(floor.image)
    # A rim of the floor's own colours, so that no texel mixes with what lies outside; and a size
    # that halves evenly, so that every level starts at the same corner.
    rim = 2**LEVELS
    above, aside = rim + -image.shape[0] % rim, rim + -image.shape[1] % rim
    image = cv2.copyMakeBorder(image, rim, above, rim, aside, cv2.BORDER_REPLICATE)
    corner = floor.origin_x - rim * metres_per_pixel, floor.origin_y - rim * metres_per_pixel
    pictures, levels = [], []
    for level in range(LEVELS):
        size = metres_per_pixel * 2**level
        pictures.append(texels(image))
        levels.append((image.shape[1], *corner, size))
        half = (max(image.shape[1] // 2, 1), max(image.shape[0] // 2, 1))
        image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
    light = lit(track.colours.wall, not colour)
    facing = [max(nx * SUN[0] + ny * SUN[1], 0.0) for nx, ny in _WALL_NORMALS]
    walls = np.rint(light[:3] + np.outer(facing, light[3:])).astype(np.uint8)
    return tuple(pictures), np.array(levels), Room(*track.room, WALL_HEIGHT, walls)


def texels(image: np.ndarray) -> np.ndarray:
    """Return the texels of a picture, gray or RGB; see Texture."""
    if image.ndim == 2:
        return image.reshape(-1)
    texel = np.zeros((image.size // 3, 4), np.uint8)
    texel[:, :3] = image.reshape(-1, 3)
    return texel.reshape(-1)
