"""Settings of the world that no world can have are refused, each in a sentence that names it."""

import math

import pytest

from league.errors import ConfigError
from league.sim.config import ObstacleConfig, RaceRules


@pytest.mark.parametrize("value", [-1.0, math.nan, math.inf])
@pytest.mark.parametrize(
    "name",
    ["max_time_s", "grid_gap", "overtake_margin", "bot_stop_s", "put_back_behind"],
)
def test_rules_refuse_what_is_no_length_and_no_time(name, value):
    with pytest.raises(ConfigError, match=name):
        RaceRules(**{name: value})


def test_grid_keeps_two_cars_of_one_lane_apart():
    # Two gaps apart: less than a car of 0.324 m would put one into the other.
    with pytest.raises(ConfigError, match=r"grid_gap is 0\.1: give 0\.2 to 10"):
        RaceRules(grid_gap=0.1)
    assert RaceRules(grid_gap=0.2).grid_gap == 0.2


@pytest.mark.parametrize("value", [-0.5, math.nan, 12.5])
@pytest.mark.parametrize("name", ["speed", "length", "width", "height"])
def test_obstacles_refuse_what_no_obstacle_is(name, value):
    with pytest.raises(ConfigError, match=f"obstacle {name}"):
        ObstacleConfig(**{name: value})


def test_usual_settings_are_accepted():
    assert RaceRules() == RaceRules(max_time_s=0.0, grid_gap=0.75)
    assert ObstacleConfig(speed=0.0).speed == 0.0
