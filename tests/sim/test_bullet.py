import copy
import hashlib
import math
import subprocess
import sys

import numpy as np
import pytest

from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.sim import records
from league.sim.config import CarConfig, ContactConfig, SimConfig
from league.sim.physics.bullet import BulletSolver, pybullet
from league.track import files
from league.track.track import TrackSet
from tests.scenes import assert_same
from tests.sim.lone import ROOM, WALL, Floor, settings

SAG = 9.81 / (2 * math.pi * CarConfig().ride_hz) ** 2
"""How far a spring is compressed at rest [m]: a wheel that rises by more hangs free."""
HALF_BASE, HALF_TRACK = 0.082, 0.08
MOTION = list(records.CAR.names or ())[:13]


def crashing(num_worlds=1):
    floor = Floor(settings(2), num_worlds)
    return floor.put(x=[0.0, 0.45], y=[0.0, 0.05], yaw=[0.1, -0.4], velocity_x=[2.0, 0.0])


def with_obstacle(**fields):
    floor = Floor(SimConfig(kind="obstacle_avoidance"), num_obstacles=1)
    for name, value in fields.items():
        floor.obstacles[name] = value
    return floor


def outer_and_inner(cars, front=1.0):
    """How far the places of the right and the left wheel of an axle have risen [m]."""
    ahead = -np.sin(cars["pitch"]) * front * HALF_BASE
    side = np.sin(cars["roll"]) * np.cos(cars["pitch"]) * HALF_TRACK
    return cars["z"] + ahead - side, cars["z"] + ahead + side


def test_car_at_rest_keeps_its_bits_for_ten_seconds():
    floor = Floor(settings()).put(x=0.1, y=-0.7, yaw=1.2345)
    before = floor.cars.copy()
    floor.drive(150)
    for name in MOTION:
        assert floor.cars[name] == before[name], name


def test_car_that_has_stopped_stands_still_for_ten_seconds_on_its_wheels():
    floor = Floor(settings()).put(velocity_x=2.0, roll=0.05, pitch=-0.03, z=0.004)
    stopped = floor.drive(45, steering=0.2)[-1]
    later = floor.drive(150, steering=0.2)[-1]
    for name in ("x", "y", "yaw"):
        assert abs(later[name] - stopped[name]) < 1e-5, name
    for name in ("z", "roll", "pitch"):
        assert abs(later[name]) < 1e-6, name


def test_dropped_car_falls_as_things_fall_and_comes_to_rest_on_its_springs():
    seen = Floor(settings()).put(z=1.0).drive(60)[:, 0, 0]
    # Within the first 0.2 s: z = 1 - g t^2 / 2.
    assert seen["z"][2] == pytest.approx(1 - 9.81 * 0.2**2 / 2, abs=0.006)
    assert abs(seen["z"][-1]) < 1e-5


def test_braking_pitches_the_nose_down_and_driving_lifts_it():
    floor = Floor(settings()).put(velocity_x=4.0)
    braking = floor.drive(6)[-1, 0, 0]
    # Torque m a h against four springs of m (2 pi f)^2 / 4 at half a wheelbase, less m g h.
    rate = 2 * math.pi * 6.0
    lean = 0.05 / (rate**2 * HALF_BASE**2 - 9.81 * 0.05)
    assert braking["pitch"] == pytest.approx(5.0 * lean, rel=0.1)
    driving = Floor(settings()).drive(6, speed=4.0)[-1, 0, 0]
    assert driving["pitch"] == pytest.approx(-4.0 * lean, rel=0.1)


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_cornering_leans_the_car_outwards(side):
    floor = Floor(settings()).put(velocity_x=2.0)
    now = floor.drive(30, steering=side * 0.2, speed=2.0)[-1, 0, 0]
    speed = math.hypot(now["velocity_x"], now["velocity_y"])
    rate = 2 * math.pi * 6.0
    lean = speed * now["yaw_rate"] * 0.05 / (rate**2 * HALF_TRACK**2 - 9.81 * 0.05)
    # A left turn (positive) leans to the right (positive).
    assert now["roll"] == pytest.approx(lean, rel=0.05)
    assert side * now["roll"] > 0.025


@pytest.mark.parametrize("height, lifts", [(0.05, False), (0.1, True)])
def test_load_transfer_lifts_the_inner_wheel_of_a_high_car(height, lifts):
    floor = Floor(settings(car=CarConfig(mass_height=height))).put(velocity_x=1.5)
    seen = floor.drive(25, steering=0.3, speed=4.0)[:, 0, 0]
    outer, inner = outer_and_inner(seen)
    assert (inner.max() > SAG) == lifts
    assert outer.max() < SAG
    assert np.abs(seen["roll"]).max() < 0.2


def test_car_with_its_mass_too_high_turns_over_in_a_corner_and_ends_on_its_body():
    floor = Floor(settings(car=CarConfig(mass_height=0.15))).put(velocity_x=3.0)
    seen = floor.drive(60, steering=0.3, speed=3.0)[:, 0, 0]
    assert abs(seen["roll"][-1]) > 1.2
    assert math.hypot(seen["velocity_x"][-1], seen["velocity_y"][-1]) < 0.01
    assert (seen["z"] > -0.02).all()


@pytest.mark.parametrize("roll", [1.57, -1.57, 3.1])
def test_car_on_its_side_or_roof_lies_still_whatever_its_motor_does(roll):
    floor = Floor(settings()).put(roll=roll, z=0.15)
    floor.drive(60, steering=0.2, speed=3.0)
    before = floor.cars.copy()
    floor.drive(30, steering=0.2, speed=3.0)
    for name in MOTION:
        assert name == "steering" or floor.cars[name] == before[name], name
    assert abs(floor.cars["roll"]) > 1.3


@pytest.mark.parametrize("friction", [0.25, 0.3, 0.5])
def test_car_on_its_side_is_immobilised_and_put_back_upright(friction):
    sim = SimConfig(contact=ContactConfig(friction=friction))
    cfg = EnvConfig(sim=sim, solver="bullet")
    env = RaceEnv(TrackSet(files.load("reinvent_2018")), cfg)
    env.reset(seed=1)
    for _ in range(10):
        env.step(np.zeros((1, 1, 2), np.float32))
    cars = env.world.cars
    cars["roll"], cars["z"], cars["velocity_x"], cars["velocity_y"] = 1.5, 0.09, 0.0, 0.0
    for _ in range(30):
        seen = env.step(np.zeros((1, 1, 2), np.float32)).verdicts
        if seen["mistake"]:
            break
        assert cars["roll"].item() > 1.2
    assert seen["immobilised"] and not seen["reversed"]
    assert cars["penalty_s"].item() == pytest.approx(2.0)
    for _ in range(30):
        env.step(np.zeros((1, 1, 2), np.float32))
    assert cars["penalty_s"].item() == 0.0
    upright = {name: cars[name].item() for name in ("z", "roll", "pitch", "velocity_z")}
    assert upright == dict.fromkeys(upright, 0.0)
    env.step(np.zeros((1, 1, 2), np.float32))
    assert abs(cars["roll"].item()) < 0.02 and abs(cars["z"].item()) < 1e-3
    env.close()


def test_cars_that_meet_head_on_climb_each_other():
    floor = Floor(settings(2), 5).put(yaw=[0.0, math.pi], velocity_x=[4.0, -3.6], x=[0.0, 0.45])
    floor.put(y=np.array([[0, -0.06], [0, -0.03], [0, 0], [0, 0.03], [0, 0.06]]))
    seen = floor.drive(45, speed=[4.0, 0.0])
    assert floor.notes["cars"].any(axis=(0, 2)).all()
    assert (seen["z"].max(axis=(0, 2)) > 0.02).sum() >= 3
    assert (seen["pitch"].min(axis=(0, 2)) < -0.2).sum() >= 3


@pytest.mark.parametrize("friction", [0.0, 0.3, 0.6])
def test_friction_between_cars_is_the_coefficient_times_what_presses_them_together(friction):
    sim = settings(2, contact=ContactConfig(friction=friction))
    floor = Floor(sim).put(y=[0.0, 0.2], velocity_x=[2.0, 0.0], velocity_y=[1.0, 0.0], grip=0.05)
    hit = floor.drive(1, speed=[2.0, 0.0])[0, 0, 1]
    # Equal masses: speeds handed over are impulses; the other car's tyres take a little of them.
    assert hit["velocity_y"] > 0.5
    assert hit["velocity_x"] / hit["velocity_y"] == pytest.approx(friction, abs=0.06)


@pytest.mark.parametrize(("gap", "touch"), [(2.0, False), (0.33, True)])
def test_copy_goes_on_to_the_same_bits_unless_cars_touch_or_have_turned(gap, touch):
    floor = Floor(settings(2)).put(x=[-gap, 0.0], y=[0.0, 0.03])
    floor.drive(15, speed=[2.0, 0.5])
    other = copy.deepcopy(floor)
    one, two = floor.drive(1, speed=[2.0, 0.5]), other.drive(1, speed=[2.0, 0.5])
    assert floor.notes["cars"].any() == touch
    assert all((one[name] == two[name]).all() for name in one.dtype.names) != touch
    assert np.abs(one["roll_rate"] - two["roll_rate"]).max() < 0.01


@pytest.mark.parametrize("yaw", [0.5, 1.6, -2.5])
def test_copy_of_a_turned_car_goes_on_nearly_alike(yaw):
    floor = Floor(settings(1)).put(yaw=yaw, velocity_x=2 * math.cos(yaw))
    floor.put(velocity_y=2 * math.sin(yaw)).drive(7, speed=[3.0])
    other = copy.deepcopy(floor)
    one, two = floor.drive(1, speed=[3.0]), other.drive(1, speed=[3.0])
    for name in ("velocity_x", "velocity_y", "yaw_rate", "roll_rate", "pitch_rate"):
        assert one[name] == pytest.approx(two[name], abs=0.002)


def test_car_that_lands_on_another_stands_on_it_and_both_know():
    floor = Floor(settings(2)).put(z=[0.0, 0.3])
    seen = floor.drive(60)[:, 0]
    assert 0.1 < seen["z"][-1, 1] < 0.2
    assert floor.notes["cars"][-1].tolist() == [[2, 1]]


def test_low_box_is_climbed_and_a_high_one_stops_the_car():
    ends = []
    for low in (True, False):
        floor = with_obstacle(x=0.6, half_length=0.1, half_width=0.2)
        if low:
            floor.solver._height = 0.03
        seen = floor.put(velocity_x=3.0).drive(15, speed=3.0)[:, 0, 0]
        assert floor.notes["obstacles"].any()
        ends.append((seen["x"][-1], np.abs(seen["z"]).max()))
    assert ends[0][0] > 1.5 and ends[0][1] > 0.001
    assert ends[1][0] < 0.6 - 0.1 - 0.162 + 0.01


def test_ghosts_pass_through_cars_but_not_walls():
    floor = Floor(settings(2)).put(x=[0.0, 0.5], velocity_x=[2.0, 0.0], ghost=[True, False])
    seen = floor.drive(15, speed=[2.0, 0.0])[:, 0]
    assert seen["x"][-1, 0] > 1.8 and seen["x"][-1, 1] == 0.5
    assert not floor.notes["cars"].any()
    floor.put(x=[WALL - 0.4, 0.5])
    seen = floor.drive(15, speed=[2.0, 0.0])[:, 0]
    assert floor.notes["wall"][:, 0, 0].any()
    assert WALL - 0.2 < seen["x"][:, 0].max() < WALL - 0.16


@pytest.mark.parametrize("lies", [False, True])
def test_frozen_car_cannot_be_pushed(lies):
    floor = Floor(settings(2)).put(x=[0.0, 0.5], velocity_x=[3.0, 1.0], penalty_s=[0.0, 5.0])
    if lies:
        floor.put(roll=[0.0, 1.5], z=[0.0, 0.09])
    held = floor.cars[0, 1].copy()
    seen = floor.drive(15, speed=3.0)[:, 0]
    assert floor.notes["cars"].any()
    for name in ("x", "y", "z", "yaw", "roll", "pitch"):
        assert (seen[name][:, 1] == held[name]).all(), name
    assert seen["velocity_x"][-1, 1] == 0.0
    # Bumper to bumper is 0.176; against a car that gives way it comes to 0.29.
    assert seen["x"][:, 0].max() < 0.22


def test_contacts_name_cars_obstacles_and_walls_and_not_the_ground():
    floor = crashing()
    floor.drive(6, speed=2.0)
    assert set(floor.notes["cars"][:, 0, 0].tolist()) == {0, 2}
    assert (floor.notes["cars"][:, 0, 1] == floor.notes["cars"][:, 0, 0] // 2).all()
    assert not floor.notes["wall"].any() and not floor.notes["obstacles"].any()
    floor = with_obstacle(x=0.6, half_length=0.15, half_width=0.2).put(velocity_x=2.0)
    floor.drive(10, speed=2.0)
    assert set(floor.notes["obstacles"][:, 0, 0].tolist()) == {0, 1}
    lying = Floor(settings()).put(roll=3.1, z=0.15)
    lying.drive(10)
    assert lying.cars["z"].item() == pytest.approx(0.194, abs=0.01)
    assert not lying.notes["wall"].any()


def test_moving_obstacle_pushes_a_car_along():
    floor = with_obstacle(half_length=0.15, half_width=0.2, velocity_x=-1.0).put(x=-0.4)
    for _ in range(15):
        floor.drive(1)
        floor.obstacles["x"] -= floor.sim.step_dt
    # After 1 s the box's face is at -1.15, the car's tail 0.162 m from its base.
    assert floor.cars["x"].item() < -1.15 - 0.162 + 0.01


@pytest.mark.parametrize("restitution", [0.15, 0.6])
def test_restitution_is_the_share_of_the_approach_that_comes_back(restitution):
    # The shell's middle is as high as the centre of mass, so the wall does not turn the car.
    height = 0.025 + 0.39 * (0.194 - 0.025)
    floor = Floor(
        settings(car=CarConfig(mass_height=height), contact=ContactConfig(restitution=restitution))
    ).put(x=WALL - 0.3, velocity_x=2.0, grip=1e-9)
    floor.drive(4)
    assert floor.notes["wall"].any()
    assert floor.cars["velocity_x"].item() == pytest.approx(-2.0 * restitution, rel=0.05)


@pytest.mark.parametrize("friction", [0.2, 0.4])
def test_friction_slows_a_car_that_slides_on_its_roof(friction):
    floor = Floor(settings(contact=ContactConfig(friction=friction))).put(roll=math.pi, z=0.194)
    floor.drive(15)
    floor.put(velocity_y=2.0)
    floor.drive(3)
    # 0.2 s at friction times g; the cabin is so wide that the car does not trip over its edge.
    lost = 2.0 - floor.cars["velocity_y"].item()
    assert lost == pytest.approx(friction * 9.81 * 0.2, rel=0.05)


def test_crash_conserves_momentum_in_the_plane():
    floor = Floor(settings(2)).put(
        x=[0.0, 0.45], y=[0.0, 0.08], yaw=[0.1, 0.7], velocity_x=[1.5, -1.0], grip=1e-9
    )
    floor.put(mass=[8.2, 10.0], velocity_y=[0.2, -0.4], yaw_rate=[1.0, -2.0])
    # On the way of the centre of mass; velocity of the base differs while the car leans.
    before, mass = floor.cars[0].copy(), floor.cars["mass"][0]
    floor.drive(30)
    assert floor.notes["cars"].any()
    after = floor.cars[0]
    for name in ("velocity_x", "velocity_y"):
        lost = (mass * (after[name] - before[name])).sum()
        assert abs(lost) < 0.02, name


def test_mass_of_a_car_counts_from_the_first_step():
    for mass in (8.2, 16.4):
        floor = Floor(settings(2)).put(x=[0.0, 0.4], velocity_x=[2.0, 0.0], grip=1e-9)
        floor.put(mass=[8.2, mass])
        floor.drive(15)
        # Momentum is shared by the masses; the light car keeps less.
        total = 8.2 * floor.cars["velocity_x"][0, 0] + mass * floor.cars["velocity_x"][0, 1]
        assert total == pytest.approx(8.2 * 2.0, abs=0.1)


def test_spring_rates_hold_with_few_physics_steps():
    floor = Floor(settings(decimation=1)).put(velocity_x=2.0)
    seen = floor.drive(45, steering=0.2, speed=2.0)[:, 0, 0]
    finer = Floor(settings()).put(velocity_x=2.0).drive(45, steering=0.2, speed=2.0)[:, 0, 0]
    assert np.abs(seen["roll"] - finer["roll"]).max() < 0.01


@pytest.mark.parametrize("decimation", [1, 8])
def test_hard_springs_and_light_bodies_do_not_swing_by_themselves(decimation):
    car = CarConfig(ride_hz=20.0, damping_ratio=2.0, roll_inertia=0.002, pitch_inertia=0.002)
    floor = Floor(settings(car=car, decimation=decimation)).put(roll=0.02, velocity_x=2.0)
    floor.drive(30, steering=0.1, speed=2.0)
    seen = floor.drive(45)[:, 0, 0]
    assert np.abs(seen["roll"][-15:]).max() < 1e-3 and np.abs(seen["z"][-15:]).max() < 1e-4


def test_world_in_a_batch_equals_the_world_alone_bit_for_bit():
    floor = crashing(3)
    floor.cars["y"] += np.array([[0, 0], [0, 0.02], [0, -0.03]], np.float32)
    begun = floor.cars.copy()
    batch = floor.drive(20, [0.2, -0.1], [3.0, 0.5])
    assert floor.notes["cars"].any()
    for index in range(3):
        alone = crashing()
        alone.cars[:] = begun[index]
        assert_same(alone.drive(20, [0.2, -0.1], [3.0, 0.5])[:, 0], batch[:, index])


def test_nothing_of_the_past_remains_after_a_reset():
    floor = crashing()
    begun = floor.cars.copy()
    first = floor.drive(20, [0.2, -0.1], [3.0, 0.5])
    floor.cars[:] = begun
    floor.solver.reset()
    assert_same(floor.drive(20, [0.2, -0.1], [3.0, 0.5]), first)
    assert_same(crashing().drive(20, [0.2, -0.1], [3.0, 0.5]), first)


def test_reset_in_the_middle_of_a_contact_is_as_good_as_a_new_solver():
    floor = Floor(settings(2)).put(y=[0.0, 0.2], velocity_x=2.0)
    floor.drive(10, [0.2, -0.25], [2.0, 2.5])
    assert floor.touched["cars"].any()
    fresh = Floor(settings(2))
    fresh.cars[:] = floor.cars
    floor.solver.reset([0])
    got = floor.drive(5, [0.2, -0.25], [2.0, 2.5])
    assert_same(got, fresh.drive(5, [0.2, -0.25], [2.0, 2.5]))


def test_reset_of_one_world_leaves_the_others_alone():
    floor, untouched = crashing(2), crashing(2)
    floor.drive(3, speed=2.0)
    untouched.drive(3, speed=2.0)
    floor.solver.reset([0])
    assert_same(floor.drive(3, speed=2.0)[:, 1], untouched.drive(3, speed=2.0)[:, 1])


def test_records_are_the_truth_where_a_car_was_put_elsewhere():
    floor = crashing()
    floor.drive(5, speed=2.0)
    floor.cars[MOTION] = np.zeros(1, records.CAR)[MOTION]
    floor.put(x=[5.0, -5.0], yaw=[2.0, -1.0])
    before = floor.cars.copy()
    floor.drive(1)
    for name in MOTION:
        assert (floor.cars[name] == before[name]).all(), name
    assert not floor.touched["cars"].any()


DIGEST = """
import hashlib
from tests.sim.lone import Floor, settings
floor = Floor(settings(2)).put(y=[0.0, 0.2], velocity_x=[3.0, 3.5], roll=[0.1, 0.0])
seen = floor.drive(40, [0.3, -0.3], [3.0, 4.0])
bits = seen["x"].tobytes() + seen["roll"].tobytes()
print(floor.notes["cars"].any(), hashlib.sha256(bits).hexdigest())
"""


def test_same_start_gives_the_same_bits_here_and_in_a_fresh_process():
    floor = Floor(settings(2)).put(y=[0.0, 0.2], velocity_x=[3.0, 3.5], roll=[0.1, 0.0])
    seen = floor.drive(40, [0.3, -0.3], [3.0, 4.0])
    again = Floor(settings(2)).put(y=[0.0, 0.2], velocity_x=[3.0, 3.5], roll=[0.1, 0.0])
    assert_same(again.drive(40, [0.3, -0.3], [3.0, 4.0]), seen)
    paths = repr([path for path in sys.path if path])
    outputs = [
        subprocess.run(
            [sys.executable, "-c", f"import sys; sys.path[:0] = {paths}\n" + DIGEST],
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for _ in range(2)
    ]
    here = hashlib.sha256(seen["x"].tobytes() + seen["roll"].tobytes()).hexdigest()
    assert outputs[0] == outputs[1] == f"True {here}\n"


@pytest.mark.parametrize(
    ("yaw", "stops"),
    [(0.0, 111.0 - 0.162), (math.pi, 103.0 + 0.162), (math.pi / 2, 42.0 - 0.162),
     (-math.pi / 2, 38.0 + 0.162)],
)  # fmt: skip
def test_walls_stand_round_a_room_wherever_it_lies(yaw, stops):
    floor = Floor(settings()).put(yaw=yaw)
    floor.solver = BulletSolver(floor.sim, np.array([[103.0, 38.0, 111.0, 42.0]]), 1)
    along = "x" if yaw in (0.0, math.pi) else "y"
    # Where the walls along the way end, and far from the middle, too.
    for across in (0.15, 0.5, 0.85):
        floor.put(velocity_x=0.0, velocity_y=0.0, yaw=yaw, yaw_rate=0.0, roll=0.0, pitch=0.0, z=0.0)
        floor.put(x=103.0 + 8.0 * across, y=38.0 + 4.0 * across)
        floor.put(**{along: stops - 0.3 * math.copysign(1.0, math.cos(yaw) + math.sin(yaw))})
        floor.drive(15, speed=1.0)
        assert floor.notes["wall"].any()
        assert floor.cars[along].item() == pytest.approx(stops, abs=0.01)


def test_too_many_worlds_are_refused_with_a_reason():
    with pytest.raises(ConfigError, match="planar"):
        BulletSolver(settings(), ROOM, 5000)


def test_body_without_height_is_refused_with_a_reason():
    with pytest.raises(ConfigError, match="clearance"):
        CarConfig(clearance=0.2)
    with pytest.raises(ConfigError, match="roll_inertia"):
        CarConfig(roll_inertia=1e-5)


def test_close_is_safe_twice_and_frees_the_simulations():
    solver = BulletSolver(settings(), ROOM, 2)
    clients = list(solver._clients)
    assert all(pybullet.isConnected(physicsClientId=client) for client in clients)
    solver.close()
    solver.close()
    assert not any(pybullet.isConnected(physicsClientId=client) for client in clients)


def test_importing_bullet_prints_nothing():
    script = "import league.sim.physics.bullet, sys; print('in', file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0
    assert (done.stdout, done.stderr) == ("", "in\n")
