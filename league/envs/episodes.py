"""Compiled: episodes in training, when they end and where cars begin the next one."""

from dataclasses import fields

import numpy as np

from league.envs import scenarios
from league.envs.config import EnvConfig, Scenarios
from league.jit import inner
from league.portable_math import clamp, f32
from league.sim import grid
from league.sim.rng import SEED_MASK, bits_of, purposes, uniform_of
from league.track.projection import frame_at, signed_gap

EPISODES = np.dtype(
    [
        ("training", np.bool_),  # whether a mistake ends an episode, instead of costing seconds
        ("longest", np.int64),  # steps after which an episode is cut off
        ("all_restart", np.bool_),  # whether every car begins its next episode by itself
        ("restarting", np.uint8),  # otherwise the cars that do; the others are retired
        ("meeting", np.bool_),  # whether cars meet in scenarios instead
        *((item.name, f32) for item in fields(Scenarios)),
        ("longest_s", f32),
    ],
    align=True,
)
"""Settings of episodes."""
_SPOT, _SIDE, _SEED = purposes(211, 214)
_CANDIDATES, _CLEAR = 8, f32(0.8)
_PREFERRED, _LATER = f32(1e9), f32(1e6)
_ZERO, _HALF, _ONE, _TWO = f32(0.0), f32(0.5), f32(1.0), f32(2.0)


def settings(cfg: EnvConfig) -> np.ndarray:
    """Return the record of these settings, shape (1,)."""
    record = np.zeros(1, EPISODES)
    record["training"] = cfg.mode == "training"
    record["longest"] = round(cfg.episode_s * cfg.sim.step_hz)
    record["all_restart"] = cfg.restarting is None
    record["restarting"] = sum(1 << car for car in cfg.restarting or ())
    if cfg.scenarios is not None:
        record["meeting"] = True
        record["longest_s"] = cfg.episode_s
        for item in fields(cfg.scenarios):
            record[item.name] = getattr(cfg.scenarios, item.name)
    return record


@inner
def end_and_begin(done, encounter, cars, obstacles, world, points, course, places, sim, episodes):
    """Begin the next episodes of the cars in the mask `done`; return the mask of those that do."""
    begins = done
    if not episodes.meeting and not episodes.all_restart:
        begins = done & episodes.restarting
        for c in range(len(cars)):
            if ((done & ~begins) >> c) & 1:
                grid.retire(cars[c])
    if begins:
        begin(begins, encounter, cars, obstacles, world, points, course, places, sim, episodes)
        for c in range(len(cars)):
            # A car that begins another episode is to blame for nothing of the last one.
            if (begins >> cars[c].pushed_by) & 1:
                cars[c].pushed_steps = 0
    return begins


@inner
def begin(mask, encounter, cars, obstacles, world, points, course, places, sim, episodes):
    """Begin the next episodes of the cars in a mask."""
    all_begin = mask == (1 << len(cars)) - 1
    if all_begin and len(obstacles) and sim.random_places and world.step > 0:
        # Another seed, and with it other obstacles.
        world.seed = bits_of(world.seed, _SEED, world.step) & SEED_MASK
        grid.place_obstacles(obstacles, world, points, course, places, sim)
    if episodes.meeting:
        scenarios.begin(encounter, cars, obstacles, world, points, course, sim, episodes)
    else:
        _begin_anywhere(mask, cars, obstacles, world, points, course, sim)
    _order(mask, cars, course)
    for c in range(len(cars)):
        if (mask >> c) & 1:
            encode(cars[c], sim)


@inner(allocates=True)
def _begin_anywhere(mask, cars, obstacles, world, points, course, sim):
    """Begin episodes at rest on free stretches of the track."""
    spots = np.empty(len(cars), np.float32)
    _free_spots(mask, cars, obstacles, world, spots, course)
    for c in range(len(cars)):
        if (mask >> c) & 1:
            frame = frame_at(points, course, spots[c])
            across = uniform_of(world.seed, _SIDE, world.step, c) - _HALF
            lateral = across * min(frame.left, frame.right)
            grid.begin_episode(c, cars, world, spots[c], lateral, points, course, sim)


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
    """Draw s of a stretch for each car of a mask: the first of 8 that is clear, or the clearest."""
    for c in range(len(cars)):
        spots[c] = cars[c].s
    for c in range(len(cars)):
        if not (mask >> c) & 1:
            continue
        best, chosen = -_ONE, _ZERO
        for attempt in range(_CANDIDATES):
            s = uniform_of(world.seed, _SPOT, world.step, c, attempt) * course.length
            room = _PREFERRED
            for other in range(len(cars)):
                if other != c:
                    room = min(room, abs(signed_gap(course, spots[other], s)))
            for k in range(len(obstacles)):
                room = min(room, abs(signed_gap(course, obstacles[k].s, s)))
            merit = _PREFERRED - f32(attempt) * _LATER if room >= _CLEAR else room
            if merit > best:
                best, chosen = merit, s
        spots[c] = chosen
