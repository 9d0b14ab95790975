"""Compiled: where cars' cameras are, and what stands where, as tables (tables.py).

Records are float32; what is worked out from them is float64, but for sines and cosines.
"""

import math

import numpy as np

from league.jit import compiled, inner
from league.portable_math import f32, sincos
from league.sim.camera.tables import (
    ACROSS,
    ALONG,
    COS,
    MODEL,
    SHADE,
    SIN,
    STEERING,
    THING_COLUMNS,
    UPWARD,
    X,
    Y,
)
from league.sim.physics.vehicle import frozen

f64 = np.float64


@compiled
def stand(rows, car, cars, obstacles, mount, kinds, box_height, colours, poses, things):
    """Write where the camera of one car is in some worlds, and what it may see there.

    Args:
        rows: the worlds, int64 (num_rows,).
        car: the slot of the car, which does not see itself; -1: no camera, and all cars are seen.
        cars: CAR records of all worlds (num_worlds, num_cars).
        obstacles: OBSTACLE records (num_worlds, num_obstacles).
        mount: how the camera is bolted to the car.
        kinds: the models of cars and of obstacles, by their numbers.
        box_height: height of an obstacle that is no car [m].
        colours: of each car and obstacle, and when it is frozen, as three numbers in the shade and
            three that full sun adds, float64 (num_rows or 1, num_bodies, 2, 6).
        poses: set to the fields of Pose, float64 (num_rows, 9).
        things: set to the cars, by slot, then the obstacles, float64 (num_rows, num_things,
            THING_COLUMNS).
    """
    for n in range(len(rows)):
        w = rows[n]
        if car >= 0:
            _pose(poses[n], cars[w, car], mount)
        shown, count = colours[min(n, len(colours) - 1)], 0
        for c in range(cars.shape[1]):
            if c != car:
                body = cars[w, c]
                colour = shown[c, 1 if frozen(body) else 0]
                _put(things[n, count], kinds[0], body, body.steering, colour)
                count += 1
        for k in range(obstacles.shape[1]):
            body, thing = obstacles[w, k], things[n, count]
            _put(thing, kinds[1], body, f32(0.0), shown[cars.shape[1] + k, 0])
            if kinds[1] != kinds[0]:
                thing[ALONG], thing[ACROSS] = 2 * f64(body.half_length), 2 * f64(body.half_width)
                thing[UPWARD] = box_height
            count += 1


@inner
def _put(thing, model, body, steering, colour):
    """Write a body of its model's own size."""
    thing[MODEL], thing[X], thing[Y], thing[STEERING] = model, body.x, body.y, steering
    thing[COS], thing[SIN] = _direction(body.yaw)
    thing[ALONG], thing[ACROSS], thing[UPWARD] = 1.0, 1.0, 1.0
    for k in range(THING_COLUMNS - SHADE):
        thing[SHADE + k] = colour[k]


@inner
def _direction(angle):
    """Return the cosine and the sine of an angle [rad], rounded to float32, as float64."""
    sine, cosine = sincos(f32(angle))
    return f64(cosine), f64(sine)


@inner
def _pose(pose, car, mount):
    """Write the fields of Pose of a car's camera."""
    x, y, z = f64(car.x), f64(car.y), f64(car.z)
    cos, sin = _direction(car.yaw)
    up = mount.up + f64(car.camera_up)
    tilt_cos, tilt_sin = _direction(mount.pitch + f64(car.camera_pitch))
    if car.roll == 0 and car.pitch == 0:
        pose[0], pose[1] = x + cos * mount.forward, y + sin * mount.forward
        pose[2] = max(up + z, mount.min_height)
        pose[3], pose[4], pose[5], pose[6] = cos, sin, tilt_cos, tilt_sin
        pose[7], pose[8] = 1.0, 0.0
        return
    # The body's axes (ahead, to the left, up) in the frame of its yaw.
    roll_cos, roll_sin = _direction(car.roll)
    pitch_cos, pitch_sin = _direction(car.pitch)
    ahead_axis = pitch_cos, 0.0, -pitch_sin
    left_axis = pitch_sin * roll_sin, roll_cos, pitch_cos * roll_sin
    up_axis = pitch_sin * roll_cos, -roll_sin, pitch_cos * roll_cos
    ahead = mount.forward * ahead_axis[0] + up * up_axis[0]
    left = mount.forward * ahead_axis[1] + up * up_axis[1]
    rise = mount.forward * ahead_axis[2] + up * up_axis[2]
    pose[0], pose[1] = x + cos * ahead - sin * left, y + sin * ahead + cos * left
    sink = mount.half_baseline * abs(left_axis[2])  # of the lower eye below the middle
    pose[2] = max(z + rise, mount.min_height + sink)
    # The view, tilted on the body.
    ahead = tilt_cos * ahead_axis[0] - tilt_sin * up_axis[0]
    left = tilt_cos * ahead_axis[1] - tilt_sin * up_axis[1]
    rise = tilt_cos * ahead_axis[2] - tilt_sin * up_axis[2]
    flat = math.sqrt(ahead * ahead + left * left)
    # The yaw of a view straight up or down is that of the body.
    turn_cos, turn_sin = (ahead / flat, left / flat) if flat > 1e-6 else (1.0, 0.0)
    pose[3], pose[4] = cos * turn_cos - sin * turn_sin, sin * turn_cos + cos * turn_sin
    pose[5], pose[6] = flat, -rise
    # The body's left axis lies across the view: in the plane of a level camera's left and up.
    pose[7] = left_axis[1] * turn_cos - left_axis[0] * turn_sin
    pose[8] = left_axis[2] * flat - (left_axis[0] * turn_cos + left_axis[1] * turn_sin) * rise
