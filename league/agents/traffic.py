"""How a scripted driver gets past others: which side, how far aside, and when to brake instead."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial

import torch
from torch import Tensor

from league.agents.path import Horizon, read_nodes
from league.envs.state import INDEX, NEAR_OBSTACLES, NEIGHBOURS

CAR_REACH = 0.40
"""Two cars whose bases are nearer than this along the track may touch [m]."""
BOX_REACH = 0.42
"""As CAR_REACH, for a car and a box [m]."""
CAR_WIDTHS = 0.196
"""Half of a car's width and half of another's [m]."""
BOX_WIDTHS = 0.248
"""Half of a car's width and half of a box's [m]."""

CORNERS = 0.035
"""Half of the squared half lengths of a car and a box, together [m^2]."""

MOST_ROOM = 0.4
"""More room than this beside a body counts no more [m]."""

_FREE = 99.0
"""Largest speed where nothing is in the way [m/s]."""


@dataclass(frozen=True)
class Manners:
    """How a driver treats others."""

    clearance: float = 0.06
    """Air left between two bodies side by side [m]."""
    share: float = 0.5
    """Part of the room left beyond the clearance that is also kept."""
    edge: float = 0.03
    """Smallest distance from the base to a border while going round something [m]."""
    approach: float = 2.6
    """Driving distance over which a car moves aside before a standing thing [m]."""
    leave: float = 0.7
    """Driving distance over which it comes back behind it [m]."""
    lead: float = 0.3
    """Driving distance over which it then stays aside before coming up to it [m]."""
    braking: float = 3.0
    """Deceleration counted on when something is in the way [m/s^2]."""
    gap: float = 0.1
    """Air left when stuck behind something [m]."""
    freer_side: bool = False
    """Take the side with more room, instead of the shorter way from the line."""


@dataclass(frozen=True, eq=False)
class Others:
    """Cars and obstacles near each car, (num_rows, things)."""

    gap: Tensor
    """Ahead along the track [m]."""
    lateral: Tensor
    """To the left of the centreline [m]."""
    speed: Tensor
    """Along the track [m/s]."""
    present: Tensor
    """Bool."""
    reach: Tensor
    """Distance along the track within which bodies may touch [m], (things,)."""
    is_box: Tensor
    """Bool, (things,)."""
    widths: Tensor
    """Distance across the track within which bodies touch [m], (things,)."""

    @cached_property
    def somewhere(self) -> list[int]:
        """Columns that hold something near any row's car; the others change nothing."""
        return self.present.any(dim=0).nonzero()[:, 0].tolist()

    @classmethod
    def told(cls, state: Tensor) -> Others:
        """Read them from the `state` group."""
        cars = partial(_columns, state, "car", NEIGHBOURS)
        boxes = partial(_columns, state, "obstacle", NEAR_OBSTACLES)
        # Whoever stands a penalty is a ghost: one drives through it.
        there = (cars("present") > 0.5) & (cars("frozen") < 0.5)
        speed = torch.clamp(cars("speed"), min=0.0)
        return cls(
            gap=torch.cat([cars("gap"), boxes("gap")], dim=1),
            lateral=torch.cat([cars("lateral"), boxes("lateral")], dim=1),
            speed=torch.cat([speed, torch.zeros_like(boxes("gap"))], dim=1),
            present=torch.cat([there, boxes("present") > 0.5], dim=1),
            reach=state.new_tensor([CAR_REACH] * NEIGHBOURS + [BOX_REACH] * NEAR_OBSTACLES),
            is_box=state.new_tensor([0.0] * NEIGHBOURS + [1.0] * NEAR_OBSTACLES) > 0.5,
            widths=state.new_tensor([CAR_WIDTHS] * NEIGHBOURS + [BOX_WIDTHS] * NEAR_OBSTACLES),
        )


def _columns(state: Tensor, things: str, count: int, what: str) -> Tensor:
    """Return what the `state` group tells of each of its cars or obstacles, (num_rows, count)."""
    first, second = (INDEX[f"{things}_{rank}_{what}"] for rank in (0, 1))
    step = second - first
    return state[:, first : first + count * step : step]


@dataclass(frozen=True, eq=False)
class Plan:
    """What the others make of the line ahead."""

    lateral: Tensor
    """Where to drive, left of the centreline [m], (num_rows, NODES)."""
    speed: Tensor
    """Largest speed now, because of what is in the way [m/s], (num_rows,)."""


def plan(
    others: Others,
    road: Horizon,
    wished: Tensor,
    lateral: Tensor,
    speed: Tensor,
    manners: Manners,
) -> Plan:
    """Move the wished places aside where another body will be, and brake where that fails.

    A moving car is met where both will be: at node distance d it is `gap - d (1 - its speed / own)`
    ahead, so that a car of nearly our own speed is passed over a long stretch.

    Args:
        others: who is near.
        road: the line ahead.
        wished: where to drive without them, left of the centreline [m], (num_rows, NODES).
        lateral: where the car is [m], (num_rows,).
        speed: its speed ahead [m/s], (num_rows,).
        manners: distances to keep.
    """
    low, high = manners.edge - road.right, road.left - manners.edge
    low, high = torch.minimum(low, high), torch.maximum(low, high)
    own = torch.clamp(speed, min=1.0)
    # In a bend the corners of two long bodies stand out towards each other.
    corners = CORNERS * road.curvature.abs()
    target = wished
    # Far ones first, so that the nearest has the last word; slots of the state are by nearness.
    for thing in reversed(others.somewhere):
        closing = torch.clamp(1.0 - others.speed[:, thing] / own, min=0.08)
        apart = others.widths[thing] + manners.clearance + corners
        weight = _weight(others, thing, road, closing, manners)
        if not bool((weight > 0).any()):
            continue  # nothing to add for any row, to the same bits
        aside = _aside(others, thing, road, wished, lateral, closing, apart, low, high, manners)
        target = target + (aside - target) * weight
    # The line itself may run nearer to a border.
    target = torch.maximum(target, torch.minimum(low, road.lateral))
    target = torch.minimum(target, torch.maximum(high, road.lateral))
    return Plan(target, largest_speed(others, target, lateral, own, manners))


def _weight(others: Others, thing: int, road: Horizon, closing: Tensor, manners: Manners) -> Tensor:
    """Return how much a thing counts at each node, 0 to 1, smooth; (num_rows, NODES)."""
    closing = closing.unsqueeze(1)
    apart = others.gap[:, thing : thing + 1] - road.ahead * closing
    # Behind it (apart < 0) the way back may be shorter than the way out.
    lead = torch.where(apart > 0, manners.lead * closing, 0.0)
    outside = torch.clamp(apart.abs() - others.reach[thing] - lead, min=0.0)
    ramp = torch.where(apart > 0, manners.approach * closing, manners.leave * closing)
    near = torch.clamp(1.0 - outside / torch.clamp(ramp, min=0.25), 0.0, 1.0)
    smooth = near * near * (3.0 - 2.0 * near)
    return torch.where(others.present[:, thing : thing + 1], smooth, 0.0)


def _aside(
    others: Others,
    thing: int,
    road: Horizon,
    wished: Tensor,
    lateral: Tensor,
    closing: Tensor,
    apart: Tensor,
    low: Tensor,
    high: Tensor,
    manners: Manners,
) -> Tensor:
    """Return the wished places pushed clear of a thing, on the better side; (num_rows, NODES)."""
    place = others.lateral[:, thing : thing + 1]
    gap = others.gap[:, thing : thing + 1]
    meeting = torch.clamp(gap / closing.unsqueeze(1), min=0.0)
    needed = read_nodes(apart, meeting)
    room_left = read_nodes(high, meeting) - (place + needed)
    room_right = (place - needed) - read_nodes(low, meeting)
    # Beside it, or nearly, the side is the one the car is on.
    here = torch.where(gap < 1.2, lateral.unsqueeze(1), read_nodes(wished, meeting))
    if manners.freer_side:
        here = torch.where(gap < 0.8, here, 0.0)
        better_left = torch.where(gap < 0.8, here - place, room_left - room_right) >= 0
    else:
        better_left = here >= place
    fits_left, fits_right = room_left >= 0, room_right >= 0
    go_left = torch.where(fits_left == fits_right, better_left, fits_left)
    beside = gap.abs() < others.reach[thing]
    go_left = torch.where(beside, lateral.unsqueeze(1) >= place, go_left)
    extra_left = manners.share * torch.clamp(room_left, 0.0, MOST_ROOM)
    extra_right = manners.share * torch.clamp(room_right, 0.0, MOST_ROOM)
    pushed_left = torch.maximum(wished, place + apart + extra_left)
    pushed_right = torch.minimum(wished, place - apart - extra_right)
    return torch.where(go_left, pushed_left, pushed_right)


def largest_speed(
    others: Others, target: Tensor, lateral: Tensor, own: Tensor, manners: Manners
) -> Tensor:
    """Return the speed from which the car can still stop closing in on what is in its way [m/s].

    Args:
        others: who is near.
        target: where the car will drive, left of the centreline [m], (num_rows, NODES).
        lateral: where it is [m], (num_rows,).
        own: its speed, at least 1 [m/s], (num_rows,).
        manners: distances to keep.
    """
    if not others.somewhere:
        return torch.full_like(own, _FREE)
    closing = torch.clamp(1.0 - others.speed / own.unsqueeze(1), min=0.08)
    before = torch.clamp(others.gap - others.reach, min=0.0)
    meeting = before / closing
    off_plan = (lateral - target[:, 0]).unsqueeze(1) / (1.0 + (meeting / 0.5) ** 2)
    apart = (read_nodes(target, meeting) + off_plan - others.lateral).abs()
    in_way = others.present & (others.gap > 0.1) & (apart < others.widths + 0.02)
    free = torch.clamp(before - manners.gap, min=0.0)
    limit = torch.sqrt(others.speed**2 + 2.0 * manners.braking * free)
    # Nothing left: fall behind a little.
    limit = torch.where(free > 0, limit, 0.7 * others.speed)
    return torch.where(in_way, limit, _FREE).amin(dim=1)
