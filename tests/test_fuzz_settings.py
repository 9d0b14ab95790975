"""Settings of unknown origin: each ends in settings that drive, or in an error one can read."""

import decimal
import fractions
import math
import random
from dataclasses import fields
from typing import Literal, get_args, get_origin

import numpy as np
import pytest
import torch

from league.envs.config import EnvConfig, RewardConfig
from league.envs.race_env import RaceEnv
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
    VisualRandomization,
)
from league.track.track import TrackSet
from tests.scenes import SETTINGS, make_ring, taken

CLASSES = (*SETTINGS, RewardConfig)
JUNK = (
    None, True, False, -1, 2**63, -(10**400), -0.5, 1e308, 5e-324, math.nan, math.inf, -math.inf,
    "", "0.5", "x" * 10_000, "three\nlines\n", b"bytes", (), [], {}, [0.5], ((0.5, 0.0),), object(),
    len, 3 + 4j, decimal.Decimal("0.5"), fractions.Fraction(1, 2), torch.tensor(0.5), torch.ones(2),
    np.ones(2), np.array("x"), np.float64("nan"), np.float32("inf"), np.bool_(True), CarConfig,
)  # fmt: skip
TINY = {
    CameraConfig: {"width": 16, "height": 12},
    LidarConfig: {"beams": 16, "sectors": 4},
}
"""What keeps pictures and scans small."""


def plausible(dice, item):
    """Return a value of the field's kind and range; now and then the end of the range."""
    low, high = item.metadata.get("range", (0, 1))
    number = dice.choice([low, high, dice.uniform(low, high)])
    if low > 0:  # such ranges span magnitudes
        number = dice.choice([number, min(low * (high / low) ** dice.random(), high)])
    if item.type is int:
        return dice.choice([round(number), np.int64(round(number))])
    if item.type is float:
        return dice.choice([number, np.float64(number), item.default])
    return dice.choice(get_args(item.type) or (True, False))


def settings_of(dice, made, spoilt):
    """Return settings of a class, some missing, in the spoilt ones some junk."""
    simple = (int, float, bool)
    flat = [i for i in fields(made) if i.type in simple or get_origin(i.type) is Literal]
    chosen = dice.sample(flat, dice.choice([len(flat), dice.randint(0, len(flat))]))
    wanted = {item.name: plausible(dice, item) for item in chosen}
    for item in dice.sample(fields(made), dice.randint(1, 2)) if dice.random() < spoilt else ():
        wanted[item.name] = dice.choice(JUNK)
    return wanted


def drawn(dice, made, spoilt=0.0, **fixed):
    """Return the first settings of a class that are accepted."""
    while True:
        try:
            return made(**settings_of(dice, made, spoilt) | TINY.get(made, {}) | fixed)
        except ConfigError as error:
            assert one_sentence(error)


def one_sentence(error):
    said = str(error)
    return 10 < len(said) < 400 and "\n" not in said


@pytest.mark.parametrize("made", CLASSES)
def test_five_hundred_random_settings_each_end_in_settings_or_a_readable_error(made):
    dice = random.Random(made.__name__)
    accepted = refused = 0
    for _ in range(500):
        wanted = settings_of(dice, made, spoilt=0.5)
        try:
            cfg = made(**wanted)
        except ConfigError as error:
            assert one_sentence(error), (wanted, error)
            refused += 1
            continue
        accepted += 1
        for item in fields(made):
            if item.type in (int, float):
                low, high = item.metadata["range"]
                assert low <= getattr(cfg, item.name) <= high
    # Neither is so rare that the other is all that was tried.
    assert accepted > 20 and refused > 100


@pytest.mark.parametrize("seed", range(40))
def test_random_settings_that_are_accepted_can_be_driven(seed):
    dice = random.Random(seed)
    kind = dice.choice(["time_trial", "obstacle_avoidance", "head_to_head"])
    num_cars = dice.choice([2, 3, 8]) if kind == "head_to_head" else 1
    parts = {
        "car": CarConfig, "contact": ContactConfig, "obstacles": ObstacleConfig,
        "rules": RaceRules, "spread": DynamicsRandomization,
    }  # fmt: skip
    while True:
        nested = {name: drawn(dice, made, 0.2) for name, made in parts.items()}
        try:
            rate = {"step_hz": dice.choice([15, 15, 1, 60]), "decimation": dice.choice([8, 1, 2])}
            sim = SimConfig(kind=kind, num_cars=num_cars, **rate, **nested)
            break
        except ConfigError as error:  # a latency longer than a step
            assert one_sentence(error)
    senses = SensorConfig(camera=drawn(dice, CameraConfig), lidar=drawn(dice, LidarConfig))
    mode = dice.choice(["race", "training"])
    cfg = EnvConfig(sim=sim, mode=mode, sensors=(senses,), looks=drawn(dice, VisualRandomization))
    env = RaceEnv(TrackSet(make_ring()), cfg, num_worlds=2, seed=seed)
    draw = np.random.default_rng(seed)
    observed = taken(env.reset(seed=seed))
    for _ in range(10):
        step = env.step(draw.uniform(-1.0, 1.0, (2, num_cars, 2)))
        observed += taken(step.observations)
        assert np.isfinite(step.rewards).all()
    assert all(np.isfinite(group).all() for groups in observed for group in groups.values())
    env.close()
