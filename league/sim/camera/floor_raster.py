"""Compiled painting of the floor: a perspective warp of its texture, bilinear."""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math

import numpy as np
from numba import int32, uint8, uint32

from league.jit import compiled, inner

_LEAST_FALL = 1e-6
"""How far a view that reaches the floor falls at least, over its way ahead in focal lengths."""


@compiled
def draw_floor(pictures, start, stop, texture, optics, view):
    """Draw the floor into rows start to stop, below the horizon, of each eye's picture.

    Pictures are (num_eyes, height, width * channels) uint8. The camera does not roll, so along a
    row the place in the texture moves by equal steps: 16 bits of fraction in whole numbers, which
    processors do many at a time.
    """
    channels, columns, texels = optics.channels, texture.columns, texture.texels
    width = pictures.shape[2] // channels
    corner, share = np.empty(width, np.uint32), np.empty(width, np.uint32)
    last_column = int32(columns - 2)
    last_row = int32(texels.size // (columns * channels) - 2)
    across_texels = int32(columns)
    unit = 65536.0 / texture.size
    for row in range(start, stop):
        down = row - optics.cy
        fall = max(optics.focal * view.pitch_sin + down * view.pitch_cos, _LEAST_FALL)
        ahead = view.z * (optics.focal * view.pitch_cos - down * view.pitch_sin) / fall
        across = view.z / fall
        dx, dy = fixed(unit * view.sin * across), fixed(-unit * view.cos * across)
        for eye, shift in enumerate(optics.eyes):
            left = shift + across * optics.cx
            world_x = view.x + view.cos * ahead - view.sin * left
            world_y = view.y + view.sin * ahead + view.cos * left
            x = fixed(unit * (world_x - texture.origin_x) - 32768)
            y = fixed(unit * (world_y - texture.origin_y) - 32768)
            for u in range(width):
                here_x, here_y = int32(x + int32(u) * dx), int32(y + int32(u) * dy)
                corner[u] = texel_at(here_x, here_y, last_column, last_row, across_texels)
                share[u] = shares_at(here_x, here_y)
            _blend(pictures[eye, row], channels, texels, columns, corner, share)


@compiled
def draw_tilted_floor(pictures, start, stop, texture, optics, view):
    """Draw the floor below the horizon into rows start to stop, for a camera that may roll.

    Pictures are those of draw_floor. Along a row the place in the texture is a quotient of two
    numbers that grow by equal steps.
    """
    channels, columns, texels = optics.channels, texture.columns, texture.texels
    width = pictures.shape[2] // channels
    corner, share = np.empty(width, np.uint32), np.empty(width, np.uint32)
    last_column = int32(columns - 2)
    last_row = int32(texels.size // (columns * channels) - 2)
    across_texels = int32(columns)
    unit = 65536.0 / texture.size
    for row in range(start, stop):
        down = row - optics.cy
        # To the right, down and along the view in the frame of a level camera: at column 0, and how
        # they grow with the columns.
        right = -optics.cx * view.roll_cos - down * view.roll_sin
        below = -optics.cx * view.roll_sin + down * view.roll_cos
        fall = optics.focal * view.pitch_sin + below * view.pitch_cos
        ahead = optics.focal * view.pitch_cos - below * view.pitch_sin
        falls, recedes = view.roll_sin * view.pitch_cos, -view.roll_sin * view.pitch_sin
        first, last = _falling(fall, falls, width)
        way_x, way_y = view.cos * ahead + view.sin * right, view.sin * ahead - view.cos * right
        ways_x = view.cos * recedes + view.sin * view.roll_cos
        ways_y = view.sin * recedes - view.cos * view.roll_cos
        for eye, shift in enumerate(optics.eyes):
            eye_ahead = shift * view.roll_sin * view.pitch_sin
            eye_left = shift * view.roll_cos
            height = unit * (view.z + shift * view.roll_sin * view.pitch_cos)
            eye_x = view.x + view.cos * eye_ahead - view.sin * eye_left
            eye_y = view.y + view.sin * eye_ahead + view.cos * eye_left
            x, y = unit * (eye_x - texture.origin_x), unit * (eye_y - texture.origin_y)
            for u in range(first, last):
                far = height / max(fall + u * falls, _LEAST_FALL)
                here_x = fixed(x + far * (way_x + u * ways_x) - 32768)
                here_y = fixed(y + far * (way_y + u * ways_y) - 32768)
                corner[u] = texel_at(here_x, here_y, last_column, last_row, across_texels)
                share[u] = shares_at(here_x, here_y)
            out = pictures[eye, row, first * channels : last * channels]
            _blend(out, channels, texels, columns, corner[first:last], share[first:last])


@inner
def _falling(fall, falls, width):
    """Return the first and one past the last column where fall + column * falls is above 0."""
    if falls == 0:
        return (0, width) if fall > 0 else (0, 0)
    edge = min(max(-fall / falls, -1.0), float(width))
    if falls > 0:
        return min(math.floor(edge) + 1, width), width
    return 0, max(math.ceil(edge), 0)


@inner
def texel_at(x, y, last_column, last_row, columns):
    """Return the number of the texel at a place with 16 bits of fraction, inside the texture."""
    column = min(max(int32(x >> 16), int32(0)), last_column)
    line = min(max(int32(y >> 16), int32(0)), last_row)
    return uint32(line * columns + column)


@inner
def shares_at(x, y):
    """Return how far a place lies beyond its texel: 8 bits across, and from bit 16 on 8 bits up."""
    return uint32((x >> 8) & 255) | (uint32((y >> 8) & 255) << uint32(16))


@inner
def fixed(number):
    """Return a number as int32; floor so far away that it does not fit lies behind a wall."""
    return int32(min(max(number, -2147483000.0), 2147483000.0))


@inner
def _blend(out, channels, texels, columns, corner, share):
    """Mix four texels for each pixel of a row; gather them first, as only the rest vectorises."""
    if channels == 1:
        for u in range(len(corner)):
            corner[u] = _four(texels, corner[u], uint32(columns), uint32(1))
        for u in range(len(corner)):
            out[u] = _mixed(corner[u], share[u])
        return
    four, step = np.empty(len(corner), np.uint32), uint32(channels)
    for channel in range(channels):
        for u in range(len(corner)):
            four[u] = _four(texels[channel:], corner[u] * step, uint32(columns) * step, step)
        for u in range(len(corner)):
            out[u * channels + channel] = _mixed(four[u], share[u])


@inner
def _four(texels, here, stride, step):
    """Return a texel, those to its right and above it, and the one to its upper right."""
    return (
        uint32(texels[here])
        | (uint32(texels[here + step]) << uint32(8))
        | (uint32(texels[here + stride]) << uint32(16))
        | (uint32(texels[here + stride + step]) << uint32(24))
    )


@inner
def _mixed(four, share):
    """Return the mean of four bytes, weighted by 8 bits across and 8 bits upwards."""
    right, up = share & uint32(255), share >> uint32(16)
    left_pair, right_pair = four & uint32(0x00FF00FF), (four >> uint32(8)) & uint32(0x00FF00FF)
    pair = left_pair * (uint32(256) - right) + right_pair * right
    low, high = pair & uint32(0xFFFF), pair >> uint32(16)
    return uint8((low * (uint32(256) - up) + high * up + uint32(32768)) >> uint32(16))
