"""Compiled: situations in which cars meet in training: how they begin, and when they are over.

All cars of a world begin together and end together. In each group of cars one is the fastest of its
group, and mostly starts last; the others obey lower top speeds, so that there is something to pass.
Whether the attack of the first group succeeds is reported for the curriculum (training/racing).
"""

import math

import numpy as np

from league.envs.rewards import NEAR
from league.jit import inner
from league.portable_math import atan, clamp, f32, heading_of, wrap_angle
from league.sim import blame, grid
from league.sim.records import NOBODY
from league.sim.rng import purposes, uniform_of
from league.sim.settings import GRAVITY
from league.track.projection import curvature_at, frame_at, signed_gap

ENCOUNTER = np.dtype(
    [
        ("attacker", np.int64),  # the fastest car of the first group, or the car behind another
        ("target", np.int64),  # the car that it meets first
        ("steps", np.int64),  # control steps so far
        ("length", np.int64),  # control steps after which it is over
        ("alone", np.bool_),  # cars are spread over the lap
        ("attack", np.bool_),  # the fastest car starts behind a target that is no roadblock
        ("dirty", np.bool_),  # the attacker has left the road or made a hard contact
    ],
    align=True,
)
"""The running scenario of one world."""

NO_ATTACK, FAILED, PASSED, CLEAN = 0, 1, 2, 3
"""How an attack ended: none was made, not passed, passed with a mistake, passed without one."""

_BASE, _KIND, _GROUPS, _ORDER, _LENGTH, _FIRST, _FAST, _SLOW, _WHICH = purposes(221, 230)
_GAP, _LANE, _PACE, _OWN_PACE, _QUEUE, _QUEUE_PACE, _LEARNER, _SIDE = purposes(231, 239)
_PENALISED, _PENALTY, _PLACE = purposes(239, 242)
_ATTEMPTS, _CLEAR = 12, f32(0.8)
_SIDE_LEAST, _SIDE_MORE, _SIDE_SHIFT, _ROW = f32(0.45), f32(0.2), f32(0.3), f32(1.0)
_NEAREST_START, _FARTHEST_START, _LANES = f32(0.45), f32(1.8), f32(0.7)
_FARTHEST_QUEUE = f32(4.0)
"""Largest distance at which a queue of slow cars begins ahead of a fast one [m]."""
_BRAKING, _ROOM = f32(0.5), f32(0.35)
"""Share of the grip with which a car can begin to brake behind another, and the room left [m]."""
_PARTED = f32(0.4)
"""An attacker starts this far behind its target, and has passed when this far ahead [m]."""
_LEAST_FAST, _ROADBLOCK = f32(0.85), (f32(0.15), f32(0.75))
_SLOWEST, _FASTER, _SPREAD = f32(0.3), f32(0.7), f32(0.15)
_AT_REST = f32(0.3)  # share of cars alone that begin at rest, as after a penalty
_CREEP = f32(0.5)  # largest speed at which cars begin on a grid [m/s]: no two starts are alike
_START, _END = f32(0.2), f32(0.5)
_STEEPEST = f32(0.3)
_LOOK = np.array((0.0, 0.4, 0.8, 1.2), np.float32)
_GRAVITY, _FAR = f32(GRAVITY), f32(1e6)
_ZERO, _HALF, _ONE, _TWO = f32(0.0), f32(0.5), f32(1.0), f32(2.0)


@inner(allocates=True)
def begin(encounter, cars, obstacles, world, points, course, sim, rules):
    """Draw a scenario of one world, and put all its cars at their places.

    Args:
        encounter: ENCOUNTER record; overwritten.
        cars: CAR records (num_cars,); overwritten.
        obstacles: OBSTACLE records (num_obstacles,), in their places.
        world: WORLD record.
        points: of the TrackSet.
        course: COURSE record of the world's track.
        sim: SETTINGS record.
        rules: EPISODES record.
    """
    seed, step, num_cars = world.seed, world.step, len(cars)
    kind = uniform_of(seed, _KIND, step)
    encounter.alone = kind < rules.alone
    standing = not encounter.alone and kind < rules.alone + rules.standing
    abreast = not encounter.alone and not standing
    abreast = abreast and kind < rules.alone + rules.standing + rules.abreast
    size = num_cars
    if encounter.alone:
        size = 1
    elif num_cars > 2 and course.closed and uniform_of(seed, _GROUPS, step) < _HALF:
        size = 2
    first = _fastest(0, size, world, rules)
    order = np.empty(num_cars, np.int64)
    _draw_order(order, first, world, rules)
    spots = np.empty((num_cars, 2), np.float32)
    _find_spots(spots, size, standing, abreast, obstacles, world, points, course, sim, rules)
    base, spread = _ZERO, _SPREAD
    drawn = uniform_of(seed, _PACE, step)
    if standing:
        base, spread = _HALF * _CREEP, _ONE
    elif not (encounter.alone and drawn < _AT_REST):
        base = (_SLOWEST + _FASTER * drawn) * sim.max_speed
    ahead = _ZERO
    for place in range(num_cars):
        c = order[place]
        grid.begin_episode(c, cars, world, spots[place, 0], spots[place, 1], points, course, sim)
        cars[c].top_speed = _top_speed(place, size, world, sim, rules)
        own = _TWO * uniform_of(seed, _OWN_PACE, step, c) - _ONE
        limit = blame.allowed_speed(cars[c].s, _LOOK, points, course, sim)
        limit = min(limit, cars[c].top_speed)
        speed = min(base * (_ONE + spread * own), limit)
        if place % size and not abreast:
            gap = signed_gap(course, cars[order[place - 1]].s, cars[c].s)
            speed = min(speed, _can_stop_behind(ahead, gap, sim))
        ahead = speed
        if speed > _ZERO:
            _roll(cars[c], speed, points, course, sim)
    target = first - 1 if first > 0 else min(1, num_cars - 1)
    encounter.attacker, encounter.target = order[first], order[target]
    encounter.attack = size > 1 and first > 0
    if encounter.attack:
        gap = signed_gap(course, cars[encounter.target].s, cars[encounter.attacker].s)
        # Passing a roadblock says nothing about how fast rivals may be.
        least = rules.slowest_rival * cars[encounter.attacker].top_speed
        encounter.attack = gap >= _PARTED and cars[encounter.target].top_speed >= least
    for c in range(num_cars):
        if c != encounter.attacker and uniform_of(seed, _PENALISED, step, c) < rules.penalised:
            _penalise(c, cars, world, points, course, sim)
            encounter.attack = encounter.attack and c != encounter.target
    seconds = rules.shortest + uniform_of(seed, _LENGTH, step) * (rules.longest_s - rules.shortest)
    encounter.length = np.int64(seconds * sim.step_hz)
    encounter.steps, encounter.dirty = 0, False


@inner
def judge(encounter, cars, verdicts, outcomes, course, sim, rules):
    """Set which cars' episodes end in this step, and how an attack ended; return whether all do.

    A contact between cars ends nothing; a car that leaves the road, hits an obstacle, stands still
    or drives backwards ends the episodes of all.
    """
    encounter.steps += 1
    over = encounter.steps >= encounter.length
    gap = signed_gap(course, cars[encounter.attacker].s, cars[encounter.target].s)
    if not encounter.alone and not _is_near(encounter.attacker, cars, course, rules.lost):
        over = True
    for c in range(len(cars)):
        seen = verdicts[c]
        failed = seen.off_track or seen.immobilised or seen.reversed or seen.finished
        failed = failed or (seen.crashed and seen.crashed_obstacle != NOBODY)
        outcomes[c].terminated = failed
        over = over or failed or seen.forced_off
    mine = verdicts[encounter.attacker]
    hard = mine.closing_speed >= sim.light_contact
    if outcomes[encounter.attacker].terminated or mine.pushed_off or hard:
        encounter.dirty = True
    for c in range(len(cars)):
        outcomes[c].truncated = over and not outcomes[c].terminated
        outcomes[c].attack = NO_ATTACK
        outcomes[c].near = _is_near(c, cars, course, NEAR)
    if over and encounter.attack:
        # A target that has failed by itself was neither passed nor missed.
        ended = FAILED
        if gap >= _PARTED:
            ended = PASSED if encounter.dirty else CLEAN
        elif outcomes[encounter.target].terminated and not encounter.dirty:
            ended = NO_ATTACK
        outcomes[encounter.attacker].attack = ended
    return over


@inner
def _is_near(c, cars, course, reach):
    """Return whether another car is within this distance along the track."""
    for other in range(len(cars)):
        if other != c and abs(signed_gap(course, cars[other].s, cars[c].s)) < reach:
            return True
    return False


@inner
def _find_spots(spots, size, standing, abreast, obstacles, world, points, course, sim, rules):
    """Draw s and lateral [m] of each place, front to back; clear of obstacles if a try finds it."""
    best = -_ONE
    chosen = np.int64(0)
    for attempt in range(_ATTEMPTS if len(obstacles) else 1):
        _draw_spots(attempt, spots, size, standing, abreast, world, points, course, sim, rules)
        room = _FAR
        for place in range(len(spots)):
            for k in range(len(obstacles)):
                room = min(room, abs(signed_gap(course, obstacles[k].s, spots[place, 0])))
        if room > best:
            best, chosen = room, attempt
        if room >= _CLEAR:
            return
    if len(obstacles):
        _draw_spots(chosen, spots, size, standing, abreast, world, points, course, sim, rules)


@inner
def _draw_spots(attempt, spots, size, standing, abreast, world, points, course, sim, rules):
    seed, step, num_cars = world.seed, world.step, len(spots)
    base = uniform_of(seed, _BASE, step, attempt) * course.length
    groups = (num_cars + size - 1) // size
    if not course.closed:
        # The first place: all others lie behind it.
        base = _START + (course.length - _START - _END) * uniform_of(seed, _BASE, step, attempt)
        base = max(base, min(_FARTHEST_START * f32(num_cars), course.length - _END))
    offset = _ZERO
    turned = uniform_of(seed, _SIDE, step, attempt) < _HALF
    for place in range(num_cars):
        member = place % size
        if member == 0:
            offset = course.length / f32(groups) * f32(place // size)
        side = _ONE if (place % 2 == 0) != turned else -_ONE
        lane = uniform_of(seed, _LANE, step, place, attempt)
        share = _LANES * (_TWO * lane - _ONE)
        if standing:
            offset += sim.grid_gap if member else _ZERO
            share = side * _HALF
        elif abreast:
            if member and member % 2 == 0:
                offset += _ROW
            share = side * (_SIDE_LEAST + _SIDE_MORE * lane)
        elif member:
            farthest = _FARTHEST_START
            if _in_queue(place // size, world, rules):
                # Slow cars are met at full speed, too.
                farthest = _FARTHEST_QUEUE if member == size - 1 else _ONE
            drawn = uniform_of(seed, _GAP, step, place, attempt)
            offset += _NEAREST_START + (farthest - _NEAREST_START) * drawn
        s = base - offset
        if abreast:
            s += _SIDE_SHIFT * (uniform_of(seed, _GAP, step, place, attempt) - _HALF)
        if not course.closed:
            s = min(max(s, _START), course.length - _END)
        frame = frame_at(points, course, s)
        spots[place, 0], spots[place, 1] = frame.s, share * min(frame.left, frame.right)


@inner
def _draw_order(order, first, world, rules):
    """Draw which car takes each place; a learner's, car 0, may be sure to be the first attacker."""
    for place in range(len(order)):
        drawn = uniform_of(world.seed, _ORDER, world.step, place)
        other = np.int64(drawn * f32(place + 1))
        order[place] = order[other]
        order[other] = place
    if uniform_of(world.seed, _LEARNER, world.step) < rules.learner:
        for place in range(len(order)):
            if order[place] == 0:
                order[place] = order[first]
                order[first] = 0
                return


@inner
def _fastest(group, size, world, rules):
    """Return which place of a group the fastest car has: mostly the last."""
    if uniform_of(world.seed, _FIRST, world.step, group) < rules.attack:
        return size - 1
    return np.int64(uniform_of(world.seed, _WHICH, world.step, group) * f32(size))


@inner
def _in_queue(group, world, rules):
    """Return whether all rivals of a group are slow: passing one must not end in the next."""
    return uniform_of(world.seed, _QUEUE, world.step, group) < rules.roadblock


@inner
def _can_stop_behind(speed, gap, sim):
    """Return from which speed [m/s] a car can slow down to that of the car ahead in time."""
    room = max(gap - _ROOM, _ZERO)
    return f32(math.sqrt(speed * speed + _TWO * _BRAKING * sim.grip * _GRAVITY * room))


@inner
def _top_speed(place, size, world, sim, rules):
    """Draw the top speed [m/s] of a place: the group's fastest, or a share of it."""
    seed, step, group = world.seed, world.step, place // size
    top, drawn = sim.max_speed, uniform_of(seed, _FAST, step, group)
    if drawn < rules.limited:
        top *= _LEAST_FAST + (_ONE - _LEAST_FAST) * drawn / rules.limited
    if place % size == _fastest(group, size, world, rules):
        return top
    drawn = uniform_of(seed, _SLOW, step, place)
    if _in_queue(group, world, rules):
        slow = uniform_of(seed, _QUEUE_PACE, step, group)
        slow = _ROADBLOCK[0] + (_ROADBLOCK[1] - _ROADBLOCK[0]) * slow
        return top * slow * (_ONE + _SPREAD * (_TWO * drawn - _ONE))
    return top * (rules.slowest_rival + (rules.fastest_rival - rules.slowest_rival) * drawn)


@inner
def _penalise(c, cars, world, points, course, sim):
    """Have a car stand as if for a penalty: on its place, or next to the road on that side."""
    car, lateral = cars[c], cars[c].lateral
    off_road = uniform_of(world.seed, _PLACE, world.step, c) < _HALF
    if off_road:
        frame = frame_at(points, course, car.s)
        lateral = frame.left if lateral > _ZERO else -frame.right
    grid.stand(car, points, course, car.s, lateral)
    seconds = sim.off_track_penalty_s * uniform_of(world.seed, _PENALTY, world.step, c)
    car.penalty_s, car.put_back, car.ghost = seconds, off_road, True


@inner
def _roll(car, speed, points, course, sim):
    """Set a car moving along the track, its wheels turned as the bend requires."""
    frame = frame_at(points, course, car.s)
    bend = curvature_at(points, course, car.s)
    # Left of the centreline a left bend is tighter.
    bend = bend / max(_ONE - bend * car.lateral, _STEEPEST)
    turned = clamp(atan(sim.arm * _TWO * bend), -sim.max_steering, sim.max_steering)
    car.yaw = wrap_angle(heading_of(frame.cos, frame.sin))
    car.velocity_x, car.velocity_y = speed * frame.cos, speed * frame.sin
    car.yaw_rate, car.steering = speed * bend, turned
    car.target_steering, car.target_speed = turned, speed
