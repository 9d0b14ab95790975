"""Compiled: where boxes stand, and how bot cars drive along a lane that they change at times.

records.py says what the arguments are.
"""

import math

import numpy as np

from league.jit import inner
from league.portable_math import atan, clamp, f32, heading_of, wrap_angle
from league.sim.rng import purposes, uniform_of
from league.track.projection import frame_at

_PLACE, _LANE, _PERIOD = purposes(101, 104)
_LANE_CHANGE_DISTANCE = f32(1.0)
_END_MARGIN = f32(1.0)
_ZERO, _HALF, _ONE, _TWO, _THREE, _SIX = (f32(n) for n in (0.0, 0.5, 1.0, 2.0, 3.0, 6.0))


@inner
def place(obstacles, world, points, course, places, settings):
    """Put the obstacles of one world where they stand at the start of its race.

    `places` are fixed places, (fraction of the lap, lane) of each, float32 (num_obstacles, 2), or
    none.
    """
    for k in range(len(obstacles)):
        thing = obstacles[k]
        lane = _first_lane(k, world.seed, course, places, settings)
        thing.s = _first_s(k, len(obstacles), world.seed, course, places, settings)
        thing.lateral = lane * _lane_offset(frame_at(points, course, thing.s), lane)
        thing.half_length, thing.half_width = settings.thing_half_length, settings.thing_half_width
        thing.velocity_x, thing.velocity_y, thing.stopped_s = _ZERO, _ZERO, _ZERO
        _pose(thing, points, course, _ZERO)


@inner
def aim(obstacles, arrivals, world, points, course, places, settings):
    """Set the velocity of bot cars, and `arrivals` to where they will be after this step."""
    for k in range(len(obstacles)):
        now, then = obstacles[k], arrivals[k]
        arrivals[k] = obstacles[k]
        if not settings.bots:
            continue
        speed = _ZERO if now.stopped_s > _ZERO else settings.bot_speed
        # Counted in whole steps, so that no rounding adds or drops one.
        steps_left = max(f32(np.rint(now.stopped_s * settings.step_hz)) - _ONE, _ZERO)
        then.stopped_s = steps_left / settings.step_hz
        then.s = now.s + speed * settings.step_dt
        then.lateral, slope = _lane_path(
            k, len(obstacles), then.s, world.seed, points, course, places, settings
        )
        _pose(then, points, course, slope)
        now.velocity_x = (then.x - now.x) / settings.step_dt
        now.velocity_y = (then.y - now.y) / settings.step_dt
        then.velocity_x, then.velocity_y = now.velocity_x, now.velocity_y


@inner
def _first_s(k, count, seed, course, places, settings):
    """Return s of obstacle k: as given, evenly spaced, or evenly spaced with a random shift."""
    if settings.fixed_places:
        return places[k, 0] * course.length
    first = min(course.length / f32(count + 1), settings.min_distance)
    stretch = course.length - first - _END_MARGIN
    # The starting grid stays clear; it stands before the line, or on an open track after it.
    stretch = max(stretch - settings.grid_length, _ZERO)
    if not course.closed:
        first += settings.grid_length
    if not settings.random_places:
        s = first + f32(k) * (stretch / f32(max(count - 1, 1)))
        return _off_the_starts(s, course, settings)
    # Each keeps to its own stretch, shortened so that two neighbours stay min_distance apart.
    spacing = stretch / f32(count)
    free = max(spacing - settings.min_distance, _ZERO)
    s = first + f32(k) * spacing + uniform_of(seed, _PLACE, k) * free
    return _off_the_starts(s, course, settings)


@inner
def _off_the_starts(s, course, settings):
    """Return a place along the track, moved off the nearest start of a pursuit where it is near."""
    if settings.pursuers == 0:
        return s
    apart = course.length / f32(settings.pursuers)
    room = min(_END_MARGIN, apart * _HALF)
    start = f32(math.floor(s / apart + _HALF)) * apart
    if abs(s - start) >= room:
        return s
    return start - room if s < start else start + room


@inner
def _first_lane(k, seed, course, places, settings):
    """Return 1 for the lane on the left and -1 on the right, or in between, as given."""
    if settings.fixed_places:
        return places[k, 1]
    if settings.random_places:
        return _ONE if uniform_of(seed, _LANE, k) < _HALF else -_ONE
    return course.inner if k % 2 == 0 else -course.inner


@inner
def _lane_offset(frame, side):
    """Return how far the middle of a lane lies from the centreline [m]."""
    return (frame.left if side > _ZERO else frame.right) * _HALF


@inner
def _lane_path(k, count, s, seed, points, course, places, settings):
    """Return lateral [m] and d(lateral)/ds of bot car k at odometer s."""
    lane = _first_lane(k, seed, course, places, settings)
    frame = frame_at(points, course, s)
    if not settings.lane_change:
        return lane * _lane_offset(frame, lane), _ZERO
    # Lanes change every 3 to 5 s of driving, over one metre, along a cubic. One change ends
    # before the next begins.
    stretch = (_THREE + _TWO * uniform_of(seed, _PERIOD, k)) * settings.bot_speed
    stretch = max(stretch, _LANE_CHANGE_DISTANCE)
    driven = s - _first_s(k, count, seed, course, places, settings)
    change = f32(math.floor(driven / stretch))
    odd = f32(math.floor(change * _HALF)) * _TWO != change
    after = -lane if odd else lane
    before = -after if change > _ZERO else after
    part = clamp((driven - change * stretch) / _LANE_CHANGE_DISTANCE, _ZERO, _ONE)
    blend = part * part * (_THREE - _TWO * part)
    side = before + (after - before) * blend
    offset = _lane_offset(frame, side)
    slope = (after - before) * _SIX * part * (_ONE - part) / _LANE_CHANGE_DISTANCE * offset
    return side * offset, slope


@inner
def _pose(thing, points, course, slope):
    """Set x, y and yaw from the place along and across the track."""
    frame = frame_at(points, course, thing.s)
    thing.x = frame.x - frame.sin * thing.lateral
    thing.y = frame.y + frame.cos * thing.lateral
    thing.yaw = wrap_angle(heading_of(frame.cos, frame.sin) + atan(slope))
