"""Drivers without a network; they read the truth (the `state` group) and never learn."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from league.agents.driver import actions_from
from league.agents.path import NODE_GAP, NODES, Horizon, Path, Place, read_nodes
from league.agents.steering import STEP_DT, STEPS, Errors, PreviewSteering
from league.agents.traffic import Manners, Others, largest_speed, plan
from league.envs.state import INDEX, NEIGHBOURS
from league.racing_line.racing_line import RacingLine, center_line, optimal_line
from league.racing_line.speed_profile import Limits
from league.sim.config import CarConfig, SensorConfig
from league.sim.settings import GRAVITY
from league.track.course import Track

_SMOOTHINGS = 2
_SLOWLY = Manners(clearance=0.08, edge=0.05, approach=1.5, lead=0.4, braking=1.5, gap=0.3)
_CAREFUL, _CAREFUL_STEPS = 1.0, 45.0
_GROW, _FADE = 0.5, 0.35
_SERVO = 0.6
"""Part of a speed error that the servo makes good within a control step."""


@dataclass(frozen=True)
class Style:
    """What makes one line follower differ from another."""

    pace: float = 1.0
    """Part of the line's speed that is driven."""
    grip: float = 0.95
    """Part of the tyres' grip that is used on the line and beside it."""
    reserve: float = 0.5
    """Part of that grip kept in hand while driving beside the line."""
    margin: float = 0.0
    """Smallest distance from the line to a border [m]."""
    manners: Manners = field(default_factory=Manners)
    """How it treats others."""
    blocks: bool = False
    """Whether it moves in front of the car behind."""


@lru_cache(maxsize=8)
def _line(track: Track, car: CarConfig, margin: float, grip: float) -> RacingLine:
    """Seek a line once for all cars of a race that want the same."""
    return optimal_line(track, car, margin, share=grip)


class LineDriver:
    """Follows the fastest line by preview steering, goes round others, brakes where it cannot."""

    def __init__(
        self,
        name: str,
        track: Track,
        car: CarConfig,
        style: Style,
        *,
        device: torch.device | str = "cpu",
    ) -> None:
        """Seek the line of a track and build the tables, on the device of the worlds."""
        self.name, self.sensors = name, SensorConfig()
        line = _line(track, car, style.margin, style.grip)
        self._car, self._style = car, style
        self._pace: float | Tensor = style.pace
        self._path = Path.of(line, track, device=device)
        self._steering = PreviewSteering.of(car, device=device)
        self._transfer = Limits.of(car).transfer
        self._grip = style.grip * car.grip * GRAVITY
        self._target = torch.zeros(0)
        self._shift = torch.zeros(0)
        self._care = torch.zeros(0)

    def reset(self, rows: np.ndarray | None) -> None:
        """Forget the last steering target, the shift beside the line and the last penalty."""
        if rows is None:
            self._target = self._shift = self._care = torch.zeros(0)
        elif len(self._target):
            # Copies: what inference mode made cannot be written to outside of it.
            kept = [memory.clone() for memory in (self._target, self._shift, self._care)]
            for memory in kept:
                memory[rows] = 0.0
            self._target, self._shift, self._care = kept

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions from the `state` group."""
        state = torch.tensor(np.asarray(observations["state"]))
        if len(self._target) != len(state):
            self._target = self._shift = self._care = torch.zeros_like(state[:, 0])
        place = self._path.beside(state[:, INDEX["s"]].contiguous())
        road = self._path.ahead_of(place)
        speed = torch.clamp(state[:, INDEX["speed_ahead"]], min=0.0)
        shift, limit = self._around(state, road, speed)
        beside = _Beside.of(road, shift)
        pace = speed / beside.longer
        steering = self._steer(state, place, shift, beside, speed, pace)
        asked = self._drive(road, shift, beside.bends, speed, limit)
        frozen = state[:, INDEX["frozen"]] > 0
        self._target = torch.where(frozen, 0.0, steering)
        self._care = torch.where(frozen, _CAREFUL_STEPS, torch.clamp(self._care - 1.0, min=0.0))
        self._shift = read_nodes(shift, (pace * STEP_DT).unsqueeze(1))[:, 0]
        return actions_from(self._target, asked, self._car)

    def _around(self, state: Tensor, road: Horizon, speed: Tensor) -> tuple[Tensor, Tensor]:
        """Return how far beside the line to drive at each node, and the largest speed now."""
        others = Others.told(state)
        wished = _mirrored(state, road, self._style.manners) if self._style.blocks else road.lateral
        lateral = state[:, INDEX["lateral"]].contiguous()
        planned = plan(others, road, wished, lateral, speed, self._style.manners)
        shift = planned.lateral - road.lateral
        limit = planned.speed
        # Whoever has just stood a penalty passes the next body slowly.
        near = others.present & (others.gap > -0.4) & (others.gap < 1.5)
        careful = (self._care > 0) & near.any(dim=1)
        limit = torch.where(careful, torch.clamp(limit, max=_CAREFUL), limit)
        # From where the last step left it, a shift grows no faster than a car can follow, and fades
        # more slowly, because what was passed is no longer told.
        held = self._shift.unsqueeze(1)
        grow, fade = 0.03 + _GROW * self._path.nodes, 0.02 + _FADE * self._path.nodes
        down = torch.where((held > 0) & (shift >= 0), fade, grow)
        up = torch.where((held < 0) & (shift <= 0), fade, grow)
        shift = torch.minimum(torch.maximum(shift, held - down), held + up)
        for _ in range(_SMOOTHINGS):
            inner = (shift[:, :-2] + 2.0 * shift[:, 1:-1] + shift[:, 2:]) / 4.0
            shift = torch.cat([shift[:, :1], inner, shift[:, -1:]], dim=1)
        return shift, limit

    def _steer(
        self,
        state: Tensor,
        place: Place,
        shift: Tensor,
        beside: _Beside,
        speed: Tensor,
        pace: Tensor,
    ) -> Tensor:
        """Return the steering target [rad]; pace is the speed counted along the line [m/s]."""
        aside = state[:, INDEX["lateral"]] - place.lateral - shift[:, 0]
        heading = state[:, INDEX["heading_error"]] - place.heading - beside.turned
        steps = torch.arange(STEPS, dtype=torch.float32, device=state.device) + 0.5
        ahead = torch.clamp(pace, min=0.3).unsqueeze(1) * (steps * STEP_DT)
        errors = Errors(
            lateral=torch.clamp(aside, -0.2, 0.2),
            heading=torch.clamp(heading, -0.8, 0.8),
            speed=speed,
            speed_left=state[:, INDEX["speed_left"]],
            yaw_rate=state[:, INDEX["yaw_rate"]],
            steering=self._target,
        )
        target = self._steering.target(errors, read_nodes(beside.bends, ahead))
        # More than this slides the front tyres and turns no tighter.
        car = self._car
        tightest = car.grip * GRAVITY / torch.clamp(speed, min=0.5) ** 2
        most = torch.clamp(torch.atan(car.wheelbase * tightest) + 0.12, max=car.max_steering)
        return torch.minimum(torch.maximum(target, -most), most)

    def _drive(
        self, road: Horizon, shift: Tensor, bends: Tensor, speed: Tensor, limit: Tensor
    ) -> Tensor:
        """Return the speed to ask for [m/s]."""
        car = self._car
        # Beside the line the plan changes at every step: keep grip and speed in hand.
        beside = torch.clamp(shift.abs() / 0.1, max=1.0)
        grip = self._grip * (1.0 - self._style.reserve * beside)
        corner = torch.sqrt(grip / torch.clamp(bends.abs(), min=1e-3))
        line = road.speed * torch.sqrt(1.0 - self._style.reserve * beside)
        allowed = self._pace * torch.minimum(line, corner)
        squared = list((allowed * allowed).unbind(dim=1))
        for node in reversed(range(NODES - 1)):
            most = squared[node + 1] + 2.0 * 0.8 * car.max_braking * NODE_GAP
            squared[node] = torch.minimum(squared[node], most)
        allowed = torch.sqrt(torch.stack(squared, dim=1))
        soon = read_nodes(allowed, (speed * (STEP_DT + car.latency_s)).unsqueeze(1))[:, 0]
        target = torch.minimum(soon, limit)
        # Drive and brakes take grip that a bend needs: leave it its share.
        bend = torch.maximum(bends[:, 0].abs(), bends[:, 1].abs())
        spare = self._spare(speed * speed * bend)
        faster = speed + torch.clamp(spare, max=car.max_acceleration) * STEP_DT
        slower = speed - torch.clamp(spare, max=car.max_braking) * STEP_DT
        target = torch.maximum(torch.minimum(target, faster), slower)
        return speed + (target - speed) / _SERVO

    def _spare(self, cornering: Tensor) -> Tensor:
        """Return `spare_grip` of a batch [m/s^2]."""
        most, t = self._car.grip * GRAVITY, self._transfer
        left = torch.clamp(most * most - cornering * cornering, min=0.05 * most * most)
        square, half = 1.0 - (most * t) ** 2, most * most * t
        return (torch.sqrt(half * half + square * left) - half) / square


class CenterlineDriver:
    """The honest beginner: chases a point of the centreline, goes round boxes, waits for cars."""

    def __init__(
        self,
        name: str,
        track: Track,
        car: CarConfig,
        *,
        device: torch.device | str = "cpu",
    ) -> None:
        """Build the speed that suits the bends, on the device of the worlds."""
        self.name, self.sensors = name, SensorConfig()
        self._car = car
        line = center_line(track, car, share=0.35, top_speed=2.0)
        self._path = Path.of(line, track, device=device)

    def reset(self, rows: np.ndarray | None) -> None:
        """Forget nothing: it remembers nothing."""

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions from the `state` group."""
        state, car = torch.tensor(np.asarray(observations["state"])), self._car
        speed = torch.clamp(state[:, INDEX["speed_ahead"]], min=0.0)
        road = self._path.ahead_of(self._path.beside(state[:, INDEX["s"]].contiguous()))
        lateral = state[:, INDEX["lateral"]].contiguous()
        others = Others.told(state)
        # Round what stands for good; behind a car it waits, even a standing one.
        boxes = replace(others, present=others.present & others.is_box)
        aside = plan(boxes, road, road.lateral, lateral, speed, _SLOWLY).lateral
        # Pure pursuit: the circle through the car, along its yaw, to a point of the path ahead.
        x, y = _point_ahead(state, road, aside, 0.35 + 0.15 * speed)
        curvature = 2.0 * y / torch.clamp(x * x + y * y, min=0.01)
        own = torch.clamp(speed, min=1.0)
        limit = largest_speed(others, aside, lateral, own, _SLOWLY)
        slow = torch.where((aside - road.lateral)[:, 2].abs() > 0.02, 1.2, self._car.max_speed)
        soon = read_nodes(road.speed, (speed * 2.0 * STEP_DT).unsqueeze(1))[:, 0]
        asked = torch.minimum(torch.minimum(soon, limit), slow)
        return actions_from(torch.atan(car.wheelbase * curvature), asked, car)


@dataclass(frozen=True, eq=False)
class _Beside:
    """The shape of a path that lies beside a line."""

    bends: Tensor
    """Its curvature at each node [1/m], (num_rows, NODES)."""
    longer: Tensor
    """Its metres for each metre of line at the car, (num_rows,)."""
    turned: Tensor
    """Its direction at the car minus the line's [rad], (num_rows,)."""

    @classmethod
    def of(cls, road: Horizon, shift: Tensor) -> _Beside:
        """Move the line's nodes along the track's normals.

        Coarse nodes tell a curve's bends badly, but the same coarse measure of both curves tells
        their difference well; it is added to the line's own, so no shift changes nothing.
        """
        x, y = road.x + shift * road.normal_x, road.y + shift * road.normal_y
        extra = _bends(x, y) - _bends(road.x, road.y)
        extra = torch.cat([extra[:, :1], extra, extra[:, -1:]], dim=1)
        (ax, ay), (bx, by) = (_start(road.x), _start(road.y)), (_start(x), _start(y))
        along, across = ax * bx + ay * by, ax * by - ay * bx
        longer = torch.sqrt((bx * bx + by * by) / (ax * ax + ay * ay))
        return cls(
            road.curvature + extra, torch.clamp(longer, 0.4, 2.5), torch.atan(across / along)
        )


def _bends(x: Tensor, y: Tensor) -> Tensor:
    """Return the curvature of the circle through each three nodes [1/m], (num_rows, NODES - 2)."""
    ax, ay = x[:, 2:] - x[:, 1:-1], y[:, 2:] - y[:, 1:-1]
    bx, by = x[:, 1:-1] - x[:, :-2], y[:, 1:-1] - y[:, :-2]
    cx, cy = ax + bx, ay + by
    sides = (ax * ax + ay * ay) * (bx * bx + by * by) * (cx * cx + cy * cy)
    return 2.0 * (bx * ay - by * ax) / torch.sqrt(torch.clamp(sides, min=1e-9))


def _start(values: Tensor) -> Tensor:
    """Return the slope at the first node in node gaps, half way from first to second order.

    First order lags where a line bends fast; second order overshoots where a shift has a kink.
    """
    return 1.5 * values[:, 1] - 1.25 * values[:, 0] - 0.25 * values[:, 2]


def _mirrored(state: Tensor, road: Horizon, manners: Manners) -> Tensor:
    """Return the line moved in front of the nearest car that comes up from behind."""
    wished, found = road.lateral, torch.zeros_like(state[:, 0])
    for rank in range(NEIGHBOURS):
        gap = state[:, INDEX[f"car_{rank}_gap"]]
        free = state[:, INDEX[f"car_{rank}_frozen"]] < 0.5
        there = (state[:, INDEX[f"car_{rank}_present"]] > 0.5) & free
        # Full weight from half a metre to a metre and a half behind, fading out at two and a half.
        weight = torch.clamp(2.5 + gap, 0.0, 1.0) * torch.clamp((-0.4 - gap) / 0.2, 0.0, 1.0)
        weight = torch.where(there & (found < 0.5), weight, 0.0)
        place = state[:, INDEX[f"car_{rank}_lateral"]].unsqueeze(1)
        place = torch.minimum(torch.maximum(place, 0.1 - road.right), road.left - 0.1)
        wished = wished + (place - wished) * weight.unsqueeze(1)
        found = torch.maximum(found, weight)
    return wished


def _point_ahead(
    state: Tensor, road: Horizon, aside: Tensor, reach: Tensor
) -> tuple[Tensor, Tensor]:
    """Return the point `aside` of the centreline, `reach` metres on, in the car's frame [m]."""
    zero = torch.zeros_like(reach)
    along, across, turned, x, y = zero, -state[:, INDEX["lateral"]], zero, zero, zero
    for node in range(6):
        weight = torch.clamp(1.0 - (reach / NODE_GAP - node).abs(), 0.0, 1.0)
        x = x + weight * (along - aside[:, node] * torch.sin(turned))
        y = y + weight * (across + aside[:, node] * torch.cos(turned))
        turn = NODE_GAP * road.curvature[:, node]
        middle = turned + 0.5 * turn
        along = along + NODE_GAP * torch.cos(middle)
        across = across + NODE_GAP * torch.sin(middle)
        turned = turned + turn
    error = state[:, INDEX["heading_error"]].contiguous()
    cos, sin = torch.cos(error), torch.sin(error)
    return cos * x + sin * y, cos * y - sin * x
