import math
from dataclasses import fields, replace

import open_floor
import pytest
import torch

from league.sim.world import Control, row

BOTH = pytest.mark.parametrize("name", ["planar", "bullet"])


def random_worlds(num_worlds, num_cars):
    """Cars close to each other and to a wall, in all postures; every third car is a ghost."""
    sim = open_floor.settings(num_cars)
    now = open_floor.world(sim, num_worlds)
    torch.manual_seed(3)
    shape = now.motion.x.shape
    size = {"x": 0.5, "y": 0.5, "yaw": 2.0, "velocity_x": 2.0, "velocity_y": 2.0, "yaw_rate": 3.0}
    motion = replace(now.motion, **{key: torch.randn(shape) * s for key, s in size.items()})
    motion = replace(motion, x=motion.x + 20.5 * (torch.arange(num_worlds) % 2).unsqueeze(1))
    standing = replace(
        now.standing,
        ghost=torch.rand(shape) < 0.2,
        penalty_s=(torch.rand(shape) < 0.2).float(),
    )
    cars = replace(
        now.cars,
        mass=8.2 + torch.rand(shape),
        grip=0.5 + 0.3 * torch.rand(shape),
        latency_s=0.05 * torch.rand(shape),
    )
    now = replace(now, motion=motion, standing=standing, cars=cars)
    now = open_floor.with_obstacle(
        now, x=0.3, y=0.2, half_length=0.15, half_width=0.2, velocity_x=0.5
    )
    return sim, now, Control(torch.randn(shape) * 0.4, torch.rand(shape) * 4)


def assert_same_bits(one, other):
    for item in fields(one):
        assert torch.equal(getattr(one, item.name), getattr(other, item.name)), item.name


@pytest.mark.parametrize("num_cars", [2, 5])
def test_world_in_a_batch_equals_the_world_alone_bit_for_bit(num_cars):
    sim, now, asked = random_worlds(60, num_cars)
    physics = open_floor.make("planar", sim, 60)
    touched = 0
    for _ in range(4):
        batch = physics.step(now, asked)
        for index in range(0, 60, 7):
            alone = physics.step(row(now, index), row(asked, index))
            assert_same_bits(alone.motion, row(batch.motion, index))
            assert_same_bits(alone.contacts, row(batch.contacts, index))
        touched += int(batch.contacts.cars.sum() + batch.contacts.walls.sum())
        assert batch.contacts.obstacles.any()
        now = replace(now, motion=batch.motion, control=asked)
    assert touched > 40  # so the bits above went through contacts


def test_step_leaves_its_inputs_alone():
    sim, now, asked = random_worlds(20, 3)
    kept = [getattr(now.motion, item.name).clone() for item in fields(now.motion)]
    with torch.inference_mode():
        open_floor.make("planar", sim, 20).step(now, asked)
    for item, before in zip(fields(now.motion), kept, strict=True):
        assert torch.equal(getattr(now.motion, item.name), before)


@BOTH
@pytest.mark.parametrize("num_worlds", [1, 3])
def test_car_at_rest_stays_exactly_where_it_is(name, num_worlds):
    sim = open_floor.settings()
    now = open_floor.world(sim, num_worlds, x=[0.1], y=[-0.7], yaw=[1.2345])
    asked = open_floor.control(now, [0.0], [0.0])
    last = open_floor.drive(open_floor.make(name, sim, num_worlds), now, asked, 15)[-1].motion
    assert_same_bits(last, now.motion)


@BOTH
def test_mirrored_steering_drives_the_mirrored_path(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, 2, yaw=[[0.3], [-0.3]], velocity_x=[[1.0], [1.0]])
    asked = open_floor.control(now, [[0.4], [-0.4]], [[3.0], [3.0]])
    last = open_floor.drive(open_floor.make(name, sim, 2), now, asked, 30)[-1].motion
    assert abs(last.y[0].item()) > 0.2
    for field, sign in (("x", 1), ("y", -1), ("yaw", -1), ("yaw_rate", -1), ("velocity_x", 1)):
        left, right = getattr(last, field).flatten().tolist()
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
    assert any(o.contacts.cars.any() for o in outcomes)
    for item in fields(now.motion):
        values = getattr(outcomes[-1].motion, item.name)
        torch.testing.assert_close(values[1].flip(0), values[0], atol=2e-3, rtol=0)


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
    assert outcomes[0].contacts.cars.tolist() == [[[False, True], [True, False]]] * num_worlds
    assert not outcomes[1].contacts.cars.any()
    torch.testing.assert_close(
        outcomes[1].motion.velocity_x,
        open_floor.table([-0.15, 0.15], num_worlds),
        atol=1e-4,
        rtol=0,
    )


@BOTH
def test_crash_conserves_linear_and_angular_momentum(name):
    sim = open_floor.settings(2)
    now = open_floor.world(
        sim,
        x=[0.0, 0.45],
        y=[0.0, 0.08],
        yaw=[0.1, 0.7],
        velocity_x=[1.5, -1.0],
        velocity_y=[0.2, -0.4],
        yaw_rate=[1.0, -2.0],
    )
    now = open_floor.slippery(now)
    mass, inertia = torch.tensor([[8.2, 10.0]]), torch.tensor([[0.085, 0.085 * 10.0 / 8.2]])
    now = replace(now, cars=replace(now.cars, mass=mass))
    asked = open_floor.control(now, [0.0], [0.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 4)
    assert any(o.contacts.cars.any() for o in outcomes)

    def momenta(m):
        spin = mass * (m.x * m.velocity_y - m.y * m.velocity_x) + inertia * m.yaw_rate
        return torch.stack([(mass * m.velocity_x).sum(), (mass * m.velocity_y).sum(), spin.sum()])

    before, after = momenta(now.motion), momenta(outcomes[-1].motion)
    torch.testing.assert_close(after, before, atol=0.01, rtol=0)
    assert (outcomes[-1].motion.velocity_x - now.motion.velocity_x).abs().max() > 0.5


@BOTH
@pytest.mark.parametrize("at", [(20.9, 0.0), (-20.9, 0.0), (0.0, 20.9), (0.0, -20.9)])
def test_walls_hold_a_car_in_the_room(name, at):
    sim = open_floor.settings()
    x, y = at
    now = open_floor.world(sim, x=[x], y=[y], yaw=[math.atan2(y, x)])
    asked = open_floor.control(now, [0.0], [2.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 30)
    assert any(o.contacts.walls.all() for o in outcomes)
    reach = max(max(o.motion.x.abs().item(), o.motion.y.abs().item()) for o in outcomes)
    # The nose is half of 0.324 m ahead of the base.
    assert open_floor.WALL - 0.162 - 0.02 < reach < open_floor.WALL - 0.162 + 0.005


@BOTH
def test_car_in_a_corner_stays_in_the_room(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, x=[20.5], y=[20.5], yaw=[math.pi / 4])
    asked = open_floor.control(now, [0.1], [3.0])
    last = open_floor.drive(open_floor.make(name, sim), now, asked, 45)[-1].motion
    for place in (last.x.item(), last.y.item()):
        assert 20.5 < place < open_floor.WALL - 0.09


@BOTH
def test_moving_obstacle_pushes_a_car_along(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, x=[-0.4])
    body = {"half_length": 0.15, "half_width": 0.2, "velocity_x": -1.0}
    now = open_floor.with_obstacle(now, **body)
    physics = open_floor.make(name, sim)
    asked = open_floor.control(now, [0.0], [0.0])
    touched = False
    for _ in range(15):
        outcome = physics.step(now, asked)
        touched |= bool(outcome.contacts.obstacles.all())
        box = replace(now.obstacles, x=now.obstacles.x - sim.step_dt)
        now = replace(now, motion=outcome.motion, obstacles=box)
    assert touched
    # After 1 s the box's face is at -1.15, the car's tail 0.162 m from its base.
    assert now.motion.x.item() < -1.15 - 0.162 + 0.01
    assert now.motion.velocity_x.item() < -0.5


@BOTH
def test_obstacle_is_not_moved_and_stops_the_car(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, velocity_x=[2.0])
    now = open_floor.with_obstacle(now, x=0.6, half_length=0.15, half_width=0.2)
    asked = open_floor.control(now, [0.0], [2.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 20)
    farthest = max(o.motion.x.item() for o in outcomes)
    # Face at 0.45, nose 0.162 ahead of the base.
    assert 0.45 - 0.162 - 0.02 < farthest < 0.45 - 0.162 + 0.01


@BOTH
def test_ghosts_pass_through_cars_and_obstacles_but_not_walls(name):
    sim = open_floor.settings(2)
    now = open_floor.world(sim, x=[0.0, 0.5], velocity_x=[2.0, 0.0])
    ghost = torch.tensor([[True, False]])
    now = replace(now, standing=replace(now.standing, ghost=ghost))
    now = open_floor.with_obstacle(now, x=0.9, half_length=0.15, half_width=0.2)
    physics = open_floor.make(name, sim)
    outcomes = open_floor.drive(physics, now, open_floor.control(now, [0.0], [2.0, 0.0]), 15)
    assert outcomes[-1].motion.x[0, 0] > 1.8
    assert outcomes[-1].motion.x[0, 1] == 0.5
    assert not any(o.contacts.cars.any() or o.contacts.obstacles.any() for o in outcomes)
    near = replace(now, motion=replace(now.motion, x=torch.tensor([[20.8, 0.5]])))
    outcomes = open_floor.drive(physics, near, open_floor.control(near, [0.0], [2.0, 0.0]), 15)
    assert any(o.contacts.walls[0, 0] for o in outcomes)
    assert outcomes[-1].motion.x[0, 0] < open_floor.WALL - 0.16


@BOTH
@pytest.mark.parametrize("ghost", [False, True])
def test_frozen_car_is_held_at_rest(name, ghost):
    sim = open_floor.settings(2)
    now = open_floor.world(
        sim, x=[0.0, 0.4], velocity_x=[2.0, 1.0], yaw_rate=[0.0, 1.0], steering=[0.0, 0.2]
    )
    standing = replace(
        now.standing,
        penalty_s=torch.tensor([[0.0, 5.0]]),
        ghost=torch.tensor([[False, ghost]]),
    )
    now = replace(now, standing=standing)
    asked = open_floor.control(now, [0.0, -0.3], [2.0, 2.0])
    outcomes = open_floor.drive(open_floor.make(name, sim), now, asked, 10)
    for outcome in outcomes:
        motion = outcome.motion
        held = [getattr(motion, item.name)[0, 1].item() for item in fields(motion)]
        assert held == pytest.approx([0.4, 0, 0, 0, 0, 0, 0.2], abs=1e-7)
    stopped = outcomes[-1].motion.x[0, 0].item() < 0.09
    assert stopped != ghost


@BOTH
def test_latency_lets_the_last_control_act_first(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, 3)
    late = replace(now.cars, latency_s=torch.tensor([[0.0], [4 / 120], [8 / 120]]))
    now = replace(now, cars=late, control=open_floor.control(now, [0.0], [0.0]))
    got = open_floor.make(name, sim, 3).step(now, open_floor.control(now, [0.0], [4.0])).motion
    # 4 m/s^2 for 8, 4 and none of the 8 physics steps of 1/120 s.
    torch.testing.assert_close(
        got.velocity_x, torch.tensor([[32 / 120], [16 / 120], [0.0]]), atol=1e-5, rtol=0
    )


@BOTH
def test_yaw_is_wrapped(name):
    sim = open_floor.settings()
    now = open_floor.world(sim, 2, yaw=[[3.1], [-3.1]], yaw_rate=[[6.0], [-6.0]])
    now = open_floor.slippery(now)
    got = open_floor.make(name, sim, 2).step(now, open_floor.control(now, [0.0], [0.0])).motion
    expected = torch.tensor([[3.5 - 2 * math.pi], [2 * math.pi - 3.5]])
    torch.testing.assert_close(got.yaw, expected, atol=1e-3, rtol=0)


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
    assert sum(o.contacts.cars.any(dim=-1).all().item() for o in outcomes) > 3
    last = outcomes[-1].motion
    gaps = torch.hypot(last.x.T - last.x, last.y.T - last.y) + 10 * torch.eye(8)
    assert gaps.min() > 0.196 - 0.01
    assert torch.isfinite(last.x).all() and last.yaw_rate.abs().max() < 20
