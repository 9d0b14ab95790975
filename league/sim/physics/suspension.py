"""Compiled: a car on four sprung wheels: springs, dampers and tyres turned into force and torque.

The road is flat, so how far a spring is compressed follows from the pose of the chassis: each wheel
stands where the chassis' own vertical through its place meets the road. A wheel that hangs free
carries nothing. The state of a chassis is a row of 13 float64: place of the centre of mass [m],
quaternion x, y, z, w, velocity [m/s] and angular velocity [rad/s], all in the world frame. Weight
is one of the forces here, so a car at rest feels exactly none. docs/physics.md has the equations.
"""

import math

import numpy as np

from league.jit import compiled, inner
from league.portable_math import direction, f32, heading_of, wrap_angle
from league.sim.config import CarConfig
from league.sim.physics import vehicle
from league.sim.settings import GRAVITY

LEAST_UPRIGHT = 0.5  # cosine of the lean beyond which no wheel carries the car (60 deg)
STILL, STILL_TURN, STILL_STEP = 0.002, 0.02, 1e-4
"""A car that lies on its body rests when it is slower than this and moved by less in a control step
[m/s, rad/s, m]: contacts alone would let it creep."""
_WHEELS = ((1.0, 1.0), (-1.0, -1.0), (1.0, -1.0), (-1.0, 1.0))
"""Ahead and to the left; diagonal pairs, so that equal loads cancel without rounding."""
_ZERO, _LEAST_LOAD, _HALF, _QUARTER = f32(0.0), f32(1e-3), f32(0.5), f32(0.25)

CHASSIS = np.dtype(
    [
        ("height", np.float64),  # of the centre of mass above the road at rest [m]
        ("stiffness", np.float64),  # of one spring, over the car's mass [1/s^2]
        ("damping", np.float64),  # of one damper, over the car's mass [1/s]
        ("cap", np.float32),  # largest force of a wheel per speed it opposes, over mass [1/s]
    ],
    align=True,
)
"""What the springs and dampers are, as compiled code reads it."""


def chassis(car: CarConfig, dt: float) -> np.ndarray:
    """Return the record of a car's springs and dampers for a physics step dt [s], shape (1,)."""
    height, arm, half_track = car.mass_height, car.wheelbase / 2, car.wheel_track / 2
    # How far a unit of force at the four wheels moves them: sideways or ahead, and in a turn.
    answer = max(
        1 / car.mass + height**2 / min(car.roll_inertia, car.pitch_inertia),
        (arm**2 + half_track**2) / car.yaw_inertia,
    )
    # The quickest motion on the springs; one that changes too much in a step would swing by itself.
    quickest = max(
        1.0,
        car.mass * half_track**2 / car.roll_inertia,
        car.mass * arm**2 / car.pitch_inertia,
    )
    rate = min(2 * math.pi * car.ride_hz, 0.5 / (dt * math.sqrt(quickest)))
    record = np.zeros(1, CHASSIS)
    record["height"] = height
    record["stiffness"] = rate**2 / 4
    record["damping"] = min(2 * car.damping_ratio * rate, 0.5 / (dt * quickest)) / 4
    record["cap"] = 1 / (4 * answer * dt * car.mass)
    return record


@compiled
def place(cars, chassis, bodies):
    """Write the states of the chassis, float64 (num_worlds, num_cars, 13), of CAR records."""
    height = chassis[0].height
    for w in range(cars.shape[0]):
        for c in range(cars.shape[1]):
            car, body = cars[w, c], bodies[w, c]
            _turn(car, body)
            xx, xy, xz, yx, yy, yz, zx, zy, zz = _axes(body)
            body[0] = car.x + zx * height
            body[1] = car.y + zy * height
            body[2] = car.z + zz * height
            roll, pitch, yaw = car.roll_rate, car.pitch_rate, car.yaw_rate
            body[10] = xx * roll + yx * pitch + zx * yaw
            body[11] = xy * roll + yy * pitch + zy * yaw
            body[12] = xz * roll + yz * pitch + zz * yaw
            body[7] = car.velocity_x + (body[11] * zz - body[12] * zy) * height
            body[8] = car.velocity_y + (body[12] * zx - body[10] * zz) * height
            body[9] = car.velocity_z + (body[10] * zy - body[11] * zx) * height


@compiled
def place_boxes(obstacles, up, bodies):
    """Write the states of obstacles, upright, with their middles `up` above the ground [m]."""
    for w in range(obstacles.shape[0]):
        for k in range(obstacles.shape[1]):
            thing, body = obstacles[w, k], bodies[w, k]
            body[:] = 0.0
            body[0], body[1], body[2] = thing.x, thing.y, up
            body[6], body[5] = direction(thing.yaw * _HALF)
            body[7], body[8] = thing.velocity_x, thing.velocity_y


@compiled
def read_back(cars, chassis, placed, bodies):
    """Write where chassis have come to, from `placed` to `bodies`, into cars but frozen ones."""
    height = chassis[0].height
    for w in range(cars.shape[0]):
        for c in range(cars.shape[1]):
            car, body = cars[w, c], bodies[w, c]
            if vehicle.frozen(car):
                continue
            old_x, old_y = _axes(placed[w, c])[:2]
            xx, xy, xz, yx, yy, yz, zx, zy, zz = _axes(body)
            if zz < LEAST_UPRIGHT and _is_still(placed[w, c], body):
                car.velocity_x, car.velocity_y, car.velocity_z = _ZERO, _ZERO, _ZERO
                car.roll_rate, car.pitch_rate, car.yaw_rate = _ZERO, _ZERO, _ZERO
                continue
            # The turn since then is added, so that a car at rest keeps the bits of its heading.
            along, across = old_x * xx + old_y * xy, old_x * xy - old_y * xx
            car.yaw = wrap_angle(car.yaw + heading_of(f32(along), f32(across)))
            car.pitch = heading_of(f32(math.sqrt(yz * yz + zz * zz)), f32(-xz))
            car.roll = heading_of(f32(zz), f32(yz))
            car.x, car.y = f32(body[0] - zx * height), f32(body[1] - zy * height)
            car.z = f32(body[2] - zz * height)
            spin_x, spin_y, spin_z = body[10], body[11], body[12]
            car.velocity_x = f32(body[7] - (spin_y * zz - spin_z * zy) * height)
            car.velocity_y = f32(body[8] - (spin_z * zx - spin_x * zz) * height)
            car.velocity_z = f32(body[9] - (spin_x * zy - spin_y * zx) * height)
            car.roll_rate = f32(spin_x * xx + spin_y * xy + spin_z * xz)
            car.pitch_rate = f32(spin_x * yx + spin_y * yy + spin_z * yz)
            car.yaw_rate = f32(spin_x * zx + spin_y * zy + spin_z * zz)


@compiled
def loads(cars, bodies, controls, sim, chassis, k, out):
    """Turn every car's wheels by physics step `k` of a control step, and write what acts on it.

    Controls are target steering [rad] and speed [m/s], float32 (num_worlds, num_cars, 2); `out` is
    set to force [N] and torque about the centre of mass [N m], world frame, float64 (num_worlds,
    num_cars, 6).
    """
    for w in range(cars.shape[0]):
        for c in range(cars.shape[1]):
            car = cars[w, c]
            if vehicle.frozen(car):
                continue
            late = vehicle.late_steps(car, sim[0]) > k
            speed = car.target_speed if late else controls[w, c, 1]
            target = car.target_steering if late else controls[w, c, 0]
            car.steering = vehicle.steered(car, sim[0], target)
            _load(car, bodies[w, c], sim[0], chassis[0], speed, out[w, c])


@inner
def _load(car, body, settings, chassis, target_speed, out):
    axes = _axes(body)
    xx, xy, zx, zy, zz = axes[0], axes[1], axes[6], axes[7], axes[8]
    height, mass = chassis.height, np.float64(car.mass)
    out[:] = 0.0
    if zz < LEAST_UPRIGHT:
        out[2] = -GRAVITY * mass
        return
    flat = math.sqrt(xx * xx + xy * xy)
    cos, sin = xx / flat, xy / flat
    ahead = cos * (body[7] - (body[11] * zz - body[12] * zy) * height) + sin * (
        body[8] - (body[12] * zx - body[10] * zz) * height
    )
    # Open differentials: each wheel is asked for a quarter of the force.
    asked = vehicle.asked_acceleration(settings, target_speed, f32(ahead)) * car.mass * _QUARTER
    cap, slope = chassis.cap * car.mass, settings.slope_of_grip / car.grip
    steering, share = direction(car.steering), mass * (GRAVITY / 4)
    for front, left in _WHEELS:
        along, across = front * settings.arm, left * settings.half_track
        rx, ry, rz, vx, vy, vz, lift = _foot(body, axes, along, across, height)
        # A spring that hangs free does not pull.
        springs = GRAVITY / 4 - chassis.stiffness * lift - chassis.damping * vz / zz
        load = max(mass * springs, 0.0)
        out[2] += load - share
        if load == 0.0:
            continue
        u, v = _pointing(front, across, 2.0 * settings.arm, steering)
        wheel_x, wheel_y = cos * u - sin * v, sin * u + cos * v
        rolling = f32(vx * wheel_x + vy * wheel_y)
        sliding = f32(vy * wheel_x - vx * wheel_y)
        grip = max(f32(load), _LEAST_LOAD) * car.grip
        drive = vehicle.drive_force(asked, rolling, grip, cap)
        lateral = vehicle.lateral_force(sliding, rolling, drive, grip, slope, cap)
        fx, fy = wheel_x * drive - wheel_y * lateral, wheel_y * drive + wheel_x * lateral
        out[0] += fx
        out[1] += fy
        out[3] += ry * load - rz * fy
        out[4] += rz * fx - rx * load
        out[5] += rx * fy - ry * fx


@inner
def _foot(body, axes, along, across, height):
    """Return where a wheel stands: where the chassis' vertical through its place meets the road.

    The wheel is mounted ahead and to the left of the base, below the centre of mass [m]. Returns
    its place from the centre of mass [m] and the velocity of the chassis there [m/s], x, y, z of
    each in the world frame; and how far the spring is extended [m].
    """
    xx, xy, xz, yx, yy, yz, zx, zy, zz = axes
    rx = xx * along + yx * across - zx * height
    ry = xy * along + yy * across - zy * height
    rz = xz * along + yz * across - zz * height
    lift = (body[2] + rz) / zz
    rx, ry, rz = rx - lift * zx, ry - lift * zy, rz - lift * zz
    vx = body[7] + body[11] * rz - body[12] * ry
    vy = body[8] + body[12] * rx - body[10] * rz
    vz = body[9] + body[10] * ry - body[11] * rx
    return rx, ry, rz, vx, vy, vz, lift


@inner
def _pointing(front, across, wheelbase, steering):
    """Return a wheel's direction, ahead and to the left: all roll about one point (Ackermann)."""
    if front < 0.0:
        return 1.0, 0.0
    cos, sin = steering
    u, v = wheelbase * cos - across * sin, wheelbase * sin
    size = math.sqrt(u * u + v * v)
    return u / size, v / size


@inner
def _is_still(placed, body):
    """Return whether a chassis has come to rest in a control step."""
    moved = _size(body[0] - placed[0], body[1] - placed[1], body[2] - placed[2])
    speed, spin = _size(body[7], body[8], body[9]), _size(body[10], body[11], body[12])
    return moved < STILL_STEP and speed < STILL and spin < STILL_TURN


@inner
def _size(x, y, z):
    return math.sqrt(x * x + y * y + z * z)


@inner
def _turn(car, body):
    """Write the quaternion of yaw, then pitch, then roll."""
    cr, sr = direction(car.roll * _HALF)
    cp, sp = direction(car.pitch * _HALF)
    cy, sy = direction(car.yaw * _HALF)
    x, y = sr * cp * cy - cr * sp * sy, cr * sp * cy + sr * cp * sy
    z, w = cr * cp * sy - sr * sp * cy, cr * cp * cy + sr * sp * sy
    size = math.sqrt(x * x + y * y + z * z + w * w)
    body[3], body[4], body[5], body[6] = x / size, y / size, z / size, w / size


@inner
def _axes(body):
    """Return the chassis' own x, y and z axes in the world frame, one after the other."""
    x, y, z, w = body[3], body[4], body[5], body[6]
    return (
        1.0 - 2.0 * (y * y + z * z),
        2.0 * (x * y + w * z),
        2.0 * (x * z - w * y),
        2.0 * (x * y - w * z),
        1.0 - 2.0 * (x * x + z * z),
        2.0 * (y * z + w * x),
        2.0 * (x * z + w * y),
        2.0 * (y * z - w * x),
        1.0 - 2.0 * (x * x + y * y),
    )
