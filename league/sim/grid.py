"""Compiled: where cars and obstacles are put, at the start and later, and how bot cars drive.

records.py says what the arguments are.
"""

import math

import numpy as np

from league.jit import inner
from league.portable_math import atan, clamp, f32, heading_of, wrap_angle
from league.sim.physics.vehicle import frozen
from league.sim.rng import purposes, uniform_of
from league.track.projection import frame_at, signed_gap

_GRIP, _MASS, _LATENCY, _STEERING, _CAMERA_UP, _CAMERA_PITCH, _START_SPEED = purposes(201, 208)
_PLACE, _LANE, _PERIOD = purposes(101, 104)
_LANE_CHANGE_DISTANCE, _END_MARGIN = f32(1.0), f32(1.0)  # [m]
_SLACK = f32(0.07)
_OPEN_START = f32(0.2)
_INFINITE = f32(np.inf)
_ZERO, _HALF, _ONE, _TWO, _THREE, _SIX = (f32(n) for n in (0.0, 0.5, 1.0, 2.0, 3.0, 6.0))


@inner
def start(cars, obstacles, world, points, course, places, settings):
    """Put one world at the start of its race: cars on their grid, at rest unless speeds vary.

    The first car stands on the start line, each further one a grid gap behind, odd ones on the
    inner lane and even ones on the outer; a car alone stands on the centreline. On an open track
    the whole grid stands just after the start. In a pursuit cars stand evenly round the lap, on the
    centreline, and each drives its laps from its own place.

    Of `world` seed and track are read and the rest is overwritten, as are cars and obstacles;
    `places` are those of `place_obstacles`.
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
    place_obstacles(obstacles, world, points, course, places, settings)


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
    """Draw a car's parameters by its slot and episode; without a spread they are the settings."""
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
def begin_episode(c, cars, world, s, lateral, points, course, settings):
    """Begin one car's episode at rest, with a new book: its laps begin where it stands."""
    car = cars[c]
    stand(car, points, course, s, lateral)
    car.zero_s = car.s if course.closed else _ZERO
    blank_book(car, car.s - car.zero_s, f32(world.step) * settings.step_dt)
    draw_parameters(car, c, world.seed, world.step, settings)


@inner
def move(car, points, course, shift, lateral):
    """Put a car at rest `shift` along the track from here, at `lateral` [m]; its book goes on."""
    car.distance = car.distance + shift
    stand(car, points, course, car.s + shift, lateral)
    car.still_steps, car.backward_steps = 0, 0


@inner
def release(car, points, course):
    """Put a car after its penalty on the nearer lane; after a crash it has been moved already."""
    if car.put_back:
        frame = frame_at(points, course, car.s)
        lateral = frame.left * _HALF if car.lateral > _ZERO else -frame.right * _HALF
        move(car, points, course, _ZERO, lateral)
    car.put_back = False


@inner
def place_behind(car, target, side, points, course, settings):
    """Return how far along and where across [m] to put a crashed car behind what it hit.

    That lies at `target` along and `side` across the track [m]; the car comes to the other lane.
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


# Obstacles -----------------------------------------------------------------------------------


@inner
def place_obstacles(obstacles, world, points, course, places, settings):
    """Put the obstacles of one world where they stand at the start of its race.

    `places` may hold (fraction of the lap, lane) of each, float32 (num_obstacles, 2).
    """
    for k in range(len(obstacles)):
        thing = obstacles[k]
        lane = _first_lane(k, world.seed, course, places, settings)
        thing.s = _first_s(k, len(obstacles), world.seed, course, places, settings)
        thing.lateral = lane * _lane_offset(frame_at(points, course, thing.s), lane)
        thing.half_length, thing.half_width = settings.thing_half_length, settings.thing_half_width
        thing.velocity_x, thing.velocity_y, thing.stopped_s = _ZERO, _ZERO, _ZERO
        _pose(thing, points, course, _ZERO)


@inner
def aim_obstacles(obstacles, arrivals, world, points, course, places, settings):
    """Set the velocity of bot cars, and `arrivals` to where they will be after this step."""
    for k in range(len(obstacles)):
        now, then = obstacles[k], arrivals[k]
        arrivals[k] = obstacles[k]
        if not settings.bots:
            continue
        speed = _ZERO if now.stopped_s > _ZERO else settings.bot_speed
        # Counted in whole steps, so that no rounding adds or drops one.
        steps_left = max(f32(np.rint(now.stopped_s * settings.step_hz)) - _ONE, _ZERO)
        then.stopped_s = steps_left / settings.step_hz
        then.s = now.s + speed * settings.step_dt
        then.lateral, slope = _lane_path(
            k, len(obstacles), then.s, world.seed, points, course, places, settings
        )
        _pose(then, points, course, slope)
        now.velocity_x = (then.x - now.x) / settings.step_dt
        now.velocity_y = (then.y - now.y) / settings.step_dt
        then.velocity_x, then.velocity_y = now.velocity_x, now.velocity_y


@inner
def _first_s(k, count, seed, course, places, settings):
    """Return s of obstacle k: as given, evenly spaced, or evenly spaced with a random shift."""
    if settings.fixed_places:
        return places[k, 0] * course.length
    first = min(course.length / f32(count + 1), settings.min_distance)
    stretch = course.length - first - _END_MARGIN
    # The starting grid stays clear; it stands before the line, or on an open track after it.
    stretch = max(stretch - settings.grid_length, _ZERO)
    if not course.closed:
        first += settings.grid_length
    if not settings.random_places:
        s = first + f32(k) * (stretch / f32(max(count - 1, 1)))
        return _off_the_starts(s, course, settings)
    # Each keeps to its own stretch, shortened so that two neighbours stay min_distance apart.
    spacing = stretch / f32(count)
    free = max(spacing - settings.min_distance, _ZERO)
    s = first + f32(k) * spacing + uniform_of(seed, _PLACE, k) * free
    return _off_the_starts(s, course, settings)


@inner
def _off_the_starts(s, course, settings):
    """Return a place along the track, moved off the nearest start of a pursuit where it is near."""
    if settings.pursuers == 0:
        return s
    apart = course.length / f32(settings.pursuers)
    room = min(_END_MARGIN, apart * _HALF)
    start = f32(math.floor(s / apart + _HALF)) * apart
    if abs(s - start) >= room:
        return s
    return start - room if s < start else start + room


@inner
def _first_lane(k, seed, course, places, settings):
    """Return 1 for the lane on the left and -1 on the right, or in between, as given."""
    if settings.fixed_places:
        return places[k, 1]
    if settings.random_places:
        return _ONE if uniform_of(seed, _LANE, k) < _HALF else -_ONE
    return course.inner if k % 2 == 0 else -course.inner


@inner
def _lane_offset(frame, side):
    """Return how far the middle of a lane lies from the centreline [m]."""
    return (frame.left if side > _ZERO else frame.right) * _HALF


@inner
def _lane_path(k, count, s, seed, points, course, places, settings):
    """Return lateral [m] and d(lateral)/ds of bot car k at odometer s."""
    lane = _first_lane(k, seed, course, places, settings)
    frame = frame_at(points, course, s)
    if not settings.lane_change:
        return lane * _lane_offset(frame, lane), _ZERO
    # Lanes change every 3 to 5 s of driving, over one metre, along a cubic. One change ends
    # before the next begins.
    stretch = (_THREE + _TWO * uniform_of(seed, _PERIOD, k)) * settings.bot_speed
    stretch = max(stretch, _LANE_CHANGE_DISTANCE)
    driven = s - _first_s(k, count, seed, course, places, settings)
    change = f32(math.floor(driven / stretch))
    odd = f32(math.floor(change * _HALF)) * _TWO != change
    after = -lane if odd else lane
    before = -after if change > _ZERO else after
    part = clamp((driven - change * stretch) / _LANE_CHANGE_DISTANCE, _ZERO, _ONE)
    blend = part * part * (_THREE - _TWO * part)
    side = before + (after - before) * blend
    offset = _lane_offset(frame, side)
    slope = (after - before) * _SIX * part * (_ONE - part) / _LANE_CHANGE_DISTANCE * offset
    return side * offset, slope


@inner
def _pose(thing, points, course, slope):
    """Set x, y and yaw from the place along and across the track."""
    frame = frame_at(points, course, thing.s)
    thing.x = frame.x - frame.sin * thing.lateral
    thing.y = frame.y + frame.cos * thing.lateral
    thing.yaw = wrap_angle(heading_of(frame.cos, frame.sin) + atan(slope))
