"""The fastest line and its speed: hand-worked corners, straights and an oval."""

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.lap_bound import lap_bound
from benchmarks.lap_optimum import lap_optimum, strays
from league.racing_line.speed_profile import Limits, spare_grip, speed_profile, travel_time
from league.racing_line.racing_line import center_line, optimal_line
from league.sim.config import CarConfig
from league.track import files
from league.track.course import Track

POINT = Limits(lateral=6.0, acceleration=4.0, braking=5.0, speed=4.0, curvature=3.5, transfer=0.0)


def ring(radius: float, width: float = 0.8) -> Track:
    """A circle driven counter-clockwise."""
    count = round(2 * math.pi * radius / 0.05)
    angle = np.arange(count) * (2 * math.pi / count)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return Track(
        name="ring",
        title="Ring",
        center=radius * unit,
        left=(radius - width / 2) * unit,
        right=(radius + width / 2) * unit,
    )


def test_speed_in_a_steady_corner_is_the_root_of_grip_times_radius():
    bends = np.full(100, 1.0)
    speed = speed_profile(bends, np.full(100, 0.1), POINT, closed=True)
    np.testing.assert_allclose(speed, math.sqrt(6.0))


def test_speed_on_a_straight_from_a_corner_grows_with_the_drive():
    bends = np.zeros(11)
    bends[0] = 6.0  # corner speed 1 m/s; then v^2 = 1 + 2 a s
    limits = replace(POINT, speed=99.0)
    speed = speed_profile(bends, np.full(10, 0.1), limits, closed=False)
    # The first step starts with all grip used by the corner; from then on 4 m/s^2 are free.
    assert speed[0] == pytest.approx(1.0)
    assert speed[1] == pytest.approx(1.0)
    assert speed[10] == pytest.approx(math.sqrt(1 + 2 * 4.0 * 0.9))


def test_a_corner_is_braked_for_in_time():
    bends = np.zeros(41)
    bends[-1] = 6.0
    speed = speed_profile(bends, np.full(40, 0.05), POINT, closed=False)
    # 1 m/s at the corner, all its grip used there; 5 m/s^2 before: v^2 = 1 + 2 * 5 * 0.5.
    assert speed[-1] == pytest.approx(1.0)
    assert speed[40 - 1 - 10] == pytest.approx(math.sqrt(1 + 2 * 5.0 * 0.5))


def test_time_of_a_straight_at_constant_acceleration_is_exact():
    assert travel_time(np.array([1.0, 3.0]), np.array([4.0])) == pytest.approx(2.0)


def test_without_load_transfer_grip_is_a_circle():
    assert spare_grip(3.0, 5.0, 0.0) == pytest.approx(4.0)
    assert spare_grip(5.0, 5.0, 0.0) == 0.0


def test_with_load_transfer_the_unloaded_axle_is_at_its_limit():
    y, most, t = 3.0, 6.867, 0.0622
    a = spare_grip(y, most, t)
    assert a < math.sqrt(most**2 - y**2)
    assert a * a + y * y == pytest.approx((most * (1 - t * a)) ** 2)


def test_the_fastest_line_of_a_narrow_ring_hugs_the_inside():
    # Time is 2 pi r / sqrt(g r): the smallest radius wins.
    car = CarConfig()
    line = optimal_line(ring(1.5), car, margin=0.1)
    radius = 1.5 - 0.3
    grip = Limits.of(car).lateral
    assert line.lateral == pytest.approx(np.full(len(line.s), 0.3), abs=0.01)
    assert line.lap_time == pytest.approx(2 * math.pi * math.sqrt(radius / grip), rel=0.005)


def test_the_bound_of_a_ring_uses_the_road_until_the_last_wheel_leaves_it():
    # The inner wheels may be off: the base goes half of the wheel track beyond the border.
    car = CarConfig()
    radius = 1.5 - 0.4 - car.wheel_track / 2
    expected = 2 * math.pi * math.sqrt(radius / (car.grip * 9.81))
    assert lap_bound(ring(1.5), car) == pytest.approx(expected, rel=0.005)


def test_the_best_lap_of_a_ring_is_driven_at_the_limit_and_the_simulator_drives_it_too():
    pytest.importorskip("casadi", reason="the extra `optimum` is not installed")
    track, car = ring(1.5), CarConfig()
    lap = lap_optimum(track, car)
    radius = 1.5 - 0.4 - car.wheel_track / 2
    least = 2 * math.pi * math.sqrt(radius / (car.grip * 9.81))
    # Turned front wheels push back a little, and what drives against that is lost to cornering.
    assert least < lap.time < 1.03 * least
    place, speed = strays(lap, car)
    assert place < 0.002
    assert speed < 0.05


def test_a_line_keeps_its_margin_and_follows_its_own_geometry():
    track = files.load("reinvent_2018")
    line = optimal_line(track, CarConfig(), margin=0.05)
    half = 0.762 / 2 - 0.05
    assert np.abs(line.lateral).max() < half + 0.01
    # Turning along a loop adds up to one turn: curvature times distance is 2 pi.
    step = track.length / len(line.s)
    assert np.sum(line.curvature * line.stretch * step) == pytest.approx(2 * math.pi, rel=0.01)


def test_more_grip_and_more_road_are_never_slower():
    track, car = files.load("peanut"), CarConfig()
    usual = optimal_line(track, car, margin=0.05).lap_time
    assert optimal_line(track, replace(car, grip=0.9), margin=0.05).lap_time < usual
    assert optimal_line(track, car, margin=0.0).lap_time < usual
    assert usual < center_line(track, car, share=1.0, top_speed=4.0).lap_time


def test_the_same_track_gives_the_same_bits():
    track, car = files.load("harbour_oval"), CarConfig()
    one, two = optimal_line(track, car, 0.0), optimal_line(track, car, 0.0)
    assert np.array_equal(one.lateral, two.lateral) and np.array_equal(one.speed, two.speed)


def test_the_centreline_stays_on_the_centreline():
    track = files.load("reinvent_2018")
    line = center_line(track, CarConfig(), share=0.35, top_speed=2.0)
    assert np.abs(line.lateral).max() < 0.01
    assert line.speed.max() <= 2.0
