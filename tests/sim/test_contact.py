import math
from types import SimpleNamespace

import numba
import numpy as np
import pytest

from league.sim.config import ContactConfig
from league.sim.physics import collision, planar
from league.sim.settings import settings
from tests.sim import open_floor

BOX = (0.162, 0.098, 0.0, 0.0)
CAR = (*BOX[:2], 1 / 8.2, 1 / 0.085, math.hypot(*BOX[:2]))


def meet(one, two):
    """Return whether two cars' boxes at x, y, yaw lie opposite, and what `manifold` finds."""
    given = []
    for x, y, yaw in (one, two):
        turn = np.array([math.cos(yaw), math.sin(yaw)], np.float32)
        given += [np.array([x, y, yaw, 0, 0, 0], np.float32), turn, np.array(BOX, np.float32)]
    out = np.zeros(14, np.float32)
    exists = collision.manifold.py_func(*given, out)
    return exists, SimpleNamespace(
        normal=out[:2], gap=out[2:4], first_x=out[4:6], first_y=out[6:8], second_x=out[8:10],
        second_y=out[10:12],
    )  # fmt: skip


def test_boxes_nose_to_tail_touch_at_both_corners():
    exists, m = meet((0, 0, 0), (0.334, 0, 0))
    assert exists and m.normal.tolist() == [1.0, 0.0]
    # 0.334 - 2 * 0.162 = 0.010 apart, all across the width.
    assert m.gap.tolist() == pytest.approx([0.010, 0.010], abs=1e-6)
    assert m.first_x.tolist() == pytest.approx([0.167, 0.167], abs=1e-6)
    assert m.first_y.tolist() == pytest.approx([-0.098, 0.098], abs=1e-6)
    assert m.second_x.tolist() == pytest.approx([-0.167, -0.167], abs=1e-6)


def test_shifted_boxes_side_by_side_touch_where_they_overlap():
    _, m = meet((0, 0, 0), (0.1, -0.19, 0))
    assert m.normal.tolist() == [0.0, -1.0]
    assert m.gap.tolist() == pytest.approx([-0.006, -0.006], abs=1e-6)
    # The faces share x from 0.1 - 0.162 to 0.162.
    assert sorted(m.first_x.tolist()) == pytest.approx([-0.062, 0.162], abs=1e-6)


def test_corner_into_a_side_is_one_deep_point():
    reach = math.hypot(0.162, 0.098)
    corner = math.atan2(0.098, 0.162)
    # The second box stands on its corner, 0.002 m inside the first one's left side.
    _, m = meet((0, 0, 0), (0, 0.098 + reach - 0.002, -math.pi / 2 - corner))
    assert m.normal[1] == pytest.approx(1.0)
    shallow, deep = sorted(m.gap.tolist(), reverse=True)
    assert deep == pytest.approx(-0.002, abs=1e-5)
    assert shallow > 0.05
    # Midway between the corner and the side, above the first box's middle.
    at = m.gap.argmin()
    assert m.first_x[at] == pytest.approx(0.0, abs=1e-5)
    assert m.first_y[at] == pytest.approx(0.098 - 0.001, abs=1e-5)


def test_boxes_past_each_others_corner_have_no_contact():
    exists, _ = meet((0, 0, 0), (0.33, 0.2, 0))
    assert not exists


def test_manifold_turns_with_the_pair():
    turn = 1.1
    c, s = math.cos(turn), math.sin(turn)
    _, flat = meet((0, 0, 0.2), (0.25, 0.12, 0.9))
    _, turned = meet((0, 0, 0.2 + turn), (c * 0.25 - s * 0.12, s * 0.25 + c * 0.12, 0.9 + turn))
    assert turned.gap.tolist() == pytest.approx(flat.gap.tolist(), abs=1e-6)
    x, y = flat.normal
    assert turned.normal.tolist() == pytest.approx([c * x - s * y, s * x + c * y], abs=1e-6)


@pytest.mark.parametrize("num_cars", [2, 3, 5, 8])
def test_schedule_pairs_all_cars_once_and_no_car_twice_in_a_round(num_cars):
    schedule = planar.schedule(num_cars)
    # A round has a pair for each two cars; of an odd number one car pauses.
    for part in schedule.reshape(-1, num_cars // 2 * 2):
        assert len(set(part.tolist())) == len(part)
    pairs = sorted(map(tuple, schedule.tolist()))
    assert pairs == [(a, b) for a in range(num_cars) for b in range(a + 1, num_cars)]


def test_car_alone_has_no_pairs():
    assert planar.schedule(1).shape == (0, 2)


def crash(friction, restitution, steps=16, **motion):
    """Let two cars without grip meet; return them after some physics steps."""
    return met(friction, restitution, steps, **motion).cars[0]


def met(friction, restitution, steps, **motion):
    """Return cars and contacts of the last of some physics steps."""
    contact = ContactConfig(friction, restitution)
    sim = open_floor.settings(2, contact=contact, step_hz=120, decimation=1)
    now = open_floor.slippery(open_floor.world(sim, **motion))
    asked = open_floor.control(now, [0.0], [0.0])
    return open_floor.drive(open_floor.make("planar", sim), now, asked, steps)[-1]


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_restitution_is_the_share_of_speed_that_comes_back(restitution):
    last = crash(0.0, restitution, x=[0.0, 0.4], velocity_x=[1.0, -1.0])
    assert last["velocity_x"].tolist() == pytest.approx([-restitution, restitution], abs=1e-3)


def test_friction_takes_at_most_its_share_of_the_impulse():
    motion = {"y": [0.0, 0.2], "velocity_y": [0.5, -0.5], "velocity_x": [2.0, 0.0]}
    last = crash(0.1, 0.0, steps=1, **motion)
    # Each car's sideways 0.5 m/s is stopped, so 0.1 * 0.5 m/s of speed goes over along the flank.
    assert last["velocity_y"].tolist() == pytest.approx([0.0, 0.0], abs=1e-4)
    assert last["velocity_x"].tolist() == pytest.approx([1.95, 0.05], abs=1e-4)
    # It acts 0.1 m off the middle (midway between the flanks): 8.2 * 0.05 * 0.1 / 0.085 rad/s.
    assert last["yaw_rate"].tolist() == pytest.approx([0.4824, 0.4824], rel=1e-3)


def test_friction_stops_sliding_when_it_can():
    motion = {"y": [0.0, 0.2], "velocity_y": [0.5, -0.5], "velocity_x": [0.1, 0.0]}
    last = crash(0.3, 0.0, steps=1, **motion)
    # The flanks no longer slide on each other where they touch.
    slide = last["velocity_x"] - np.array([0.1, -0.1]) * last["yaw_rate"]
    assert slide[0] == pytest.approx(slide[1], abs=1e-4)


def test_elastic_crash_keeps_the_energy():
    last = crash(0.0, 1.0, x=[0.0, 0.42], y=[0.0, 0.06], yaw=[0.0, 0.5], velocity_x=[1.0, -1.0])
    linear = 0.5 * 8.2 * (last["velocity_x"] ** 2 + last["velocity_y"] ** 2)
    energy = linear + 0.5 * 0.085 * last["yaw_rate"] ** 2
    assert energy.sum() == pytest.approx(8.2, rel=1e-3)
    assert abs(last["yaw_rate"]).max() > 0.5


def overlapping(generator, depth=0.0):
    """Return two places that overlap by a little more than this, and their `manifold`."""
    yaw, way = generator.uniform(-math.pi, math.pi, 2), generator.uniform(-math.pi, math.pi)
    for far in np.arange(0.4, 0.15, -0.0002):
        places = (0.0, 0.0, yaw[0]), (far * math.cos(way), far * math.sin(way), yaw[1])
        exists, m = meet(*places)
        if exists and m.gap.min() < -depth:
            return places, m
    raise AssertionError("they do not meet")


@pytest.mark.parametrize("seed", range(6))
def test_a_car_at_rest_in_another_touches_it_and_is_moved_out(seed):
    (one, two), m = overlapping(np.random.default_rng(seed), depth=0.003)
    x, y, yaw = ([a, b] for a, b in zip(one, two, strict=True))
    last = met(0.3, 0.15, 1, x=x, y=y, yaw=yaw)
    assert last.contacts["cars"].tolist() == [[2, 1]]
    apart = [np.diff(last.cars[name][0] - was).item() for name, was in (("x", x), ("y", y))]
    # A fifth of what is deeper than half a millimetre at the deeper point.
    assert m.normal @ apart == pytest.approx(0.2 * (-m.gap.min() - 0.0005), abs=1e-5)


def parting(cars, m):
    """Return how fast two cars part at both points along the normal [m/s]."""
    first = [
        cars["velocity_x"][0] - cars["yaw_rate"][0] * m.first_y,
        cars["velocity_y"][0] + cars["yaw_rate"][0] * m.first_x,
    ]
    second = [
        cars["velocity_x"][1] - cars["yaw_rate"][1] * m.second_y,
        cars["velocity_y"][1] + cars["yaw_rate"][1] * m.second_x,
    ]
    x, y = second[0] - first[0], second[1] - first[1]
    return x * m.normal[0] + y * m.normal[1]


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("seed", range(12))
def test_points_press_only_as_much_as_parts_them(seed, friction):
    generator = np.random.default_rng(seed)
    (one, two), m = overlapping(generator)
    speeds = {
        "velocity_x": m.normal[0] * np.array([1.0, -0.5]) + generator.normal(0, 0.5, 2),
        "velocity_y": m.normal[1] * np.array([1.0, -0.5]) + generator.normal(0, 0.5, 2),
        "yaw_rate": generator.normal(0, 3.0, 2),
    }
    x, y, yaw = ([a, b] for a, b in zip(one, two, strict=True))
    last = crash(friction, 0.3, steps=1, x=x, y=y, yaw=yaw, **speeds)
    before = parting(speeds, m)
    # Points that would meet within the step bounce, others close their gap at most.
    meets = (before < -0.05) & (m.gap + before / 120 < 0)
    goal = np.where(meets, -0.3 * before, -120 * np.maximum(m.gap, 0))
    short = parting(last, m) - goal
    assert (short > -1e-3).all()
    # The impulses of both points and of friction, from what has changed of the second car.
    way = 8.2 * np.array([last[name][1] - speeds[name][1] for name in ("velocity_x", "velocity_y")])
    turned = 0.085 * (last["yaw_rate"][1] - speeds["yaw_rate"][1])
    across = np.array([-m.normal[1], m.normal[0]])
    near = int(m.gap[0] > m.gap[1])
    arms = m.second_x * m.normal[1] - m.second_y * m.normal[0]
    lever = m.second_x[near] * across[1] - m.second_y[near] * across[0]
    pressed, rubbed = way @ m.normal, way @ across
    pair = np.linalg.solve([[1.0, 1.0], arms], [pressed, turned - lever * rubbed])
    assert (pair > -2e-3).all() and abs(rubbed) <= friction * pressed + 2e-3
    assert pressed > 0.1
    # What presses does so just as much as its point lacks.
    assert (np.minimum(pair, short) < 2e-3).all()


def test_a_heavier_car_is_moved_out_of_the_other_less():
    now = {"y": [0.0, 0.15], "mass": [8.2, 24.6]}
    last = met(0.3, 0.15, 1, **now)
    moved = last.cars["y"][0] - now["y"]
    # 0.046 m of overlap are mended by 5 mm, three quarters of it by the lighter car.
    assert moved.tolist() == pytest.approx([-0.00375, 0.00125], abs=1e-5)


@numba.njit
def worked(bodies, boxes, turn, times, friction):
    """Work a pair of cars that meet some times over; its bodies are changed in place."""
    touch, impulse = np.zeros(14, np.float32), np.zeros(3, np.float32)
    collision.manifold(bodies[0], turn[0], boxes[0], bodies[1], turn[1], boxes[1], touch)
    collision._goals(bodies[0], bodies[1], touch, np.float32(1 / 120), np.float32(0.3))
    for _ in range(times):
        collision._push(bodies, boxes, 0, 1, touch, impulse, friction)


@pytest.mark.parametrize("friction", [0.0, 0.4])
@pytest.mark.parametrize("seed", range(12))
def test_what_was_parted_is_not_pushed_when_it_is_worked_again(seed, friction):
    generator = np.random.default_rng(seed)
    places, m = overlapping(generator)
    bodies = np.zeros((2, 6), np.float32)
    bodies[:, :3], bodies[:, 3:] = places, generator.normal(0.0, [0.5, 0.5, 3.0], (2, 3))
    bodies[:, 3:5] += m.normal * np.array([[1.0], [-0.5]])
    boxes = np.array([CAR] * 2, np.float32)
    turn = np.stack([np.cos(bodies[:, 2]), np.sin(bodies[:, 2])], axis=1)
    once, more = bodies.copy(), bodies.copy()
    worked(once, boxes, turn, 1, np.float32(friction))
    worked(more, boxes, turn, 4, np.float32(friction))
    assert abs(once - bodies).max() > 0.1
    # Where friction at its limit turns a car, both answer each other for longer: 2 % are left.
    assert more == pytest.approx(once, abs=0.06 if (seed, friction) == (10, 0.4) else 1e-4)
    # A physics step works a pair once that shares no car with another one.
    names = "x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate"
    motion = {name: column.tolist() for name, column in zip(names, bodies.T, strict=True)}
    last = crash(friction, 0.3, steps=1, **motion)
    for name, column in zip(names[3:], once.T[3:], strict=True):
        assert last[name] == pytest.approx(column, abs=1e-3)


def test_boxes_put_into_each_other_come_apart_without_speed():
    last = crash(0.3, 0.15, y=[0.0, 0.15])
    # 0.046 m of overlap, mended by 20 % of what is left, 5 mm at most, in each of 16 steps.
    assert last["y"][1] - last["y"][0] > 0.19
    assert not last["velocity_y"].any()


def test_car_pressed_against_a_wall_by_another_stands():
    wall = open_floor.WALL - 0.162
    last = crash(0.0, 0.0, steps=1, x=[wall - 0.3255, wall - 0.0005], velocity_x=[1.0, 0.2])
    # The pair is worked three times, the wall after it each time: 0.6, 0.3, 0.15 m/s are left.
    assert last["velocity_x"].tolist() == pytest.approx([0.15, 0.0], abs=1e-3)


def test_a_car_that_a_wall_stops_is_hit_from_behind_within_the_step():
    sim = open_floor.settings(2)
    front = open_floor.WALL - 0.163
    now = open_floor.slippery(open_floor.world(sim, x=[front - 0.6, front], velocity_x=[4.0, 4.0]))
    asked = open_floor.control(now, [0.0], [4.0])
    last = open_floor.drive(open_floor.make("planar", sim), now, asked, 1)[-1]
    assert last.contacts["wall"][0].tolist() == [False, True]
    assert last.contacts["cars"][0].tolist() == [2, 1]


@numba.njit
def count_near(cars, obstacles, course, pairs, sim):
    room = np.empty((len(pairs) + 4 * len(cars), 2), np.int64)  # four walls, and no obstacles here
    close = planar._close_pairs(cars, pairs, sim)
    return planar._near(close, cars, obstacles, course, pairs, sim, room)


def test_only_bodies_that_may_meet_within_the_step_are_pairs():
    sim = open_floor.settings(3)
    pairs, course = planar.schedule(3), open_floor.floor().courses[0]

    def near(**fields):
        now = open_floor.world(sim, **fields)
        return count_near(now.cars[0], now.obstacles[0], course, pairs, settings(sim)[0])

    assert near(x=[0.0, 1.5, 3.0]) == 0
    assert near(x=[0.0, 0.5, 3.0]) == 1
    assert near(x=[0.0, 0.5, 3.0], ghost=[True, False, False]) == 0
    assert near(x=[0.0, 0.5, 3.0], penalty_s=[1.0, 1.0, 0.0]) == 0
    # 0.38 m of boxes, 0.2 of margin; the rest of 1.5 m is driven in a step of 1/15 s.
    assert near(x=[0.0, 1.5, 8.0], velocity_x=[8.0, -7.0, 0.0]) == 1
    # In a corner there are two walls.
    wall = open_floor.WALL
    assert near(x=[0.0, 3.0, wall - 0.2], y=[0.0, 0.0, 0.2 - wall]) == 2


@numba.njit
def near_and_meeting(cars, obstacles, course, pairs, sim, room):
    """Return how many bodies are near, and whether some cars meet in the physics step."""
    close = planar._close_pairs(cars, pairs, sim)
    number = planar._near(close, cars, obstacles, course, pairs, sim, room)
    return number, planar._some_meet(close, cars, pairs, sim)


@numba.njit
def looked_at(cars, near, sim):
    """Return whether `collision.part` would look closer at any of some pairs of cars."""
    radius, seen = sim.radius, False
    for n in range(len(near)):
        bodies, boxes = np.zeros((2, 6), np.float32), np.zeros((2, 5), np.float32)
        for k in range(2):
            car = cars[near[n, k]]
            bodies[k, 0], bodies[k, 1], bodies[k, 2] = car.x, car.y, car.yaw
            bodies[k, 3], bodies[k, 4], bodies[k, 5] = car.velocity_x, car.velocity_y, car.yaw_rate
            boxes[k, 4] = radius
        dt = sim.physics_dt
        seen = seen or not collision._are_apart(bodies[0], boxes[0], bodies[1], boxes[1], dt)
    return seen


def test_cars_meet_where_boxes_are_looked_at():
    sim, num_cars = open_floor.settings(8), 8
    pairs, course = planar.schedule(num_cars), open_floor.floor().courses[0]
    generator, seen = np.random.default_rng(6), set()
    for width in (0.5, 2.0, 4.0) * 60:
        now = open_floor.world(
            sim,
            x=generator.uniform(-1.0, 1.0, num_cars) * width,
            y=generator.uniform(-0.5, 0.5, num_cars) * width,
            velocity_x=generator.uniform(-3.0, 3.0, num_cars),
            yaw_rate=generator.uniform(-5.0, 5.0, num_cars),
        )
        room = np.zeros((100, 2), np.int64)
        given = now.cars[0], now.obstacles[0], course, pairs, settings(sim)[0]
        near, meet = near_and_meeting(*given, room)
        assert meet == looked_at(now.cars[0], room[:near], settings(sim)[0])
        seen.add((meet, near > 0))
    assert seen == {(True, True), (False, True), (False, False)}


@numba.njit
def skipped(bodies, boxes, turn, dt):
    """Return whether a pair is skipped, and whether it would have touched or lacked speed."""
    touch = np.zeros(14, np.float32)
    apart = collision._are_apart(bodies[0], boxes[0], bodies[1], boxes[1], dt)
    if not collision.manifold(bodies[0], turn[0], boxes[0], bodies[1], turn[1], boxes[1], touch):
        return apart, False
    hit = collision._goals(bodies[0], bodies[1], touch, dt, np.float32(0.3))
    return apart, hit or min(touch[2], touch[3]) <= 0


def test_pairs_that_are_skipped_could_not_have_met():
    generator, counts = np.random.default_rng(5), np.zeros((2, 2), np.int64)
    boxes = np.array([CAR] * 2, np.float32)
    for _ in range(4000):
        bodies = np.zeros((2, 6), np.float32)
        bodies[:, :3] = generator.uniform([-0.3, -0.3, -math.pi], [0.3, 0.3, math.pi], (2, 3))
        bodies[:, 3:] = generator.normal(0.0, [3.0, 3.0, 6.0], (2, 3))
        turn = np.stack([np.cos(bodies[:, 2]), np.sin(bodies[:, 2])], axis=1)
        apart, meets = skipped(bodies, boxes, turn, np.float32(1 / 120))
        counts[int(apart), int(meets)] += 1
    assert counts[1, 1] == 0
    assert counts[1, 0] > 100 and counts[0, 1] > 100


@pytest.mark.parametrize("way", [0.0, math.pi / 2, math.pi])
@pytest.mark.parametrize(
    ("one", "two", "closing"),
    [
        ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0),
        ((4.0, 0.0, 0.0), (-3.0, 0.0, 0.0), 7.0),
        ((0.0, -3.0, 0.0), (0.0, 4.0, 0.0), 7.0),
        ((3.0, 1.0, 0.0), (1.0, 2.0, 0.0), 3.0),  # at most, along x and y together
        # Corners 0.1893 m from the middle, at 10 rad/s.
        ((0.0, 0.0, 10.0), (0.0, 0.0, 0.0), 1.893),
        ((0.0, 0.0, 0.0), (0.0, 0.0, -10.0), 1.893),
    ],
)
def test_pairs_are_skipped_beyond_their_corners_and_what_these_close_in_a_step(
    one, two, closing, way
):
    boxes, turn = np.array([CAR] * 2, np.float32), np.array([[1.0, 0.0]] * 2, np.float32)
    reach = 2 * 0.18934 + closing / 120 + 0.0005
    for more, apart in ((-0.0005, False), (0.0005, True)):
        far = reach + more
        bodies = np.array(
            [[0, 0, 0, *one], [far * math.cos(way), far * math.sin(way), 0, *two]], np.float32
        )
        assert skipped(bodies, boxes, turn, np.float32(1 / 120))[0] == apart
