"""Compiled: the planar solver, forces integrated in the plane and contacts of boxes by impulses.

Semi-implicit Euler: forces change velocities, contacts mend them, velocities move the cars.
"""

import numpy as np

from league.jit import inner
from league.portable_math import f32, sincos, wrap_angle
from league.sim.physics.collision import SLOP, arrays_of, part, views_of
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


@inner
def step_world(cars, obstacles, course, controls, contacts, pairs, settings):
    """Move the cars of one world through a control step, and note what touched what.

    Cars that are frozen are held where they are, at rest; ghosts touch neither cars nor obstacles.
    Obstacles move at their velocity of this step and cannot be pushed.

    The motion of the cars is changed, their contacts are overwritten. Controls are target steering
    [rad] and speed [m/s] of each car, float32 (num_cars, 2); `pairs` are those of `schedule`.
    """
    num_cars, near_fixed = len(cars), False
    for c in range(num_cars):
        contacts[c].cars, contacts[c].obstacles, contacts[c].wall = 0, 0, False
        if frozen(cars[c]):
            cars[c].velocity_x, cars[c].velocity_y, cars[c].yaw_rate = _ZERO, _ZERO, _ZERO
        near_fixed |= _may_hit_fixed(cars[c], obstacles, course, settings)
    close = _close_pairs(cars, pairs, settings)
    for k in range(settings.decimation):
        for c in range(num_cars):
            if not frozen(cars[c]):
                _accelerate(cars[c], controls[c], settings, k)
        # Most cars that may meet in a control step do not: arrays are made for those that do.
        if near_fixed or _some_meet(close, cars, pairs, settings):
            _step_near(k, close, cars, obstacles, course, controls, contacts, pairs, settings)
            break
        for c in range(num_cars):
            if not frozen(cars[c]):
                _move(cars[c], settings.physics_dt, _ZERO, _ZERO)
    for c in range(num_cars):
        cars[c].yaw = wrap_angle(cars[c].yaw)


@inner(allocates=True)
def _step_near(first, close, cars, obstacles, course, controls, contacts, pairs, settings):
    fixed = len(obstacles) + NUM_WALLS
    arrays = arrays_of(max(len(cars) + fixed, len(pairs) + len(cars) * fixed))
    _push_apart(arrays, first, close, cars, obstacles, course, controls, contacts, pairs, settings)


@inner
def _push_apart(arrays, first, close, cars, obstacles, course, controls, contacts, pairs, settings):
    """Move the cars from a physics step on in which some bodies may touch; see `part`.

    In the first of these steps the cars have been accelerated already.
    """
    num_cars, dt = len(cars), settings.physics_dt
    bodies, boxes, shift, near, touched, scratch = views_of(arrays)
    number = _near(close, cars, obstacles, course, pairs, settings, near)
    near, engaged = near[:number], 0
    for n in range(number):
        touched[n], engaged = 0, engaged | 1 << near[n, 0] | 1 << near[n, 1]
    _set_bodies(engaged, bodies, boxes, cars, obstacles, course, settings)
    for k in range(first, settings.decimation):
        for c in range(num_cars):
            car = cars[c]
            if k > first and not frozen(car):
                _accelerate(car, controls[c], settings, k)
            if (engaged >> c) & 1:
                _write(bodies[c], car.x, car.y, car.yaw)
                _write(bodies[c, 3:], car.velocity_x, car.velocity_y, car.yaw_rate)
        bounce, rub = settings.restitution, settings.friction
        part(bodies, boxes, shift, near, touched, scratch, dt, bounce, rub)
        for c in range(num_cars):
            car = cars[c]
            if frozen(car):
                continue
            if (engaged >> c) & 1:
                car.velocity_x, car.velocity_y = bodies[c, 3], bodies[c, 4]
                car.yaw_rate = bodies[c, 5]
                _move(car, dt, shift[c, 0], shift[c, 1])
            else:
                _move(car, dt, _ZERO, _ZERO)
        for body in range(num_cars, num_cars + len(obstacles)):
            bodies[body, 0] += bodies[body, 3] * dt
            bodies[body, 1] += bodies[body, 4] * dt
    for n in range(number):
        if touched[n]:
            _note(contacts, near[n, 0], near[n, 1], num_cars, len(obstacles))


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
    """Lean the chassis as its springs would, but not for contacts; only cameras read it."""
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
def _may_hit_fixed(car, obstacles, course, settings):
    """Return whether a car may touch a wall or an obstacle in the control step."""
    nearest = min(course.x_max - car.x, car.x - course.x_min)
    nearest = min(nearest, min(course.y_max - car.y, car.y - course.y_min))
    hit = nearest < _reach(car, settings) and not frozen(car)
    for k in range(len(obstacles)):
        hit = hit or _may_hit(car, obstacles[k], settings)
    return hit


@inner
def _close_pairs(cars, pairs, settings):
    """Return which pairs of cars may touch in the control step, as a mask: bit n is pair n."""
    close = 0
    for n in range(len(pairs)):
        if _may_meet(cars[pairs[n, 0]], cars[pairs[n, 1]], settings):
            close |= 1 << n
    return close


@inner
def _some_meet(close, cars, pairs, settings):
    """Return whether `part` would look closer at any of these pairs; it is `_are_apart` there."""
    n = 0
    while close >> n:
        if (close >> n) & 1:
            one, two = cars[pairs[n, 0]], cars[pairs[n, 1]]
            closing = abs(two.velocity_x - one.velocity_x) + abs(two.velocity_y - one.velocity_y)
            closing += abs(one.yaw_rate) * settings.radius + abs(two.yaw_rate) * settings.radius
            room = settings.radius + settings.radius + closing * settings.physics_dt + SLOP
            dx, dy = two.x - one.x, two.y - one.y
            if not dx * dx + dy * dy > room * room:
                return True
        n += 1
    return False


@inner
def _near(close, cars, obstacles, course, pairs, settings, out):
    """Write the pairs of bodies that may touch in the control step; return how many.

    Bodies are numbered: cars, obstacles, then the walls at x_max, x_min, y_max and y_min. `out` is
    set to the pairs, int64 (num_pairs, 2); `close` has those of cars.
    """
    number, num_cars = 0, len(cars)
    for n in range(len(pairs)):
        if (close >> n) & 1:
            out[number, 0], out[number, 1] = pairs[n, 0], pairs[n, 1]
            number += 1
    for k in range(len(obstacles)):
        for c in range(num_cars):
            if _may_hit(cars[c], obstacles[k], settings):
                out[number, 0], out[number, 1] = c, num_cars + k
                number += 1
    for wall in range(NUM_WALLS):
        for c in range(num_cars):
            to_wall = _to_wall(cars[c], course, wall)
            if to_wall < _reach(cars[c], settings) and not frozen(cars[c]):
                out[number, 0], out[number, 1] = c, num_cars + len(obstacles) + wall
                number += 1
    return number


@inner
def _may_meet(one, two, settings):
    # Not by their speed towards each other: what one hits first may stop it within the step.
    room = _reach(one, settings) + _reach(two, settings)
    dx, dy = two.x - one.x, two.y - one.y
    if dx * dx + dy * dy >= room * room:
        return False
    return not (one.ghost or two.ghost or (frozen(one) and frozen(two)))


@inner
def _may_hit(car, thing, settings):
    speed = abs(thing.velocity_x) + abs(thing.velocity_y)
    size = thing.half_length + thing.half_width + speed * settings.step_dt
    room = _reach(car, settings) + size
    dx, dy = car.x - thing.x, car.y - thing.y
    return dx * dx + dy * dy < room * room and not (car.ghost or frozen(car))


@inner
def _reach(car, settings):
    """Return how far from its base a car may touch something within the control step [m]."""
    speed = abs(car.velocity_x) + abs(car.velocity_y)
    return speed * settings.step_dt + REACH_MARGIN + settings.radius


@inner
def _to_wall(car, course, wall):
    if wall == 0:
        return course.x_max - car.x
    if wall == 1:
        return car.x - course.x_min
    if wall == 2:
        return course.y_max - car.y
    return car.y - course.y_min


@inner
def _set_bodies(engaged, bodies, boxes, cars, obstacles, course, settings):
    num_cars, fixed = len(cars), len(cars) + len(obstacles)
    for c in range(num_cars):
        _write(boxes[c], settings.half_length, settings.half_width, _ZERO)
        if frozen(cars[c]):
            _write(boxes[c, 2:], _ZERO, _ZERO, settings.radius)
        else:
            ease = _ONE / cars[c].mass
            _write(boxes[c, 2:], ease, ease / settings.inertia_of_mass, settings.radius)
    for k in range(len(obstacles)):
        thing, row = obstacles[k], num_cars + k
        _write(bodies[row], thing.x, thing.y, thing.yaw)
        _write(bodies[row, 3:], thing.velocity_x, thing.velocity_y, _ZERO)
        _fix(boxes[row], thing.half_length, thing.half_width)
    if not engaged >> fixed:
        return
    middle_x, half_x = (course.x_min + course.x_max) * _HALF, (course.x_max - course.x_min) * _HALF
    middle_y, half_y = (course.y_min + course.y_max) * _HALF, (course.y_max - course.y_min) * _HALF
    for wall in range(NUM_WALLS):
        side = _ONE if wall == 0 or wall == 2 else -_ONE
        row = fixed + wall
        _write(bodies[row, 3:], _ZERO, _ZERO, _ZERO)
        if wall < 2:
            _write(bodies[row], middle_x + side * (half_x + _HALF_WALL), middle_y, _ZERO)
            _fix(boxes[row], _HALF_WALL, half_y + _HALF_WALL)
        else:
            _write(bodies[row], middle_x, middle_y + side * (half_y + _HALF_WALL), _ZERO)
            _fix(boxes[row], half_x + _HALF_WALL, _HALF_WALL)


@inner
def _fix(box, half_length, half_width):
    """Set a box that nothing moves."""
    _write(box, half_length, half_width, _ZERO)
    box[3], box[4] = _ZERO, half_length + half_width


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
