"""Where cars are put: on the starting grid, back on the road, anywhere for training."""

from dataclasses import replace

import torch
from torch import Tensor

from league.geometry import heading_of, wrap_angle
from league.sim import draws, obstacles
from league.sim.config import CarConfig, SimConfig
from league.sim.world import (
    CarParameters,
    Control,
    Motion,
    Standing,
    World,
    put,
    row,
    select,
)
from league.track.course import TrackSet

_GRIP, _MASS, _LATENCY, _STEERING, _CAMERA_UP, _CAMERA_PITCH = range(201, 207)
_SPOT, _SIDE, _SEED = 211, 212, 213
_SLACK = 0.07
_CANDIDATES, _ROOM = 8, 0.8


def start(tracks: TrackSet, sim: SimConfig, seed: Tensor, track: Tensor) -> World:
    """Return the worlds at the start of a race: cars at rest on a staggered grid.

    The first car stands on the start line, each further one 0.75 m behind, odd ones on the inner
    lane and even ones on the outer (facts 5.1); a car alone stands on the centreline. On an open
    track the whole grid stands just after the start.

    Args:
        tracks: the courses.
        sim: settings.
        seed: seed of each race, int64, (num_worlds,).
        track: row of the TrackSet of each race, int64, (num_worlds,).
    """
    slot = torch.arange(sim.num_cars, device=seed.device).expand(seed.shape[0], sim.num_cars)
    distance, lateral = slots(tracks, sim, track, slot)
    motion, s = _at_rest(tracks, track, distance, lateral)
    standing = _blank_standing(sim, s, lateral, distance)
    still = Control(steering=torch.zeros_like(s), speed=torch.zeros_like(s))
    return World(
        seed=seed,
        step=torch.zeros_like(seed),
        track=track,
        motion=motion,
        control=still,
        cars=parameters(sim, seed, torch.zeros_like(slot)),
        obstacles=obstacles.place(tracks, sim, seed, track),
        standing=standing,
    )


def slots(tracks: TrackSet, sim: SimConfig, track: Tensor, slot: Tensor) -> tuple[Tensor, Tensor]:
    """Return where places of the starting grid are: distance from the line [m], and lateral [m].

    Args:
        tracks: the courses.
        sim: settings.
        track: row of the TrackSet of each race, int64, (num_worlds,).
        slot: place of each car from 0, the first, int64, (num_worlds, num_cars).
    """
    distance = -sim.rules.grid_gap * slot.to(torch.float32)
    closed = tracks.closed[track].unsqueeze(1)
    last = sim.rules.grid_gap * (sim.num_cars - 1)
    distance = torch.where(closed, distance, distance + (last + 0.2))
    lateral = torch.zeros_like(distance)
    if sim.num_cars > 1:
        inner = tracks.inner[track].unsqueeze(1)
        side = torch.where(slot % 2 == 1, inner, -inner)
        _, _, frame = tracks.at(track, distance)
        lateral = side * torch.where(side > 0, frame.left, frame.right) / 2
    return distance, lateral


def parameters(sim: SimConfig, seed: Tensor, episode: Tensor) -> CarParameters:
    """Draw each car's parameters; with a zero spread they are the settings.

    Args:
        sim: settings.
        seed: seed of each race, (num_worlds,).
        episode: number that makes this draw differ from others, int64, (num_worlds, num_cars).
    """
    car, spread = sim.car, sim.spread
    number = torch.arange(episode.shape[1], device=seed.device).expand(episode.shape)

    none = torch.zeros(episode.shape, device=seed.device)

    def drawn(purpose: int, reach: float) -> Tensor:
        if reach == 0:
            return none
        return reach * (2.0 * draws.uniform(seed.unsqueeze(1), purpose, number, episode) - 1.0)

    half = spread.latency_s / 2
    return CarParameters(
        grip=car.grip * (1.0 + drawn(_GRIP, spread.grip)),
        mass=car.mass * (1.0 + drawn(_MASS, spread.mass)),
        latency_s=car.latency_s + half + drawn(_LATENCY, half),
        steering_offset=drawn(_STEERING, spread.steering_offset),
        camera_up=drawn(_CAMERA_UP, spread.camera_position),
        camera_pitch=drawn(_CAMERA_PITCH, spread.camera_angle),
    )


def move(tracks: TrackSet, world: World, who: Tensor, shift: Tensor, lateral: Tensor) -> World:
    """Return the world with some cars put elsewhere along their track, at rest.

    Args:
        tracks: the courses.
        world: the races.
        who: which cars, bool, (num_worlds, num_cars).
        shift: how far along the track from where they are [m].
        lateral: where across the track [m].
    """
    book = world.standing
    distance = book.distance + shift
    motion, s = _at_rest(tracks, world.track, book.s + shift, lateral)
    moved = replace(
        book,
        s=s,
        lateral=lateral,
        distance=distance,
        still_steps=torch.zeros_like(book.still_steps),
        backward_steps=torch.zeros_like(book.backward_steps),
    )
    still = Control(torch.zeros_like(s), torch.zeros_like(s))
    return replace(
        world,
        motion=select(who, motion, world.motion),
        control=select(who, still, world.control),
        standing=replace(
            book,
            **{
                name: torch.where(who, getattr(moved, name), getattr(book, name))
                for name in ("s", "lateral", "distance", "still_steps", "backward_steps")
            },
        ),
    )


def release(tracks: TrackSet, world: World, done: Tensor) -> World:
    """Put back the cars whose penalty ended, on the nearer lane where they left the road."""
    who = done & world.standing.put_back
    _, _, frame = tracks.at(world.track, world.standing.s)
    left_lane, right_lane = frame.left / 2, -frame.right / 2
    lateral = torch.where(world.standing.lateral > 0, left_lane, right_lane)
    moved = move(tracks, world, who, torch.zeros_like(lateral), lateral)
    book = moved.standing
    return replace(moved, standing=replace(book, put_back=book.put_back & ~done))


def put_behind(
    tracks: TrackSet, sim: SimConfig, world: World, who: Tensor, car: Tensor, obstacle: Tensor
) -> World:
    """Put crashed cars 1 m behind what they hit, on the other lane; never forward (facts 5.2).

    Args:
        tracks: the courses.
        sim: settings.
        world: the races.
        who: which cars, bool, (num_worlds, num_cars).
        car: the car each one hit, or -1.
        obstacle: the obstacle each one hit, or -1.
    """
    book, things = world.standing, world.obstacles
    target = torch.gather(book.s, 1, torch.clamp(car, min=0))
    side = torch.gather(book.lateral, 1, torch.clamp(car, min=0))
    if sim.num_obstacles:
        thing, hit = torch.clamp(obstacle, min=0), obstacle >= 0
        target = torch.where(hit, torch.gather(things.s, 1, thing), target)
        side = torch.where(hit, torch.gather(things.lateral, 1, thing), side)
    shift = tracks.signed_gap(world.track, target, book.s) - sim.rules.put_back_behind
    shift = torch.clamp(shift, max=0.0)
    # On an open track the start is as far back as one can go.
    closed = tracks.closed[world.track].unsqueeze(1)
    shift = torch.where(closed, shift, torch.maximum(shift, -book.s))
    _, _, frame = tracks.at(world.track, book.s + shift)
    lateral = torch.where(side > 0, -frame.right / 2, frame.left / 2)
    return move(tracks, world, who, shift, lateral)


def clear_of_others(car: CarConfig, world: World, solid: Tensor, wanting: Tensor) -> Tensor:
    """Return which ghosts could become solid without touching anything, bool, (num_worlds, cars).

    Of two ghosts that want to on one spot, the one ahead goes first and the other waits.

    Args:
        car: what all cars share.
        world: the races.
        solid: which cars are there to be touched, bool, (num_worlds, num_cars).
        wanting: which ghosts want to become solid, bool, (num_worlds, num_cars).
    """
    body, things, distance = world.motion, world.obstacles, world.standing.distance
    half = 0.5 * (car.length**2 + car.width**2) ** 0.5
    near = torch.zeros_like(wanting)
    slot = torch.arange(world.num_cars, device=wanting.device)
    for other in range(world.num_cars):
        part = slice(other, other + 1)
        gap = _squared_gap(body.x, body.y, body.x[:, part], body.y[:, part])
        rival = distance[:, part]
        first = (rival > distance) | ((rival == distance) & (slot > other))
        there = (solid[:, part] & (slot != other)) | (wanting[:, part] & first)
        near = near | ((gap < (2 * half + _SLACK) ** 2) & there)
    for thing in range(things.x.shape[1]):
        part = slice(thing, thing + 1)
        gap = _squared_gap(body.x, body.y, things.x[:, part], things.y[:, part])
        size, width = things.half_length[:, part], things.half_width[:, part]
        reach = torch.sqrt(size * size + width * width) + (half + _SLACK)
        near = near | (gap < reach * reach)
    return ~near


def restart(tracks: TrackSet, sim: SimConfig, world: World, who: Tensor) -> World:
    """Start a new episode for some cars, on a free stretch anywhere on the track, at rest.

    Eight places are drawn; the first that is 0.8 m clear of all else is taken, or the clearest.
    Their book begins anew there: a lap is complete where the episode began. Obstacles at random
    places are placed anew.
    """
    rows = who.any(dim=1).nonzero()[:, 0]
    if len(rows) < world.num_worlds:
        part = _restart(tracks, sim, row(world, rows), who[rows])
        return put(part, rows, world)
    return _restart(tracks, sim, world, who)


def _restart(tracks: TrackSet, sim: SimConfig, world: World, who: Tensor) -> World:
    world = _new_obstacles(tracks, sim, world, who)
    number = torch.arange(world.num_cars, device=who.device).expand(who.shape)
    seed, step = world.seed.unsqueeze(1), world.step.unsqueeze(1)
    spot = free_spots(tracks, world, who)
    _, _, frame = tracks.at(world.track, spot)
    across = draws.uniform(seed, _SIDE, step, number) - 0.5
    lateral = across * torch.minimum(frame.left, frame.right)
    return begin(tracks, sim, world, who, spot, lateral)


def begin(
    tracks: TrackSet, sim: SimConfig, world: World, who: Tensor, spot: Tensor, lateral: Tensor
) -> World:
    """Return the world with some cars beginning an episode at rest, with a new book.

    Args:
        tracks: the courses.
        sim: settings.
        world: the races.
        who: which cars, bool, (num_worlds, num_cars).
        spot: where along the track [m].
        lateral: where across the track [m].
    """
    motion, s = _at_rest(tracks, world.track, spot, lateral)
    closed = tracks.closed[world.track].unsqueeze(1)
    zero_s = torch.where(closed, s, torch.zeros_like(s))
    now = (world.step.to(torch.float32) * sim.step_dt).unsqueeze(1).expand(who.shape).contiguous()
    fresh = _blank_standing(sim, s, lateral, s - zero_s)
    standing = select(who, replace(fresh, zero_s=zero_s, lap_start_s=now), world.standing)
    step = world.step.unsqueeze(1).expand(who.shape)
    return replace(
        world,
        motion=select(who, motion, world.motion),
        control=select(who, Control(torch.zeros_like(s), torch.zeros_like(s)), world.control),
        cars=select(who, parameters(sim, world.seed, step), world.cars),
        standing=replace(standing, ahead=_ahead_on_road(tracks, world, standing, who)),
    )


def restart_all(tracks: TrackSet, sim: SimConfig, world: World) -> World:
    """Start every car's first episode."""
    return restart(tracks, sim, world, torch.ones_like(world.standing.ghost))


def _new_obstacles(tracks: TrackSet, sim: SimConfig, world: World, who: Tensor) -> World:
    """Give worlds whose only car starts anew another seed, and with it other obstacles."""
    if sim.num_obstacles == 0 or not sim.obstacles.random_places:
        return world
    anew = who.all(dim=1) & (world.step > 0)
    seed = torch.where(anew, draws.bits(world.seed, _SEED, world.step) & (2**62 - 1), world.seed)
    placed = obstacles.place(tracks, sim, seed, world.track)
    return replace(world, seed=seed, obstacles=select(anew, placed, world.obstacles))


def free_spots(tracks: TrackSet, world: World, who: Tensor) -> Tensor:
    """Draw s of a free stretch for each car; those that start together keep clear of each other."""
    book, things = world.standing, world.obstacles
    number = torch.arange(world.num_cars, device=who.device)
    attempt = torch.arange(_CANDIDATES, device=who.device)
    seed, step = world.seed.reshape(-1, 1, 1), world.step.reshape(-1, 1, 1)
    share = draws.uniform(seed, _SPOT, step, number.unsqueeze(1), attempt)
    drawn = share * tracks.length[world.track].reshape(-1, 1, 1)  # (num_worlds, cars, candidates)
    taken = list(book.s.unbind(dim=1)) + list(things.s.unbind(dim=1))
    for car in range(world.num_cars):
        candidate = drawn[:, car].contiguous()
        room = torch.full_like(candidate, 1e9)
        for other, s in enumerate(taken):
            if other != car:
                gap = tracks.signed_gap(world.track, s.unsqueeze(1), candidate)
                room = torch.minimum(room, gap.abs())
        # The first that is clear enough, or else the clearest.
        merit = torch.where(room >= _ROOM, 1e9 - attempt * 1e6, room)
        spot = torch.gather(candidate, 1, merit.argmax(dim=1, keepdim=True))[:, 0]
        taken[car] = torch.where(who[:, car], spot, taken[car])
    return torch.stack(taken[: world.num_cars], dim=1)


def _ahead_on_road(tracks: TrackSet, world: World, standing: Standing, who: Tensor) -> Tensor:
    """Return who is ahead of whom, seen on the road where one of the two has started anew."""
    gap = tracks.signed_gap(world.track, standing.s.unsqueeze(2), standing.s.unsqueeze(1))
    anew = who.unsqueeze(2) | who.unsqueeze(1)
    return torch.where(anew, gap > 0, standing.ahead)


def _squared_gap(x: Tensor, y: Tensor, other_x: Tensor, other_y: Tensor) -> Tensor:
    dx, dy = x - other_x, y - other_y
    return dx * dx + dy * dy


def _at_rest(tracks: TrackSet, track: Tensor, s: Tensor, lateral: Tensor) -> tuple[Motion, Tensor]:
    """Return the motion of cars standing at (s, lateral) along the track, and s wrapped."""
    x, y, frame = tracks.at(track, s)
    zero = torch.zeros_like(x)
    motion = Motion(
        x=x - frame.sin * lateral,
        y=y + frame.cos * lateral,
        yaw=wrap_angle(heading_of(frame.cos, frame.sin)),
        velocity_x=zero,
        velocity_y=zero,
        yaw_rate=zero,
        steering=zero,
    )
    return motion, frame.s


def _blank_standing(sim: SimConfig, s: Tensor, lateral: Tensor, distance: Tensor) -> Standing:
    worlds, cars = s.shape
    zero, count = torch.zeros_like(s), torch.zeros_like(s, dtype=torch.int64)
    never = torch.zeros_like(s, dtype=torch.bool)
    slot = torch.arange(cars, device=s.device)
    return Standing(
        s=s,
        lateral=lateral,
        zero_s=zero,
        distance=distance,
        best_distance=distance,
        laps=count,
        lap_start_s=zero,
        last_lap_s=zero,
        best_lap_s=torch.full_like(s, float("inf")),
        finish_s=torch.full_like(s, float("inf")),
        penalty_s=zero,
        ghost=never,
        put_back=never,
        still_steps=count,
        backward_steps=count,
        touching_cars=never.unsqueeze(-1).expand(worlds, cars, cars).contiguous(),
        touching_obstacles=torch.zeros(
            (worlds, cars, sim.num_obstacles), dtype=torch.bool, device=s.device
        ),
        off_tracks=count,
        crashes=count,
        contacts_taken=count,
        immobilised=count,
        reversed=count,
        overtakes=count,
        lead_changes=count[:, 0].contiguous(),
        ahead=(slot.unsqueeze(1) < slot.unsqueeze(0)).expand(worlds, cars, cars).contiguous(),
        leader=count[:, 0].contiguous(),
    )
