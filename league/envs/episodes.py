"""Compiled: episodes in training, when they end and where cars begin the next one."""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from league.jit import inner
from league.portable_math import atan, clamp, f32, heading_of, wrap, wrap_angle
from league.sim import grid
from league.sim import obstacles as obstacle_kernels
from league.sim.rng import SEED_MASK, bits_of, uniform_of
from league.sim.settings import GRAVITY
from league.track.projection import curvature_at, frame_at, signed_gap

if TYPE_CHECKING:
    from league.envs.config import EnvConfig

EPISODES = np.dtype(
    [
        ("training", np.bool_),  # whether a mistake ends an episode, instead of costing seconds
        ("longest", np.int64),  # steps after which an episode is cut off
        ("all_restart", np.bool_),  # whether every car begins its next episode by itself
        ("restarting", np.uint8),  # otherwise the cars that do; the others are retired
        ("placing", np.bool_),  # whether the others are placed around car 0
        # The fields of OpponentPlacement.
        ("alone", f32),
        ("standing", f32),
        ("rolling", f32),
        ("reach", f32),
        ("ahead", f32),
        ("room", f32),
        ("lost", f32),
        ("top_speed", f32),
        ("pace", f32),
    ],
    align=True,
)
"""Settings of episodes."""
_PLACEMENT = ("alone", "standing", "rolling", "reach", "ahead", "room", "lost", "top_speed", "pace")

_SPOT, _SIDE, _SEED = 211, 212, 213
_NEAR_SPOT, _NEAR_SIDE, _KIND, _SLOT, _ROLL, _PACE, _OWN_PACE, _GAP, _LANE = range(221, 230)
_CANDIDATES, _ROOM = 8, f32(0.8)
_NEAR_CANDIDATES = 24
_LANES, _ACROSS, _ALONG = f32(0.7), f32(0.3), f32(0.5)
_START, _END = f32(0.2), f32(0.5)
_LEAST_BEND, _STEEPEST = f32(1e-3), f32(0.3)
_SLOWEST, _FASTER = f32(0.3), f32(0.7)
_LOOK = np.array((0.0, 0.4, 0.8, 1.2), np.float32)
_GRAVITY = f32(GRAVITY)
_NOWHERE, _FAR, _PREFERRED, _LATER = f32(-1000.0), f32(1e6), f32(1e9), f32(1e6)
_ZERO, _HALF, _ONE, _TWO = f32(0.0), f32(0.5), f32(1.0), f32(2.0)


def settings(cfg: EnvConfig) -> np.ndarray:
    """Return the record of these settings, shape (1,)."""
    record = np.zeros(1, EPISODES)
    record["training"] = cfg.mode == "training"
    record["longest"] = round(cfg.episode_s * cfg.sim.step_hz)
    record["all_restart"] = cfg.restarting is None
    record["restarting"] = sum(1 << car for car in cfg.restarting or ())
    record["placing"] = cfg.placement is not None
    if cfg.placement is not None:
        for name in _PLACEMENT:
            record[name] = getattr(cfg.placement, name)
    return record


@inner
def begin_all(cars, obstacles, world, points, course, places, sim, episodes):
    """Begin the first episode of every car of one world, which has just been put on the grid."""
    all_cars = (1 << len(cars)) - 1
    _restart(all_cars, cars, obstacles, world, points, course, places, sim, episodes)


@inner
def end_and_begin(done, cars, obstacles, world, points, course, places, sim, episodes):
    """Begin the next episodes of one world; return the mask of the cars that begin one.

    `done` is the mask of the cars with an episode that is over; see step.py for the rest.
    """
    begins = done
    if episodes.placing:
        begins = _joining(done, cars, course, episodes)
    elif not episodes.all_restart:
        begins = done & episodes.restarting
        for c in range(len(cars)):
            if ((done & ~begins) >> c) & 1:
                grid.retire(cars[c])
    if begins:
        _restart(begins, cars, obstacles, world, points, course, places, sim, episodes)
        for c in range(len(cars)):
            # A car that begins another episode is to blame for nothing of the last one.
            if (begins >> cars[c].pushed_by) & 1:
                cars[c].pushed_steps = 0
    return begins


@inner
def _joining(done, cars, course, episodes):
    """Return the mask of the cars that are placed around car 0 in this step.

    When car 0 begins an episode, all do; else those that have ended theirs or are left behind.
    """
    if done & 1:
        return (1 << len(cars)) - 1
    begins = 0
    for c in range(1, len(cars)):
        gap = signed_gap(course, cars[c].s, cars[0].s)
        if not cars[c].parked and ((done >> c) & 1 or abs(gap) > episodes.lost):
            begins |= 1 << c
    return begins


@inner
def _restart(mask, cars, obstacles, world, points, course, places, sim, episodes):
    spots = np.empty((len(cars), 2), np.float32)
    all_begin = mask == (1 << len(cars)) - 1
    if all_begin and len(obstacles) and sim.random_places and world.step > 0:
        # Another seed, and with it other obstacles.
        world.seed = bits_of(world.seed, _SEED, world.step) & SEED_MASK
        obstacle_kernels.place(obstacles, world, points, course, places, sim)
    if episodes.placing:
        _place_around_learner(mask, cars, obstacles, world, spots, points, course, sim, episodes)
        return
    _free_spots(mask, cars, obstacles, world, spots, course)
    for c in range(len(cars)):
        if (mask >> c) & 1:
            frame = frame_at(points, course, spots[c, 0])
            across = uniform_of(world.seed, _SIDE, world.step, c) - _HALF
            lateral = across * min(frame.left, frame.right)
            _begin(c, cars, world, spots[c, 0], lateral, points, course, sim)
    _order(mask, cars, course)
    for c in range(len(cars)):
        if (mask >> c) & 1:
            encode(cars[c], sim)


@inner
def _begin(c, cars, world, s, lateral, points, course, sim):
    """Begin one car's episode at rest, with a new book: its laps begin where it stands."""
    car = cars[c]
    grid.stand(car, points, course, s, lateral)
    car.zero_s = car.s if course.closed else _ZERO
    grid.blank_book(car, car.s - car.zero_s, f32(world.step) * sim.step_dt)
    grid.draw_parameters(car, c, world.seed, world.step, sim)


@inner
def _order(mask, cars, course):
    """Set which cars are ahead on the road, for pairs in which one has begun an episode."""
    for c in range(len(cars)):
        for other in range(len(cars)):
            if other != c and ((mask >> c) & 1 or (mask >> other) & 1):
                bit = np.uint8(1 << other)
                if signed_gap(course, cars[c].s, cars[other].s) > _ZERO:
                    cars[c].ahead |= bit
                else:
                    cars[c].ahead &= ~bit


@inner
def encode(car, sim):
    """Set a car's last action to the one that asks for its target controls; see actions.encode."""
    share = (car.target_speed - sim.min_speed) / (sim.max_speed - sim.min_speed)
    car.action_steering = clamp(car.target_steering / sim.max_steering, -_ONE, _ONE)
    car.action_speed = clamp(_TWO * share - _ONE, -_ONE, _ONE)


@inner
def _free_spots(mask, cars, obstacles, world, spots, course):
    """Draw s of a free stretch for each car of a mask; those that begin together keep clear.

    Of eight places the first that is 0.8 m clear of all else is taken, or the clearest.
    """
    for c in range(len(cars)):
        spots[c, 0] = cars[c].s
    for c in range(len(cars)):
        if not (mask >> c) & 1:
            continue
        best, chosen = -_ONE, _ZERO
        for attempt in range(_CANDIDATES):
            s = uniform_of(world.seed, _SPOT, world.step, c, attempt) * course.length
            room = _PREFERRED
            for other in range(len(cars)):
                if other != c:
                    room = min(room, abs(signed_gap(course, spots[other, 0], s)))
            for k in range(len(obstacles)):
                room = min(room, abs(signed_gap(course, obstacles[k].s, s)))
            merit = _PREFERRED - f32(attempt) * _LATER if room >= _ROOM else room
            if merit > best:
                best, chosen = merit, s
        spots[c, 0] = chosen


@inner
def _place_around_learner(mask, cars, obstacles, world, spots, points, course, sim, episodes):
    """Begin episodes of all cars if car 0 begins one, else of those that join it."""
    seed, step, num_cars = world.seed, world.step, len(cars)
    first = mask & 1 == 1
    kind = uniform_of(seed, _KIND, step)
    alone = first and kind < episodes.alone
    on_grid = first and not alone and kind < episodes.alone + episodes.standing
    _near_spots(mask, cars, obstacles, world, spots, points, course, episodes)
    if on_grid:
        shift = np.int64(uniform_of(seed, _SLOT, step) * f32(num_cars))
        for c in range(num_cars):
            place = (c + shift) % num_cars
            spots[c, 0], spots[c, 1] = grid.slot(place, num_cars, points, course, sim)
    frame = frame_at(points, course, cars[0].s)
    base = max(cars[0].velocity_x * frame.cos + cars[0].velocity_y * frame.sin, _ZERO)
    if first:
        base = _ZERO
        if uniform_of(seed, _ROLL, step) < episodes.rolling and not on_grid:
            base = (_SLOWEST + _FASTER * uniform_of(seed, _PACE, step)) * episodes.top_speed
    for c in range(num_cars):
        if (mask >> c) & 1:
            limit = _allowed(cars[c], spots[c, 0], points, course, sim, episodes)
            own = _TWO * uniform_of(seed, _OWN_PACE, step, c) - _ONE
            speed = min(base * (_ONE + episodes.pace * own), limit)
            _begin(c, cars, world, spots[c, 0], spots[c, 1], points, course, sim)
            if speed > _ZERO:
                _roll(cars[c], speed, points, course, sim)
    _order(mask, cars, course)
    for c in range(len(cars)):
        if (mask >> c) & 1:
            encode(cars[c], sim)
    if alone:
        far = wrap(cars[0].s + course.length * _HALF, course.length)
        for c in range(1, num_cars):
            cars[c].x, cars[c].s, cars[c].parked = _NOWHERE, far, True
            grid.retire(cars[c])


@inner
def _near_spots(mask, cars, obstacles, world, spots, points, course, episodes):
    """Draw places on the road for all that begin, near car 0, where nothing else is.

    Of the candidates the first that is clear of everything is taken, or else the clearest.
    """
    seed, step = world.seed, world.step
    for c in range(len(cars)):
        spots[c, 0], spots[c, 1] = cars[c].s, cars[c].lateral
    if mask & 1:
        spots[0, 0] = _clear_spot(obstacles, world, course)
        side = _TWO * uniform_of(seed, _NEAR_SIDE, step) - _ONE
        spots[0, 1] = _across(points, course, spots[0, 0], side)
    behind = _ONE - episodes.ahead
    for c in range(1, len(cars)):
        if not (mask >> c) & 1:
            continue
        best, s, lateral = -_ONE, _ZERO, _ZERO
        for attempt in range(_NEAR_CANDIDATES):
            drawn = uniform_of(seed, _GAP, step, c, attempt)
            part = behind if drawn < behind else episodes.ahead
            place = spots[0, 0] + (drawn - behind) / part * episodes.reach
            if not course.closed:
                place = min(max(place, _START), course.length - _END)
            side = _TWO * uniform_of(seed, _LANE, step, c, attempt) - _ONE
            across = _across(points, course, place, side)
            clear, room = _clearance(c, mask, place, across, spots, course, episodes)
            away = _to_obstacle(place, obstacles, course)
            clear, room = clear and away >= _ROOM, min(room, away)
            merit = _PREFERRED - f32(attempt) * _LATER if clear else room
            if merit > best:
                best, s, lateral = merit, place, across
        spots[c, 0], spots[c, 1] = s, lateral


@inner
def _clear_spot(obstacles, world, course):
    """Draw s for car 0: the first of eight places that is clear of obstacles, or the last."""
    s = uniform_of(world.seed, _NEAR_SPOT, world.step) * course.length
    for attempt in range(1, _CANDIDATES):
        if _to_obstacle(s, obstacles, course) >= _ROOM:
            break
        s = uniform_of(world.seed, _NEAR_SPOT, world.step, attempt) * course.length
    return s


@inner
def _to_obstacle(s, obstacles, course):
    """Return how far the nearest obstacle is along the track [m]."""
    room = _FAR
    for k in range(len(obstacles)):
        room = min(room, abs(signed_gap(course, obstacles[k].s, s)))
    return room


@inner
def _clearance(c, mask, place, across, spots, course, episodes):
    """Return whether a place is clear of all other cars, and the gap to the nearest [m].

    Clear is half a metre along the track or most of a lane across; of car 0, if it drives, more.
    """
    clear, room = True, _FAR
    for other in range(len(spots)):
        if other == c:
            continue
        away = abs(signed_gap(course, place, spots[other, 0]))
        apart = away >= _ALONG or abs(across - spots[other, 1]) >= _ACROSS
        if other == 0:
            apart = apart and (mask & 1 == 1 or away >= episodes.room)
        elif other > c and (mask >> other) & 1:
            # A car that begins too has no place yet.
            apart = True
        clear = clear and apart
        room = min(room, away)
    return clear, room


@inner
def _across(points, course, s, side):
    """Return the lateral place [m] of a share of half the road's width, -1 to 1."""
    frame = frame_at(points, course, s)
    return side * _LANES * min(frame.left, frame.right)


@inner
def _allowed(car, s, points, course, sim, episodes):
    """Return the speed that the next bend allows at a rolling start [m/s]."""
    sharpest = _ZERO
    for k in range(len(_LOOK)):
        sharpest = max(sharpest, abs(curvature_at(points, course, s + _LOOK[k])))
    limit = f32(math.sqrt(sim.grip * _GRAVITY / max(sharpest, _LEAST_BEND)))
    return min(limit, episodes.top_speed)


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
