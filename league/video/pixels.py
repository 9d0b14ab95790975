"""Compiled: shadows on the floor of a whole picture, and paint mixed into a part of one."""

import math

from numba import uint8, uint32

from league.jit import compiled


@compiled(allocates=True)
def draw_shadow(picture, start, outline, edge, kept, optics, view):
    """Darken the floor inside a convex outline, from row start on, of the first eye's picture.

    The picture is uint8 (height, width * 3), the outline the outward normal and offset of each side
    in the world's frame, n . p <= d inside, (sides, 3). `edge` is how far inside the outline the
    shadow is full, and outside it none [m], `kept` the share of the brightness that is left in it.
    The view, a Pose, does not roll.
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


@compiled
def mix(region, paint, mask, opacity):
    """Mix paint into a part of a picture, both uint8 (height, width, 3), in place.

    The mask, uint8 (height, width), is 255 where the paint covers; its opacity is in 256ths.
    """
    for v in range(region.shape[0]):
        for u in range(region.shape[1]):
            share = (uint32(mask[v, u]) * uint32(opacity)) >> uint32(8)
            for channel in range(3):
                under = uint32(region[v, u, channel]) * (uint32(255) - share)
                over = uint32(paint[v, u, channel]) * share
                region[v, u, channel] = uint8((over + under) // uint32(255))
