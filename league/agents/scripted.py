"""Drivers without a network: they read the truth (the `state` group) and follow a line.

How one drives, at each control step: look along its line; move the targets off it where others
are in the way; steer for the path through the targets; ask for the speed that its bends and what
is in the way allow.
"""

# Records have the attributes of their fields.
# pyright: reportAttributeAccessIssue=false

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, fields
from functools import lru_cache

import numpy as np

from league.agents.steering import (
    NODE,
    NODE_GAP,
    NODES,
    STEP_DT,
    at,
    circle,
    gains,
    look_ahead,
    slope,
    steering_target,
    table,
)
from league.envs.actions import encode
from league.envs.state import FIELDS, INDEX, LOOKAHEADS, NEAR_OBSTACLES, NEIGHBOURS
from league.jit import compiled, inner
from league.portable_math import atan, clamp, f32
from league.racing_line.racing_line import center_line, optimal_line
from league.racing_line.search import spare_grip
from league.sim.config import CarConfig, SensorConfig
from league.sim.settings import GRAVITY
from league.track.track import Track, TrackSet


@dataclass(frozen=True)
class Style:
    """What makes one line follower differ from another."""

    on_centerline: bool = False  # whether its line is the centreline, not the fastest one
    pace: float = 1.0  # part of the line's speed that is driven
    top_speed: float = 99.0  # largest speed [m/s]
    grip: float = 0.93  # part of the tyres' grip that is used on the line and off it
    reserve: float = 0.5  # part of that grip kept in hand while driving off the line
    margin: float = 0.03  # smallest distance from the fastest line to a border [m]
    clearance: float = 0.06  # air left between two bodies side by side [m]
    # smallest distance from the base to a border while going round something [m]
    edge: float = 0.03
    # driving distance over which a car moves aside before a standing thing [m]
    approach: float = 2.6
    lead: float = 0.3  # driving distance over which it then stays aside before coming up to it [m]
    braking: float = 3.0  # deceleration counted on when something is in the way [m/s^2]
    gap: float = 0.1  # air left when stuck behind something [m]
    # whether it takes the side with more room, instead of the shorter way from the line
    freer_side: bool = False
    waits: bool = False  # whether it stays behind other cars; it goes round boxes alone
    blocks: bool = False  # whether it moves in front of the car behind


_STYLE = np.dtype([(one.name, np.float64) for one in fields(Style)])
_CAR = np.dtype([(one.name, np.float64) for one in fields(CarConfig)])
_MEMORY = np.dtype([("steering", np.float64), ("aside", np.float64)])
"""Last steering target [rad] and last distance from the line [m]."""

_GROW, _FADE = 0.5, 0.35  # of the path away from the line, for each metre ahead
_BRAKING = 0.8  # part of the brakes that is counted on
_MOST_CORNERING = math.sqrt(0.95)  # part of the grip; a twentieth of its square is left to drive
_SERVO = 0.6  # part of a speed error that the servo makes good within a control step

_RIVAL = np.dtype([(name, np.float64) for name in ("present", "gap", "lateral", "speed", "frozen")])
_BOX = np.dtype([(name, np.float64) for name in ("present", "gap", "lateral")])
_STATE = np.dtype(
    [
        *((name, np.float64) for name in FIELDS[: INDEX["progress"] + 1]),
        ("curvature", np.float64, len(LOOKAHEADS)),
        ("cars", _RIVAL, NEIGHBOURS),
        ("obstacles", _BOX, NEAR_OBSTACLES),
    ]
)
"""A row of the `state` group; league/envs/state.py has the meaning."""
_THING = np.dtype(
    [(name, np.float64) for name in ("gap", "lateral", "speed", "closing", "reach", "width", "box")]
)
"""A car or a box: distance ahead [m], place left of the centreline [m] and speed [m/s] along the
track, the share of its distance that is closed while the car drives there, the distances along and
across the track within which bodies may touch [m], and whether it is a box."""

_CAR_REACH, _BOX_REACH = 0.40, 0.42
_CAR_WIDTH, _BOX_WIDTH = 0.196, 0.248
_CORNERS = 0.035  # half of the squared half lengths of a car and a box, together [m^2]
_LEAVE = 0.7  # driving distance over which a car comes back behind a body [m]
_SHARE = 0.5  # part of the room left beyond the clearance that is also kept
_MOST_ROOM = 0.4  # more room than this next to a body counts no more [m]
_SLOWEST = 1.0  # a car that stands is planned for as if it drove so [m/s]
_FREE = 99.0


@lru_cache(maxsize=8)
def _line(track: Track, car: CarConfig, style: Style) -> np.ndarray:
    """Make the table of a line once for all cars of a race that want the same."""
    if style.on_centerline:
        return table(center_line(track, car, share=style.grip, top_speed=style.top_speed))
    return table(optimal_line(track, car, style.margin, share=style.grip))


class LineDriver:
    """Follows a line by preview steering, goes round others, brakes where it cannot."""

    def __init__(self, name: str, track: Track, car: CarConfig, style: Style) -> None:
        """Compute the line of a track and build the tables."""
        self.name, self.sensors = name, SensorConfig()
        tracks, self._car = TrackSet(track), car
        self._settings = (
            *(_line(track, car, style), tracks.points, tracks.courses, gains(car)),
            *(np.array([astuple(car)], _CAR), np.array([astuple(style)], _STYLE)),
        )
        self._memory = np.zeros(0, _MEMORY)

    def reset(self, rows: np.ndarray | None) -> None:
        """Forget the last steering target and the distance from the line."""
        if rows is None:
            self._memory = np.zeros(0, _MEMORY)
        elif len(self._memory):
            self._memory[rows] = np.zeros(1, _MEMORY)

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions from the `state` group."""
        rows = np.ascontiguousarray(observations["state"], np.float64).view(_STATE)[:, 0]
        if len(self._memory) != len(rows):
            self._memory = np.zeros(len(rows), _MEMORY)
        controls = np.empty((2, len(rows)))
        _drive(rows, self._memory, controls, *self._settings)
        return encode(controls[0], controls[1], self._car)


@compiled(allocates=True)
def _drive(states, memories, controls, line, points, courses, gains, cars, styles):
    """Write the steering targets [rad] and speeds to ask for [m/s] of all rows, (2, num_rows)."""
    road, things = np.empty(NODES, NODE), np.empty(NEIGHBOURS + NEAR_OBSTACLES, _THING)
    car, style = cars[0], styles[0]
    for row in range(len(states)):
        state, memory = states[row], memories[row]
        speed = max(state.speed_ahead, 0.0)
        look_ahead(line, points, courses[0], state.s, road)
        for node in road:
            node.target = node.lateral
        if style.blocks:
            _cover(state, road)
        near = things[: _gather(state, things)]
        _go_round(state.lateral, near, road, style)
        limit = min(_largest_speed(state.lateral, near, road, style), style.top_speed)
        _leave_line(road, memory.aside)
        # Metres of the path for each metre of the line, and the angle between them.
        ax, ay, bx, by = slope(road.x), slope(road.y), slope(road.path_x), slope(road.path_y)
        longer = clamp(math.sqrt((bx * bx + by * by) / (ax * ax + ay * ay)), 0.4, 2.5)
        turned = atan(f32((ax * by - ay * bx) / (ax * bx + ay * by)))
        lateral = clamp(state.lateral - road[0].lateral - road[0].aside, -0.2, 0.2)
        heading = clamp(state.heading_error - road[0].heading - turned, -0.8, 0.8)
        errors = (lateral, heading, state.speed_left, state.yaw_rate, memory.steering)
        target = steering_target(gains, speed, errors, road, max(speed / longer, 0.3))
        # More than this slides the front tyres and turns no tighter.
        tightest = car.grip * GRAVITY / max(speed, 0.5) ** 2
        most = min(atan(f32(car.wheelbase * tightest)) + 0.12, car.max_steering)
        target = clamp(target, -most, most)
        controls[0, row] = memory.steering = 0.0 if state.frozen else target
        controls[1, row] = _speed(speed, road, limit, car, style)
        memory.aside = at(road.aside, speed / longer * STEP_DT)


@inner
def _leave_line(road, held):
    """Write a path from the distance from the line that was held last towards the targets."""
    for k in range(NODES):
        # It leaves the line no faster than a car can follow, and comes back more slowly, because
        # what was passed is no longer in the observations.
        node, aside = road[k], road[k].target - road[k].lateral
        grow, fade = 0.03 + _GROW * k * NODE_GAP, 0.02 + _FADE * k * NODE_GAP
        down = fade if held > 0.0 and aside >= 0.0 else grow
        up = fade if held < 0.0 and aside <= 0.0 else grow
        node.aside = clamp(aside, held - down, held + up)
        node.path_x = node.x + node.aside * node.normal_x
        node.path_y = node.y + node.aside * node.normal_y
    for k in range(NODES):
        # Coarse nodes give bends badly, but the same measure of both gives their difference well.
        inside = min(max(k, 1), NODES - 2)
        extra = circle(road.path_x, road.path_y, inside) - circle(road.x, road.y, inside)
        road[k].bend = road[k].curvature + extra


@inner
def _speed(speed, road, limit, car, style):
    """Return the speed to ask for [m/s]."""
    squared = np.inf
    for node in road[::-1]:
        # Off the line the path changes at every step: keep grip and speed in hand.
        share = 1.0 - style.reserve * min(abs(node.aside) / 0.1, 1.0)
        corner = style.grip * car.grip * GRAVITY * share / max(abs(node.bend), 1e-3)
        most = style.pace**2 * min(node.speed * node.speed * share, corner)
        squared = min(most, squared + 2.0 * _BRAKING * car.max_braking * NODE_GAP)
        node.speed = math.sqrt(squared)
    target = min(at(road.speed, speed * (STEP_DT + car.latency_s)), limit)
    # Drive and brakes take grip that a bend needs: leave it its share.
    cornering, most = speed * speed * max(abs(road[0].bend), abs(road[1].bend)), car.grip * GRAVITY
    transfer = 2.0 * car.mass_height / car.wheelbase / GRAVITY
    spare = spare_grip(min(cornering, _MOST_CORNERING * most), most, transfer)
    faster = speed + min(spare, car.max_acceleration) * STEP_DT
    slower = speed - min(spare, car.max_braking) * STEP_DT
    return speed + (clamp(target, slower, faster) - speed) / _SERVO


# Getting past others -------------------------------------------------------------------------


@inner
def _gather(state, things):
    """Write the cars (no ghosts) and boxes near a car, nearest first; return how many."""
    own, count = max(state.speed_ahead, _SLOWEST), 0
    for car in state.cars:
        if car.present and not car.frozen:
            speed = max(car.speed, 0.0)
            thing = things[count]
            thing.gap, thing.lateral, thing.speed, thing.box = car.gap, car.lateral, speed, 0.0
            thing.reach, thing.width = _CAR_REACH, _CAR_WIDTH
            thing.closing = max(1.0 - speed / own, 0.08)
            count += 1
    for box in state.obstacles:
        if box.present:
            thing = things[count]
            thing.gap, thing.lateral, thing.speed, thing.box = box.gap, box.lateral, 0.0, 1.0
            thing.reach, thing.width, thing.closing = _BOX_REACH, _BOX_WIDTH, 1.0
            count += 1
    return count


@inner
def _cover(state, road):
    """Aim in front of the nearest free car behind, if it is near."""
    for car in state.cars:
        # Full weight from half a metre to a metre and a half behind, fading out at two and a half.
        weight = clamp(2.5 + car.gap, 0.0, 1.0) * clamp((-0.4 - car.gap) / 0.2, 0.0, 1.0)
        if car.present and not car.frozen and weight > 0.0:
            for node in road:
                place = clamp(car.lateral, 0.1 - node.right, node.left - 0.1)
                node.target += (place - node.target) * weight
            return


@inner(allocates=True)
def _go_round(lateral, things, road, style):
    """Move the targets aside where another body will be.

    A moving body is met where both will be: at distance d it is `gap - d (1 - its speed / own)`
    ahead, so that a car of nearly the own speed is passed over a long stretch.
    """
    wished = road.target.copy()
    # Far ones first, so that the nearest has the last word.
    for thing in things[::-1]:
        if style.waits and not thing.box:
            continue
        meeting = max(thing.gap / thing.closing, 0.0)
        planned = at(wished, meeting)
        # Within reach the side is the one the car is on.
        if thing.gap < 1.2:
            planned = lateral
        apart = thing.width + style.clearance + _CORNERS * abs(at(road.curvature, meeting))
        room_left = at(road.left, meeting) - style.edge - (thing.lateral + apart)
        room_right = (thing.lateral - apart) + at(road.right, meeting) - style.edge
        left = planned >= thing.lateral
        if style.freer_side and thing.gap >= 0.8:
            left = room_left >= room_right
        if (room_left >= 0.0) != (room_right >= 0.0):
            left = room_left >= 0.0
        if abs(thing.gap) < thing.reach:
            left = lateral >= thing.lateral
        extra = _SHARE * clamp(room_left if left else room_right, 0.0, _MOST_ROOM)
        for k in range(NODES):
            # In a bend the corners of two long bodies stand out towards each other.
            apart = thing.width + style.clearance + _CORNERS * abs(road[k].curvature) + extra
            aside = max(wished[k], thing.lateral + apart)
            if not left:
                aside = min(wished[k], thing.lateral - apart)
            road[k].target += (aside - road[k].target) * _weight(thing, road[k].ahead, style)
    for node in road:
        # The line itself may run nearer to a border.
        node.target = max(node.target, min(style.edge - node.right, node.lateral))
        node.target = min(node.target, max(node.left - style.edge, node.lateral))


@inner
def _weight(thing, ahead, style):
    """Return how much a thing counts at a distance, from 0 to 1, smoothly."""
    apart = thing.gap - ahead * thing.closing
    if apart > 0.0:
        outside = apart - thing.reach - style.lead * thing.closing
        ramp = style.approach * thing.closing
    else:  # the way back may be shorter than the way out
        outside, ramp = -apart - thing.reach, _LEAVE * thing.closing
    near = clamp(1.0 - max(outside, 0.0) / max(ramp, 0.25), 0.0, 1.0)
    return near * near * (3.0 - 2.0 * near)


@inner
def _largest_speed(lateral, things, road, style):
    """Return the speed from which the car can still stop closing in on what is in its way [m/s]."""
    most = _FREE
    for thing in things:
        before = max(thing.gap - thing.reach, 0.0)
        meeting = before / thing.closing
        off_plan = (lateral - road[0].target) / (1.0 + meeting * meeting / 0.25)
        apart = abs(at(road.target, meeting) + off_plan - thing.lateral)
        if thing.gap > 0.1 and apart < thing.width + 0.02:
            free = before - style.gap
            if free > 0.0:
                limit = math.sqrt(thing.speed * thing.speed + 2.0 * style.braking * free)
            else:  # fall behind a little
                limit = 0.7 * thing.speed
            most = min(most, limit)
    return most
