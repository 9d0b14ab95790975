import subprocess
import sys

import numpy as np
import open_floor
import pytest
from scenes import assert_same

from league.errors import ConfigError
from league.sim.bullet import BulletSolver, pybullet


def solver(sim, num_worlds=1) -> BulletSolver:
    return BulletSolver(sim, open_floor.floor().rooms, num_worlds)


def crashing(num_worlds=1):
    sim = open_floor.settings(2)
    now = open_floor.world(
        sim, num_worlds, x=[0.0, 0.45], y=[0.0, 0.05], yaw=[0.1, -0.4], velocity_x=[2.0, 0.0]
    )
    return sim, now, open_floor.control(now, [0.2, -0.1], [3.0, 0.5])


def driven(physics: BulletSolver, now, asked, steps):
    return open_floor.drive(open_floor.bullet(physics), now, asked, steps)


def test_bullet_and_planar_drive_the_same_path_without_contact():
    sim = open_floor.settings(2)
    now = open_floor.world(sim, 3, y=[0.0, 8.0], velocity_x=[[1.0, 4.0], [2.0, 0.0], [3.0, 1.0]])
    asked = open_floor.control(now, [[0.4, -0.1], [0.1, -0.5], [-0.3, 0.2]], [3.5, 1.0])
    planar, bullet = (
        open_floor.drive(open_floor.make(name, sim, 3), now, asked, 30)[-1].cars
        for name in ("planar", "bullet")
    )
    for field in ("x", "y", "yaw"):
        np.testing.assert_allclose(planar[field], bullet[field], atol=1e-3, rtol=0)


def test_world_in_a_batch_equals_the_world_alone_bit_for_bit():
    sim, now, asked = crashing(3)
    now.cars["y"] += np.float32([[0.0, 0.0], [0.0, 0.02], [0.0, -0.03]])
    batch = driven(solver(sim, 3), now, asked, 10)
    for index in range(3):
        row = slice(index, index + 1)
        alone = driven(solver(sim), now.row(index), asked[row], 10)
        assert_same(alone[-1].cars, batch[-1].cars[row])
    assert any(o.contacts["cars"].any() for o in batch)


def test_nothing_of_the_past_remains_after_a_reset():
    sim, now, asked = crashing()
    physics = solver(sim)
    first = driven(physics, now, asked, 10)
    physics.reset()
    again = driven(physics, now, asked, 10)
    assert_same(first, again)
    assert_same(first, driven(solver(sim), now, asked, 10))


def test_reset_in_the_middle_of_a_contact_is_as_good_as_a_new_solver():
    sim = open_floor.settings(2)
    now = open_floor.world(sim, y=[0.0, 0.2], velocity_x=[2.0, 2.0])
    asked = open_floor.control(now, [0.2, -0.25], [2.0, 2.5])
    physics = solver(sim)
    last = driven(physics, now, asked, 10)[-1]
    assert last.contacts["cars"].any()
    rubbing = open_floor.later(now, last, asked)
    physics.reset([0])
    got = driven(physics, rubbing, asked, 3)
    assert_same(got, driven(solver(sim), rubbing, asked, 3))


def test_reset_of_one_world_leaves_the_others_alone():
    sim, now, asked = crashing(2)
    physics, untouched = solver(sim, 2), solver(sim, 2)
    later = open_floor.later(now, driven(physics, now, asked, 3)[-1], asked)
    driven(untouched, now, asked, 3)
    physics.reset([0])
    got, expected = (driven(one, later, asked, 3)[-1].cars for one in (physics, untouched))
    assert_same(got[1], expected[1])


def test_world_is_the_truth_where_a_car_was_put_elsewhere():
    sim, now, asked = crashing()
    physics = solver(sim)
    driven(physics, now, asked, 5)
    elsewhere = open_floor.world(sim, x=[5.0, -5.0], yaw=[2.0, -1.0])
    asked = open_floor.control(elsewhere, [0.0], [0.0])
    got = driven(physics, elsewhere, asked, 1)[-1]
    assert_same(got, driven(solver(sim), elsewhere, asked, 1)[-1])
    for field in ("x", "y", "yaw"):
        np.testing.assert_allclose(got.cars[field], elsewhere.cars[field], atol=1e-6, rtol=0)
    assert not got.contacts["cars"].any()


def test_mass_of_a_car_counts_from_the_first_step():
    sim = open_floor.settings(1)
    physics, planar = solver(sim), open_floor.make("planar", sim)
    for mass in (8.2, 12.0):
        heavy = open_floor.world(sim, velocity_x=[2.0], mass=[mass], grip=[0.9])
        asked = open_floor.control(heavy, [0.5], [2.0])
        got, expected = driven(physics, heavy, asked, 1)[0].cars, planar(heavy, asked).cars
        assert got["yaw_rate"].item() == pytest.approx(expected["yaw_rate"].item(), rel=1e-4)


def test_two_solvers_do_not_know_of_each_other():
    sim, now, asked = crashing()
    alone = driven(solver(sim), now, asked, 10)[-1].cars
    physics, other = solver(sim), solver(sim)
    step = now
    for _ in range(10):
        step = open_floor.later(step, driven(physics, step, asked, 1)[0], asked)
        driven(other, now, asked, 1)
        other.reset()
    assert_same(step.cars[["x", "y", "yaw"]], alone[["x", "y", "yaw"]])


def test_too_many_worlds_are_refused_with_a_reason():
    with pytest.raises(ConfigError, match="planar"):
        solver(open_floor.settings(), 5000)


def test_close_is_safe_twice_and_frees_the_simulations():
    physics = solver(open_floor.settings(), 2)
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
