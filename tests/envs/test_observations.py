"""Own motion and the `state` group, number by number."""

import numpy as np
import pytest

from league.envs import observations
from league.envs.state import ABSENT_GAP, FIELDS, INDEX, NEIGHBOURS, SIZE
from league.sim.config import ObstacleConfig, SimConfig
from league.track.track import TrackSet
from tests.scenes import Stages, make_ring, make_straight, put_cars


def field(num_cars: int) -> SimConfig:
    return SimConfig(kind="head_to_head" if num_cars > 1 else "time_trial", num_cars=num_cars)


def state(tracks, world) -> np.ndarray:
    """Return the `state` group of every car, (num_cars, num_worlds, SIZE)."""
    out = np.full((world.cars.shape[1], world.num_worlds, SIZE), np.nan, np.float32)
    tables = world.cars, world.obstacles, world.worlds, tracks.points, tracks.courses
    observations.states(0, world.num_worlds, *tables, out)
    return out


def seen(tracks, world, car=0, row=0) -> dict[str, float]:
    return dict(zip(FIELDS, state(tracks, world)[car, row].tolist(), strict=True))


def test_own_motion_is_scaled_and_ends_with_the_last_action(straight):
    tracks = straight()
    world = put_cars(tracks, field(1), [(3.0, 0.1)], speed=2.0)
    cars = world.cars
    cars["yaw_rate"], cars["steering"] = 4.0, -0.2618
    cars["action_steering"], cars["action_speed"] = 0.25, -0.75
    # 2 of 4 m/s, 4 of 8 rad/s, -15 of 30 deg.
    expected = pytest.approx([0.5, 0.5, -0.5, 0.25, -0.75], abs=1e-4)
    assert Stages(tracks, field(1)).motions(world)[0, 0].tolist() == expected


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_state_tells_place_speed_and_borders(ring, num_worlds):
    tracks, sim = ring(), field(1)
    world = put_cars(tracks, sim, [(15.0, 0.1)], num_worlds=num_worlds, speed=2.0)
    values = seen(tracks, world, row=-1)
    assert values["s"] == pytest.approx(3.0, abs=1e-4)
    assert values["lateral"] == pytest.approx(0.1, abs=1e-5)
    assert values["heading_error"] == pytest.approx(0.0, abs=1e-3)
    assert values["speed_ahead"] == pytest.approx(2.0, abs=1e-4)
    assert values["speed_left"] == pytest.approx(0.0, abs=1e-3)
    assert (values["left"], values["right"]) == pytest.approx((0.4, 0.4), abs=1e-5)
    assert values["progress"] == pytest.approx(1.25, abs=1e-4)
    assert values["curvature_1m"] == pytest.approx(1 / 1.9099, abs=1e-3)


def test_heading_error_is_positive_to_the_left(straight):
    tracks, sim = straight(), field(1)
    world = put_cars(tracks, sim, [(3.0, 0.0)])
    world.cars["yaw"] = 0.3
    values = seen(tracks, world)
    assert values["heading_error"] == pytest.approx(0.3)
    # 1 m/s along the track is to the right of a car that looks to the left.
    assert values["speed_left"] == pytest.approx(-0.2955, abs=1e-4)


def test_neighbours_are_given_nearest_first_ahead_or_behind(ring):
    tracks, sim = ring(), field(5)
    places = [(11.5, 0.0), (12.3, 0.1), (11.0, -0.1), (14.5, 0.0), (6.0, 0.2)]
    values = seen(tracks, put_cars(tracks, sim, places, speed=1.5))
    assert values["car_0_gap"] == pytest.approx(-0.5, abs=1e-3)
    assert values["car_0_lateral"] == pytest.approx(-0.1, abs=1e-4)
    assert values["car_1_gap"] == pytest.approx(0.8, abs=1e-3)  # across the start line
    assert values["car_2_gap"] == pytest.approx(3.0, abs=1e-3)
    assert [values[f"car_{rank}_present"] for rank in range(3)] == [1, 1, 1]
    assert values["car_1_speed"] == pytest.approx(1.5, abs=1e-3)


def test_each_car_observes_all_others(ring):
    tracks, sim = ring(), field(3)
    world = put_cars(tracks, sim, [(3.0, 0.0), (4.0, 0.1), (6.0, -0.1)], speed=1.5)
    for car, others in enumerate([((1.0, 0.1), (3.0, -0.1)), ((-1.0, 0.0), (2.0, -0.1)),
                                   ((-2.0, 0.1), (-3.0, 0.0))]):  # fmt: skip
        values = seen(tracks, world, car)
        for rank, (gap, lateral) in enumerate(others):
            assert values[f"car_{rank}_present"] == 1
            assert values[f"car_{rank}_gap"] == pytest.approx(gap, abs=1e-3)
            assert values[f"car_{rank}_lateral"] == pytest.approx(lateral, abs=1e-4)
            assert values[f"car_{rank}_speed"] == pytest.approx(1.5, abs=1e-3)


def test_of_neighbours_equally_far_the_one_of_the_lower_number_comes_first(straight):
    tracks, sim = straight(), field(3)
    for gap in (0.5, -0.5):
        values = seen(
            tracks, put_cars(tracks, sim, [(5.0, 0.0), (5.0 + gap, 0.1), (5.0 - gap, 0.2)])
        )
        assert (values["car_0_gap"], values["car_1_gap"]) == (gap, -gap)


@pytest.mark.parametrize("num_cars", [1, 2, 3])
def test_absent_neighbours_are_given_as_far_away(ring, num_cars):
    tracks, sim = ring(), field(num_cars)
    values = seen(tracks, put_cars(tracks, sim, [(float(car), 0.0) for car in range(num_cars)]))
    for rank in range(num_cars - 1, NEIGHBOURS):
        assert values[f"car_{rank}_present"] == 0
        assert values[f"car_{rank}_gap"] == ABSENT_GAP


def test_frozen_cars_are_observed_as_such(ring):
    tracks, sim = ring(), field(2)
    world = put_cars(tracks, sim, [(1.0, 0.0), (2.0, 0.0)])
    world.cars["penalty_s"] = 0.0, 1.0
    first, second = (seen(tracks, world, car) for car in (0, 1))
    assert (first["frozen"], first["car_0_frozen"]) == (0, 1)
    assert (second["frozen"], second["car_0_frozen"]) == (1, 0)


def test_next_obstacles_ahead_are_given_and_one_alongside_counts_until_it_is_passed(ring):
    places = ((0.25, 1.0), (0.5, -1.0), (0.75, 1.0))
    sim = SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(count=3, places=places))
    tracks = ring()
    for s, gaps in ((2.0, [1, 4]), (3.3, [-0.3, 2.7]), (3.4, [2.6, 5.6]), (8.0, [1.0, None])):
        values = seen(tracks, put_cars(tracks, sim, [(s, -0.2)]))
        for rank, gap in enumerate(gaps):
            if gap is None:  # the next one is nearer behind than ahead
                continue
            assert values[f"obstacle_{rank}_present"] == 1
            assert values[f"obstacle_{rank}_gap"] == pytest.approx(gap, abs=1e-3)
    assert values["obstacle_0_lateral"] == pytest.approx(0.2, abs=1e-3)


def test_state_of_a_mirrored_world_is_mirrored():
    sim = field(2)
    flips = {"lateral", "heading_error", "speed_left", "yaw_rate", "steering"}
    values = []
    for track, side in ((make_ring(), 1.0), (make_ring().mirrored(), -1.0)):
        tracks = TrackSet(track)
        values.append(seen(tracks, put_cars(tracks, sim, [(3.0, 0.1 * side), (3.9, -0.2 * side)])))
    for name in FIELDS:
        sign = -1 if name in flips or name.startswith("curvature") or "lateral" in name else 1
        assert values[0][name] == pytest.approx(sign * values[1][name], abs=1e-4), name


def test_layout_names_every_column_once():
    assert len(set(FIELDS)) == SIZE == len(INDEX)


def test_curvature_ahead_is_held_at_the_end_of_an_open_track():
    tracks, sim = TrackSet(make_straight()), field(1)
    values = seen(tracks, put_cars(tracks, sim, [(9.0, 0.0)]))
    assert values["curvature_6m"] == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("rate_hz", [*range(1, 16), 0.017, 0.3, 3.7, 7.5, 14.9, 60])
@pytest.mark.parametrize("step_hz", [10, 15, 30])
def test_sensors_are_due_at_the_same_steps_as_ever(rate_hz, step_hz):
    step = np.arange(100_001)
    # As races have been recorded: in float64, a little after each multiple of the period.
    share = min(rate_hz / step_hz, 1.0)
    count, before = (np.floor(at * share + 1e-9) for at in (step, step - 1))
    expected = (count != before) | (step == 0)
    assert np.array_equal(observations.due(float(rate_hz), step_hz, step), expected)
