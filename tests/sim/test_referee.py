"""The rules, one by one, on a ring of 12 m and a straight of 10 m, with hand-worked numbers.

Who is to blame here: the rear car, as in DeepRacer, unless a test says otherwise; the rules of this
league about that are in test_blame.py.
"""

from dataclasses import replace

import numpy as np
import pytest

from league.sim import referee
from league.sim.config import RULES, ObstacleConfig, RaceRules, SimConfig
from league.sim.records import NOBODY, World, members
from league.track.track import TrackSet
from tests.scenes import MOTION, Stages, assert_same, go_to, make_ring, put_cars, touch

ALONE = SimConfig(kind="time_trial", num_cars=1)


def head_to_head(num_cars: int = 2, **rules) -> SimConfig:
    asked = replace(RULES["deepracer"], **rules)
    return SimConfig(kind="head_to_head", num_cars=num_cars, rules=asked)


def with_obstacles(kind: str = "box", *, place: float = 0.5, lane: float = 1.0) -> SimConfig:
    things = ObstacleConfig(count=1, kind=kind, places=((place, lane),), lane_change=False)
    return SimConfig(kind="obstacle_avoidance", num_cars=1, obstacles=things)


def judged(tracks, sim, before, places, contacts=None, speed=1.0):
    """Return the verdict and the world after the cars went to these places."""
    after = go_to(tracks, before, places, speed=speed)
    return Stages(tracks, sim).judge(before, after, contacts)


def raced(tracks, sim, before, places, contacts=None, speed=1.0):
    """Return the verdict and the world after penalties, as in a race."""
    verdict, world = judged(tracks, sim, before, places, contacts, speed)
    return verdict, Stages(tracks, sim).settle(world, verdict)


def stay(tracks, sim, world: World) -> tuple[np.ndarray, World]:
    """Return what a step brings in which no car moves."""
    stages = Stages(tracks, sim)
    verdict, world = stages.judge(world, world)
    return verdict, stages.settle(world, verdict)


def passes(verdict: np.ndarray) -> list[list[int]]:
    """Return (car, car it passed) of the first world."""
    return np.argwhere(members(verdict["overtook"][0], verdict.shape[1])).tolist()


def cars_that(flags: np.ndarray) -> list[int]:
    """Return the cars of one world for which this holds."""
    return np.flatnonzero(flags).tolist()


# Off the track.


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(("beyond", "off"), [(0.079, False), (0.081, True)])
def test_off_track_begins_when_the_last_wheel_has_left(straight, num_worlds, side, beyond, off):
    # Border 0.4 m from the centre, wheels 0.08 m from the middle of the car.
    tracks = straight()
    before = put_cars(tracks, ALONE, [(3.0, side * 0.4)], num_worlds=num_worlds)
    verdict, world = judged(tracks, ALONE, before, [(3.1, side * (0.4 + beyond))])
    assert verdict["off_track"].tolist() == [[off]] * num_worlds
    assert world.cars["off_tracks"].tolist() == [[int(off)]] * num_worlds


def test_one_wheel_on_the_road_is_enough_for_a_car_that_stands_across(straight):
    # Across the track the axles lie 0.082 m before and behind the middle.
    tracks = straight()
    before = put_cars(tracks, ALONE, [(3.0, 0.4)])
    across = go_to(tracks, before, [(3.0, 0.481)])
    across.cars["yaw"] = np.pi / 2
    verdict, _ = Stages(tracks, ALONE).judge(before, across)
    assert not verdict["off_track"]


def test_wheels_stand_at_the_corners_of_wheelbase_and_wheel_track(straight):
    world = put_cars(straight(), ALONE, [(3.0, 0.1)])
    arm, half_track = ALONE.car.wheelbase / 2, ALONE.car.wheel_track / 2
    x, y = np.moveaxis(referee.wheel_positions(arm, half_track, world.cars), 3, 0)
    assert x[0, 0].tolist() == pytest.approx([3.082, 3.082, 2.918, 2.918], abs=1e-5)
    assert y[0, 0].tolist() == pytest.approx([0.18, 0.02, 0.18, 0.02], abs=1e-5)


def test_wheels_of_a_car_across_the_track_stand_across_it(straight):
    # The track runs along x, so the base's axles lie 0.082 m to either side of it.
    world = put_cars(straight(), ALONE, [(3.0, 0.1)])
    world.cars["yaw"] = np.pi / 2
    arm, half_track = ALONE.car.wheelbase / 2, ALONE.car.wheel_track / 2
    x, y = np.moveaxis(referee.wheel_positions(arm, half_track, world.cars), 3, 0)
    assert x[0, 0].tolist() == pytest.approx([2.92, 3.08, 2.92, 3.08], abs=1e-5)
    assert y[0, 0].tolist() == pytest.approx([0.182, 0.182, 0.018, 0.018], abs=1e-5)


def test_off_track_car_is_frozen_where_it_stands_then_put_on_the_nearer_lane(ring):
    tracks = ring()
    before = put_cars(tracks, ALONE, [(3.0, -0.3)])
    verdict, world = raced(tracks, ALONE, before, [(3.2, -0.5)])
    assert verdict["off_track"]
    assert world.cars["ghost"]
    left_at = world.cars[MOTION]
    for _ in range(29):
        verdict, world = stay(tracks, ALONE, world)
        assert not verdict["released"]
        assert_same(world.cars[MOTION], left_at)
    verdict, world = stay(tracks, ALONE, world)
    assert verdict["released"]
    # Nearer lane: half way between centre and right border, on the very s where it left.
    place = tracks.project(world.track, world.cars["x"], world.cars["y"])
    assert place.lateral.item() == pytest.approx(-0.2, abs=1e-3)
    assert place.s.item() == pytest.approx(3.2, abs=1e-3)
    assert world.cars["distance"].item() == pytest.approx(3.2, abs=1e-3)
    assert world.cars["velocity_x"].item() == world.cars["velocity_y"].item() == 0
    assert not world.cars["ghost"]


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize(
    ("seconds", "steps"), [(2.0, 30), (5.0, 75), (0.0, 1), (1.0, 15), (0.2, 3), (60.0, 900)]
)
def test_penalty_is_stood_for_exactly_its_steps(straight, num_worlds, seconds, steps):
    tracks, sim = straight(), SimConfig(rules=RaceRules(off_track_penalty_s=seconds))
    before = put_cars(tracks, sim, [(3.0, 0.4)], num_worlds=num_worlds)
    _, world = raced(tracks, sim, before, [(3.1, 0.5)])
    frozen = 0
    while (world.cars["penalty_s"] > 0).all():
        verdict, world = Stages(tracks, sim).judge(world, world)
        frozen += 1
    assert frozen == steps
    assert verdict["released"].all()
    assert not (world.cars["penalty_s"] > 0).any()


def test_retired_car_stays_a_ghost_and_is_never_released(ring):
    tracks, sim = ring(), head_to_head(off_track_penalty_s=0.2)
    world = put_cars(tracks, sim, [(3.0, 0.2), (6.0, 0.2)])
    world.cars["retired"], world.cars["ghost"] = [True, False], [True, False]
    world.cars["penalty_s"] = 0.2
    for _ in range(5):
        verdict, world = stay(tracks, sim, world)
        assert not verdict["released"][0, 0]
        assert world.cars["ghost"].tolist() == [[True, bool((world.cars["penalty_s"] > 0)[0, 1])]]
    assert world.cars["still_steps"].tolist() == [[0, 2]]


def test_frozen_car_beyond_the_middle_of_a_hairpin_keeps_its_place():
    # A ring of 0.477 m radius: from beyond its middle the nearest point of the road is elsewhere.
    tracks = TrackSet(make_ring(points=60, width=0.6))
    before = put_cars(tracks, ALONE, [(1.0, 0.3)])
    _, world = raced(tracks, ALONE, before, [(1.1, 0.6)])
    kept = world.cars
    assert kept["penalty_s"].item() == 2.0
    for _ in range(29):
        _, world = stay(tracks, ALONE, world)
        assert world.cars["s"].item() == kept["s"].item()
        assert world.cars["distance"].item() == kept["distance"].item()


# Contacts.


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize(
    ("places", "rear"),
    [
        ([(3.0, 0.0), (3.3, 0.0)], 0),
        ([(3.3, 0.0), (3.0, 0.0)], 1),
        ([(11.9, 0.0), (12.2, 0.1)], 0),  # across the start line
        ([(3.00, 0.1), (3.01, -0.1)], 0),  # almost side by side
    ],
)
def test_rear_car_is_to_blame(ring, num_worlds, places, rear):
    tracks, sim = ring(), head_to_head()
    before = put_cars(tracks, sim, [(s - 0.05, y) for s, y in places], num_worlds=num_worlds)
    verdict, world = judged(tracks, sim, before, places, touch(before, (0, 1)))
    front = 1 - rear
    for row in range(num_worlds):
        assert cars_that(verdict["crashed"][row]) == [rear]
        assert cars_that(verdict["was_hit"][row]) == [front]
        assert verdict["crashed_car"][row, rear] == front
    assert world.cars["crashes"].sum() == world.cars["contacts_taken"].sum() == num_worlds


def test_nobody_is_to_blame_exactly_side_by_side(straight):
    tracks, sim = straight(), head_to_head()
    before = put_cars(tracks, sim, [(3.0, 0.1), (3.0, -0.1)])
    verdict, _ = judged(tracks, sim, before, [(3.1, 0.1), (3.1, -0.1)], touch(before, (0, 1)))
    assert not (verdict["mistake"].any() | verdict["was_hit"].any())


def test_contact_that_lasts_is_taken_once(ring):
    # In training the front car drives on: being pushed for three steps is one contact taken.
    tracks, sim = ring(), head_to_head()
    world = put_cars(tracks, sim, [(3.0, 0.0), (3.3, 0.0)])
    for push in range(1, 4):
        places = [(3.0 + 0.05 * push, 0.0), (3.3 + 0.05 * push, 0.0)]
        _, world = judged(tracks, sim, world, places, touch(world, (0, 1)))
    assert world.cars["contacts_taken"].tolist() == [[0, 1]]


def test_car_that_hit_two_at_once_is_put_behind_the_rearmost(ring):
    tracks, sim = ring(), head_to_head(3)
    # The farther one has the lower number.
    before = put_cars(tracks, sim, [(3.32, 0.1), (3.0, 0.0), (3.22, -0.1)])
    contacts = touch(before, (0, 1), (1, 2))
    verdict, world = raced(tracks, sim, before, [(3.32, 0.1), (3.02, 0.0), (3.22, -0.1)], contacts)
    assert verdict["crashed_car"][0, 1] == 2
    assert world.cars["distance"][0, 1] == pytest.approx(2.22, abs=1e-3)


def test_crashed_car_is_moved_behind_on_the_other_lane_first_and_then_frozen(ring):
    tracks, sim = ring(), head_to_head()
    before = put_cars(tracks, sim, [(3.0, 0.15), (3.3, 0.15)])
    verdict, world = raced(tracks, sim, before, [(3.05, 0.15), (3.35, 0.15)], touch(before, (0, 1)))
    assert verdict["crashed"].tolist() == [[True, False]]
    book = world.cars
    assert book["distance"][0, 0] == pytest.approx(2.35, abs=1e-3)  # 3.35 - 1
    assert book["lateral"][0, 0] == pytest.approx(-0.2, abs=1e-3)
    assert book["penalty_s"].tolist() == [[5.0, 0.0]]
    assert book["ghost"].tolist() == [[True, False]]
    moved_to = world.cars["x"][0, 0].item(), world.cars["y"][0, 0].item()
    for _ in range(75):
        verdict, world = stay(tracks, sim, world)
    assert verdict["released"][0, 0]
    assert (world.cars["x"][0, 0].item(), world.cars["y"][0, 0].item()) == moved_to


def test_crashed_car_is_never_put_forward(ring):
    # A box with its middle 1.2 m ahead: one metre behind it would be 0.2 m forward.
    tracks, sim = ring(), with_obstacles(place=0.5)
    before = put_cars(tracks, sim, [(4.79, 0.0)])
    verdict, world = raced(tracks, sim, before, [(4.8, 0.0)], touch(before, obstacles=((0, 0),)))
    assert verdict["crashed"]
    assert world.cars["distance"].item() == pytest.approx(4.8, abs=1e-3)


def test_car_cannot_be_put_behind_the_beginning_of_an_open_track(straight):
    tracks, sim = straight(), head_to_head()
    before = put_cars(tracks, sim, [(0.2, 0.1), (0.5, 0.1)])
    _, world = raced(tracks, sim, before, [(0.22, 0.1), (0.52, 0.1)], touch(before, (0, 1)))
    assert world.cars["s"][0, 0] == 0.0
    assert world.cars["distance"][0, 0] == pytest.approx(0.0, abs=1e-6)


def test_put_back_beside_the_start_line_a_lap_is_not_counted_again(ring):
    tracks, sim = ring(), head_to_head()
    before = put_cars(tracks, sim, [(11.9, 0.1), (12.25, 0.1)])
    verdict, world = raced(tracks, sim, before, [(12.05, 0.1), (12.3, 0.1)], touch(before, (0, 1)))
    assert verdict["lap"].tolist() == [[True, False]]
    assert world.cars["distance"][0, 0] == pytest.approx(11.3, abs=1e-3)
    for _ in range(75):
        _, world = stay(tracks, sim, world)
    for s in (11.6, 11.9, 12.2):
        verdict, world = judged(tracks, sim, world, [(s, -0.2), (14.0, 0.1)])
        assert not verdict["lap"].any()
    assert world.cars["laps"][0, 0] == 1


def test_car_put_back_where_another_stands_stays_a_ghost_until_it_is_clear(ring):
    tracks, sim = ring(), head_to_head(off_track_penalty_s=0.2)
    before = put_cars(tracks, sim, [(3.0, 0.4), (3.05, 0.2)])
    places = [(3.0, 0.5), (3.05, 0.2)]
    _, world = raced(tracks, sim, before, places)
    for _ in range(3):
        verdict, world = stay(tracks, sim, world)
    assert verdict["released"].tolist() == [[True, False]]
    assert world.cars["ghost"].tolist() == [[True, False]]
    _, world = raced(tracks, sim, world, [(3.1, 0.2), (3.45, 0.2)])
    assert world.cars["ghost"].tolist() == [[True, False]]
    _, world = raced(tracks, sim, world, [(3.1, 0.2), (3.75, 0.2)])
    assert world.cars["ghost"].tolist() == [[False, False]]


def test_of_two_ghosts_on_one_spot_the_front_one_becomes_solid_first(ring):
    # Both ran into car 2 at once, so both stand one metre behind it, and are let go together.
    tracks, sim = ring(), head_to_head(3, crash_penalty_s=0.2)
    before = put_cars(tracks, sim, [(3.0, 0.1), (3.0, 0.3), (3.3, 0.2)])
    places = [(3.02, 0.1), (3.02, 0.3), (3.32, 0.2)]
    _, world = raced(tracks, sim, before, places, touch(before, (0, 2), (1, 2)))
    assert world.cars["x"][0, 0] == world.cars["x"][0, 1]
    for _ in range(3):
        _, world = stay(tracks, sim, world)
    assert world.cars["ghost"].tolist() == [[False, True, False]]
    _, world = raced(tracks, sim, world, [(2.4, -0.2), (2.6, -0.2), (5.0, 0.2)])
    assert world.cars["ghost"].tolist() == [[False, True, False]]
    _, world = raced(tracks, sim, world, [(2.4, -0.2), (3.0, -0.2), (5.0, 0.2)])
    assert not world.cars["ghost"].any()


def test_box_is_hit_at_ones_own_fault_even_from_beside(ring):
    tracks, sim = ring(), with_obstacles("box")
    before = put_cars(tracks, sim, [(6.1, 0.0)])
    verdict, world = raced(tracks, sim, before, [(6.15, 0.0)], touch(before, obstacles=((0, 0),)))
    assert verdict["crashed"]
    assert verdict["crashed_obstacle"].item() == 0
    assert verdict["crashed_car"].item() == NOBODY
    # The box stands at 6 m on the left lane: the car at 5 m on the right one.
    assert world.cars["distance"].item() == pytest.approx(5.0, abs=1e-2)
    assert world.cars["lateral"].item() == pytest.approx(-0.2, abs=1e-3)


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_bot_that_runs_into_the_car_ahead_stops_and_nobody_is_penalised(ring, num_worlds):
    tracks, sim = ring(), with_obstacles("bot")
    world = put_cars(tracks, sim, [(6.3, 0.2)], num_worlds=num_worlds)
    for push in range(1, 4):  # also while the bot, now standing, still touches
        contacts = touch(world, obstacles=((0, 0),))
        verdict, world = raced(tracks, sim, world, [(6.3 + 0.01 * push, 0.2)], contacts)
        assert not verdict["mistake"].any()
        assert world.obstacles["stopped_s"].tolist() == [[2.0]] * num_worlds
    assert not (world.cars["crashes"] > 0).any()


def test_car_that_runs_into_a_bot_is_to_blame(ring):
    tracks, sim = ring(), with_obstacles("bot")
    before = put_cars(tracks, sim, [(5.6, 0.2)])
    verdict, world = raced(tracks, sim, before, [(5.7, 0.2)], touch(before, obstacles=((0, 0),)))
    assert verdict["crashed"]
    assert world.obstacles["stopped_s"].item() == 0.0


# Standing and driving backwards.


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_immobilised_fires_on_the_fifteenth_step_without_movement(straight, num_worlds):
    tracks = straight()
    world = put_cars(tracks, ALONE, [(3.0, 0.3)], num_worlds=num_worlds)
    for step in range(1, 16):
        # 0.0002 m in a step is standing still.
        verdict, world = judged(tracks, ALONE, world, [(3.0 + 0.0002 * step, 0.3)])
        assert verdict["immobilised"].tolist() == [[step == 15]] * num_worlds
    assert world.cars["immobilised"].tolist() == [[1]] * num_worlds


@pytest.mark.parametrize(("step_m", "fires"), [(0.00028, True), (0.00032, False)])
def test_who_creeps_by_more_than_a_third_of_a_millimetre_a_step_is_not_immobilised(
    straight, step_m, fires
):
    # Standing still is at most 0.3 mm a step, 4.5 mm/s.
    tracks = straight()
    world = put_cars(tracks, ALONE, [(3.0, 0.3)])
    world.cars["x"] = x = np.float32(3.0)
    for _ in range(15):
        after = world.copy()
        after.cars["x"] = x = x + np.float32(step_m)
        after.worlds["step"] += 1
        verdict, world = Stages(tracks, ALONE).judge(world, after)
    assert verdict["immobilised"].tolist() == [[fires]]


def test_one_movement_starts_the_count_of_standing_again(straight):
    tracks = straight()
    world = put_cars(tracks, ALONE, [(3.0, 0.3)])
    fired = []
    for step in range(1, 30):
        s = 3.0 if step < 14 else 3.001
        verdict, world = judged(tracks, ALONE, world, [(s, 0.3)])
        fired.append(bool(verdict["immobilised"]))
    assert fired.index(True) == 28  # moved in step 14, so steps 15 to 29 stand


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_reversed_fires_on_the_fifteenth_step_backwards(ring, num_worlds):
    tracks = ring()
    world = put_cars(tracks, ALONE, [(6.0, 0.1)], num_worlds=num_worlds)
    for step in range(1, 16):
        verdict, world = judged(tracks, ALONE, world, [(6.0 - 0.02 * step, 0.1)])
        assert verdict["reversed"].tolist() == [[step == 15]] * num_worlds
    world = Stages(tracks, ALONE).settle(world, verdict)
    assert world.cars["penalty_s"].tolist() == [[2.0]] * num_worlds
    assert world.cars["put_back"].all()


# Laps.


def test_lap_is_counted_once_however_often_the_line_is_crossed(ring):
    tracks = ring()
    world = put_cars(tracks, ALONE, [(11.9, 0.0)])
    counted = []
    for s in (12.1, 11.8, 12.1, 11.5, 12.3):
        verdict, world = judged(tracks, ALONE, world, [(s, 0.0)])
        counted.append(bool(verdict["lap"]))
    assert counted == [True, False, False, False, False]
    assert world.cars["laps"].item() == 1


def test_lap_is_not_counted_when_the_line_is_crossed_backwards(ring):
    tracks = ring()
    world = put_cars(tracks, ALONE, [(0.1, 0.0)])
    for s in (-0.1, -0.3, -0.1, 0.2):
        verdict, world = judged(tracks, ALONE, world, [(s, 0.0)])
        assert not verdict["lap"]
    assert world.cars["laps"].item() == 0
    assert world.cars["distance"].item() == pytest.approx(0.2, abs=1e-3)


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_lap_time_is_interpolated_within_the_step(ring, num_worlds):
    # Step 150 goes from 11.94 m at 149/15 s to 12.02 m at 150/15 s: three quarters before the line.
    tracks = ring()
    before = put_cars(tracks, ALONE, [(11.94, 0.0)], num_worlds=num_worlds, step=149)
    verdict, world = judged(tracks, ALONE, before, [(12.02, 0.0)])
    assert verdict["lap"].all()
    crossing = (149 + 0.75) / 15
    for times in (world.cars["last_lap_s"], world.cars["best_lap_s"], world.cars["lap_start_s"]):
        assert times[0, 0].item() == pytest.approx(crossing, abs=1e-3)


def test_race_is_finished_with_the_last_lap_and_not_before(ring):
    tracks, sim = ring(), SimConfig(rules=RaceRules(laps=2))
    world = put_cars(tracks, sim, [(11.95, 0.0)], step=99)
    verdict, world = judged(tracks, sim, world, [(12.05, 0.0)])
    assert verdict["lap"]
    assert not verdict["finished"]
    assert np.isinf(world.cars["finish_s"])
    second = put_cars(tracks, sim, [(23.95, 0.0)], step=199)
    verdict, world = judged(tracks, sim, second, [(24.05, 0.0)])
    assert verdict["finished"]
    assert world.cars["finish_s"].item() == pytest.approx(199.5 / 15, abs=1e-3)


def test_car_that_has_finished_is_a_ghost_and_no_longer_judged(ring):
    tracks, sim = ring(), head_to_head(laps=1)
    world = put_cars(tracks, sim, [(11.95, 0.2), (11.0, 0.2)], step=99)
    _, world = raced(tracks, sim, world, [(12.05, 0.2), (11.1, 0.2)])
    assert world.cars["ghost"].tolist() == [[True, False]]
    verdict, world = raced(tracks, sim, world, [(12.15, 0.6), (11.2, 0.2)])
    assert not verdict["mistake"].any()
    assert world.cars["laps"].tolist() == [[1, 0]]


def test_open_track_is_driven_once_and_ends_before_its_end(straight):
    tracks, sim = straight(), SimConfig(rules=RaceRules(laps=3))
    before = put_cars(tracks, sim, [(9.65, 0.0)], step=99)
    verdict, world = judged(tracks, sim, before, [(9.75, 0.0)])  # ends at 9.7 m
    assert verdict["finished"]
    assert world.cars["finish_s"].item() == pytest.approx(99.5 / 15, abs=1e-3)


def test_penalty_seconds_are_part_of_the_lap(ring):
    tracks = ring()
    world = put_cars(tracks, ALONE, [(11.5, 0.4)], step=100)
    _, world = raced(tracks, ALONE, world, [(11.6, 0.5)])  # step 101: off
    for _ in range(30):
        _, world = stay(tracks, ALONE, world)  # step 131: put back
    verdict, world = raced(tracks, ALONE, world, [(11.8, 0.2)])
    verdict, world = raced(tracks, ALONE, world, [(12.0001, 0.2)])  # step 133
    assert verdict["lap"]
    assert world.cars["last_lap_s"].item() == pytest.approx(133 / 15, abs=1e-3)


# Running order.


def test_overtake_is_counted_when_clear_and_does_not_flicker_side_by_side(ring):
    tracks, sim = ring(), head_to_head()  # half a car, 0.162 m, ahead is a pass
    world = put_cars(tracks, sim, [(3.0, 0.1), (3.3, -0.1)])
    seen, leads = [], []
    for gap in (-0.1, 0.1, -0.1, 0.15, 0.2, 0.1, -0.1, -0.15, 0.3):
        s = world.cars["distance"][0, 1] + 0.05
        verdict, world = judged(tracks, sim, world, [(s + gap, 0.1), (s, -0.1)])
        seen.append(passes(verdict))
        leads.append(world.worlds["leader"][0])
    assert seen == [[], [], [], [], [[0, 1]], [], [], [], []]
    assert leads == [1, 1, 1, 1, 0, 0, 0, 0, 0]
    assert world.cars["overtakes"].tolist() == [[1, 0]]
    assert world.worlds["lead_changes"].tolist() == [1]


@pytest.mark.parametrize("frozen", [0, 1])
def test_passing_is_no_overtake_while_either_car_is_frozen(ring, frozen):
    tracks, sim = ring(), head_to_head()
    world = put_cars(tracks, sim, [(3.0, 0.1), (3.1, -0.1)])
    world.cars["penalty_s"][0, frozen] = 1.0
    verdict, world = judged(tracks, sim, world, [(3.4, 0.1), (3.1, -0.1)])
    assert not verdict["overtook"].any()
    assert world.cars["overtakes"].tolist() == [[0, 0]]


def test_lapped_car_is_not_overtaken(ring):
    tracks, sim = ring(), head_to_head()
    world = put_cars(tracks, sim, [(15.0, 0.1), (3.3, -0.1)])
    for s in (15.2, 15.4, 15.6):
        verdict, world = judged(tracks, sim, world, [(s, 0.1), (3.35, -0.1)])
        assert not verdict["overtook"].any()


def test_a_change_of_the_lead_is_in_the_verdicts_of_all_cars(ring):
    tracks, sim = ring(), head_to_head(3)
    world = put_cars(tracks, sim, [(3.0, 0.2), (3.2, 0.0), (1.0, -0.2)])
    verdict, world = judged(tracks, sim, world, [(3.6, 0.2), (3.3, 0.0), (1.1, -0.2)])
    assert verdict["lead_changed"].all()
    assert world.worlds[["leader", "lead_changes"]].tolist() == [(0, 1)]
    verdict, world = judged(tracks, sim, world, [(3.8, 0.2), (3.4, 0.0), (1.2, -0.2)])
    assert not verdict["lead_changed"].any()
    assert world.worlds[["leader", "lead_changes"]].tolist() == [(0, 1)]


def test_ring_of_three_side_by_side_leaves_the_leader_in_place(ring):
    # Car 2 leads car 1, car 1 car 0, each by less than a pass; car 0 is clear of car 2: a ring.
    tracks, sim = ring(), head_to_head(3)
    world = put_cars(tracks, sim, [(3.0, 0.2), (3.2, 0.0), (3.4, -0.2)])
    assert world.worlds["leader"].tolist() == [2]
    _, world = judged(tracks, sim, world, [(3.5, 0.2), (3.42, 0.0), (3.45, -0.2)])
    verdict, world = judged(tracks, sim, world, [(3.65, 0.2), (3.55, 0.0), (3.46, -0.2)])
    assert members(world.cars["ahead"][0], 3).sum(axis=1).tolist() == [1, 1, 1]
    assert not verdict["lead_changed"].any()
    assert world.worlds["leader"].tolist() == [2]
    assert referee.running_order(world.cars, False).tolist() == [[0, 1, 2]]  # untied by distance


def test_who_is_home_by_a_nose_has_passed_and_stays_ahead(ring):
    tracks, sim = ring(), head_to_head(laps=1)
    world = put_cars(tracks, sim, [(11.85, 0.2), (11.9, -0.2)], step=99)
    verdict, world = judged(tracks, sim, world, [(12.06, 0.2), (12.01, -0.2)])
    # Crossings after 15/21 and 10/11 of the step.
    assert verdict["finished"].all()
    assert passes(verdict) == [[0, 1]]
    assert referee.running_order(world.cars, False).tolist() == [[0, 1]]
    verdict, world = judged(tracks, sim, world, [(12.1, 0.2), (12.4, -0.2)])
    assert not (verdict["overtook"].any() | verdict["lead_changed"].any())
    assert referee.running_order(world.cars, False).tolist() == [[0, 1]]


def test_who_is_home_is_ahead_of_a_car_that_led_it_and_is_not(ring):
    # Car 1 leads by less than a pass. Car 0 crosses the line in this step, car 1 1 mm short of it.
    tracks, sim = ring(), head_to_head(laps=1)
    world = put_cars(tracks, sim, [(11.85, 0.2), (11.9, -0.2)], step=99)
    verdict, world = judged(tracks, sim, world, [(12.02, 0.2), (11.999, -0.2)])
    assert verdict["finished"].tolist() == [[True, False]]
    assert passes(verdict) == [[0, 1]]
    assert world.worlds["leader"].tolist() == [0]


def begin_at(cars: np.ndarray, zero_s: list[float]) -> None:
    """Have each car's laps begin at a place of its own."""
    cars["zero_s"] = zero_s
    cars["distance"] -= cars["zero_s"]
    cars["best_distance"] = cars["distance"]


def test_in_training_a_pass_is_what_happens_on_the_road(ring):
    # Episodes began at 2 m and 5 m: car 0 has driven less, and yet it passes.
    tracks, sim = ring(), head_to_head()
    world = put_cars(tracks, sim, [(8.0, 0.1), (8.1, -0.1)])
    begin_at(world.cars, [5.0, 2.0])
    verdict, world = judged(tracks, sim, world, [(8.3, 0.1), (8.11, -0.1)])
    assert passes(verdict) == [[0, 1]]
    # Half a lap later ahead turns into behind, but no car has passed.
    far = put_cars(tracks, sim, [(8.0, 0.1), (2.1, -0.1)])
    begin_at(far.cars, [5.0, 2.0])
    verdict, _ = judged(tracks, sim, far, [(8.2, 0.1), (2.1, -0.1)])
    assert not verdict["overtook"].any()


# Properties.


def swapped(records: np.ndarray) -> np.ndarray:
    """Return records of cars or verdicts with cars 0 and 1 exchanged."""
    found = records[:, ::-1].copy()
    for name in {"ahead", "touching_cars", "overtook"} & set(found.dtype.names):
        found[name] = (found[name] & 1) << 1 | found[name] >> 1
    if "crashed_car" in found.dtype.names:
        hit = found["crashed_car"]
        found["crashed_car"] = np.where(hit == NOBODY, NOBODY, 1 - hit)
    return found


@pytest.mark.parametrize("seed", range(5))
def test_swapping_two_cars_swaps_the_verdict(ring, seed):
    tracks, sim = ring(), head_to_head(laps=1)
    draw = np.random.default_rng(seed).random((40, 2, 2))
    first = [(11.0 + 0.3 * a, b - 0.5) for a, b in draw[0]]
    one = put_cars(tracks, sim, first)
    other = put_cars(tracks, sim, first[::-1])
    for row in draw[1:]:
        shift = one.cars["distance"][0].tolist()
        places = [(s + 0.15 * a, 0.9 * (b - 0.5)) for s, (a, b) in zip(shift, row, strict=True)]
        near = abs(places[0][0] - places[1][0]) < 0.3
        pairs = ((0, 1),) if near and not one.cars["ghost"].any() else ()
        seen, one = raced(tracks, sim, one, places, touch(one, *pairs))
        mirrored, other = raced(tracks, sim, other, places[::-1], touch(other, *pairs))
        assert_same(swapped(seen), mirrored)
        assert_same(swapped(one.cars), other.cars)
        assert one.worlds["leader"] == 1 - other.worlds["leader"]


@pytest.mark.parametrize("lateral", [0.3, 0.45, 0.5, -0.3, -0.45, -0.5])
def test_mirrored_track_gives_the_mirrored_verdict(lateral):
    plain, flipped = make_ring(), make_ring().mirrored()
    assert flipped.direction == "clockwise"
    outcome = []
    for track, side in ((plain, 1.0), (flipped, -1.0)):
        tracks = TrackSet(track)
        before = put_cars(tracks, ALONE, [(3.0, side * lateral)])
        verdict, world = raced(tracks, ALONE, before, [(3.1, side * lateral)])
        for _ in range(30):
            _, world = stay(tracks, ALONE, world)
        outcome.append((bool(verdict["off_track"]), world.cars[0, 0]))
    (off, car), (off_flipped, car_flipped) = outcome
    assert off == off_flipped
    for name, sign in (("x", 1), ("y", -1), ("lateral", -1), ("distance", 1)):
        assert car[name] == pytest.approx(sign * car_flipped[name], abs=1e-5), name
