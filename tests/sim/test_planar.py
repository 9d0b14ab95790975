import math

import numpy as np
import pytest

from tests.scenes import MOTION, assert_same
from tests.sim import open_floor

BOTH = pytest.mark.parametrize("name", ["planar", "bullet"])


def random_worlds(num_worlds, num_cars):
    """Cars close to each other and to a wall, in all postures; every fifth car is a ghost."""
    sim = open_floor.settings(num_cars)
    now = open_floor.world(sim, num_worlds)
    draw = np.random.default_rng(3)
    shape, cars = now.cars.shape, now.cars
    size = {"x": 0.5, "y": 0.5, "yaw": 2.0, "velocity_x": 2.0, "velocity_y": 2.0, "yaw_rate": 3.0}
    for name, spread in size.items():
        cars[name] = draw.normal(0.0, spread, shape)
    cars["x"] += 20.5 * (np.arange(num_worlds) % 2)[:, None]
    cars["ghost"] = draw.random(shape) < 0.2
    cars["penalty_s"] = draw.random(shape) < 0.2
    cars["mass"] = 8.2 + draw.random(shape)
    cars["grip"] = 0.5 + 0.3 * draw.random(shape)
    cars["latency_s"] = 0.05 * draw.random(shape)
    now = open_floor.with_obstacle(
        now, x=0.3, y=0.2, half_length=0.15, half_width=0.2, velocity_x=0.5
    )
    return sim, now, open_floor.control(now, draw.normal(0, 0.4, shape), 4 * draw.random(shape))


@pytest.mark.parametrize("num_cars", [2, 5])
def test_world_in_a_batch_equals_the_world_alone_bit_for_bit(num_cars):
    sim, now, asked = random_worlds(90, num_cars)
    physics = open_floor.make("planar", sim, 90)
    touched = 0
    for _ in range(4):
        batch = physics(now, asked)
        for index in range(0, 90, 7):
            row = slice(index, index + 1)
            alone = physics(now.row(index), asked[row])
            assert_same(alone.cars, batch.cars[row])
            assert_same(alone.contacts, batch.contacts[row])
        pairs = np.bitwise_count(batch.contacts["cars"]).sum()
        touched += int(pairs + batch.contacts["wall"].sum())
        assert batch.contacts["obstacles"].any()
        now = open_floor.later(now, batch, asked)
    assert touched > 40  # so the bits above went through contacts


def test_physics_changes_nothing_but_motion_and_lean(same):
    sim, now, asked = random_worlds(20, 3)
    outcome = open_floor.make("planar", sim, 20)(now, asked)
    others = [name for name in now.cars.dtype.names if name not in (*MOTION, "roll", "pitch")]
    same(outcome.cars[others], now.cars[others])
    assert not np.array_equal(outcome.cars["x"], now.cars["x"])


@BOTH
@pytest.mark.parametrize("num_worlds", [1, 3])
def test_car_at_rest_stays_exactly_where_it_is(name, num_worlds):
    sim = open_floor.settings()
    now = open_floor.world(sim, num_worlds, x=[0.1], y=[-0.7], yaw=[1.2345])
    asked = open_floor.control(now, [0.0], [0.0])
    last = open_floor.drive(open_floor.make(name, sim, num_worlds), now, asked, 15)[-1].cars
    assert_same(last, now.cars)


@BOTH
def test_mirrored_steering_drives_the_mirrored_path(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, 2, yaw=[[0.3], [-0.3]], velocity_x=[[1.0], [1.0]])
    asked = open_floor.control(now, [[0.4], [-0.4]], [[3.0], [3.0]])
    last = open_floor.drive(open_floor.make(name, sim, 2), now, asked, 30)[-1].cars
    assert abs(last["y"][0, 0]) > 0.2
    for field, sign in (("x", 1), ("y", -1), ("yaw", -1), ("yaw_rate", -1), ("velocity_x", 1)):
        left, right = last[field].ravel().tolist()
        assert right == pytest.approx(sign * left, abs=1e-5), field


@BOTH
def test_swapped_cars_swap_their_results(name):
    sim = open_floor.settings(2)
    now = open_floor.world(
        sim,
        2,
        x=[[0.0, 0.1], [0.1, 0.0]],
        y=[[0.0, 0.25], [0.25, 0.0]],
        velocity_x=[[2.0, 2.2], [2.2, 2.0]],
    )
    asked = open_floor.control(now, [[0.3, -0.1], [-0.1, 0.3]], [2.0, 2.0])
    outcomes = open_floor.drive(open_floor.make(name, sim, 2), now, asked, 15)
    assert any(o.contacts["cars"].any() for o in outcomes)
    for field in MOTION:
        one, other = outcomes[-1].cars[field]
        np.testing.assert_allclose(other[::-1], one, atol=2e-3, rtol=0)


@BOTH
@pytest.mark.parametrize("num_worlds", [1, 3])
def test_head_on_crash_gives_back_the_restitution(name, num_worlds):
    sim = open_floor.settings(2)
    now = open_floor.slippery(
        open_floor.world(sim, num_worlds, x=[0.0, 0.4], velocity_x=[1.0, -1.0])
    )
    outcomes = open_floor.drive(
        open_floor.make(name, sim, num_worlds), now, open_floor.control(now, [0.0], [0.0]), 2
    )
    # Equal masses at +-1 m/s, restitution 0.15: they part at -+0.15 m/s.
    assert outcomes[0].contacts["cars"].tolist() == [[0b10, 0b01]] * num_worlds
    assert not outcomes[1].contacts["cars"].any()
    # In Bullet the noses rise a little, so bases part a little slower than centres of mass.
    slack = 1e-4 if name == "planar" else 0.005
    for speeds in outcomes[1].cars["velocity_x"].tolist():
        assert speeds == pytest.approx([-0.15, 0.15], abs=slack)


@BOTH
def test_crash_conserves_linear_and_angular_momentum(name):
    sim = open_floor.settings(2)
    mass, inertia = np.array([8.2, 10.0]), np.array([0.085, 0.085 * 10.0 / 8.2])
    now = open_floor.world(
        sim,
        x=[0.0, 0.45],
        y=[0.0, 0.08],
        yaw=[0.1, 0.7],
        velocity_x=[1.5, -1.0],
        velocity_y=[0.2, -0.4],
        yaw_rate=[1.0, -2.0],
        mass=mass,
    )
    now = open_floor.slippery(now)
    asked = open_floor.control(now, [0.0], [0.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 4)
    assert any(o.contacts["cars"].any() for o in outcomes)

    def momenta(cars):
        x, y, velocity_x, velocity_y, yaw_rate = (
            cars[field][0].astype(float)
            for field in ("x", "y", "velocity_x", "velocity_y", "yaw_rate")
        )
        spin = mass * (x * velocity_y - y * velocity_x) + inertia * yaw_rate
        return [(mass * velocity_x).sum(), (mass * velocity_y).sum(), spin.sum()]

    last = outcomes[-1].cars
    # In Bullet the cars still lean, so their bases move a little otherwise than their masses.
    slack = 0.01 if name == "planar" else 0.05
    assert momenta(last) == pytest.approx(momenta(now.cars), abs=slack)
    assert abs(last["velocity_x"] - now.cars["velocity_x"]).max() > 0.5


@BOTH
@pytest.mark.parametrize("at", [(20.9, 0.0), (-20.9, 0.0), (0.0, 20.9), (0.0, -20.9)])
def test_walls_hold_a_car_in_the_room(name, at):
    sim = open_floor.settings()
    x, y = at
    now = open_floor.world(sim, x=[x], y=[y], yaw=[math.atan2(y, x)])
    asked = open_floor.control(now, [0.0], [2.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 30)
    assert any(o.contacts["wall"].all() for o in outcomes)
    reach = max(max(abs(o.cars["x"].item()), abs(o.cars["y"].item())) for o in outcomes)
    # The nose is half of 0.324 m ahead of the base.
    assert open_floor.WALL - 0.162 - 0.02 < reach < open_floor.WALL - 0.162 + 0.005


@BOTH
def test_car_in_a_corner_stays_in_the_room(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, x=[20.5], y=[20.5], yaw=[math.pi / 4])
    asked = open_floor.control(now, [0.1], [3.0])
    last = open_floor.drive(open_floor.make(name, sim), now, asked, 45)[-1].cars
    for place in (last["x"].item(), last["y"].item()):
        assert 20.5 < place < open_floor.WALL - 0.09


@BOTH
def test_moving_obstacle_pushes_a_car_along(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, x=[-0.4])
    now = open_floor.with_obstacle(now, half_length=0.15, half_width=0.2, velocity_x=-1.0)
    physics = open_floor.make(name, sim)
    asked = open_floor.control(now, [0.0], [0.0])
    touched = False
    for _ in range(15):
        outcome = physics(now, asked)
        touched |= bool(outcome.contacts["obstacles"].all())
        now = open_floor.later(now, outcome, asked)
        now.obstacles["x"] -= sim.step_dt
    assert touched
    # After 1 s the box's face is at -1.15, the car's tail 0.162 m from its base.
    assert now.cars["x"].item() < -1.15 - 0.162 + 0.01
    assert now.cars["velocity_x"].item() < -0.5


@BOTH
def test_obstacle_is_not_moved_and_stops_the_car(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, velocity_x=[2.0])
    now = open_floor.with_obstacle(now, x=0.6, half_length=0.15, half_width=0.2)
    asked = open_floor.control(now, [0.0], [2.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 20)
    farthest = max(o.cars["x"].item() for o in outcomes)
    # Face at 0.45, nose 0.162 ahead of the base.
    assert 0.45 - 0.162 - 0.02 < farthest < 0.45 - 0.162 + 0.01


@BOTH
def test_ghosts_pass_through_cars_and_obstacles_but_not_walls(name):
    sim = open_floor.settings(2)
    now = open_floor.world(sim, x=[0.0, 0.5], velocity_x=[2.0, 0.0], ghost=[True, False])
    now = open_floor.with_obstacle(now, x=0.9, half_length=0.15, half_width=0.2)
    physics = open_floor.make(name, sim)
    asked = open_floor.control(now, [0.0], [2.0, 0.0])
    outcomes = open_floor.drive(physics, now, asked, 15)
    assert outcomes[-1].cars["x"][0, 0] > 1.8
    assert outcomes[-1].cars["x"][0, 1] == 0.5
    assert not any(o.contacts["cars"].any() or o.contacts["obstacles"].any() for o in outcomes)
    now.cars["x"] = [20.8, 0.5]
    outcomes = open_floor.drive(physics, now, asked, 15)
    assert any(o.contacts["wall"][0, 0] for o in outcomes)
    assert outcomes[-1].cars["x"][0, 0] < open_floor.WALL - 0.16


@BOTH
@pytest.mark.parametrize("ghost", [False, True])
@pytest.mark.parametrize("why", [{"penalty_s": [0.0, 5.0]}, {"retired": [False, True]}])
def test_frozen_car_is_held_at_rest(name, ghost, why):
    sim = open_floor.settings(2)
    now = open_floor.world(
        sim,
        x=[0.0, 0.4],
        velocity_x=[2.0, 1.0],
        yaw_rate=[0.0, 1.0],
        steering=[0.0, 0.2],
        ghost=[False, ghost],
        **why,
    )
    asked = open_floor.control(now, [0.0, -0.3], [2.0, 2.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 10)
    for outcome in outcomes:
        held = [outcome.cars[field][0, 1].item() for field in MOTION]
        assert held == pytest.approx([0.4, 0, 0, 0, 0, 0, 0.2], abs=1e-7)
    stopped = outcomes[-1].cars["x"][0, 0].item() < 0.09
    assert stopped != ghost


@BOTH
def test_latency_lets_the_last_control_act_first(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, 3, latency_s=[[0.0], [4 / 120], [8 / 120]])
    got = open_floor.make(name, sim, 3)(now, open_floor.control(now, [0.0], [4.0])).cars
    # 4 m/s^2 for 8, 4 and none of the 8 physics steps of 1/120 s.
    expected = [32 / 120, 16 / 120, 0.0]
    # In Bullet the nose rises at first, and the base runs ahead of the centre of mass.
    slack = 1e-5 if name == "planar" else 0.02
    assert got["velocity_x"][:, 0].tolist() == pytest.approx(expected, abs=slack)


@BOTH
def test_yaw_is_wrapped(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, 2, yaw=[[3.1], [-3.1]], yaw_rate=[[6.0], [-6.0]])
    now = open_floor.slippery(now)
    got = open_floor.make(name, sim, 2)(now, open_floor.control(now, [0.0], [0.0])).cars
    expected = [3.5 - 2 * math.pi, 2 * math.pi - 3.5]
    assert got["yaw"][:, 0].tolist() == pytest.approx(expected, abs=1e-3)


def test_eight_cars_in_a_pile_up_end_apart():
    sim = open_floor.settings(8)
    turn = [math.tau * k / 8 for k in range(8)]
    now = open_floor.world(
        sim,
        x=[0.9 * math.cos(t) for t in turn],
        y=[0.9 * math.sin(t) for t in turn],
        yaw=[math.remainder(t + math.pi, math.tau) for t in turn],
    )
    asked = open_floor.control(now, [0.02 * k for k in range(8)], [3.0] * 8)
    outcomes = open_floor.drive(open_floor.make("planar", sim), now, asked, 30)
    assert sum(o.contacts["cars"].all() for o in outcomes) > 3
    last = outcomes[-1].cars
    x, y = last["x"], last["y"]
    gaps = np.hypot(x.T - x, y.T - y) + 10 * np.eye(8)
    assert gaps.min() > 0.196 - 0.01
    assert np.isfinite(x).all()
    assert abs(last["yaw_rate"]).max() < 20


def leaning(name, sim, asked, start):
    """Drive a car; return its roll and pitch after each step, (num_steps, 2) [rad]."""
    now = open_floor.world(sim, velocity_x=[start])
    physics, seen = open_floor.make(name, sim), []
    for steering, speed in asked:
        control = open_floor.control(now, [steering], [speed])
        outcome = physics(now, control)
        car = outcome.cars[0, 0]
        seen.append((float(car["roll"]), float(car["pitch"])))
        now = open_floor.later(now, outcome, control)
    return np.array(seen)


@pytest.mark.parametrize(
    ("axis", "asked"),
    [
        pytest.param(0, [(0.1 if k > 8 else 0.0, 2.5) for k in range(40)], id="bend"),
        pytest.param(0, [(0.12 * math.sin(k / 4), 2.5) for k in range(40)], id="slalom"),
        pytest.param(1, [(0.0, 4.0 if k < 14 else 1.0) for k in range(40)], id="brakes"),
        pytest.param(
            1,
            [(0.12 * math.sin(k / 7), 2.5 + math.sin(k / 5)) for k in range(60)],
            id="both",
        ),
    ],
)
def test_cameras_lean_as_on_bullets_springs(axis, asked):
    sim = open_floor.settings()
    flat, sprung = (leaning(name, sim, asked, start=2.5)[:, axis] for name in ("planar", "bullet"))
    assert np.abs(sprung).max() > math.radians(0.8)
    assert np.abs(flat).max() == pytest.approx(np.abs(sprung).max(), rel=0.2)
    # The root of the mean square of how far they are apart.
    assert np.sqrt(np.square(flat - sprung).mean()) < 0.2 * np.sqrt(np.square(sprung).mean())
