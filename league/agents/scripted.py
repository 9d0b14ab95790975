"""Drivers without a network: they read the truth (the `state` group) and follow a line.

How one drives, at each control step: look along its line; move the targets beside it where others
are in the way; steer for the path through the targets; ask for the speed that its bends and what
is in the way allow.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false
# pyright: reportAttributeAccessIssue=false

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from functools import lru_cache

import numpy as np

from league.agents.driver import actions_from
from league.agents.path import NODE, NODE_GAP, NODES, Path, at, circle, look_ahead, start
from league.agents.steering import STEP_DT, gains, steering_target
from league.agents.traffic import STATE, THING, cover, gather, go_round, largest_speed
from league.envs.state import NEAR_OBSTACLES, NEIGHBOURS
from league.jit import compiled, inner
from league.portable_math import atan, clamp, f32
from league.racing_line.racing_line import center_line, optimal_line
from league.sim.config import CarConfig, SensorConfig
from league.sim.settings import GRAVITY
from league.track.course import Track


@dataclass(frozen=True)
class Style:
    """What makes one line follower differ from another."""

    on_centerline: bool = False
    """Whether its line is the centreline, not the fastest one."""
    pace: float = 1.0
    """Part of the line's speed that is driven."""
    top_speed: float = 99.0
    """Largest speed [m/s]."""
    grip: float = 0.93
    """Part of the tyres' grip that is used on the line and beside it."""
    reserve: float = 0.5
    """Part of that grip kept in hand while driving beside the line."""
    margin: float = 0.03
    """Smallest distance from the fastest line to a border [m]."""
    clearance: float = 0.06
    """Air left between two bodies side by side [m]."""
    edge: float = 0.03
    """Smallest distance from the base to a border while going round something [m]."""
    approach: float = 2.6
    """Driving distance over which a car moves aside before a standing thing [m]."""
    lead: float = 0.3
    """Driving distance over which it then stays aside before coming up to it [m]."""
    braking: float = 3.0
    """Deceleration counted on when something is in the way [m/s^2]."""
    gap: float = 0.1
    """Air left when stuck behind something [m]."""
    freer_side: bool = False
    """Whether it takes the side with more room, instead of the shorter way from the line."""
    waits: bool = False
    """Whether it stays behind other cars; it goes round boxes alone."""
    blocks: bool = False
    """Whether it moves in front of the car behind."""


_STYLE = np.dtype([(one.name, np.float64) for one in fields(Style)])
_CAR = np.dtype([(one.name, np.float64) for one in fields(CarConfig)])
_MEMORY = np.dtype([("steering", np.float64), ("aside", np.float64), ("care", np.float64)])
"""Last steering target [rad], last place beside the line [m], control steps of care left."""

_SMOOTHINGS = 2
_CAREFUL, _CAREFUL_STEPS = 1.0, 45.0
_GROW, _FADE = 0.5, 0.35  # of the path beside the line, for each metre ahead
_SERVO = 0.6  # part of a speed error that the servo makes good within a control step


@lru_cache(maxsize=8)
def _path(track: Track, car: CarConfig, style: Style) -> Path:
    """Make the table of a line once for all cars of a race that want the same."""
    if style.on_centerline:
        return Path.of(center_line(track, car, share=style.grip, top_speed=style.top_speed), track)
    return Path.of(optimal_line(track, car, style.margin, share=style.grip), track)


class LineDriver:
    """Follows a line by preview steering, goes round others, brakes where it cannot."""

    def __init__(self, name: str, track: Track, car: CarConfig, style: Style) -> None:
        """Seek the line of a track and build the tables."""
        self.name, self.sensors = name, SensorConfig()
        self._car, self._path, self._gains = car, _path(track, car, style), gains(car)
        self._records = np.array([astuple(car)], _CAR), np.array([astuple(style)], _STYLE)
        self._memory = np.zeros(0, _MEMORY)

    def reset(self, rows: np.ndarray | None) -> None:
        """Forget the last steering target, the place beside the line and the last penalty."""
        if rows is None:
            self._memory = np.zeros(0, _MEMORY)
        elif len(self._memory):
            self._memory[rows] = np.zeros(1, _MEMORY)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions from the `state` group."""
        return self.drive(observations["state"], 1.0)

    def drive(self, state: np.ndarray, pace: np.ndarray | float) -> np.ndarray:
        """Return actions from the `state` group, at a part of the own pace, one or for each row."""
        rows = np.ascontiguousarray(state, np.float64).view(STATE)[:, 0]
        paces = np.full(len(rows), pace, np.float64)
        if len(self._memory) != len(rows):
            self._memory = np.zeros(len(rows), _MEMORY)
        controls = np.empty((2, len(rows)))
        _drive(rows, paces, self._path, self._gains, *self._records, self._memory, controls)
        return actions_from(*controls, self._car)


@compiled
def _drive(states, paces, path, gain_table, cars, styles, memories, controls):
    """Write the steering targets [rad] and speeds to ask for [m/s] of all rows, (2, num_rows)."""
    road, things = np.empty(NODES, NODE), np.empty(NEIGHBOURS + NEAR_OBSTACLES, THING)
    car, style = cars[0], styles[0]
    for row in range(len(states)):
        state, memory = states[row], memories[row]
        speed = max(state.speed_ahead, 0.0)
        look_ahead(path, state.s, road)
        limit = _around(state, things, road, style, memory)
        first = road[0]
        # Metres of the path beside the line for each metre of it, and the angle between them.
        (ax, ay), (bx, by) = start(road, 0.0), start(road, 1.0)
        longer = math.sqrt((bx * bx + by * by) / (ax * ax + ay * ay))
        along_line = speed / clamp(longer, 0.4, 2.5)
        turned = atan(f32((ax * by - ay * bx) / (ax * bx + ay * by)))
        lateral = clamp(state.lateral - first.lateral - first.aside, -0.2, 0.2)
        heading = clamp(state.heading_error - first.heading - turned, -0.8, 0.8)
        errors = (lateral, heading, state.speed_left, state.yaw_rate, memory.steering)
        target = steering_target(gain_table, (speed, errors), road, max(along_line, 0.3))
        # More than this slides the front tyres and turns no tighter.
        tightest = car.grip * GRAVITY / max(speed, 0.5) ** 2
        most = min(atan(f32(car.wheelbase * tightest)) + 0.12, car.max_steering)
        target = clamp(target, -most, most)
        controls[0, row] = memory.steering = 0.0 if state.frozen else target
        controls[1, row] = _speed(speed, road, min(limit, style.top_speed), paces[row], car, style)
        memory.care = _CAREFUL_STEPS if state.frozen else max(memory.care - 1.0, 0.0)
        memory.aside = at(road.aside, along_line * STEP_DT)


@inner
def _around(state, things, road, style, memory):
    """Write where to drive and how that bends; return the largest speed because of others [m/s]."""
    things = things[: gather(state, things)]
    for node in road:
        node.target = node.lateral
    if style.blocks:
        cover(state, road)
    go_round(state.lateral, things, road, style)
    limit = largest_speed(state.lateral, things, road, style)
    for thing in things:
        # Whoever has just stood a penalty passes the next body slowly.
        if memory.care > 0.0 and -0.4 < thing.gap < 1.5:
            limit = min(limit, _CAREFUL)
    for k in range(NODES):
        # From where the last step left it, the path leaves the line no faster than a car can
        # follow, and comes back more slowly, because what was passed is no longer told.
        aside, held = road[k].target - road[k].lateral, memory.aside
        grow, fade = 0.03 + _GROW * k * NODE_GAP, 0.02 + _FADE * k * NODE_GAP
        down = fade if held > 0.0 and aside >= 0.0 else grow
        up = fade if held < 0.0 and aside <= 0.0 else grow
        road[k].aside = clamp(aside, held - down, held + up)
    for _ in range(_SMOOTHINGS):
        before = road[0].aside
        for k in range(1, NODES - 1):
            here = road[k].aside
            road[k].aside = (before + 2.0 * here + road[k + 1].aside) / 4.0
            before = here
    for k in range(NODES):
        # Coarse nodes tell bends badly, but the same measure of both tells their difference well.
        inside = min(max(k, 1), NODES - 2)
        extra = circle(road, inside, 1.0) - circle(road, inside, 0.0)
        road[k].bend = road[k].curvature + extra
    return limit


@inner
def _speed(speed, road, limit, pace, car, style):
    """Return the speed to ask for [m/s]."""
    allowed = 0.0
    after = 1e9
    for k in range(NODES - 1, -1, -1):
        node = road[k]
        # Beside the line the path changes at every step: keep grip and speed in hand.
        share = 1.0 - style.reserve * min(abs(node.aside) / 0.1, 1.0)
        corner = style.grip * car.grip * GRAVITY * share / max(abs(node.bend), 1e-3)
        most = (pace * style.pace) ** 2 * min(node.speed * node.speed * share, corner)
        after = min(most, after + 1.6 * car.max_braking * NODE_GAP)
        node.target = math.sqrt(after)
    allowed = at(road.target, speed * (STEP_DT + car.latency_s))
    target = min(allowed, limit)
    # Drive and brakes take grip that a bend needs: leave it its share.
    spare = _spare(speed * speed * max(abs(road[0].bend), abs(road[1].bend)), car)
    faster = speed + min(spare, car.max_acceleration) * STEP_DT
    slower = speed - min(spare, car.max_braking) * STEP_DT
    target = max(min(target, faster), slower)
    return speed + (target - speed) / _SERVO


@inner
def _spare(cornering, car):
    """Return the drive or braking that tyres can give beside cornering [m/s^2]; see pace.py."""
    most, transfer = car.grip * GRAVITY, 2.0 * car.mass_height / car.wheelbase / GRAVITY
    left = max(most * most - cornering * cornering, 0.05 * most * most)
    square, half = 1.0 - (most * transfer) ** 2, most * most * transfer
    return (math.sqrt(half * half + square * left) - half) / square
