"""Compiled: the planar solver, forces integrated in the plane and contacts of boxes by impulses.

Semi-implicit Euler: forces change velocities, contacts mend them, velocities move the cars.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import numpy as np

from league.jit import compiled, inner
from league.portable_math import f32, sincos, wrap_angle
from league.sim.physics.collision import part, scratch_of
from league.sim.physics.vehicle import frozen, late_steps, push
from league.sim.settings import HALF_WALL

_HALF_WALL = f32(HALF_WALL)
REACH_MARGIN = f32(0.1)
"""Added to the distance two bodies may close in a control step [m]; covers what forces add."""
NUM_WALLS = 4
_ZERO, _HALF, _ONE = f32(0.0), f32(0.5), f32(1.0)


def schedule(num_cars: int) -> np.ndarray:
    """Return all pairs of cars in the order in which contacts are worked, int64 (num_pairs, 2).

    Rounds in which no car occurs twice (circle method of round-robin tournaments).
    """
    seats = list(range(num_cars + num_cars % 2))
    pairs: list[tuple[int, int]] = []
    for _ in range(len(seats) - 1):
        met = sorted((seats[i], seats[-1 - i]) for i in range(len(seats) // 2))
        pairs += [(min(pair), max(pair)) for pair in met if max(pair) < num_cars]
        seats = [seats[0], seats[-1], *seats[1:-1]]
    return np.array(pairs, np.int64).reshape(-1, 2)


@compiled
def step_world(cars, obstacles, course, controls, contacts, pairs, settings):
    """Move the cars of one world through a control step, and note what touched what.

    Cars that are frozen are held where they are, at rest; ghosts touch neither cars nor obstacles.
    Obstacles move at their velocity of this step and cannot be pushed.

    Args:
        cars: CAR records (num_cars,); their motion is changed.
        obstacles: OBSTACLE records (num_obstacles,).
        course: COURSE record, for the walls.
        controls: target steering [rad] and speed [m/s] of each car, float32 (num_cars, 2).
        contacts: CONTACT records (num_cars,); overwritten.
        pairs: of `schedule`.
        settings: SETTINGS record.
    """
    num_cars, dt = len(cars), settings.physics_dt
    for c in range(num_cars):
        contacts[c].cars, contacts[c].obstacles, contacts[c].wall = 0, 0, False
        if frozen(cars[c]):
            cars[c].velocity_x, cars[c].velocity_y, cars[c].yaw_rate = _ZERO, _ZERO, _ZERO
    number = _near(cars, obstacles, course, pairs, settings, pairs[:0])
    if number == 0:
        for k in range(settings.decimation):
            for c in range(num_cars):
                if not frozen(cars[c]):
                    _accelerate(cars[c], controls[c], settings, k)
                    _move(cars[c], dt, _ZERO, _ZERO)
    else:
        _step_near(number, cars, obstacles, course, controls, contacts, pairs, settings)
    for c in range(num_cars):
        cars[c].yaw = wrap_angle(cars[c].yaw)


@inner(allocates=True)
def _step_near(number, cars, obstacles, course, controls, contacts, pairs, settings):
    near = np.empty((number, 2), np.int64)
    _near(cars, obstacles, course, pairs, settings, near)
    first, second = near[:, 0].copy(), near[:, 1].copy()
    bodies, boxes = _bodies(cars, obstacles, course, settings)
    touched, shift = np.zeros(number, np.bool_), np.empty((len(bodies), 2), np.float32)
    scratch = scratch_of(len(bodies), number)
    _push_apart(cars, controls, bodies, boxes, first, second, touched, shift, scratch, settings)
    for n in range(number):
        if touched[n]:
            _note(contacts, first[n], second[n], len(cars), len(obstacles))


@inner
def _push_apart(cars, controls, bodies, boxes, first, second, touched, shift, scratch, settings):
    """Move the cars through a control step in which some of the pairs may touch; see `part`."""
    num_cars, dt = len(cars), settings.physics_dt
    for k in range(settings.decimation):
        for c in range(num_cars):
            if not frozen(cars[c]):
                _accelerate(cars[c], controls[c], settings, k)
            _write(bodies[c], cars[c].x, cars[c].y, cars[c].yaw)
            _write(bodies[c, 3:], cars[c].velocity_x, cars[c].velocity_y, cars[c].yaw_rate)
        bounce, rub = settings.restitution, settings.friction
        part(bodies, boxes, first, second, touched, shift, scratch, dt, bounce, rub)
        for c in range(num_cars):
            if not frozen(cars[c]):
                car = cars[c]
                car.velocity_x, car.velocity_y = bodies[c, 3], bodies[c, 4]
                car.yaw_rate = bodies[c, 5]
                _move(car, dt, shift[c, 0], shift[c, 1])
        for body in range(num_cars, len(bodies)):
            bodies[body, 0] += bodies[body, 3] * dt
            bodies[body, 1] += bodies[body, 4] * dt


@inner
def _accelerate(car, control, settings, k):
    late = late_steps(car, settings) > k
    steering = car.target_steering if late else control[0]
    speed = car.target_speed if late else control[1]
    acting = push(car, settings, steering, speed)
    ease = _ONE / car.mass * settings.physics_dt
    car.velocity_x += acting.force_x * ease
    car.velocity_y += acting.force_y * ease
    car.yaw_rate += acting.torque * (ease / settings.inertia_of_mass)
    car.steering = acting.steering
    if settings.lean_share > _ZERO:
        _lean(car, acting, settings)


@inner
def _lean(car, acting, settings):
    """Lean the chassis as its springs would under the tyres' forces; only cameras read it.

    See settings.lean_per_acceleration. Contacts do not lean it.
    """
    sin, cos = sincos(car.yaw)
    ahead = (cos * acting.force_x + sin * acting.force_y) / car.mass
    left = (cos * acting.force_y - sin * acting.force_x) / car.mass
    car.roll += (settings.roll_of_left * left - car.roll) * settings.lean_share
    car.pitch += (-settings.pitch_of_brakes * ahead - car.pitch) * settings.lean_share


@inner
def _move(car, dt, shift_x, shift_y):
    car.x = car.x + shift_x + car.velocity_x * dt
    car.y = car.y + shift_y + car.velocity_y * dt
    car.yaw = car.yaw + car.yaw_rate * dt


@inner
def _write(row, first, second, third):
    row[0], row[1], row[2] = first, second, third


@inner
def _reach(car, settings):
    """Return how far from its base a car may touch something within the control step [m]."""
    speed = abs(car.velocity_x) + abs(car.velocity_y)
    return speed * settings.step_dt + REACH_MARGIN + settings.radius


@inner
def _near(cars, obstacles, course, pairs, settings, out):
    """Return how many pairs of bodies may touch in the control step; write them if there is room.

    Bodies are numbered: cars, obstacles, then the walls at x_max, x_min, y_max and y_min. `out` is
    set to the pairs, int64 (num_pairs, 2); with no rows they are only counted.
    """
    number, num_cars = 0, len(cars)
    for n in range(len(pairs)):
        one, two = cars[pairs[n, 0]], cars[pairs[n, 1]]
        if one.ghost or two.ghost or (frozen(one) and frozen(two)):
            continue
        dx, dy = two.x - one.x, two.y - one.y
        room = _reach(one, settings) + _reach(two, settings)
        if dx * dx + dy * dy < room * room:
            if len(out):
                out[number, 0], out[number, 1] = pairs[n, 0], pairs[n, 1]
            number += 1
    for k in range(len(obstacles)):
        thing = obstacles[k]
        speed = abs(thing.velocity_x) + abs(thing.velocity_y)
        size = thing.half_length + thing.half_width + speed * settings.step_dt
        for c in range(num_cars):
            if cars[c].ghost or frozen(cars[c]):
                continue
            dx, dy = cars[c].x - thing.x, cars[c].y - thing.y
            room = _reach(cars[c], settings) + size
            if dx * dx + dy * dy < room * room:
                if len(out):
                    out[number, 0], out[number, 1] = c, num_cars + k
                number += 1
    for wall in range(NUM_WALLS):
        for c in range(num_cars):
            if frozen(cars[c]):
                continue
            if _to_wall(cars[c], course, wall) < _reach(cars[c], settings):
                if len(out):
                    out[number, 0], out[number, 1] = c, num_cars + len(obstacles) + wall
                number += 1
    return number


@inner
def _to_wall(car, course, wall):
    if wall == 0:
        return course.x_max - car.x
    if wall == 1:
        return car.x - course.x_min
    if wall == 2:
        return course.y_max - car.y
    return car.y - course.y_min


@inner(allocates=True)
def _bodies(cars, obstacles, course, settings):
    num_cars, fixed = len(cars), len(cars) + len(obstacles)
    bodies = np.zeros((fixed + NUM_WALLS, 6), np.float32)
    boxes = np.zeros((fixed + NUM_WALLS, 4), np.float32)
    for c in range(num_cars):
        boxes[c, 0], boxes[c, 1] = settings.half_length, settings.half_width
        if not frozen(cars[c]):
            boxes[c, 2] = _ONE / cars[c].mass
            boxes[c, 3] = _ONE / cars[c].mass / settings.inertia_of_mass
    for k in range(len(obstacles)):
        thing = obstacles[k]
        _write(bodies[num_cars + k], thing.x, thing.y, thing.yaw)
        _write(bodies[num_cars + k, 3:], thing.velocity_x, thing.velocity_y, _ZERO)
        boxes[num_cars + k, 0], boxes[num_cars + k, 1] = thing.half_length, thing.half_width
    middle_x, half_x = (course.x_min + course.x_max) * _HALF, (course.x_max - course.x_min) * _HALF
    middle_y, half_y = (course.y_min + course.y_max) * _HALF, (course.y_max - course.y_min) * _HALF
    for wall in range(NUM_WALLS):
        side = _ONE if wall == 0 or wall == 2 else -_ONE
        row = fixed + wall
        if wall < 2:
            _write(bodies[row], middle_x + side * (half_x + _HALF_WALL), middle_y, _ZERO)
            boxes[row, 0], boxes[row, 1] = _HALF_WALL, half_y + _HALF_WALL
        else:
            _write(bodies[row], middle_x, middle_y + side * (half_y + _HALF_WALL), _ZERO)
            boxes[row, 0], boxes[row, 1] = half_x + _HALF_WALL, _HALF_WALL
    return bodies, boxes


@inner
def _note(contacts, one, two, num_cars, num_obstacles):
    """Set the contact bits of two bodies that touched; the first is a car."""
    if two < num_cars:
        contacts[one].cars |= np.uint8(1 << two)
        contacts[two].cars |= np.uint8(1 << one)
    elif two < num_cars + num_obstacles:
        contacts[one].obstacles |= np.uint32(1 << (two - num_cars))
    else:
        contacts[one].wall = True
