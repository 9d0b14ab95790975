"""Compiled: how a scripted driver gets past others: which side, how far aside, when to brake."""

import math

import numpy as np

from league.agents.steering import NODES, at
from league.envs.state import FIELDS, INDEX, LOOKAHEADS, NEAR_OBSTACLES, NEIGHBOURS
from league.jit import inner
from league.portable_math import clamp

RIVAL = np.dtype([(name, np.float64) for name in ("present", "gap", "lateral", "speed", "frozen")])
BOX = np.dtype([(name, np.float64) for name in ("present", "gap", "lateral")])
STATE = np.dtype(
    [
        *((name, np.float64) for name in FIELDS[: INDEX["progress"] + 1]),
        ("curvature", np.float64, len(LOOKAHEADS)),
        ("cars", RIVAL, NEIGHBOURS),
        ("obstacles", BOX, NEAR_OBSTACLES),
    ]
)
"""A row of the `state` group; league/envs/state.py has the meaning."""
THING = np.dtype(
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


@inner
def gather(state, things):
    """Write the cars and boxes near a car into THING records, the nearest first of each kind.

    Returns:
        Their number. A car that stands a penalty is a ghost and does not count.
    """
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
def cover(state, road):
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
def go_round(lateral, things, road, style):
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
def largest_speed(lateral, things, road, style):
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
