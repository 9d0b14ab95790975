"""Compiled: a floor in colour over a whole picture, shadows on it, and paint mixed into a part.

`draw_floor` gives the bits of the one in floor_raster.py, three times faster where pictures are
large: the three colours of a texel lie in one number, which is read once and mixed in vector units.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math

import numpy as np
from numba import int32, uint8, uint32

from league.jit import compiled, inner
from league.sim.camera.floor_raster import fixed, shares_at, texel_at
from league.sim.camera.raster import Texture


def packed(texture: Texture) -> Texture:
    """Return a texture of RGB texels as one of whole numbers, red lowest, uint32 (texels,)."""
    red, green, blue = texture.texels.reshape(-1, 3).T.astype(np.uint32)
    return texture._replace(texels=red | green << 8 | blue << 16)


@compiled
def draw_floor(picture, start, stop, texture, optics, view):
    """Draw the floor into rows start to stop, below the horizon, of the first eye's picture.

    The picture is uint8 (height, width * 3), and the texture one of `packed`.
    """
    columns, texels, width = texture.columns, texture.texels, picture.shape[1] // 3
    last_column, last_row = int32(columns - 2), int32(texels.size // columns - 2)
    stride, unit = int32(columns), 65536.0 / texture.size
    corner, share = np.empty(width, np.uint32), np.empty(width, np.uint32)
    four = np.empty((4, width), np.uint32)
    for row in range(start, stop):
        down = row - optics.cy
        fall = max(optics.focal * view.pitch_sin + down * view.pitch_cos, 1e-6)
        ahead = view.z * (optics.focal * view.pitch_cos - down * view.pitch_sin) / fall
        across = view.z / fall
        dx, dy = fixed(unit * view.sin * across), fixed(-unit * view.cos * across)
        left = optics.eyes[0] + across * optics.cx
        world_x = view.x + view.cos * ahead - view.sin * left
        world_y = view.y + view.sin * ahead + view.cos * left
        x = fixed(unit * (world_x - texture.origin_x) - 32768)
        y = fixed(unit * (world_y - texture.origin_y) - 32768)
        for u in range(width):
            here_x, here_y = int32(x + int32(u) * dx), int32(y + int32(u) * dy)
            corner[u] = texel_at(here_x, here_y, last_column, last_row, stride)
            share[u] = shares_at(here_x, here_y)
        for u in range(width):
            four[0, u], four[1, u] = texels[corner[u]], texels[corner[u] + uint32(1)]
            above = corner[u] + uint32(stride)
            four[2, u], four[3, u] = texels[above], texels[above + uint32(1)]
        # A loop of its own: only without reads from anywhere does it vectorise.
        for u in range(width):
            corner[u] = _mixed(four[0, u], four[1, u], four[2, u], four[3, u], share[u])
        for u in range(width):
            picture[row, 3 * u] = uint8(corner[u])
            picture[row, 3 * u + 1] = uint8(corner[u] >> uint32(8))
            picture[row, 3 * u + 2] = uint8(corner[u] >> uint32(16))


@compiled
def draw_shadow(picture, start, outline, edge, kept, optics, view):
    """Darken the floor inside a convex outline, from row start on, of the first eye's picture.

    Args:
        picture: (height, width * 3) uint8; changed in place.
        start: the first row.
        outline: outward normal and offset of each side, n . p <= d inside, world frame; (sides, 3).
        edge: how far inside the outline the shadow is full, and outside it none [m].
        kept: share of the brightness that is left in the full shadow.
        optics: the lens, raster.Optics.
        view: where the camera is, raster.Pose; it does not roll.
    """
    for row in range(start, len(picture)):
        down = row - optics.cy
        fall = max(optics.focal * view.pitch_sin + down * view.pitch_cos, 1e-6)
        ahead = view.z * (optics.focal * view.pitch_cos - down * view.pitch_sin) / fall
        across = view.z / fall
        left = optics.eyes[0] + across * optics.cx
        x = view.x + view.cos * ahead - view.sin * left
        y = view.y + view.sin * ahead + view.cos * left
        # Inside a side where beyond + column * grows <= edge.
        beyond = outline[:, 0] * x + outline[:, 1] * y - outline[:, 2]
        grows = across * (outline[:, 0] * view.sin - outline[:, 1] * view.cos)
        first, last = 0.0, picture.shape[1] // 3 - 1.0
        for side in range(len(outline)):
            if grows[side] > 0:
                last = min(last, (edge - beyond[side]) / grows[side])
            elif grows[side] < 0:
                first = max(first, (edge - beyond[side]) / grows[side])
            elif beyond[side] > edge:
                last = -1.0
        for u in range(math.ceil(first), math.floor(last) + 1):
            outside = -edge
            for side in range(len(outline)):
                outside = max(outside, beyond[side] + u * grows[side])
            share = 0.5 - 0.5 * outside / edge
            light = uint32(256 - 256 * (1 - kept) * share * share * (3 - 2 * share))
            for channel in range(3 * u, 3 * u + 3):
                picture[row, channel] = uint8((uint32(picture[row, channel]) * light) >> uint32(8))


@inner
def _mixed(here, right, above, corner, share):
    """Return the mean of four packed texels, weighted by 8 bits across and 8 bits upwards."""
    across, up = share & uint32(255), share >> uint32(16)
    back, down, half = uint32(256) - across, uint32(256) - up, uint32(32768)
    pair, one = uint32(0x00FF00FF), uint32(0x000000FF)
    # Red and blue lie 16 bits apart, so one product holds both.
    low = (here & pair) * back + (right & pair) * across
    high = (above & pair) * back + (corner & pair) * across
    low_g = ((here >> uint32(8)) & one) * back + ((right >> uint32(8)) & one) * across
    high_g = ((above >> uint32(8)) & one) * back + ((corner >> uint32(8)) & one) * across
    lane = uint32(0xFFFF)
    red = ((low & lane) * down + (high & lane) * up + half) >> uint32(16)
    green = (low_g * down + high_g * up + half) >> uint32(16)
    blue = ((low >> uint32(16)) * down + (high >> uint32(16)) * up + half) >> uint32(16)
    return red | (green << uint32(8)) | (blue << uint32(16))


@compiled
def mix(region, paint, mask, opacity):
    """Mix paint into a part of a picture where the mask covers it.

    Args:
        region: the part, (height, width, 3) uint8; changed in place.
        paint: (height, width, 3) uint8.
        mask: 255 where the paint covers, (height, width) uint8.
        opacity: of the paint, in 256ths.
    """
    for v in range(region.shape[0]):
        for u in range(region.shape[1]):
            share = (uint32(mask[v, u]) * uint32(opacity)) >> uint32(8)
            for channel in range(3):
                under = uint32(region[v, u, channel]) * (uint32(255) - share)
                over = uint32(paint[v, u, channel]) * share
                region[v, u, channel] = uint8((over + under) // uint32(255))
