"""Settings of the world that no world can have are refused, each in a sentence that names it."""

import math
from dataclasses import fields

import numpy as np
import pytest
import torch

from league.errors import ConfigError
from league.sim.config import (
    CameraConfig,
    CarConfig,
    ContactConfig,
    DynamicsRandomization,
    LidarConfig,
    ObstacleConfig,
    RaceRules,
    SensorConfig,
    SimConfig,
)
from league.track.track import TrackSet
from tests.scenes import SETTINGS, make_ring, start

NUMBERS = [(made, item) for made in SETTINGS for item in fields(made) if item.type in (int, float)]
CHOICES = [
    (made, item)
    for made in SETTINGS
    for item in fields(made)
    if item.type not in (int, float) and item.name not in ("places", "count")
]


def refused(made, **settings):
    """Return the sentence with which settings are refused."""
    with pytest.raises(ConfigError) as refusal:
        made(**settings)
    said = str(refusal.value)
    assert "\n" not in said and len(said) < 250
    return said


def named(cases):
    return [f"{made.__name__}.{item.name}" for made, item in cases]


@pytest.mark.parametrize(("made", "item"), NUMBERS, ids=named(NUMBERS))
def test_a_number_is_refused_that_is_none_or_out_of_range(made, item):
    low, high = item.metadata["range"]
    strange = [math.nan, math.inf, -math.inf, 10**400, None, True, "1", [1.0], 1j, torch.ones(1)]
    strange += [low - 1, high + 1, np.array([low]), np.float64(math.nan)]
    if item.type is int:
        strange += [item.default + 0.5, float(item.default)]
    for value in strange:
        assert f"{item.name} is " in refused(made, **{item.name: value})


@pytest.mark.parametrize(("made", "item"), CHOICES, ids=named(CHOICES))
def test_a_choice_is_refused_that_is_none(made, item):
    for value in ("x", 1, math.nan, (), object()):
        assert f"{item.name} is " in refused(made, **{item.name: value})


@pytest.mark.parametrize("number", [np.float32, np.float64, np.float16])
def test_numbers_may_be_numpys(number):
    assert CarConfig(grip=number(0.5)).grip == 0.5
    assert CameraConfig(width=np.int64(64)).shape == (2, 120, 64)


@pytest.mark.parametrize(
    ("made", "settings", "sentence"),
    [
        (CarConfig, {"grip": -1}, "car grip is -1: give 0.01 to 10"),
        (CarConfig, {"mass": 0}, "car mass is 0: give 0.01 to 10000"),
        (CarConfig, {"grip": math.nan}, "car grip is nan: give 0.01 to 10"),
        (CarConfig, {"max_speed": 0.1}, "min_speed must lie below max_speed"),
        # 0.001 * 1000 kg * (0.324^2 + 0.196^2 + 0.164^2) m^2 = 0.17 kg m^2, twice the default.
        (CarConfig, {"mass": 1000.0}, "car yaw_inertia is 0.085: give at least 0.17 for"),
        (ContactConfig, {"restitution": 3}, "contact restitution is 3: give 0 to 1"),
        (CameraConfig, {"eyes": "three"}, "camera eyes is 'three': choose one of stereo, left,"),
        (CameraConfig, {"width": 64.5}, "camera width is 64.5: give a whole number, 8 to 1920"),
        (CameraConfig, {"colour": 1}, "camera colour is 1: give True or False"),
        (LidarConfig, {"form": "x"}, "choose one of ranges, sectors, discretised"),
        (LidarConfig, {"form": "discretised", "bins": 0}, "lidar bins is 0"),
        (LidarConfig, {"form": "sectors", "sectors": 7}, "does not divide 64 beams"),
        (LidarConfig, {"min_range": 3.0, "max_range": 3.0}, "min_range must lie below max_range"),
        (SensorConfig, {"camera": LidarConfig()}, "give a CameraConfig or None"),
        (RaceRules, {"laps": 1.5}, "laps is 1.5: give a whole number, 1 to 1000"),
        (DynamicsRandomization, {"grip": 2.0}, "spread grip is 2.0: give 0 to 0.95"),
        (SimConfig, {"kind": "head2head"}, "kind is 'head2head': choose one of time_trial,"),
        (SimConfig, {"decimation": 0}, "decimation is 0: give a whole number, 1 to 1000"),
        (SimConfig, {"car": None}, "car is None: give a CarConfig"),
        (
            SimConfig,
            {"spread": DynamicsRandomization(latency_s=0.1)},
            "longer than one control step",
        ),
        (RaceRules, {"light_contact": 2.0}, "full_contact 1.5: give speeds that grow"),
        (ObstacleConfig, {"count": 33}, "obstacle count is 33: give a whole number, 0 to 32"),
        (ObstacleConfig, {"count": "x"}, "obstacle count is 'x': give a whole number, 0 to 32"),
        (ObstacleConfig, {"count": True}, "obstacle count is True: give a whole number"),
        (ObstacleConfig, {"count": math.nan}, "obstacle count is nan: give a whole number"),
        (ObstacleConfig, {"count": 1.5}, "obstacle count is 1.5: give a whole number, 0 to 32"),
        (SimConfig, {"num_cars": 2}, "a time_trial race has 2 cars: it is driven alone"),
    ],
)
def test_a_refusal_says_what_was_expected(made, settings, sentence):
    assert sentence in refused(made, **settings)


@pytest.mark.parametrize(
    "places",
    [((7.5, 30.0),), ((0.5,),), ((0.5, 0.0, 0.0),), ((math.nan, 0.0),), ("ab",), (0.5,), "a", 3],
)
def test_a_place_is_a_share_of_the_lap_and_a_lane(places):
    said = refused(ObstacleConfig, count=1, places=places)
    assert "fraction of the lap from 0 to 1, lane from -1 to 1" in said


def test_there_are_as_many_places_as_obstacles():
    assert "1 places for 2 obstacles" in refused(ObstacleConfig, count=2, places=((0.5, 1.0),))
    assert ObstacleConfig(count=2, places=((0, -1), (1, 1.0))).count == 2


@pytest.mark.parametrize(
    "settings",
    [
        {"grip": 0.05},  # ice
        {"mass": 1.5, "yaw_inertia": 0.01, "max_speed": 20.0},  # a fast 1/18 toy
        {"mass": 2.0, "wheelbase": 0.32, "length": 0.5, "yaw_inertia": 0.03},  # 1/10
        {"steering_rate": 1e6, "speed_gain": 1e6},  # servos without delay
        {"min_speed": 0.0, "latency_s": 1 / 15},
        {"nose": 0.0, "mass_height": 0.0, "cornering_stiffness": 30.0},
    ],
)
def test_cars_of_other_makes_are_accepted(settings):
    assert SimConfig(car=CarConfig(**settings)).car.wheel_track == 0.16


def test_no_spread_that_is_accepted_draws_a_car_without_grip_or_mass():
    sim = SimConfig(spread=DynamicsRandomization(grip=0.95, mass=0.95))
    cars = start(TrackSet(make_ring()), sim, list(range(2000))).cars
    assert cars["grip"].min() > 0.03 and cars["mass"].min() > 0.4  # 5 % of 0.7 and of 8.2 kg


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
