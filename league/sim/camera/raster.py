"""Compiled painting: walls and things as convex polygons; the floor is in painting.py.

A pixel belongs to a polygon if its centre lies inside: neighbours share no pixel and leave none
out.
"""

import math

import numpy as np
from numba import uint8

from league.jit import inner
from league.portable_math import f32, sincos
from league.sim.camera import tables

# Pixels --------------------------------------------------------------------------------------


@inner
def _fill(picture, channels, points, count, colour, spans):
    """Fill a convex polygon of (u, v) pixels; (height, width * channels), spans (height, 2)."""
    height, width = len(picture), picture.shape[1] // channels
    first, last = height, 0
    for k in range(count):
        before = count - 1 if k == 0 else k - 1
        u, v, far_u, far_v = points[before, 0], points[before, 1], points[k, 0], points[k, 1]
        if v > far_v:  # from top to bottom, so that faces agree on the edge they share
            u, v, far_u, far_v = far_u, far_v, u, v
        top, bottom = _row(v, height), _row(far_v, height)
        if top >= bottom:
            continue
        slope = (far_u - u) / (far_v - v)
        for row in range(top, bottom):
            if row < first or row >= last:
                spans[row, 0], spans[row, 1] = math.inf, -math.inf
            at = u + (row - v) * slope
            spans[row, 0], spans[row, 1] = min(spans[row, 0], at), max(spans[row, 1], at)
        # A convex outline meets rows one after the other, so those seen are always in one piece.
        first, last = min(first, top), max(last, bottom)
    for row in range(first, last):
        left, right = _row(spans[row, 0], width), _row(spans[row, 1], width)
        if channels == 1:
            picture[row, left:right].fill(colour[0])
        else:
            for u in range(left, right):
                for channel in range(channels):
                    picture[row, u * channels + channel] = colour[channel]


@inner
def _row(at, size):
    """Return the first whole number that is not less, within 0 and size."""
    return int(min(max(math.ceil(at), 0.0), float(size)))


@inner
def _polygon(pictures, eye, points, count, colour, optics, scratch):
    """Cut a polygon of X, Y, Z in the camera's frame at the near plane, project and fill it."""
    pixels, spans = scratch
    shift = optics.eyes[eye]
    seen = 0
    for k in range(count):
        before = count - 1 if k == 0 else k - 1
        z, last_z = points[k, 2], points[before, 2]
        if (z >= optics.near) != (last_z >= optics.near):
            part = (optics.near - last_z) / (z - last_z)
            x = points[before, 0] + part * (points[k, 0] - points[before, 0])
            y = points[before, 1] + part * (points[k, 1] - points[before, 1])
            scale = optics.focal / optics.near
            pixels[seen, 0] = optics.cx + (x + shift) * scale
            pixels[seen, 1] = optics.cy + y * scale
            seen += 1
        if z >= optics.near:
            scale = optics.focal / z
            pixels[seen, 0] = optics.cx + (points[k, 0] + shift) * scale
            pixels[seen, 1] = optics.cy + points[k, 1] * scale
            seen += 1
    if seen >= 3:
        _fill(pictures[eye], optics.channels, pixels, seen, colour, spans)


# The room ------------------------------------------------------------------------------------


@inner(allocates=True)
def draw_room(pictures, optics, view, room, things, far, models):
    """Draw the walls round a room, then the things in it, far to near; see painting.paint.

    Pictures are (num_eyes, height, width * channels) uint8, the floor and the sky already there.
    """
    scratch = np.empty((2 * tables.MOST_CORNERS, 2)), np.empty((pictures.shape[1], 2))
    _walls(pictures, optics, view, room, scratch)
    feet = np.empty((len(things), 6))
    chosen = np.empty(len(things), np.int64)
    seen = 0
    # Half of the picture's extent to either side of a level camera with the same view.
    width = pictures.shape[2] / optics.channels * abs(view.roll_cos)
    slope = (width + pictures.shape[1] * abs(view.roll_sin)) / 2 / optics.focal
    for number in range(len(things)):
        if _stand(feet[seen], things[number], view, optics, slope, models):
            chosen[seen] = number
            seen += 1
    for place in _far_to_near(feet[:seen]):
        thing, foot = things[chosen[place]], feet[place]
        _thing(pictures, optics, view, thing, foot, far, models, scratch)


@inner(allocates=True)
def _walls(pictures, optics, view, room, scratch):
    (x_min, y_min), (x_max, y_max) = (room.x_min, room.y_min), (room.x_max, room.y_max)
    corners = ((x_min, y_min), (x_max, y_min), (x_max, y_max), (x_min, y_max))
    points = np.empty((4, 3))
    for side in range(4):
        colour = room.colours[side]
        for k in range(4):
            x, y = corners[side if k in (0, 3) else (side + 1) % 4]
            _camera(points, k, x, y, room.height if k >= 2 else 0.0, view)
        for eye in range(len(optics.eyes)):
            _polygon(pictures, eye, points, len(points), colour, optics, scratch)


@inner
def _camera(points, k, x, y, z, view):
    """Write a point of the world as X, Y, Z of the camera's frame."""
    dx, dy = x - view.x, y - view.y
    ahead, up = view.cos * dx + view.sin * dy, z - view.z
    _see(points[k], ahead, view.cos * dy - view.sin * dx, up, view)


@inner
def _see(point, ahead, left, up, view):
    """Write X, Y, Z of the camera's frame of a place in the frame of its yaw, from the camera."""
    down = -ahead * view.pitch_sin - up * view.pitch_cos
    point[0] = view.roll_sin * down - view.roll_cos * left
    point[1] = view.roll_sin * left + view.roll_cos * down
    point[2] = ahead * view.pitch_cos - up * view.pitch_sin


@inner
def _lit(colour, light, facing):
    """Write the colour of a face that the sun meets at an angle of this cosine."""
    for channel in range(3):
        full = light[channel] + max(facing, 0.0) * light[3 + channel]
        colour[channel] = uint8(min(full + 0.5, 255.0))  # type: ignore


# Things --------------------------------------------------------------------------------------


@inner
def _stand(foot, thing, view, optics, slope, models):
    """Write where a thing stands before the camera; return whether it may be seen.

    A footprint is x ahead, y to the left, cosine and sine of its turn, half length and half width.
    """
    dx, dy = thing[tables.X] - view.x, thing[tables.Y] - view.y
    x, y = view.cos * dx + view.sin * dy, view.cos * dy - view.sin * dx
    size = models.sizes[int(thing[tables.MODEL])]
    half_length, half_width = size[0] * thing[tables.ALONG], size[1] * thing[tables.ACROSS]
    foot[0], foot[1] = x, y
    foot[2] = thing[tables.COS] * view.cos + thing[tables.SIN] * view.sin
    foot[3] = thing[tables.SIN] * view.cos - thing[tables.COS] * view.sin
    foot[4], foot[5] = half_length, half_width
    reach = half_length + half_width
    depth = x * view.pitch_cos + view.z * view.pitch_sin
    widest = max(abs(optics.eyes[0]), abs(optics.eyes[-1]))
    aside = abs(y) - widest - reach * math.sqrt(1 + slope * slope)
    # To a camera that looks up what is higher is deeper: there the foot does not decide.
    looks_up = view.pitch_sin < 0
    return looks_up or (depth + reach >= optics.near and aside <= slope * depth)


@inner(allocates=True)
def _thing(pictures, optics, view, thing, foot, far, models, scratch):
    """Draw one thing: for each eye its solids, far to near, and of each the faces turned to it."""
    model = int(thing[tables.MODEL])
    if foot[0] * foot[0] + foot[1] * foot[1] > far * far:
        model = models.models[model, 2]
    first, last = models.models[model, 0], models.models[model, 1]
    base = models.solids[first, 0]
    place = np.empty((models.solids[last - 1, 1] - base, 3))
    for solid in range(first, last):
        _project(place, base, solid, thing, foot, view, models)
    points, colour = np.empty((tables.MOST_CORNERS, 3)), np.empty(3, np.uint8)
    for eye, shift in enumerate(optics.eyes):
        # The eye in the frame of the unstretched model.
        dx = shift * view.roll_sin * view.pitch_sin - foot[0]
        dy = shift * view.roll_cos - foot[1]
        ahead = (foot[2] * dx + foot[3] * dy) / thing[tables.ALONG]
        left = (foot[2] * dy - foot[3] * dx) / thing[tables.ACROSS]
        up = (view.z + shift * view.roll_sin * view.pitch_cos) / thing[tables.UPWARD]
        for number in _order(first, last, ahead, left, up, models):
            solid = first + number
            eye_x, eye_y, sun_cos, sun_sin = ahead, left, thing[tables.COS], thing[tables.SIN]
            if models.solids[solid, 4]:
                sin, cos = sincos(f32(thing[tables.STEERING]))
                dx, dy = ahead - models.pivots[solid, 0], left - models.pivots[solid, 1]
                eye_x, eye_y = cos * dx + sin * dy, cos * dy - sin * dx
                sun_cos, sun_sin = cos * sun_cos - sin * sun_sin, sin * sun_cos + cos * sun_sin
            sun_x = models.sun[0] * sun_cos + models.sun[1] * sun_sin
            sun_y = models.sun[1] * sun_cos - models.sun[0] * sun_sin
            for face in range(models.solids[solid, 2], models.solids[solid, 3]):
                plane = models.planes[face]
                if plane[0] * eye_x + plane[1] * eye_y + plane[2] * up <= plane[3]:
                    continue
                facing = plane[0] * sun_x + plane[1] * sun_y + plane[2] * models.sun[2]
                paint = models.faces[face, 2]
                light = thing[tables.SHADE :] if paint < 0 else models.paints[paint]
                _lit(colour, light, facing)
                count = models.faces[face, 1] - models.faces[face, 0]
                for k in range(count):
                    vertex = models.corners[models.faces[face, 0] + k] - base
                    for axis in range(3):
                        points[k, axis] = place[vertex, axis]
                _polygon(pictures, eye, points, count, colour, optics, scratch)


@inner
def _project(place, base, solid, thing, foot, view, models):
    """Write the vertices of a solid as X, Y, Z of the camera's frame."""
    steered = models.solids[solid, 4] != 0
    sin, cos = sincos(f32(thing[tables.STEERING]))
    for vertex in range(models.solids[solid, 0], models.solids[solid, 1]):
        row = models.vertices[vertex]
        x, y = row[0], row[1]
        if steered:
            x, y = cos * x - sin * y, sin * x + cos * y
            x, y = x + models.pivots[solid, 0], y + models.pivots[solid, 1]
        x, y = x * thing[tables.ALONG], y * thing[tables.ACROSS]
        up = row[2] * thing[tables.UPWARD] - view.z
        ahead = foot[0] + foot[2] * x - foot[3] * y
        _see(place[vertex - base], ahead, foot[1] + foot[3] * x + foot[2] * y, up, view)


# What hides what -----------------------------------------------------------------------------


@inner(allocates=True)
def _order(first, last, x, y, z, models):
    """Return the solids of a model, far to near, for an eye in the model's frame.

    Of two solids the nearer one lies on the eye's side of the plane that parts them.
    """
    count = last - first
    before = np.zeros((count, count), np.bool_)
    for one in range(count):
        for other in range(count):
            plane = models.parting[first + one, other]
            here = plane[0] * x + plane[1] * y + plane[2] * z < plane[3]
            before[other, one] = other != one and here
    return _painted(before, np.zeros(count))


@inner(allocates=True)
def _far_to_near(feet):
    """Return the order in which things must be painted, as indices.

    Things are taken by distance, farthest first, unless one left over lies behind the next: two
    rectangles that do not overlap are parted by a side of one of them, and the one on the camera's
    side of it is the nearer one. The feet are the footprints of _stand, for a camera at (0, 0) that
    looks along +x.
    """
    count = len(feet)
    before, distance = np.zeros((count, count), np.bool_), np.empty(count)
    for one in range(count):
        distance[one] = feet[one, 0] ** 2 + feet[one, 1] ** 2
        low, high = _bearings(feet[one])
        for other in range(count):
            other_low, other_high = _bearings(feet[other])
            if other != one and other_low < high and low < other_high:
                before[other, one] = _compare(feet[other], feet[one]) < 0
    return _painted(before, distance)


@inner(allocates=True)
def _painted(before, distance):
    """Return an order in which nothing comes too early; where they go in a circle, the farthest.

    `before`, (count, count), is whether the first is to be painted before the second; of those that
    are free to come the one at the largest `distance` is taken.
    """
    count = len(distance)
    order, left = np.empty(count, np.int64), np.ones(count, np.bool_)
    for place in range(count):
        choice, choice_free = -1, False
        for one in range(count):
            if left[one]:
                free = True
                for other in range(count):
                    if left[other] and before[other, one]:
                        free = False
                better = choice < 0 or distance[one] > distance[choice]
                if (free and not choice_free) or (free == choice_free and better):
                    choice, choice_free = one, free
        order[place] = choice
        left[choice] = False
    return order


@inner
def _bearings(foot):
    """Return the least and the greatest y / x of a rectangle; all, if it is not wholly ahead."""
    ahead_x, ahead_y = foot[2] * foot[4], foot[3] * foot[4]
    left_x, left_y = -foot[3] * foot[5], foot[2] * foot[5]
    low, high = math.inf, -math.inf
    if foot[0] - abs(ahead_x) - abs(left_x) < 0.1:
        return high, low
    for a in (-1, 1):
        for b in (-1, 1):
            slope = (foot[1] + a * ahead_y + b * left_y) / (foot[0] + a * ahead_x + b * left_x)
            low, high = min(low, slope), max(high, slope)
    spare = 0.05 / foot[0]  # the eyes are off the middle
    return low - spare, high + spare


@inner
def _compare(one, other):
    """Return -1 if `one` must be painted before `other`, 1 if after, 0 if they overlap."""
    side = _parted(one, other)
    return side if side else -_parted(other, one)


@inner
def _parted(one, other):
    """Return -1 if a side of `one` parts the two with the camera beyond it, 1 if before it."""
    dx, dy = other[0] - one[0], other[1] - one[1]
    turn_cos = abs(one[2] * other[2] + one[3] * other[3])
    turn_sin = abs(one[2] * other[3] - one[3] * other[2])
    for side in range(2):
        nx, ny, half = one[2], one[3], one[4]
        spread = turn_cos * other[4] + turn_sin * other[5]
        if side:
            nx, ny, half = -one[3], one[2], one[5]
            spread = turn_sin * other[4] + turn_cos * other[5]
        gap = nx * dx + ny * dy
        if abs(gap) >= half + spread - 1e-3:
            camera = -(nx * one[0] + ny * one[1])
            beyond = camera > half if gap > 0 else camera < -half
            return -1 if beyond else 1
    return 0
