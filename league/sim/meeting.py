"""Where cars are put when one learns to race the others: near it, so that they meet."""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from league.geometry import heading_of, wrap_angle
from league.sim import draws, grid
from league.sim.config import SimConfig
from league.sim.meeting_config import Meeting
from league.sim.world import Control, Motion, World, put, row, select
from league.track.course import TrackSet

_SPOT, _SIDE, _KIND, _SLOT, _ROLL, _PACE, _OWN_PACE, _GAP, _LANE = range(221, 230)
_CANDIDATES = 24
_LANES = 0.7
_LOOK = (0.0, 0.4, 0.8, 1.2)
_GRAVITY = 9.81
_NOWHERE = -1000.0


def beginning(tracks: TrackSet, cfg: Meeting, world: World, done: Tensor) -> Tensor:
    """Return which cars begin an episode, given whose is over; bool, (num_worlds, num_cars)."""
    book = world.standing
    gap = tracks.signed_gap(world.track, book.s, book.s[:, :1])
    joining = (done | (gap.abs() > cfg.lost)) & ~parked(world)
    who = joining | done[:, :1]
    who[:, 0] = done[:, 0]
    return who


def parked(world: World) -> Tensor:
    """Return which cars are out of the world while car 0 is alone, bool, (num_worlds, cars)."""
    return torch.isinf(world.standing.penalty_s)


def restart(tracks: TrackSet, sim: SimConfig, cfg: Meeting, world: World, who: Tensor) -> World:
    """Begin episodes: of all cars where car 0's begins, else of those that join it.

    Args:
        tracks: the courses.
        sim: settings of the world.
        cfg: how the cars meet.
        world: the races.
        who: which cars, as `beginning` says, bool, (num_worlds, num_cars).
    """
    rows = who.any(dim=1).nonzero()[:, 0]
    if len(rows) < world.num_worlds:
        part = _restart(tracks, sim, cfg, row(world, rows), who[rows])
        return put(part, rows, world)
    return _restart(tracks, sim, cfg, world, who)


def _restart(tracks: TrackSet, sim: SimConfig, cfg: Meeting, world: World, who: Tensor) -> World:
    seed, first = world.seed, who[:, :1]
    kind = draws.uniform(seed, _KIND, world.step).unsqueeze(1)
    alone = first & (kind < cfg.alone)
    on_grid = first & ~alone & (kind < cfg.alone + cfg.standing)
    spot, lateral = _near(tracks, cfg, world, who)
    shift = (draws.uniform(seed, _SLOT, world.step) * world.num_cars).to(torch.int64).unsqueeze(1)
    slot = torch.arange(world.num_cars, device=who.device) + shift
    grid_s, grid_lateral = grid.slots(tracks, sim, world.track, slot % world.num_cars)
    spot = torch.where(on_grid, grid_s, spot)
    lateral = torch.where(on_grid, grid_lateral, lateral)
    speed = torch.where(on_grid, 0.0, _speeds(tracks, sim, cfg, world, who, spot))
    world = grid.begin(tracks, sim, world, who, spot, lateral)
    world = _rolling(tracks, sim, world, who & (speed > 0), speed)
    return _parked(tracks, world, who & alone)


def _near(tracks: TrackSet, cfg: Meeting, world: World, who: Tensor) -> tuple[Tensor, Tensor]:
    """Draw places on the road for all that begin, near car 0, on nobody's place.

    Of `_CANDIDATES` places the first is taken that is clear of everybody, or else the clearest.
    """
    book, first = world.standing, who[:, :1]
    drawn = draws.uniform(world.seed, _SPOT, world.step) * tracks.length[world.track]
    side = 2.0 * draws.uniform(world.seed, _SIDE, world.step) - 1.0
    spot = torch.where(first, drawn.unsqueeze(1), book.s[:, :1])
    across = _across(tracks, world, spot, side.unsqueeze(1))
    taken = list(book.s.split(1, dim=1))
    beside = list(book.lateral.split(1, dim=1))
    taken[0], beside[0] = spot, torch.where(first, across, beside[0])
    for car in range(1, world.num_cars):
        place, across = _candidates(tracks, cfg, world, car, spot)
        clear, room = _clearance(tracks, cfg, world, who, car, place, across, taken, beside)
        merit = torch.where(clear, 1e9 - torch.arange(_CANDIDATES, device=who.device) * 1e6, room)
        best = merit.argmax(dim=1, keepdim=True)
        begins = who[:, car : car + 1]
        taken[car] = torch.where(begins, torch.gather(place, 1, best), taken[car])
        beside[car] = torch.where(begins, torch.gather(across, 1, best), beside[car])
    return torch.cat(taken, dim=1), torch.cat(beside, dim=1)


def _candidates(
    tracks: TrackSet, cfg: Meeting, world: World, car: int, about: Tensor
) -> tuple[Tensor, Tensor]:
    """Draw places for a car: along the track and across [m], (num_worlds, _CANDIDATES)."""
    seed, step = world.seed.unsqueeze(1), world.step.unsqueeze(1)
    attempt = torch.arange(_CANDIDATES, device=about.device)
    drawn = draws.uniform(seed, _GAP, step, car, attempt)
    behind = 1.0 - cfg.ahead
    gap = (drawn - behind) / torch.where(drawn < behind, behind, cfg.ahead) * cfg.reach
    length, closed = (each[world.track].unsqueeze(1) for each in (tracks.length, tracks.closed))
    place = about + gap
    place = torch.where(closed, place, torch.minimum(torch.clamp(place, min=0.2), length - 0.5))
    side = 2.0 * draws.uniform(seed, _LANE, step, car, attempt) - 1.0
    return place, _across(tracks, world, place, side)


def _clearance(
    tracks: TrackSet,
    cfg: Meeting,
    world: World,
    who: Tensor,
    car: int,
    place: Tensor,
    across: Tensor,
    taken: list[Tensor],
    beside: list[Tensor],
) -> tuple[Tensor, Tensor]:
    """Return which places are clear of all others, bool, and the gap to the nearest [m].

    Clear is half a metre along the track or most of a lane across; of car 0 that is driving, more.
    """
    clear = torch.ones_like(place, dtype=torch.bool)
    room = torch.full_like(place, 1e6)
    for other in range(world.num_cars):
        if other == car:
            continue
        away = tracks.signed_gap(world.track, place, taken[other]).abs()
        apart = (away >= 0.5) | ((across - beside[other]).abs() >= 0.3)
        if other == 0:
            apart = apart & (who[:, :1] | (away >= cfg.room))
        elif other > car:
            # Who begins too has not got its place yet.
            apart = apart | who[:, other : other + 1]
        clear, room = clear & apart, torch.minimum(room, away)
    return clear, room


def _across(tracks: TrackSet, world: World, s: Tensor, side: Tensor) -> Tensor:
    """Return the lateral place [m] of a share of the road's half, -1 to 1."""
    _, _, frame = tracks.at(world.track, s.contiguous())
    return side * _LANES * torch.minimum(frame.left, frame.right)


def _speeds(
    tracks: TrackSet, sim: SimConfig, cfg: Meeting, world: World, who: Tensor, spot: Tensor
) -> Tensor:
    """Return how fast each car begins [m/s]: at like speeds, what the next bend allows, or 0."""
    first, seed, step = who[:, :1], world.seed, world.step
    looks = spot.unsqueeze(2) + spot.new_tensor(_LOOK)
    sharpest = torch.amax(tracks.curvature_at(world.track, looks).abs(), dim=2)
    limit = torch.sqrt(sim.car.grip * _GRAVITY / torch.clamp(sharpest, min=1e-3))
    limit = torch.clamp(limit, max=cfg.top_speed)
    rolls = (draws.uniform(seed, _ROLL, step) < cfg.rolling).unsqueeze(1)
    share = 0.3 + 0.7 * draws.uniform(seed, _PACE, step).unsqueeze(1)
    drawn = torch.where(rolls, share * cfg.top_speed, 0.0)
    body, frame = world.motion, tracks.at(world.track, world.standing.s)[2]
    along = (body.velocity_x * frame.cos + body.velocity_y * frame.sin)[:, :1]
    base = torch.where(first, drawn, torch.clamp(along, min=0.0))
    number = torch.arange(world.num_cars, device=who.device)
    own = 2.0 * draws.uniform(seed.unsqueeze(1), _OWN_PACE, step.unsqueeze(1), number) - 1.0
    return torch.minimum(base * (1.0 + cfg.pace * own), limit)


def _rolling(tracks: TrackSet, sim: SimConfig, world: World, who: Tensor, speed: Tensor) -> World:
    """Return the world with some cars moving along the track, wheels turned as the bend asks."""
    book = world.standing
    _, _, frame = tracks.at(world.track, book.s)
    bend = tracks.curvature_at(world.track, book.s)
    # Left of the centreline a left bend is tighter.
    bend = bend / torch.clamp(1.0 - bend * book.lateral, min=0.3)
    turned = torch.atan(sim.car.wheelbase * bend)
    turned = torch.clamp(turned, -sim.car.max_steering, sim.car.max_steering)
    motion = Motion(
        x=world.motion.x,
        y=world.motion.y,
        yaw=wrap_angle(heading_of(frame.cos, frame.sin)),
        velocity_x=speed * frame.cos,
        velocity_y=speed * frame.sin,
        yaw_rate=speed * bend,
        steering=turned,
    )
    return replace(
        world,
        motion=select(who, motion, world.motion),
        control=select(who, Control(steering=turned, speed=speed), world.control),
    )


def _parked(tracks: TrackSet, world: World, who: Tensor) -> World:
    """Return the world with all but car 0 out of it where `who` says so: frozen, ghosts, unseen."""
    who = who.clone()
    who[:, 0] = False
    book, body = world.standing, world.motion
    far = book.s[:, :1] + tracks.length[world.track].unsqueeze(1) / 2
    far = torch.remainder(far, tracks.length[world.track].unsqueeze(1))
    return replace(
        world,
        motion=replace(body, x=torch.where(who, _NOWHERE, body.x)),
        standing=replace(
            book,
            s=torch.where(who, far, book.s),
            penalty_s=torch.where(who, torch.inf, book.penalty_s),
            ghost=book.ghost | who,
        ),
    )
