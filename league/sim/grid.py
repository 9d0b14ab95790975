"""Compiled: where cars are put, on the starting grid and back on the road.

records.py says what the arguments are.
"""

import math

import numpy as np

from league.jit import inner
from league.portable_math import f32, heading_of, wrap_angle
from league.sim import obstacles as obstacles_room
from league.sim.physics.vehicle import frozen
from league.sim.rng import purposes, uniform_of
from league.track.projection import frame_at, signed_gap

_GRIP, _MASS, _LATENCY, _STEERING, _CAMERA_UP, _CAMERA_PITCH, _START_SPEED = purposes(201, 208)
_SLACK = f32(0.07)
_OPEN_START = f32(0.2)
_INFINITE = f32(np.inf)
_ZERO, _HALF, _ONE, _TWO = f32(0.0), f32(0.5), f32(1.0), f32(2.0)


@inner
def start(cars, obstacles, world, points, course, places, settings):
    """Put one world at the start of its race: cars on their grid, at rest unless speeds vary.

    The first car stands on the start line, each further one a grid gap behind, odd ones on the
    inner lane and even ones on the outer; a car alone stands on the centreline. On an open track
    the whole grid stands just after the start. In a pursuit cars stand evenly round the lap, on the
    centreline, and each drives its laps from its own place.

    Of `world` seed and track are read and the rest is overwritten, as are cars and obstacles;
    `places` are those of obstacles.place.
    """
    world.step, world.leader, world.lead_changes = 0, 0, 0
    for c in range(len(cars)):
        distance, lateral = slot(c, len(cars), points, course, settings)
        stand(cars[c], points, course, distance, lateral)
        draw_parameters(cars[c], c, world.seed, np.int64(0), settings)
        if settings.start_speed > _ZERO:
            speed = settings.start_speed * uniform_of(world.seed, _START_SPEED, c)
            frame = frame_at(points, course, distance)
            cars[c].velocity_x, cars[c].velocity_y = speed * frame.cos, speed * frame.sin
            cars[c].target_speed = speed
        cars[c].lateral, cars[c].zero_s = lateral, _ZERO
        if settings.pursuers > 0:
            distance, cars[c].zero_s = _ZERO, cars[c].s
        blank_book(cars[c], distance, _ZERO)
    for c in range(len(cars)):
        cars[c].ahead = 0
        for other in range(len(cars)):
            first = c < other
            if settings.pursuers > 0 and c != other:
                first = signed_gap(course, cars[c].s, cars[other].s) > _ZERO
            if first:
                cars[c].ahead |= np.uint8(1 << other)
    obstacles_room.place(obstacles, world, points, course, places, settings)


@inner
def slot(place, num_cars, points, course, settings):
    """Return where a place of the grid is: distance from the line [m], and lateral [m]."""
    if settings.pursuers > 0:
        return -course.length * f32(place) / f32(num_cars), _ZERO
    distance = -settings.grid_gap * f32(place)
    if not course.closed:
        distance += settings.grid_gap * f32(num_cars - 1) + _OPEN_START
    if num_cars == 1:
        return distance, _ZERO
    side = course.inner if place % 2 == 1 else -course.inner
    frame = frame_at(points, course, distance)
    return distance, side * (frame.left if side > _ZERO else frame.right) * _HALF


@inner
def stand(car, points, course, s, lateral):
    """Put a car at rest at a place along and across its track, with neither control nor action."""
    frame = frame_at(points, course, s)
    car.x = frame.x - frame.sin * lateral
    car.y = frame.y + frame.cos * lateral
    car.yaw = wrap_angle(heading_of(frame.cos, frame.sin))
    car.s, car.lateral = frame.s, lateral
    car.velocity_x, car.velocity_y, car.yaw_rate, car.steering = _ZERO, _ZERO, _ZERO, _ZERO
    car.z, car.roll, car.pitch = _ZERO, _ZERO, _ZERO
    car.velocity_z, car.roll_rate, car.pitch_rate = _ZERO, _ZERO, _ZERO
    car.target_steering, car.target_speed = _ZERO, _ZERO


@inner
def draw_parameters(car, number, seed, episode, settings):
    """Draw a car's parameters; without a spread they are the settings.

    `number` is its slot; `episode` makes this draw differ from others of the same seed.
    """
    car.top_speed = settings.max_speed
    half = settings.latency_spread_s * _HALF
    grip, mass = settings.grip_spread, settings.mass_spread
    car.grip = settings.grip * (_ONE + _drawn(seed, _GRIP, number, episode, grip))
    car.mass = settings.mass * (_ONE + _drawn(seed, _MASS, number, episode, mass))
    car.latency_s = settings.latency_s + half + _drawn(seed, _LATENCY, number, episode, half)
    car.steering_offset = _drawn(seed, _STEERING, number, episode, settings.steering_spread)
    car.camera_up = _drawn(seed, _CAMERA_UP, number, episode, settings.camera_up_spread)
    car.camera_pitch = _drawn(seed, _CAMERA_PITCH, number, episode, settings.camera_pitch_spread)


@inner
def _drawn(seed, purpose, number, episode, reach):
    """Return a number in [-reach, reach)."""
    if reach == _ZERO:
        return _ZERO
    return reach * (_TWO * uniform_of(seed, purpose, number, episode) - _ONE)


@inner
def blank_book(car, distance, now_s):
    """Reset the referee's book of a car at its place; its laps begin at `distance` [m]."""
    car.distance, car.best_distance = distance, distance
    car.lap_start_s, car.last_lap_s = now_s, _ZERO
    car.best_lap_s, car.finish_s, car.penalty_s = _INFINITE, _INFINITE, _ZERO
    car.laps, car.still_steps, car.backward_steps, car.episode_steps = 0, 0, 0, 0
    car.off_tracks, car.crashes, car.touches, car.contacts_taken = 0, 0, 0, 0
    car.pushed_by, car.pushed_steps, car.pushed_speed, car.pace = 0, 0, _ZERO, _ZERO
    car.immobilised, car.reversed, car.overtakes = 0, 0, 0
    car.touching_cars, car.touching_obstacles = 0, 0
    car.ghost, car.put_back, car.retired = False, False, False


@inner
def move(car, points, course, shift, lateral):
    """Put a car elsewhere along its track, at rest; its book goes on.

    `shift` is how far along the track from where it is, `lateral` where across the track [m].
    """
    car.distance = car.distance + shift
    stand(car, points, course, car.s + shift, lateral)
    car.still_steps, car.backward_steps = 0, 0


@inner
def release(car, points, course):
    """Put a car after its penalty on the nearer lane where it left the road, if it asked for it.

    After a crash the car has been moved already.
    """
    if car.put_back:
        frame = frame_at(points, course, car.s)
        lateral = frame.left * _HALF if car.lateral > _ZERO else -frame.right * _HALF
        move(car, points, course, _ZERO, lateral)
    car.put_back = False


@inner
def place_behind(car, target, side, points, course, settings):
    """Return how to move a crashed car behind what it hit, on the other lane; never forward.

    `target` and `side` are the place of what it hit along and across the track [m].

    Returns:
        How far along the track from where it is [m], and where across the track [m].
    """
    shift = min(signed_gap(course, target, car.s) - settings.put_back_behind, _ZERO)
    if not course.closed:
        # On an open track the start is as far back as one can go.
        shift = max(shift, -car.s)
    frame = frame_at(points, course, car.s + shift)
    return shift, -frame.right * _HALF if side > _ZERO else frame.left * _HALF


@inner
def is_clear(c, cars, obstacles, solid, wanting, settings):
    """Return whether the ghost in slot `c` could become solid without touching anything.

    Of two ghosts that want to on one spot, the one ahead goes first and the other waits. `solid`
    and `wanting` are masks: of the cars that can be touched, and of the ghosts that want to become
    solid.
    """
    me = cars[c]
    apart = _TWO * settings.radius + _SLACK
    for other in range(len(cars)):
        rival = cars[other]
        first = rival.distance > me.distance or (rival.distance == me.distance and c > other)
        there = (solid >> other) & 1 or ((wanting >> other) & 1 and first)
        dx, dy = me.x - rival.x, me.y - rival.y
        if other != c and there and dx * dx + dy * dy < apart * apart:
            return False
    for k in range(len(obstacles)):
        thing = obstacles[k]
        size = thing.half_length * thing.half_length + thing.half_width * thing.half_width
        reach = f32(math.sqrt(size)) + settings.radius + _SLACK
        dx, dy = me.x - thing.x, me.y - thing.y
        if dx * dx + dy * dy < reach * reach:
            return False
    return True


@inner
def retire(car):
    """Take a car out of the race for good: frozen, and in no one's way."""
    car.retired, car.ghost = True, True


@inner
def is_racing(car):
    """Return whether a car is neither frozen nor home."""
    return not frozen(car) and car.finish_s == _INFINITE
