"""Compiled: contacts: who is to blame, how hard they were, who was pushed off the road.

The rules, with a drawing of each case: docs/rules.md.
"""

import math

import numpy as np

from league.jit import inner
from league.portable_math import f32, sincos
from league.sim import grid
from league.sim.records import NOBODY
from league.sim.settings import GRAVITY
from league.track.projection import curvature_at, frame_at, signed_gap

_SIDEWAYS = f32(0.05)  # slower movement to the side is none [m/s]
_CHAIN_STEPS = 3
"""A contact is passed on if the pushed car touches a third one within so many steps, no harder."""
PACE_EVERY = 16  # steps between two looks at how fast cars drive
_FAR_SLOWER = f32(0.5)  # a car below this share of its own pace is in the way
_CLEAR_AHEAD = f32(1.5)  # a car may be slow for what is this close ahead of it [m]
_LOOK = np.array((-0.8, -0.4, 0.0, 0.4, 0.8, 1.2), np.float32)
"""Where bends limit the speed: behind the car too, because it has to gain speed after them [m]."""
_LEAST_BEND = f32(1e-3)
_GRAVITY = f32(GRAVITY)
_LEAST_DISTANCE = f32(1e-3)
_INFINITE = f32(np.inf)
_ZERO, _HALF, _ONE = f32(0.0), f32(0.5), f32(1.0)


@inner
def begin(car, seen, touched):
    """Clear what is judged here of one car; return whether there is anything to judge."""
    seen.crashed_car, seen.crashed_obstacle = NOBODY, NOBODY
    seen.to_blame, seen.touched, seen.was_hit = False, False, False
    seen.forced_off, seen.pushed_off = False, False
    seen.closing_speed, seen.penalty_s = _ZERO, _ZERO
    return touched.cars != 0 or touched.obstacles != 0 or car.pushed_steps > 0


@inner
def judge_contacts(before, cars, obstacles, world, verdicts, contacts, points, course, settings):
    """Judge the contacts of one world in a control step; see referee.judge for the arguments.

    Contact with a box is the car's own fault; with a bot car it is if the bot was ahead. Of several
    obstacles that were hit at once, the rearmost is named; of several cars, the one where the
    contact costs most.
    """
    met = False
    for c in range(len(cars)):
        cars[c].pushed_steps = max(cars[c].pushed_steps - 1, 0)
        met |= contacts[c].cars != 0
        if contacts[c].obstacles:
            _judge_obstacles(cars[c], obstacles, verdicts[c], contacts[c], course, settings)
    if met:
        _judge_cars(before, cars, obstacles, verdicts, contacts, points, course, settings)
    for c in range(len(cars)):
        _find_forced_off(c, before, cars, verdicts, settings)
    if settings.room and len(cars) > 1 and world.step % PACE_EVERY == 0:
        for c in range(len(cars)):
            _learn_pace(before[c], cars[c], verdicts[c], points, course, settings)


@inner
def _judge_obstacles(car, obstacles, seen, touched, course, settings):
    nearest = _INFINITE
    for k in range(len(obstacles)):
        if (touched.obstacles >> k) & 1:
            gap = signed_gap(course, obstacles[k].s, car.s)
            if gap < nearest and (gap > _ZERO or not settings.bots):
                seen.crashed_obstacle, nearest = k, gap
                seen.penalty_s = settings.crash_penalty_s


@inner(allocates=True)
def _judge_cars(before, cars, obstacles, verdicts, contacts, points, course, settings):
    """Judge the contacts of cars with each other."""
    # For each car the mask of those towards which it is to blame.
    blamed = np.zeros(len(cars), np.uint8)
    _blame(blamed, before, cars, obstacles, verdicts, contacts, points, course, settings)


@inner
def _blame(blamed, before, cars, obstacles, verdicts, contacts, points, course, settings):
    for c in range(len(cars)):
        for other in range(len(cars)):
            if (contacts[c].cars >> other) & 1 and _is_to_blame(
                c, other, before, cars, obstacles, points, course, settings
            ):
                blamed[c] |= np.uint8(1 << other)
    if settings.push_steps > 0:
        for c in range(len(cars)):
            for other in range(len(cars)):
                if (blamed[other] >> c) & 1 and not (blamed[c] >> other) & 1:
                    _push(c, other, before, cars, points, course, settings)
        for c in range(len(cars)):
            if cars[c].pushed_steps == settings.push_steps:
                cars[c].pushed_by = _origin(c, cars, settings)
    for c in range(len(cars)):
        seen, nearest = verdicts[c], _INFINITE
        new = contacts[c].cars & ~before[c].touching_cars
        for other in range(len(cars)):
            mine, its = (blamed[c] >> other) & 1, (blamed[other] >> c) & 1
            began = (new >> other) & 1 == 1
            if its and not mine and began:
                seen.was_hit = True
            if not mine:
                continue
            closing = _closing_speed(c, other, before, cars, points, course, settings)
            passed_on = _was_just_pushed(cars[c], settings) and cars[c].pushed_by != other
            if passed_on and closing <= cars[c].pushed_speed:
                continue
            seen.to_blame = True
            seen.closing_speed = max(seen.closing_speed, closing)
            if closing < settings.light_contact:
                seen.touched = seen.touched or began
                continue
            cost = _cost(closing, its, settings)
            gap = abs(signed_gap(course, cars[other].s, cars[c].s))
            if cost > seen.penalty_s or (cost == seen.penalty_s and gap < nearest):
                seen.crashed_car, seen.penalty_s, nearest = other, cost, gap


@inner
def _cost(closing, shared, settings):
    """Return the penalty of a contact [s], in whole control steps; one at least."""
    share = _ONE
    if closing < settings.full_contact:
        share = (closing - settings.light_contact) / (
            settings.full_contact - settings.light_contact
        )
    if shared:
        share *= _HALF
    if share == _ONE:
        return settings.crash_penalty_s
    steps = f32(np.rint(share * settings.crash_penalty_s * settings.step_hz))
    return max(steps, _ONE) / settings.step_hz


@inner
def _is_to_blame(c, other, before, cars, obstacles, points, course, settings):
    """Return whether a car is to blame for touching another; both may be, or neither."""
    gap = signed_gap(course, cars[other].s, cars[c].s)
    if not settings.room:
        return gap > _ZERO
    me, rival = before[c], before[other]
    wrong_way = _drives_backwards(me, points, course)
    if wrong_way or _drives_backwards(rival, points, course):
        return wrong_way
    if _are_alongside(me, rival, points, course, settings):
        mine = _sideways(c, other, before, cars, points, course, settings)
        its = _sideways(other, c, before, cars, points, course, settings)
        if max(mine, its) > _SIDEWAYS:
            return mine > its
        return gap > _ZERO
    return gap > _ZERO or (
        gap < _ZERO and _impedes(c, before, cars, obstacles, points, course, settings)
    )


@inner
def _drives_backwards(car, points, course):
    """Return whether a car faces against the track, and moves that way."""
    frame = frame_at(points, course, car.s)
    sin, cos = sincos(car.yaw)
    along = car.velocity_x * frame.cos + car.velocity_y * frame.sin
    return cos * frame.cos + sin * frame.sin < _ZERO and along < -_SIDEWAYS


@inner
def _are_alongside(me, rival, points, course, settings):
    """Return whether two cars overlap along the track by more than a quarter of a car."""
    reach = _half_extent(me, points, course, settings)
    reach += _half_extent(rival, points, course, settings)
    return reach - abs(signed_gap(course, rival.s, me.s)) > settings.alongside


@inner
def _half_extent(car, points, course, settings):
    """Return half of the stretch of the track that a car covers [m]."""
    frame = frame_at(points, course, car.s)
    sin, cos = sincos(car.yaw)
    along, across = cos * frame.cos + sin * frame.sin, sin * frame.cos - cos * frame.sin
    return abs(along) * settings.half_length + abs(across) * settings.half_width


@inner
def _sideways(c, other, before, cars, points, course, settings):
    """Return how fast a car moves across the track towards another, and negative away [m/s].

    By its velocity before the step or by how far it came in it, whichever is more: the one misses
    what begins within the step, the other what the contact has stopped.
    """
    me = before[c]
    frame = frame_at(points, course, me.s)
    left = me.velocity_y * frame.cos - me.velocity_x * frame.sin
    came = (cars[c].lateral - me.lateral) / settings.step_dt
    if before[other].lateral < me.lateral:
        left, came = -left, -came
    return max(left, came)


@inner
def _closing_speed(c, other, before, cars, points, course, settings):
    """Return how fast two cars came together, 0 at least [m/s].

    Alongside across the track, so that rubbing costs nothing; otherwise along the line between
    them. By velocities or movement, as in `_sideways`.
    """
    me, rival = before[c], before[other]
    if settings.room and _are_alongside(me, rival, points, course, settings):
        mine = _sideways(c, other, before, cars, points, course, settings)
        its = _sideways(other, c, before, cars, points, course, settings)
        return max(mine + its, _ZERO)
    x, y = rival.x - me.x, rival.y - me.y
    distance = max(f32(math.sqrt(x * x + y * y)), _LEAST_DISTANCE)
    x, y = x / distance, y / distance
    speed = (me.velocity_x - rival.velocity_x) * x + (me.velocity_y - rival.velocity_y) * y
    came_x = (cars[c].x - me.x) - (cars[other].x - rival.x)
    came_y = (cars[c].y - me.y) - (cars[other].y - rival.y)
    return max(speed, (came_x * x + came_y * y) / settings.step_dt, _ZERO)


@inner
def _impedes(c, before, cars, obstacles, points, course, settings):
    """Return whether a car drives, and wants to, far below its own pace for no visible reason."""
    me = before[c]
    slow = _FAR_SLOWER * me.pace * allowed_speed(me.s, _LOOK, points, course, settings)
    speed = f32(math.sqrt(me.velocity_x * me.velocity_x + me.velocity_y * me.velocity_y))
    if speed >= slow or cars[c].target_speed >= slow:
        return False
    for other in range(len(before)):
        if other != c and not before[other].ghost:
            gap = signed_gap(course, before[other].s, me.s)
            if _ZERO < gap < _CLEAR_AHEAD:
                return False
    for k in range(len(obstacles)):
        gap = signed_gap(course, obstacles[k].s, me.s)
        if _ZERO < gap < _CLEAR_AHEAD:
            return False
    return True


@inner
def _learn_pace(old, car, seen, points, course, settings):
    """Note the largest share of the speed allowed by the road that a car has driven."""
    if grid.is_racing(old):
        speed = seen.advance * settings.step_hz
        share = speed / allowed_speed(car.s, _LOOK, points, course, settings)
        car.pace = max(car.pace, min(share, _ONE))


@inner
def allowed_speed(s, look, points, course, settings):
    """Return about how fast a car can be at a place, for the bends this far from it [m/s].

    `look` are distances along the track, negative behind the car, float32 (any,) [m].
    """
    sharpest = _LEAST_BEND
    for k in range(len(look)):
        sharpest = max(sharpest, abs(curvature_at(points, course, s + look[k])))
    return min(f32(math.sqrt(settings.grip * _GRAVITY / sharpest)), settings.max_speed)


@inner
def _push(c, other, before, cars, points, course, settings):
    """Note that a car was pushed by another, which alone is to blame."""
    car = cars[c]
    # A contact lasts for some steps, and the first of them are the hard ones.
    hardest = before[c].pushed_speed if _was_just_pushed(car, settings) else _ZERO
    closing = _closing_speed(other, c, before, cars, points, course, settings)
    car.pushed_speed = max(closing, hardest)
    car.pushed_by, car.pushed_steps = other, settings.push_steps


@inner
def _was_just_pushed(car, settings):
    """Return whether what a car touches now may be the fault of another, which has pushed it."""
    return car.pushed_steps > max(settings.push_steps - _CHAIN_STEPS, 0)


@inner
def _origin(c, cars, settings):
    """Return who began the chain of pushes that ends in a car."""
    first = cars[c].pushed_by
    for _ in range(len(cars)):
        pusher = cars[first].pushed_by
        if not _was_just_pushed(cars[first], settings) or pusher == c:
            break
        first = pusher
    return first


@inner
def _find_forced_off(c, before, cars, verdicts, settings):
    """Find whether a car left the road, or hit an obstacle, because another has pushed it."""
    seen = verdicts[c]
    into_thing = seen.crashed_obstacle != NOBODY and _was_just_pushed(cars[c], settings)
    leaves = seen.off_track or into_thing
    if leaves and cars[c].pushed_steps > 0 and grid.is_racing(before[c]):
        seen.forced_off, seen.off_track = True, False
        verdicts[cars[c].pushed_by].pushed_off = True
