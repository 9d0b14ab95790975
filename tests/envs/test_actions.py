from __future__ import annotations

import random

import numpy as np
import pytest
import torch

from league.envs import parallel_env
from league.envs.actions import checked
from league.errors import ActionError


@pytest.mark.parametrize(
    "action",
    [
        [0, 1],
        (0.5, -1.0),
        np.array([0.25, 1.0]),
        np.array([1, -1], np.int8),
        np.array([0.5, 0.5], np.float16),
        torch.tensor([0.5, -0.5]),
        torch.tensor([0.5, -0.5], dtype=torch.bfloat16, requires_grad=True),
        np.array([1 + 1e-9, -1 - 1e-9]),  # full, in double precision
    ],
)
def test_two_numbers_from_minus_one_to_one_are_an_action(action):
    taken = checked(action, "car_0")
    assert taken.shape == (2,) and taken.dtype == np.float32
    assert np.abs(taken).max() <= 1.0


@pytest.mark.parametrize(
    ("action", "sentence"),
    [
        ([np.nan, 0], "must be numbers from -1 to 1"),
        ([np.inf, 0], "must be numbers from -1 to 1"),
        ([1.01, 0], r"is \[1.01, 0.0\]: steering and speed must be numbers from -1 to 1"),
        ([0.3, 1.0000001], r"is \[0.3, 1.0000001\]: steering and speed must be"),
        ([0, 1e300], "must be numbers from -1 to 1"),
        ([0], r"has shape \(1,\): expected \(2,\)"),
        ([[0, 0]], r"has shape \(1, 2\): expected \(2,\)"),
        (0.5, r"has shape \(\): expected \(2,\)"),
        ([], r"has shape \(0,\)"),
        ([[0], [0, 1]], "expected real numbers"),
        (None, "expected real numbers"),
        ("left", "expected real numbers"),
        ({"steering": 0, "speed": 1}, "expected real numbers"),
        ([True, False], "expected real numbers"),
        ([1j, 0], "expected real numbers"),
        ([10**400, 0], "expected real numbers"),
        (torch.tensor([True, False]), "expected real numbers"),
        (torch.tensor([1j, 0]), "expected real numbers"),
        (np.array(["0", "1"]), "expected real numbers"),
    ],
)
def test_anything_else_is_refused_with_a_sentence(action, sentence):
    with pytest.raises(ActionError, match=sentence) as raised:
        checked(action, "car_0")
    assert "car_0" in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("actions", "sentence"),
    [
        (
            {"car_0": [0, 0], "car_1": [0, 0], "car_2": [0, 0]},
            "an action for 'car_2', which is no agent here; nearest: car_",
        ),
        ({"car_0": [0, 0], "car_1": [0, 0], 0: [0, 0]}, "an action for 0"),
        ({"car_0": [0, 0]}, "no action for car_1"),
        ({}, "no action for car_0, car_1"),
        ([[0, 0], [0, 0]], "give a dict"),
        (None, "give a dict"),
    ],
)
def test_every_agent_acts_and_nobody_else(actions, sentence):
    env = parallel_env(sensors=(), solver="planar")
    env.reset(seed=0)
    with pytest.raises(ActionError, match=sentence):
        env.step(actions)


def test_a_refused_action_changes_nothing():
    one, other = (parallel_env(sensors=(), solver="planar") for _ in "ab")
    one.reset(seed=0), other.reset(seed=0)
    good = {"car_0": [0.1, 0.5], "car_1": [0.0, 0.5]}
    for _ in range(5):
        with pytest.raises(ActionError):
            one.step({**good, "car_1": [np.nan, 0]})
        observed = [env.step(good)[0] for env in (one, other)]
        assert np.array_equal(observed[0]["car_0"]["motion"], observed[1]["car_0"]["motion"])


def test_nobody_acts_before_the_first_reset():
    env = parallel_env(sensors=())
    with pytest.raises(ActionError, match="before the first reset"):
        env.step({"car_0": [0, 0], "car_1": [0, 0]})


def test_five_thousand_random_actions_end_in_a_step_or_an_action_error():
    env = parallel_env(kind="time_trial", sensors=(), solver="planar")
    env.reset(seed=0)
    dice = random.Random(0)
    steps = refused = 0
    for _ in range(5000):
        try:
            _, rewards, *_ = env.step(nonsense(dice))
            steps += 1
            assert all(np.isfinite(value) for value in rewards.values())
        except ActionError as error:
            refused += 1
            assert "\n" not in str(error) and len(str(error)) < 400
        if not env.agents:
            env.reset()
    assert steps > 500 and refused > 2000


def nonsense(dice: random.Random) -> object:
    """Return something that may be the actions of one agent, car_0."""
    if dice.random() < 0.1:
        return dice.choice([None, [], 3, "car_0", {}, [[0, 0]], {None: None}, np.zeros((1, 2))])
    named = {dice.choice(["car_0"] * 9 + ["car_1", "Car_0", "", 0, None, ("car_0",)]): one(dice)}
    if dice.random() < 0.05:
        named["car_7"] = one(dice)
    return named


def one(dice: random.Random) -> object:
    number = dice.choice(
        [
            lambda: dice.uniform(-1, 1),
            lambda: dice.uniform(-1, 1),
            lambda: dice.uniform(-2, 2),
            lambda: dice.choice([0, 1, -1, 2, True, None, "0", b"1", 1j, [], {}, object()]),
            lambda: dice.choice([float("nan"), float("inf"), -float("inf"), 5e-324, 1e308, -0.0]),
            lambda: dice.choice([10**30, -(10**400), 2**63, -(2**63)]),
        ]
    )
    length = dice.choice([2] * 8 + [0, 1, 3, 64])
    values = [number() for _ in range(length)]
    shape = dice.random()
    if shape < 0.3:
        return tuple(values)
    if shape < 0.4:
        return [values, values]
    if shape < 0.7 and all(isinstance(value, float) for value in values):
        kind = dice.choice([np.float16, np.float32, np.float64, np.longdouble, object])
        with np.errstate(over="ignore"):
            return np.array(values).astype(kind)
    if shape < 0.85 and all(isinstance(value, float) for value in values):
        kind = dice.choice([torch.float16, torch.bfloat16, torch.float32, torch.float64])
        return torch.tensor(values, dtype=kind)
    if shape < 0.9:
        return dice.choice([None, 0.5, "0.5", set(), object(), np.float32(0.1), len])
    return values
