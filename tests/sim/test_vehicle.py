import math

import numpy as np
import pytest

from league.sim.config import CarConfig
from league.sim.settings import GRAVITY
from tests.sim import open_floor

CAR = CarConfig()
HZ = 120


def field(num_worlds=1, **fields):
    """Return the settings of control steps of one physics step, and worlds of one car."""
    sim = open_floor.settings(step_hz=HZ, decimation=1)
    return sim, open_floor.world(sim, num_worlds, **fields)


def push(sim, now, steering, speed):
    """Return the force [N] and torque [N m] on each car, and the new angle of its wheels [rad]."""
    asked = open_floor.control(now, steering, speed)
    after = open_floor.make("planar", sim)(now, asked).cars[:, 0]
    # In a single step without contacts the change of momentum is force times time.
    change = {
        name: after[name].astype(float) - now.cars[name][:, 0]
        for name in ("velocity_x", "velocity_y", "yaw_rate")
    }
    return (
        change["velocity_x"] * CAR.mass * HZ,
        change["velocity_y"] * CAR.mass * HZ,
        change["yaw_rate"] * CAR.yaw_inertia * HZ,
        after["steering"],
    )


def driven(steering, speed, steps, **motion):
    """Drive one car in each world; return each field as (steps, num_worlds)."""
    sim = open_floor.settings()
    rows = {name: [[value] for value in values] for name, values in motion.items()}
    now = open_floor.world(sim, len(steering), **rows)
    asked = open_floor.control(now, [[s] for s in steering], [[v] for v in speed])
    physics = open_floor.make("planar", sim, len(steering))
    outcomes = open_floor.drive(physics, now, asked, steps)
    return np.stack([outcome.cars[:, 0] for outcome in outcomes])


def speeds(cars):
    return np.hypot(cars["velocity_x"], cars["velocity_y"])


def energy(cars):
    return 0.5 * CAR.mass * speeds(cars) ** 2 + 0.5 * CAR.yaw_inertia * cars["yaw_rate"] ** 2


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_car_at_rest_is_pushed_ahead_by_mass_times_acceleration(num_worlds):
    # 12 / s times 1 m/s asks for 12 m/s^2, cut to 4: 8.2 kg * 4 m/s^2 = 32.8 N.
    force_x, force_y, torque, _ = push(*field(num_worlds), [0.0], [1.0])
    assert force_x.tolist() == pytest.approx([32.8] * num_worlds, rel=1e-6)
    assert not force_y.any() and not torque.any()


def test_push_turns_with_the_car():
    force_x, force_y, _, _ = push(*field(yaw=[math.pi / 2]), [0.0], [1.0])
    assert force_y.item() == pytest.approx(32.8, rel=1e-5)
    assert force_x.item() == pytest.approx(0.0, abs=1e-4)


def test_steering_turns_at_its_rate_towards_the_clipped_target_plus_offset():
    sim, now = field(3, steering=[[0.0], [0.5], [0.0]], steering_offset=[[0.0], [0.02], [0.02]])
    steering = push(sim, now, [[2.0], [2.0], [0.0]], [0.0])[3]
    # 7 rad/s for 1/120 s is 0.0583; pi/6 + 0.02 is 0.0436 away from 0.5; 0 + 0.02.
    assert steering.tolist() == pytest.approx([7 / 120, math.pi / 6 + 0.02, 0.02], rel=1e-6)


def test_sideways_sliding_is_resisted_with_all_the_grip():
    _, force_y, torque, _ = push(*field(velocity_y=[2.0]), [0.0], [0.0])
    # 0.7 * 8.2 kg * 9.81 m/s^2 = 56.31 N against the slide, through the middle.
    assert force_y.item() == pytest.approx(-0.7 * 8.2 * GRAVITY, rel=1e-4)
    assert torque.item() == pytest.approx(0.0, abs=1e-4)


def test_small_slip_is_resisted_in_proportion_to_cornering_stiffness():
    _, force_y, _, _ = push(*field(velocity_x=[2.0], velocity_y=[0.001]), [0.0], [2.0])
    # Slip 0.0005: 12 / rad * 80.44 N * 0.0005 = 0.4827 N, less 0.3 % of the brush's bend.
    assert force_y.item() == pytest.approx(-0.4827, rel=0.005)


def test_force_never_exceeds_grip_times_weight():
    sim, now = field(2000)
    draw = np.random.default_rng(0)
    shape = now.cars.shape
    for name, size in (("velocity_x", 2), ("velocity_y", 2), ("yaw_rate", 8), ("yaw", 2)):
        now.cars[name] = draw.normal(0, size, shape)
    force_x, force_y, _, _ = push(sim, now, draw.normal(0, 1, shape), 4 * draw.random(shape))
    size = np.hypot(force_x, force_y)
    assert size.max() <= 0.7 * 8.2 * GRAVITY * 1.0001
    assert size.max() > 0.6 * 8.2 * GRAVITY


def test_slow_circle_has_the_radius_of_the_steering():
    steering = [0.3, 0.5, -0.5]
    last = driven(steering, [0.3] * 3, 60)[-1]
    for got, angle in zip(speeds(last) / last["yaw_rate"], steering, strict=True):
        # The rear axle's circle is wheelbase / tan(steering); the base rides 0.082 m ahead of it.
        rear = 0.164 / math.tan(angle)
        assert got == pytest.approx(math.copysign(math.hypot(rear, 0.082), angle), rel=0.01)


def test_cornering_reaches_but_never_passes_the_grip():
    steering = [0.02 * step for step in range(1, 26)]
    steady = driven(steering, [2.5] * 25, 90)[-1]
    lateral = speeds(steady) * steady["yaw_rate"] / GRAVITY
    assert 0.63 < lateral.max() <= 0.7


def test_car_that_asks_too_much_runs_wide():
    # 3 m/s on 0.3 rad would be 3^2 / 0.53 = 17 m/s^2, 2.5 times what 0.7 g gives.
    last = driven([0.3], [3.0], 8, velocity_x=[3.0])[-1]
    assert speeds(last).item() / last["yaw_rate"].item() > 0.8


def test_braking_into_a_turn_spins_the_car():
    flick = driven([0.5], [0.0], 12, velocity_x=[4.0])
    # The nose points more than 90 degrees away from where the car is going.
    yaw = flick["yaw"]
    away = np.cos(yaw) * flick["velocity_x"] + np.sin(yaw) * flick["velocity_y"]
    assert away.min() < -0.1


def test_braking_distance_is_the_hand_worked_one():
    last = driven([0.0], [0.0], 60, velocity_x=[4.0])[-1]
    # 5 m/s^2 asked, half by each axle. Load of the rear: 8.2 * (9.81 / 2 - 5 * 0.05 / 0.164) N, so
    # it gives 0.95 * 0.7 * 3.381 = 2.248 m/s^2, the front all its 2.5: 4.748 m/s^2 in all, until
    # the servo eases off below 5 / 12 = 0.417 m/s and rolls out over 0.417 / 12 m.
    expected = (16 - 0.417**2) / (2 * 4.748) + 0.417 / 12
    assert last["x"].item() == pytest.approx(expected, rel=0.015)
    assert abs(last["velocity_x"].item()) < 1e-3


def test_servo_reaches_the_asked_speed_without_passing_it():
    found = driven([0.0], [2.0], 60)["velocity_x"]
    assert found.max() <= 2.0 + 1e-5
    assert found[-1].item() == pytest.approx(2.0, abs=1e-3)


def test_energy_never_grows_without_throttle():
    draw = np.random.default_rng(1)
    size = {"velocity_x": 2.0, "velocity_y": 2.0, "yaw_rate": 10.0, "yaw": 2.0}
    first = {name: draw.normal(0, spread, 300) for name, spread in size.items()}
    # Where the car rolls backwards, a target of 0 is a throttle: keep those that roll ahead.
    yaw = first["yaw"]
    keep = np.cos(yaw) * first["velocity_x"] + np.sin(yaw) * first["velocity_y"] > 0
    first = {name: values[keep].tolist() for name, values in first.items()}
    number = int(keep.sum())
    steering = np.linspace(-0.5, 0.5, number).tolist()
    energies = energy(driven(steering, [0.0] * number, 30, **first))
    assert (energies[1:] <= energies[:-1] * (1 + 1e-5) + 1e-7).all()
    assert energies[0].max() > 10


@pytest.mark.parametrize("steering", [0.0, 0.5])
def test_speed_never_grows_without_throttle(steering):
    found = speeds(driven([steering] * 4, [0.1] * 4, 30, velocity_x=[0.5, 1.0, 2.0, 4.0]))
    # A car that has spun to a stop is driven on to its 0.1 m/s (and the base swings about the rear
    # axle: 0.1 m/s ahead, 0.104 m/s in all); above that nothing may add speed.
    faster = found[1:] > found[:-1] * (1 + 1e-5)
    assert not (faster & (found[1:] > 0.105)).any()


def test_crawling_with_full_steering_does_not_jitter():
    rates = driven([0.5], [0.1], 60)["yaw_rate"][30:]
    assert (rates.max() - rates.min()) / rates.mean() < 1e-3


def test_heavier_car_drives_the_same_path():
    last = driven([0.3, 0.3], [3.0, 3.0], 30, mass=[8.2, 10.0])[-1]
    assert last["x"][1] == pytest.approx(last["x"][0], abs=1e-4)
    assert last["yaw"][1] == pytest.approx(last["yaw"][0], abs=1e-4)
