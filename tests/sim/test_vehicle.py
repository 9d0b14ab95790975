import math
from dataclasses import replace

import open_floor
import pytest
import torch

from league.sim.config import CarConfig
from league.sim.vehicle import GRAVITY, forces
from league.sim.world import Motion

CAR = CarConfig()
DT = 1 / 120


def push(sim, now, steering, speed):
    asked = open_floor.control(now, steering, speed)
    return forces(now.motion, asked.steering, asked.speed, now.cars, sim.car, DT)


def driven(steering, speed, steps, **motion):
    """Drive one car in each world; a list entry for each world."""
    sim = open_floor.settings()
    rows = {name: [[value] for value in values] for name, values in motion.items()}
    now = open_floor.world(sim, len(steering), **rows)
    asked = open_floor.control(now, [[s] for s in steering], [[v] for v in speed])
    physics = open_floor.make("planar", sim, len(steering))
    return [outcome.motion for outcome in open_floor.drive(physics, now, asked, steps)]


def energy(motion: Motion):
    linear = motion.velocity_x**2 + motion.velocity_y**2
    return 0.5 * CAR.mass * linear + 0.5 * CAR.yaw_inertia * motion.yaw_rate**2


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_car_at_rest_is_pushed_ahead_by_mass_times_acceleration(num_worlds):
    sim = open_floor.settings()
    # 12 / s times 1 m/s asks for 12 m/s^2, cut to 4: 8.2 kg * 4 m/s^2 = 32.8 N.
    got = push(sim, open_floor.world(sim, num_worlds), [0.0], [1.0])
    torch.testing.assert_close(got.force_x, torch.full((num_worlds, 1), 32.8))
    assert not got.force_y.any() and not got.torque.any()


def test_push_turns_with_the_car():
    sim = open_floor.settings()
    got = push(sim, open_floor.world(sim, yaw=[math.pi / 2]), [0.0], [1.0])
    assert got.force_y.item() == pytest.approx(32.8, rel=1e-5)
    assert got.force_x.item() == pytest.approx(0.0, abs=1e-4)


def test_steering_turns_at_its_rate_towards_the_clipped_target_plus_offset():
    sim = open_floor.settings()
    now = open_floor.world(sim, 3, steering=[[0.0], [0.5], [0.0]])
    now = replace(
        now, cars=replace(now.cars, steering_offset=torch.tensor([[0.0], [0.02], [0.02]]))
    )
    got = push(sim, now, [[2.0], [2.0], [0.0]], [0.0]).steering
    # 7 rad/s for 1/120 s is 0.0583; pi/6 + 0.02 is 0.0436 away from 0.5; 0 + 0.02.
    expected = torch.tensor([[7 / 120], [math.pi / 6 + 0.02], [0.02]])
    torch.testing.assert_close(got, expected)


def test_sideways_sliding_is_resisted_with_all_the_grip():
    sim = open_floor.settings()
    got = push(sim, open_floor.world(sim, velocity_y=[2.0]), [0.0], [0.0])
    # 0.7 * 8.2 kg * 9.81 m/s^2 = 56.31 N against the slide, through the middle.
    assert got.force_y.item() == pytest.approx(-0.7 * 8.2 * GRAVITY, rel=1e-4)
    assert got.torque.item() == pytest.approx(0.0, abs=1e-4)


def test_small_slip_is_resisted_in_proportion_to_cornering_stiffness():
    sim = open_floor.settings()
    got = push(sim, open_floor.world(sim, velocity_x=[2.0], velocity_y=[0.001]), [0.0], [2.0])
    # Slip 0.0005: 12 / rad * 80.44 N * 0.0005 = 0.4827 N, less 0.3 % of the brush's bend.
    assert got.force_y.item() == pytest.approx(-0.4827, rel=0.005)


def test_force_never_exceeds_grip_times_weight():
    sim = open_floor.settings()
    torch.manual_seed(0)
    now = open_floor.world(sim, 2000)
    spread = {
        name: torch.randn_like(now.motion.x) * size
        for name, size in (("velocity_x", 2), ("velocity_y", 2), ("yaw_rate", 8), ("yaw", 2))
    }
    now = replace(now, motion=replace(now.motion, **spread))
    got = forces(now.motion, torch.randn(2000, 1), torch.rand(2000, 1) * 4, now.cars, sim.car, DT)
    size = torch.sqrt(got.force_x**2 + got.force_y**2)
    assert size.max() <= 0.7 * 8.2 * GRAVITY * 1.0001
    assert size.max() > 0.6 * 8.2 * GRAVITY


def test_slow_circle_has_the_radius_of_the_steering():
    last = driven([0.3, 0.5, -0.5], [0.3] * 3, 60)[-1]
    radius = torch.sqrt(last.velocity_x**2 + last.velocity_y**2) / last.yaw_rate
    for got, steering in zip(radius.flatten().tolist(), [0.3, 0.5, -0.5], strict=True):
        # The rear axle's circle is wheelbase / tan(steering); the base rides 0.082 m ahead of it.
        rear = 0.164 / math.tan(steering)
        assert got == pytest.approx(math.copysign(math.hypot(rear, 0.082), steering), rel=0.01)


def test_cornering_reaches_but_never_passes_the_grip():
    steering = [0.02 * step for step in range(1, 26)]
    steady = driven(steering, [2.5] * 25, 90)[-1]
    speed = torch.sqrt(steady.velocity_x**2 + steady.velocity_y**2)
    lateral = speed * steady.yaw_rate / GRAVITY
    assert 0.63 < lateral.max() <= 0.7


def test_car_that_asks_too_much_runs_wide():
    # 3 m/s on 0.3 rad would be 3^2 / 0.53 = 17 m/s^2, 2.5 times what 0.7 g gives.
    first = driven([0.3], [3.0], 8, velocity_x=[3.0])[-1]
    radius = math.hypot(first.velocity_x.item(), first.velocity_y.item()) / first.yaw_rate.item()
    assert radius > 0.8


def test_braking_into_a_turn_spins_the_car():
    flick = driven([0.5], [0.0], 12, velocity_x=[4.0])
    # The nose points more than 90 degrees away from where the car is going.
    away = [
        (torch.cos(m.yaw) * m.velocity_x + torch.sin(m.yaw) * m.velocity_y).item() for m in flick
    ]
    assert min(away) < -0.1


def test_braking_distance_is_the_hand_worked_one():
    motions = driven([0.0], [0.0], 60, velocity_x=[4.0])
    # 5 m/s^2 asked, half by each axle. Load of the rear: 8.2 * (9.81 / 2 - 5 * 0.05 / 0.164) N, so
    # it gives 0.95 * 0.7 * 3.381 = 2.248 m/s^2, the front all its 2.5: 4.748 m/s^2 in all, until
    # the servo eases off below 5 / 12 = 0.417 m/s and rolls out over 0.417 / 12 m.
    expected = (16 - 0.417**2) / (2 * 4.748) + 0.417 / 12
    assert motions[-1].x.item() == pytest.approx(expected, rel=0.015)
    assert abs(motions[-1].velocity_x.item()) < 1e-3


def test_servo_reaches_the_asked_speed_without_passing_it():
    speeds = torch.stack([m.velocity_x for m in driven([0.0], [2.0], 60)])
    assert speeds.max() <= 2.0 + 1e-5
    assert speeds[-1].item() == pytest.approx(2.0, abs=1e-3)


def test_energy_never_grows_without_throttle():
    torch.manual_seed(1)
    size = {"velocity_x": 2.0, "velocity_y": 2.0, "yaw_rate": 10.0, "yaw": 2.0}
    start = {name: (torch.randn(300) * s).tolist() for name, s in size.items()}
    # Where the car rolls backwards, a target of 0 is a throttle: keep those that roll ahead.
    keep = [
        math.cos(yaw) * vx + math.sin(yaw) * vy > 0
        for yaw, vx, vy in zip(start["yaw"], start["velocity_x"], start["velocity_y"], strict=True)
    ]
    start = {
        name: [v for v, k in zip(values, keep, strict=True) if k] for name, values in start.items()
    }
    steering = torch.linspace(-0.5, 0.5, sum(keep)).tolist()
    motions = driven(steering, [0.0] * sum(keep), 30, **start)
    energies = torch.stack([energy(m) for m in motions])
    assert (energies[1:] <= energies[:-1] * (1 + 1e-5) + 1e-7).all()
    assert energies[0].max() > 10


@pytest.mark.parametrize("steering", [0.0, 0.5])
def test_speed_never_grows_without_throttle(steering):
    motions = driven([steering] * 4, [0.1] * 4, 30, velocity_x=[0.5, 1.0, 2.0, 4.0])
    speeds = torch.stack([torch.sqrt(m.velocity_x**2 + m.velocity_y**2) for m in motions])
    # A car that has spun to a stop is driven on to its 0.1 m/s (and the base swings about the rear
    # axle: 0.1 m/s ahead, 0.104 m/s in all); above that nothing may add speed.
    faster = speeds[1:] > speeds[:-1] * (1 + 1e-5)
    assert not (faster & (speeds[1:] > 0.105)).any()


def test_crawling_with_full_steering_does_not_jitter():
    motions = driven([0.5], [0.1], 60)
    rates = torch.stack([m.yaw_rate for m in motions[30:]])
    assert (rates.max() - rates.min()) / rates.mean() < 1e-3


def test_heavier_car_drives_the_same_path():
    sim = open_floor.settings()
    now = open_floor.world(sim, 2)
    now = replace(now, cars=replace(now.cars, mass=torch.tensor([[8.2], [10.0]])))
    asked = open_floor.control(now, [0.3], [3.0])
    last = open_floor.drive(open_floor.make("planar", sim, 2), now, asked, 30)[-1].motion
    assert last.x[1].item() == pytest.approx(last.x[0].item(), abs=1e-4)
    assert last.yaw[1].item() == pytest.approx(last.yaw[0].item(), abs=1e-4)
