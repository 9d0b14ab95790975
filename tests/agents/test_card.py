"""A card is data, checked; it says what a network needs and where it comes from."""

import json

import pytest
import safetensors.torch
import torch
from pydantic import ValidationError

from league.agents.checkpoint import Card, RewardCard
from league.agents.network import NetworkConfig
from league.envs.actions import ContinuousActions, grid
from league.errors import ConfigError, PolicyError
from league.matchmaking import submission
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from league.training.config import RunConfig, TrainConfig
from league.training.run import Run
from tests.agents.trained import SENSES, make_card


@pytest.mark.parametrize("senses", SENSES)
@pytest.mark.parametrize("space", [ContinuousActions(-20, 20, 1, 2), grid(5, 30, 2, 3)])
def test_a_card_survives_json(senses, space):
    card = make_card(
        senses,
        action_space=space,
        network=NetworkConfig(hidden=(64,), activation="relu"),
        tracks=("peanut", "harbour_oval"),
        reward=RewardCard(name="mine.py", sha256="a" * 64),
        parents=("b" * 64,),
        results={"best_lap_s": 9.25, "completion": 1.0, "laps": None},
        command="league train --minutes 1",
    )
    again = Card.model_validate_json(card.model_dump_json(), strict=True)
    assert again == card
    assert again.sensors == SENSES[senses]
    assert again.action_space == space


def test_shapes_follow_from_sensors_space_and_network():
    card = make_card("lidar", action_space=grid(5, 30, 2, 3), network=NetworkConfig(hidden=(8,)))
    assert card.group_shapes == {"lidar": (64,), "motion": (5,)}
    assert card.weight_shapes == {
        "mlp.0.weight": (8, 69),
        "mlp.0.bias": (8,),
        "mlp.2.weight": (10, 8),
        "mlp.2.bias": (10,),
    }


def test_a_card_cannot_be_changed():
    with pytest.raises(ValidationError):
        make_card().name = "another"


@pytest.mark.parametrize(
    "change",
    [
        {"format": 2},
        {"name": ""},
        {"name": "n" * 81},
        {"name": "red\x1b[31m"},
        {"command": "a\nb"},
        {"command": "c" * 2001},
        {"tracks": ["t"] * 257},
        {"kind": "rally"},
        {"reward": {"name": "x", "sha256": "short"}},
        {"parents": ["Z" * 64]},
        {"created": "yesterday"},
        {"steps": -1},
        {"steps": True},
        {"train_s": float("nan")},
        {"results": {"lap": "fast"}},
        {"results": {str(number): 1.0 for number in range(65)}},
        {"surprise": 1},
        {"sensors": {"camera": {"width": "48"}}},
        {"sensors": {"camera": {"wide": 48}}},
        {"sensors": {"camera": {"eyes": "third"}}},
        {"sensors": {"radar": {}}},
        {"action_space": {}, "network": {"layers": 3}},
        {"action_space": {"choices": [[0, 1, 2], [0, 1, 2]]}},
    ],
)
def test_what_a_card_cannot_hold_is_refused(change):
    given = {**json.loads(make_card().model_dump_json()), **change}
    with pytest.raises(ValidationError):
        Card.model_validate_json(json.dumps(given), strict=True)


@pytest.mark.parametrize(
    "sensors",
    [
        SensorConfig(camera=CameraConfig(up=3.0)),
        SensorConfig(camera=CameraConfig(forward=-0.5)),
        SensorConfig(camera=CameraConfig(width=1920, height=1080)),
        SensorConfig(lidar=LidarConfig(max_range=1e6)),
        SensorConfig(lidar=LidarConfig(noise=2.0)),
    ],
)
def test_sensors_no_car_can_carry_are_refused(sensors):
    with pytest.raises(ValidationError):
        make_card(sensors=sensors)


def test_settings_that_contradict_each_other_are_refused_as_everywhere():
    with pytest.raises(ConfigError, match="low must lie below high"):
        Card.model_validate(
            {"name": "x", "sensors": {}, "action_space": {"steering_low": 9, "steering_high": 3}}
        )


COSTLY = {
    # 26 kB of weights that would make 78 million numbers for each of four rows: 2.7 GB.
    "sensors": SensorConfig(camera=CameraConfig(640, 480, eyes="left")),
    "network": NetworkConfig(channels=(256, 1), kernels=(1, 1), strides=(1, 8), hidden=(8,)),
}


def test_a_network_that_costs_too_much_is_refused_before_it_is_trained(tmp_path):
    with pytest.raises(ConfigError, match="holds 78648010 activations") as refusal:
        Run(RunConfig(minutes=1.0, train=TrainConfig(**COSTLY)), tmp_path)
    assert "\n" not in str(refusal.value)


def test_a_network_that_costs_too_much_is_refused_when_it_is_submitted():
    card = make_card(**COSTLY)
    content = safetensors.torch.save(
        {"mlp.0.bias": torch.zeros(8)}, {"card": card.model_dump_json()}
    )
    with pytest.raises(PolicyError, match=r"submission is refused: .*78648010 activations"):
        submission.unpack(content)
