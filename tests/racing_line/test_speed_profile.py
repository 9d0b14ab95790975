"""How fast a car may go on a line: hand-worked corners and straights."""

import math

import numpy as np
import pytest

from league.racing_line.search import CarLimits, spare_grip, speed_profile, travel_time

POINT = CarLimits(
    lateral=6.0, acceleration=4.0, braking=5.0, speed=4.0, curvature=3.5, transfer=0.0
)


def test_speed_in_a_steady_corner_is_the_root_of_grip_times_radius():
    bends = np.full(100, 1.0)
    speed = speed_profile(bends, np.full(100, 0.1), POINT, closed=True)
    np.testing.assert_allclose(speed, math.sqrt(6.0))


def test_speed_on_a_straight_from_a_corner_grows_with_the_drive():
    bends = np.zeros(11)
    bends[0] = 6.0  # corner speed 1 m/s; then v^2 = 1 + 2 a s
    limits = POINT._replace(speed=99.0)
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
