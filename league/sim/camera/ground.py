"""The floor of a track as textures of falling resolution, and which rows of a picture read them."""

import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import NamedTuple
from weakref import WeakKeyDictionary

import cv2
import numpy as np

from league.sim.camera import raster
from league.sim.camera.lens import Lens
from league.sim.camera.scene import SUN, WALL_HEIGHT, Colour, in_light, lit, three
from league.track import markings
from league.track.track import Track

LEVELS = 5
"""Textures of one floor; each has half the resolution of the one before."""

BLUR = 1.6
"""How many texels lie side by side in one pixel at most; more would flicker."""

MAX_TEXELS = 6_000_000
"""Largest texture; the floor of a larger room is painted coarser."""

_FINEST = ((40, 0.02), (240, 0.01), (10**9, 0.005))
_WALL_NORMALS = ((0.0, 1.0), (-1.0, 0.0), (0.0, -1.0), (1.0, 0.0))


class Level(NamedTuple):
    """One texture of the floor."""

    image: np.ndarray
    """(rows, columns) or (rows, columns, 3) uint8; rows grow with +y."""
    origin_x: float
    """World x of the left edge of column 0 [m]."""
    origin_y: float
    """World y of the lower edge of row 0 [m]."""
    metres_per_pixel: float
    """Size of a texel [m]."""


@dataclass(frozen=True, eq=False)
class Ground:
    """A track's floor and the wall round it, ready to be drawn."""

    levels: tuple[Level, ...]
    """Textures, finest first."""
    room: tuple[float, float, float, float]
    """x_min, y_min, x_max, y_max of the wall [m]."""
    walls: tuple[Colour, ...]
    """Lit colour of the wall at y_min, x_max, y_max, x_min."""

    @cached_property
    def textures(self) -> tuple[raster.Texture, ...]:
        """The levels as the painter takes them."""
        return tuple(
            raster.Texture(
                level.image.reshape(-1),
                level.image.shape[1],
                level.origin_x,
                level.origin_y,
                level.metres_per_pixel,
            )
            for level in self.levels
        )

    @cached_property
    def enclosure(self) -> raster.Room:
        """The walls as the painter takes them."""
        colours = np.rint([three(one) for one in self.walls]).astype(np.uint8)
        x_min, y_min, x_max, y_max = map(float, self.room)
        return raster.Room(x_min, y_min, x_max, y_max, WALL_HEIGHT, colours)


class Band(NamedTuple):
    """Rows of a picture that read one texture."""

    start: int
    stop: int
    level: int


class Floor(NamedTuple):
    """A floor as one camera reads it."""

    ground: Ground
    bands: tuple[Band, ...]


_grounds: WeakKeyDictionary[Track, dict[tuple[float, bool], Ground]] = WeakKeyDictionary()


def finest_for(track: Track, width: int) -> float:
    """Return the size of the finest texel [m] for pictures of this width."""
    x_min, y_min, x_max, y_max = track.room
    size = next(size for limit, size in _FINEST if width < limit)
    while (x_max - x_min) * (y_max - y_min) > MAX_TEXELS * size**2:
        size *= 2
    return size


def ground_of(track: Track, metres_per_pixel: float, colour: bool) -> Ground:
    """Return the track's floor, painted on first use and kept as long as the track is."""
    kept = _grounds.setdefault(track, {})
    key = (metres_per_pixel, colour)
    if key not in kept:
        kept[key] = _paint(track, metres_per_pixel, colour)
    return kept[key]


def floor_of(track: Track, lens: Lens, height: float, pitch: float, colour: bool) -> Floor:
    """Return a track's floor for a camera at about this height [m] and downward tilt [rad]."""
    finest = finest_for(track, lens.width)
    return Floor(ground_of(track, finest, colour), bands(lens, height, pitch, finest))


@lru_cache(maxsize=256)
def bands(lens: Lens, height: float, pitch: float, finest: float) -> tuple[Band, ...]:
    """Return which texture each row of a picture reads, from the top row down.

    Args:
        lens: the lens.
        height: of the camera above the floor [m].
        pitch: downward tilt [rad].
        finest: size of a texel of level 0 [m].
    """
    levels = []
    for row in range(lens.height):
        wished = lens.metres_per_pixel(row, height, pitch) / BLUR / finest
        level = math.ceil(math.log2(wished)) if 0 < wished < math.inf else LEVELS - 1
        levels.append(min(max(level, 0), LEVELS - 1))
    edges = [row for row in range(1, lens.height) if levels[row] != levels[row - 1]]
    starts, stops = [0, *edges], [*edges, lens.height]
    found = [Band(a, b, levels[a]) for a, b in zip(starts, stops, strict=True)]
    horizon = int(min(max(lens.horizon(pitch), 0), lens.height))
    limit = max(2, lens.height // 80)
    while len(found) > limit:
        seen = [min(band.stop - horizon, band.stop - band.start) for band in found]
        thin = seen.index(min(seen[:-1]))
        # A thin band joins the one below and reads what the taller of the two reads.
        one, below = found[thin], found[thin + 1]
        level = one.level if seen[thin] > seen[thin + 1] else below.level
        found[thin : thin + 2] = [Band(one.start, below.stop, level)]
    return tuple(found)


def _paint(track: Track, metres_per_pixel: float, colour: bool) -> Ground:
    floor = markings.floor(track, metres_per_pixel, colour=colour)
    image = np.ascontiguousarray(floor.image)
    # A rim of the floor's own colours, so that no texel mixes with what lies outside; and a size
    # that halves evenly, so that every level starts at the same corner.
    rim = 2**LEVELS
    above, beside = rim + -image.shape[0] % rim, rim + -image.shape[1] % rim
    image = cv2.copyMakeBorder(image, rim, above, rim, beside, cv2.BORDER_REPLICATE)
    origin_x = floor.origin_x - rim * metres_per_pixel
    origin_y = floor.origin_y - rim * metres_per_pixel
    levels = []
    for level in range(LEVELS):
        size = metres_per_pixel * 2**level
        levels.append(Level(image, origin_x, origin_y, size))
        half = (max(image.shape[1] // 2, 1), max(image.shape[0] // 2, 1))
        image = cv2.resize(image, half, interpolation=cv2.INTER_AREA)
    light = lit(track.colours.wall, not colour)
    walls = tuple(in_light(light, nx * SUN[0] + ny * SUN[1]) for nx, ny in _WALL_NORMALS)
    return Ground(tuple(levels), track.room, walls)
