"""Where cars are put at the start of a race, and what is drawn for each car."""

import numpy as np
import pytest

from league.sim.config import CarConfig, DynamicsRandomization, SimConfig
from league.sim.records import members
from league.track.track import TrackSet
from tests.scenes import assert_same, make_straight, start


def field(num_cars: int, **settings) -> SimConfig:
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    return SimConfig(kind=kind, num_cars=num_cars, **settings)


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("num_cars", range(2, 9))
def test_grid_is_staggered_by_075_m_with_odd_cars_on_the_inner_lane(
    ring, num_worlds, clockwise, num_cars
):
    tracks, sim = ring(clockwise=clockwise), field(num_cars)
    world = start(tracks, sim, list(range(num_worlds)))
    cars = world.cars
    place = tracks.project(world.track, cars["x"], cars["y"])
    inner = -0.2 if clockwise else 0.2
    for car in range(num_cars):
        assert cars["distance"][-1, car] == pytest.approx(-0.75 * car)
        assert place.s[-1, car] == pytest.approx((12 - 0.75 * car) % 12, abs=1e-3)
        side = inner if car % 2 else -inner
        assert place.lateral[-1, car] == pytest.approx(side, abs=1e-3)
    along = np.cos(cars["yaw"]) * place.cos + np.sin(cars["yaw"]) * place.sin
    assert along.min() == pytest.approx(1.0, abs=1e-5)
    # The first is ahead of all, the last of none.
    beaten = members(cars["ahead"][0], num_cars).sum(axis=1)
    assert beaten.tolist() == list(range(num_cars - 1, -1, -1))


def test_car_alone_starts_on_the_start_line_in_the_middle(ring):
    cars = start(ring(), field(1), [0]).cars
    assert cars["distance"].tolist() == cars["lateral"].tolist() == [[0.0]]
    assert cars["x"].item() == cars["y"].item() == 0.0
    assert cars["yaw"].item() == pytest.approx(0.0, abs=1e-6)


def test_grid_of_an_open_track_stands_on_the_track():
    cars = start(TrackSet(make_straight()), field(4), [0]).cars
    assert cars["x"][0].tolist() == pytest.approx([2.45, 1.7, 0.95, 0.2], abs=1e-5)


def test_without_a_spread_every_car_is_as_set(ring):
    cars = start(ring(), field(3), [0, 1, 2]).cars
    settings = CarConfig()
    assert (cars["grip"] == np.float32(settings.grip)).all()
    assert (cars["mass"] == np.float32(settings.mass)).all()
    for name in ("steering_offset", "camera_up", "camera_pitch"):
        assert not cars[name].any()


def test_spread_is_drawn_within_its_range_and_differs_between_cars_and_worlds(ring):
    spread = DynamicsRandomization(
        grip=0.2, mass=0.1, latency_s=0.02, steering_offset=0.03, camera_angle=0.05
    )
    cars = start(ring(), field(4, spread=spread), list(range(500))).cars
    for name, low, high in (
        ("grip", 0.56, 0.84),
        ("mass", 7.38, 9.02),
        ("latency_s", 0.0, 0.02),
        ("steering_offset", -0.03, 0.03),
        ("camera_pitch", -0.05, 0.05),
    ):
        drawn = cars[name].astype(float)
        assert low <= drawn.min() < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < drawn.max() <= high
        assert len(np.unique(drawn)) > 1900
    assert not cars["camera_up"].any()


def test_world_of_a_seed_is_the_same_alone_and_in_a_batch(ring):
    sim = SimConfig(kind="obstacle_avoidance", spread=DynamicsRandomization(grip=0.2))
    together = start(ring(), sim, [5, 6, 7])
    assert_same(together.row(1), start(ring(), sim, [6]))
