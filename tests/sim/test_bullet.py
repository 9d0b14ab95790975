import subprocess
import sys
from dataclasses import fields, replace

import open_floor
import pytest
import torch

from league.errors import ConfigError
from league.sim.bullet import pybullet
from league.sim.world import row


def crashing(num_worlds=1):
    sim = open_floor.settings(2)
    now = open_floor.world(
        sim, num_worlds, x=[0.0, 0.45], y=[0.0, 0.05], yaw=[0.1, -0.4], velocity_x=[2.0, 0.0]
    )
    return sim, now, open_floor.control(now, [0.2, -0.1], [3.0, 0.5])


def assert_same_bits(one, other):
    for item in fields(one):
        assert torch.equal(getattr(one, item.name), getattr(other, item.name)), item.name


def test_bullet_and_planar_drive_the_same_path_without_contact():
    sim = open_floor.settings(2)
    now = open_floor.world(sim, 3, y=[0.0, 8.0], velocity_x=[[1.0, 4.0], [2.0, 0.0], [3.0, 1.0]])
    asked = open_floor.control(now, [[0.4, -0.1], [0.1, -0.5], [-0.3, 0.2]], [3.5, 1.0])
    ends = [
        open_floor.drive(open_floor.make(name, sim, 3), now, asked, 30)[-1].motion
        for name in ("planar", "bullet")
    ]
    for field in ("x", "y", "yaw"):
        torch.testing.assert_close(
            getattr(ends[0], field), getattr(ends[1], field), atol=1e-3, rtol=0
        )


def test_world_in_a_batch_equals_the_world_alone_bit_for_bit():
    sim, now, asked = crashing(3)
    shifted = now.motion.y + torch.tensor([[0.0, 0.0], [0.0, 0.02], [0.0, -0.03]])
    now = replace(now, motion=replace(now.motion, y=shifted))
    batch = open_floor.drive(open_floor.make("bullet", sim, 3), now, asked, 10)
    for index in range(3):
        alone = open_floor.drive(
            open_floor.make("bullet", sim), row(now, index), row(asked, index), 10
        )
        assert_same_bits(alone[-1].motion, row(batch[-1].motion, index))
    assert any(o.contacts.cars.any() for o in batch)


def test_nothing_of_the_past_remains_after_a_reset():
    sim, now, asked = crashing()
    physics = open_floor.make("bullet", sim)
    first = open_floor.drive(physics, now, asked, 10)
    physics.reset()
    again = open_floor.drive(physics, now, asked, 10)
    fresh = open_floor.drive(open_floor.make("bullet", sim), now, asked, 10)
    for one, two, three in zip(first, again, fresh, strict=True):
        assert_same_bits(one.motion, two.motion)
        assert_same_bits(one.motion, three.motion)
        assert_same_bits(one.contacts, two.contacts)


def test_reset_in_the_middle_of_a_contact_is_as_good_as_a_new_solver():
    sim = open_floor.settings(2)
    now = open_floor.world(sim, y=[0.0, 0.2], velocity_x=[2.0, 2.0])
    asked = open_floor.control(now, [0.2, -0.25], [2.0, 2.5])
    physics = open_floor.make("bullet", sim)
    outcomes = open_floor.drive(physics, now, asked, 10)
    assert outcomes[-1].contacts.cars.any()
    rubbing = replace(now, motion=outcomes[-1].motion)
    physics.reset([0])
    got = open_floor.drive(physics, rubbing, asked, 3)[-1].motion
    expected = open_floor.drive(open_floor.make("bullet", sim), rubbing, asked, 3)[-1].motion
    assert_same_bits(got, expected)


def test_reset_of_one_world_leaves_the_others_alone():
    sim, now, asked = crashing(2)
    physics, untouched = open_floor.make("bullet", sim, 2), open_floor.make("bullet", sim, 2)
    middle = open_floor.drive(physics, now, asked, 3)[-1].motion
    open_floor.drive(untouched, now, asked, 3)
    physics.reset([0])
    later = replace(now, motion=middle)
    got = open_floor.drive(physics, later, asked, 3)[-1].motion
    expected = open_floor.drive(untouched, later, asked, 3)[-1].motion
    assert_same_bits(row(got, 1), row(expected, 1))


def test_world_is_the_truth_where_a_car_was_put_elsewhere():
    sim, now, asked = crashing()
    physics = open_floor.make("bullet", sim)
    open_floor.drive(physics, now, asked, 5)
    elsewhere = open_floor.world(sim, x=[5.0, -5.0], yaw=[2.0, -1.0])
    got = physics.step(elsewhere, open_floor.control(elsewhere, [0.0], [0.0]))
    assert_same_bits(got.motion, elsewhere.motion)
    assert not got.contacts.cars.any()


def test_mass_of_a_car_counts_from_the_first_step():
    sim = open_floor.settings(1)
    now = open_floor.world(sim, velocity_x=[2.0])
    physics, planar = open_floor.make("bullet", sim), open_floor.make("planar", sim)
    for mass in (8.2, 12.0):
        cars = replace(now.cars, mass=torch.tensor([[mass]]), grip=torch.tensor([[0.9]]))
        heavy = replace(now, cars=cars)
        asked = open_floor.control(now, [0.5], [2.0])
        got, expected = physics.step(heavy, asked).motion, planar.step(heavy, asked).motion
        assert got.yaw_rate.item() == pytest.approx(expected.yaw_rate.item(), rel=1e-4)


def test_two_solvers_do_not_know_of_each_other():
    sim, now, asked = crashing()
    alone = open_floor.drive(open_floor.make("bullet", sim), now, asked, 10)[-1].motion
    physics, other = open_floor.make("bullet", sim), open_floor.make("bullet", sim)
    step = now
    for _ in range(10):
        step = replace(step, motion=physics.step(step, asked).motion)
        other.step(now, asked)
        other.reset()
    assert_same_bits(step.motion, alone)


def test_too_many_worlds_are_refused_with_a_reason():
    with pytest.raises(ConfigError, match="planar"):
        open_floor.make("bullet", open_floor.settings(), 5000)


def test_close_is_safe_twice_and_frees_the_simulations():
    physics = open_floor.make("bullet", open_floor.settings(), 2)
    clients = list(physics._clients)
    assert all(pybullet.isConnected(physicsClientId=client) for client in clients)
    physics.close()
    physics.close()
    assert not any(pybullet.isConnected(physicsClientId=client) for client in clients)


def test_importing_bullet_prints_nothing():
    script = "import league.sim.bullet, sys; print('in', file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0
    assert (done.stdout, done.stderr) == ("", "in\n")
