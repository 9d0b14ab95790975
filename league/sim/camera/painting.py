"""Compiled: whole pictures of many worlds: the sky, the floor as a warp of its texture, things."""

import math

import numpy as np
from numba import int32, uint8, uint32

from league.jit import compiled, inner
from league.sim.camera.raster import draw_room
from league.sim.camera.tables import Pose, Texture

FLOOR, ROOM = 1, 2
"""Phases of a picture: the sky and the floor; the walls and what stands before them."""
_LEAST_FALL = 1e-6
"""How far a view that reaches the floor falls at least, over its way ahead in focal lengths."""


@compiled(allocates=True)
def paint(phases, rows, pictures, poses, things, floor, sky, optics, far, models):
    """Draw the pictures of some worlds on one track.

    Args:
        phases: what to draw, FLOOR, ROOM or both.
        rows: the pictures to draw, int64 (num_rows,).
        pictures: uint8 (num_pictures, num_eyes, height, width * channels).
        poses: where each camera is, the fields of Pose, float64 (num_pictures, 9).
        things: what stands there, float64 (num_pictures, num_things, THING_COLUMNS).
        floor: the track's floor and walls.
        sky: a row of sky, uint8 (width * channels,).
        optics: the lens.
        far: things farther than this become what they are when far [m].
        models: the shapes.

    Returns:
        The row of the farthest floor in the last picture.
    """
    top = 0
    for n in rows:
        at = poses[n]
        view = Pose(at[0], at[1], at[2], at[3], at[4], at[5], at[6], at[7], at[8])
        if phases & FLOOR:
            top = _draw_ground(pictures[n], floor, sky, optics, view)
        if phases & ROOM:
            draw_room(pictures[n], optics, view, floor.room, things[n], far, models)
    return top


@inner
def _draw_ground(pictures, floor, sky, optics, view):
    """Draw the sky and the floor of one picture; return the row of the farthest floor."""
    height = pictures.shape[1]
    level = view.roll_cos == 1 and view.roll_sin == 0
    top = _first_floor_row(height, floor.room, optics, view) if level else 0
    # Of a camera that rolls the horizon is a slope, and the sky lies next to the floor, too.
    for eye in range(len(pictures)):
        for row in range(top if level else height):
            out = pictures[eye, row]
            for k in range(len(sky)):
                out[k] = sky[k]
    for band in range(len(floor.bands)):
        start, stop = max(floor.bands[band, 0], top), floor.bands[band, 1]
        number = floor.bands[band, 2]
        fields = floor.levels[number]
        columns, size = int(fields[0]), fields[3]
        texture = Texture(floor.texels[number], columns, fields[1], fields[2], size)
        if start < stop and level:
            draw_floor(pictures, start, stop, texture, optics, view)
        elif start < stop:
            draw_tilted_floor(pictures, start, stop, texture, optics, view)
    return top


@inner
def _first_floor_row(height, room, optics, view):
    """Return the row of the farthest floor in view: no floor lies beyond the room's corners."""
    along_x = view.cos * ((room.x_max if view.cos > 0 else room.x_min) - view.x)
    farthest = along_x + view.sin * ((room.y_max if view.sin > 0 else room.y_min) - view.y)
    depth = farthest * view.pitch_cos + view.z * view.pitch_sin
    if depth <= optics.near:
        return 0
    rise = view.z * view.pitch_cos - farthest * view.pitch_sin
    row = optics.cy + optics.focal * rise / depth
    return int(min(max(row, 0.0), float(height)))


@inner(allocates=True)
def draw_floor(pictures, start, stop, texture, optics, view):
    """Draw the floor into rows start to stop, below the horizon, of each eye's picture.

    Pictures are (num_eyes, height, width * channels) uint8. The camera does not roll, so along a
    row the place in the texture moves by equal steps: 16 bits of fraction in whole numbers, which
    processors do many at a time.
    """
    channels, columns, texels = optics.channels, texture.columns, texture.texels
    width = pictures.shape[2] // channels
    corner, share = np.empty(width, np.uint32), np.empty(width, np.uint32)
    last_column, last_row = _last_texel(texture, channels)
    across_texels = int32(columns)
    unit = 65536.0 / texture.size
    for row in range(start, stop):
        down = row - optics.cy
        fall = max(optics.focal * view.pitch_sin + down * view.pitch_cos, _LEAST_FALL)
        ahead = view.z * (optics.focal * view.pitch_cos - down * view.pitch_sin) / fall
        across = view.z / fall
        dx, dy = _fixed(unit * view.sin * across), _fixed(-unit * view.cos * across)
        for eye, shift in enumerate(optics.eyes):
            left = shift + across * optics.cx
            world_x = view.x + view.cos * ahead - view.sin * left
            world_y = view.y + view.sin * ahead + view.cos * left
            x = _fixed(unit * (world_x - texture.origin_x) - 32768)
            y = _fixed(unit * (world_y - texture.origin_y) - 32768)
            for u in range(width):
                here_x, here_y = int32(x + int32(u) * dx), int32(y + int32(u) * dy)
                corner[u] = _texel_at(here_x, here_y, last_column, last_row, across_texels)
                share[u] = _shares_at(here_x, here_y)
            _blend(pictures[eye, row], channels, texels, columns, corner, share)


@inner(allocates=True)
def draw_tilted_floor(pictures, start, stop, texture, optics, view):
    """Draw the floor below the horizon into rows start to stop, for a camera that may roll.

    Pictures are those of draw_floor. Along a row the place in the texture is a quotient of two
    numbers that grow by equal steps.
    """
    channels, columns, texels = optics.channels, texture.columns, texture.texels
    width = pictures.shape[2] // channels
    corner, share = np.empty(width, np.uint32), np.empty(width, np.uint32)
    last_column, last_row = _last_texel(texture, channels)
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
                here_x = _fixed(x + far * (way_x + u * ways_x) - 32768)
                here_y = _fixed(y + far * (way_y + u * ways_y) - 32768)
                corner[u] = _texel_at(here_x, here_y, last_column, last_row, across_texels)
                share[u] = _shares_at(here_x, here_y)
            out = pictures[eye, row, first * channels : last * channels]
            _blend(out, channels, texels, columns, corner[first:last], share[first:last])


@inner
def _last_texel(texture, channels):
    """Return the last column and the last row of texels that have others to the right and above."""
    rows = texture.texels.size // (1 if channels == 1 else 4) // texture.columns
    return int32(texture.columns - 2), int32(rows - 2)


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
def _texel_at(x, y, last_column, last_row, columns):
    """Return the number of the texel at a place with 16 bits of fraction, inside the texture."""
    column = min(max(int32(x >> 16), int32(0)), last_column)
    line = min(max(int32(y >> 16), int32(0)), last_row)
    return uint32(line * columns + column)


@inner
def _shares_at(x, y):
    """Return how far a place lies beyond its texel: 8 bits across, and from bit 16 on 8 bits up."""
    return uint32((x >> 8) & 255) | (uint32((y >> 8) & 255) << uint32(16))


@inner
def _fixed(number):
    """Return a number as int32; floor so far away that it does not fit lies behind a wall."""
    return int32(min(max(number, -2147483000.0), 2147483000.0))  # type: ignore


@inner(allocates=True)
def _blend(out, channels, texels, columns, corner, share):
    """Mix four texels for each pixel of a row; gather them first, as only the rest vectorises."""
    width, stride = len(corner), uint32(columns)
    if channels == 1:
        for u in range(width):
            corner[u] = _four(texels, corner[u], stride)
        for u in range(width):
            out[u] = _mixed(corner[u], share[u])
        return
    colours, four = texels.view(np.uint32), np.empty((4, width), np.uint32)
    for u in range(width):
        four[0, u], four[1, u] = colours[corner[u]], colours[corner[u] + uint32(1)]
        above = corner[u] + stride
        four[2, u], four[3, u] = colours[above], colours[above + uint32(1)]
    for u in range(width):
        corner[u] = _mixed_colours(four[0, u], four[1, u], four[2, u], four[3, u], share[u])
    for u in range(width):
        out[3 * u] = uint8(corner[u])
        out[3 * u + 1] = uint8(corner[u] >> uint32(8))
        out[3 * u + 2] = uint8(corner[u] >> uint32(16))


@inner
def _four(texels, here, stride):
    """Return a gray texel, those to its right and above it, and the one to its upper right."""
    return (
        uint32(texels[here])
        | (uint32(texels[here + uint32(1)]) << uint32(8))
        | (uint32(texels[here + stride]) << uint32(16))
        | (uint32(texels[here + stride + uint32(1)]) << uint32(24))
    )


@inner
def _mixed(four, share):
    """Return the mean of four bytes, weighted by 8 bits across and 8 bits upwards."""
    right, up = share & uint32(255), share >> uint32(16)
    left_pair, right_pair = four & uint32(0x00FF00FF), (four >> uint32(8)) & uint32(0x00FF00FF)
    pair = left_pair * (uint32(256) - right) + right_pair * right
    low, high = pair & uint32(0xFFFF), pair >> uint32(16)
    return uint8((low * (uint32(256) - up) + high * up + uint32(32768)) >> uint32(16))


@inner
def _mixed_colours(here, right, above, corner, share):
    """Return the mean of four texels in colour, weighted by 8 bits across and 8 bits upwards."""
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
