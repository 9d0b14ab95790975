"""The rear lidar, with ranges worked by hand."""

import math

import numpy as np
import pytest

from league.sim import lidar
from league.sim.config import LidarConfig
from tests.sim.looking import random_scenes, room, settings, world

QUIET = LidarConfig(noise=0.0, beams=61)  # 5 deg apart, beam 30 straight to the rear
REAR = 30
FORWARD = 0.0291


def scan(now, cfg=QUIET, car=0, half=6.0) -> np.ndarray:
    return lidar.scan(room(half=half), settings(now.num_cars), cfg, now, car)


def test_beams_run_from_front_left_over_the_rear_to_front_right():
    degrees = [math.degrees(angle) for angle in lidar.beam_angles(LidarConfig())]
    assert degrees[0] == pytest.approx(30) and degrees[-1] == pytest.approx(330)
    assert degrees[31] == pytest.approx(180 - 150 / 63) and len(degrees) == 64


def test_wall_behind_and_beside():
    # Walls at +-6 m; the lidar sits 0.0291 m ahead of the base at x = 1.
    ranges = scan(world(room(), [(1.0, 2.0, 0.0)]))[0]
    assert ranges[REAR] == pytest.approx(1.0291 + 6, abs=1e-4)
    assert ranges[12] == pytest.approx(4.0, abs=1e-4)  # beam 12 points to 90 deg, the left
    assert ranges[48] == pytest.approx(8.0, abs=1e-4)
    # Beam 0 points 30 deg left of ahead: y = 6 is 4 m away, x = 6 is 4.9709 m: the wall ahead.
    assert ranges[0] == pytest.approx(4.9709 / math.cos(math.radians(30)), abs=1e-4)


@pytest.mark.parametrize("yaw", [0.0, 1.0, -2.5])
def test_a_car_one_metre_behind_reads_one_metre_less_its_half_length(yaw):
    x, y = -math.cos(yaw), -math.sin(yaw)
    ranges = scan(world(room(), [(0, 0, yaw), (x, y, yaw)]))[0]
    assert ranges[REAR] == pytest.approx(FORWARD + 1 - 0.162, abs=1e-5)
    # The one that follows looks away from it.
    assert scan(world(room(), [(0, 0, yaw), (x, y, yaw)]), car=1).min() > 3


def test_a_car_ahead_is_in_the_blind_wedge():
    alone = scan(world(room(), [(0, 0, 0)]))
    assert np.array_equal(scan(world(room(), [(0, 0, 0), (0.8, 0, 0)])), alone)
    assert np.array_equal(scan(world(room(), [(0, 0, 0), (0.8, 0.2, 0)])), alone)


def test_a_box_beside_reads_its_near_side():
    # 90 deg to the right: the box's side is 1.5 - 0.2 m away, turned by a quarter.
    now = world(room(), [(0, 0, 0)], [(FORWARD, -1.5, math.pi / 2, 0.2, 0.1)])
    assert scan(now)[0, 48] == pytest.approx(1.3, abs=1e-4)
    # 5 deg off it passes at 1.3 * tan(5 deg) = 0.114 > 0.1 m: the wall, 6 / cos(5 deg).
    assert scan(now)[0, 49] == pytest.approx(6 / math.cos(math.radians(5)), abs=1e-4)


def test_ranges_are_clipped_at_both_ends():
    near = scan(world(room(), [(0, 0, 0), (-0.15, 0, 0)]))[0, REAR]
    assert near == pytest.approx(0.15)
    far = scan(world(room(half=20.0), [(0, 0, 0)]), half=20.0)[0, REAR]
    assert far == 12.0


@pytest.mark.parametrize("yaw", [0.0, math.pi / 2, math.pi])
def test_beams_along_a_side_are_no_trouble(yaw):
    now = world(room(), [(0, 0, yaw), (-1, 0.098, 0)], [(0, -1, 0, 0.1, 0.1)])
    assert np.isfinite(scan(now)).all()


def test_frozen_cars_are_seen():
    cars = [(0, 0, 0), (-1, 0, 0)]
    assert np.array_equal(scan(world(room(), cars, penalty=[0.0, 2.0])), scan(world(room(), cars)))


def test_noise_has_a_standard_deviation_of_one_centimetre_and_changes_with_the_step():
    cfg = LidarConfig()
    now = world(room(), [[(0, 0, 0)]] * 200)
    exact = scan(now, LidarConfig(noise=0.0))
    error = scan(now, cfg) - exact
    assert error.std() == pytest.approx(0.01, rel=0.05) and abs(error.mean()) < 0.0005
    noisy = scan(now, cfg)
    now.worlds["step"] += 1
    assert not np.array_equal(scan(now, cfg), noisy)


def test_sectors_show_what_stands_within_half_a_metre():
    cfg = LidarConfig(noise=0.0, form="sectors")
    # Behind: 0.45 + 0.0291 - 0.162 = 0.317 m, on the middle beams of sectors 3 and 4.
    seen = scan(world(room(), [(0, 0, 0), (-0.45, 0, 0)]), cfg)[0]
    assert seen.tolist() == [0, 0, 0, 1, 1, 0, 0, 0]


def test_discretised_sectors_are_one_hot_and_empty_beyond_the_clip():
    cfg = LidarConfig(noise=0.0, form="discretised")
    seen = scan(world(room(), [(0, 0, 0), (-1.0, 0, 0)]), cfg)[0].reshape(8, 8)
    # 0.867 m in bins of 0.25 m: bin 3; the walls are beyond 2 m.
    assert seen[3].tolist() == [0, 0, 0, 1, 0, 0, 0, 0]
    assert seen[4].tolist() == seen[3].tolist()
    assert seen.sum() == 2


@pytest.mark.parametrize("form", ["ranges", "sectors", "discretised"])
def test_a_world_scans_the_same_alone_and_in_a_batch(form):
    tracks, cfg = room(half=3.0), LidarConfig(form=form)
    now = random_scenes(tracks, 5)
    together = lidar.scan(tracks, settings(3), cfg, now, 0)
    assert together.shape == (5, cfg.size) and together.dtype == np.float32
    for index in range(5):
        alone = lidar.scan(tracks, settings(3), cfg, now.row(index), 0)
        assert np.array_equal(alone[0], together[index])
    chosen = lidar.scan(tracks, settings(3), cfg, now, 0, np.array([4, 2]))
    assert np.array_equal(chosen, together[[4, 2]])
