"""A policy's decision: what torch computes, with the same bits alone, in a batch, everywhere."""

import hashlib
import random
from typing import get_args

import numpy as np
import pytest
import torch

from league.agents import checkpoint, roster
from league.agents.network import Activation, NetworkConfig
from league.agents.policy import Policy
from league.envs.actions import ContinuousActions, grid, to_actions
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig
from league.errors import PolicyError
from league.race_spec import Entry, RaceSpec
from league.racing.race import run
from league.sim.config import CarConfig, SimConfig
from league.track import files
from league.track.track import TrackSet
from tests.actor import Actor
from tests.agents.trained import SENSES, make_checkpoint, readings

CAR = CarConfig()


def by_torch(trained, groups) -> np.ndarray:
    """Return what torch computes from the same weights."""
    card = trained.card
    actor = Actor(card.network, card.group_shapes, card.action_space.size)
    actor.load_state_dict({name: torch.from_numpy(w) for name, w in trained.weights.items()})
    scaled = {
        name: torch.from_numpy(group).to(torch.float32) / (255.0 if group.dtype == np.uint8 else 1)
        for name, group in groups.items()
    }
    with torch.no_grad():
        return actor(scaled).numpy()


def check(trained, rows: int) -> None:
    """Compare a batch with torch, and each row with the row alone."""
    policy, many = Policy(trained, CAR), readings(trained.card, rows, seed=rows)
    together = policy.outputs(many)
    np.testing.assert_allclose(together, by_torch(trained, many), rtol=1e-5, atol=1e-5)
    for row in range(rows):
        alone = policy.outputs({name: group[row : row + 1] for name, group in many.items()})
        assert np.array_equal(alone[0], together[row])


@pytest.mark.parametrize("activation", get_args(Activation))
@pytest.mark.parametrize("senses", SENSES)
def test_a_policy_computes_what_torch_computes(senses, activation):
    network = NetworkConfig(hidden=(64, 32), activation=activation, normalise=True)
    check(make_checkpoint(senses, network=network), 5)


UNEVEN = (
    {"hidden": (129,)},
    {"hidden": (10, 50)},
    {"channels": (16, 33, 32)},
    {"channels": (3, 5, 7), "hidden": (1,)},
    {"channels": (1, 32, 32), "hidden": (200, 128), "activation": "mish"},
)


@pytest.mark.parametrize("layers", UNEVEN)
@pytest.mark.parametrize("senses", SENSES)
def test_layers_of_uneven_width_are_computed_the_same_way(senses, layers):
    check(make_checkpoint(senses, network=NetworkConfig(**layers)), 13)


def test_many_random_networks_are_computed_the_same_way():
    draw = random.Random(5)
    for number in range(60):
        number_of = draw.randint(1, 3)
        even = number % 2 == 0

        def sizes(count: int, largest: int, even: bool = even) -> tuple[int, ...]:
            step = 16 if even else 1
            return tuple(step * draw.randint(1, largest // step) for _ in range(count))

        network = NetworkConfig(
            channels=sizes(number_of, 64),
            kernels=tuple(draw.randint(1, 4) for _ in range(number_of)),
            strides=tuple(draw.randint(2, 3) for _ in range(number_of)),
            hidden=sizes(draw.randint(1, 3), 128),
            activation=draw.choice(get_args(Activation)),
            normalise=draw.random() < 0.5,
        )
        space = grid(draw.randint(2, 6), 30, draw.randint(1, 40), 4)
        senses = draw.choice(list(SENSES))
        trained = make_checkpoint(senses, network=network, action_space=space)
        check(trained, draw.choice((1, 5, 6)))


def test_a_decision_has_these_bits_on_every_machine():
    # The weights are computed without libm; only + - * / and sqrt take part in the decision.
    trained = make_checkpoint("all", network=NetworkConfig(activation="mish", normalise=True))
    for name, weight in trained.weights.items():
        ramp = np.arange(weight.size, dtype=np.float32) * np.float32(0.618034) % np.float32(1.0)
        spread = np.float32(1.0 if name.startswith("obs") else weight[0].size ** -0.5)
        weight[:] = ((ramp + np.float32(0.1)) * spread).reshape(weight.shape)
    groups = readings(trained.card, 3)
    outputs = Policy(trained, CAR).outputs(groups)
    assert np.isfinite(outputs).all() and outputs.std() > 0.0
    assert hashlib.sha256(outputs.tobytes()).hexdigest()[:16] == "76a9d60bed2909fb"


def test_continuous_outputs_become_actions_by_the_space_of_the_card():
    space = ContinuousActions(-10, 10, 1, 2)
    trained = make_checkpoint("blind", action_space=space)
    for name, weight in trained.weights.items():
        if name.startswith("mlp"):
            weight[:] = 0.0
    trained.weights["mlp.2.bias"][:] = 0.5, 3.0
    # Steering 0.5 of 10 deg is 5 deg: 1/6 of 30. Speed is cut off at 2 m/s: (2 - 0.1) / 3.9.
    actions = Policy(trained, CAR).act(readings(trained.card, 3))
    np.testing.assert_allclose(actions, [[1 / 6, 2 * 1.9 / 3.9 - 1]] * 3, atol=1e-6)


def test_discrete_outputs_choose_the_best_score():
    space = grid(3, 30, 1, 2)
    trained = make_checkpoint("blind", action_space=space)
    trained.weights["mlp.2.weight"][:] = 0.0
    trained.weights["mlp.2.bias"][:] = 0.0, -1.0, 9.0
    actions = Policy(trained, CAR).act(readings(trained.card, 2))
    assert space.choices[2] == (-30.0, 2.0)
    scores = np.array([[0.0, 0.0, 1.0]] * 2, np.float32)
    assert np.array_equal(actions, to_actions(space, scores, CAR))
    assert actions[:, 0].tolist() == [-1.0, -1.0]


def test_actions_are_float32_of_one_row_per_car():
    trained = make_checkpoint("blind")
    actions = Policy(trained, CAR).act(readings(trained.card, 3))
    assert (actions.dtype, actions.shape) == (np.float32, (3, 2))


@pytest.mark.parametrize("spoil", ["missing", "shape", "floats"])
def test_observations_of_other_sensors_are_refused(spoil):
    trained = make_checkpoint("stereo")
    groups = readings(trained.card, 1)
    given = groups.pop("stereo")
    if spoil == "shape":
        groups["stereo"] = given[:, :, 1:]
    elif spoil == "floats":
        groups["stereo"] = given.astype(np.float32)
    wanted = r"'rookie' was given .* needs uint8 stereo of shape \(2, 36, 48"
    with pytest.raises(PolicyError, match=wanted):
        Policy(trained, CAR).act(groups)


def test_the_roster_loads_a_checkpoint_for_any_set_of_tracks(tmp_path):
    checkpoint.save(tmp_path / "a.pt", make_checkpoint("lidar", name="Rookie of May"))
    both = TrackSet(files.load("harbour_oval"), files.load("peanut"))
    driver = roster.load(str(tmp_path / "a.pt"), both, CAR)
    assert driver.name == "Rookie of May"
    assert driver.sensors == SENSES["lidar"]


def test_the_roster_names_the_file_it_cannot_load(tmp_path):
    with pytest.raises(PolicyError, match=r"nobody\.pt.*cannot be read \(No such file"):
        roster.load(str(tmp_path / "nobody.pt"), TrackSet(files.load("peanut")), CAR)


def test_two_checkpoints_race_each_other_and_again_the_same_way(tmp_path):
    for number, senses in enumerate(["stereo", "all"]):
        checkpoint.save(tmp_path / f"{number}.pt", make_checkpoint(senses, seed=number))
    spec = RaceSpec(
        track="harbour_oval",
        laps=1,
        max_time_s=3.0,
        entries=tuple(Entry(name=str(tmp_path / f"{number}.pt")) for number in (0, 1)),
    )
    first, second = run(spec, record=False), run(spec, record=False)
    assert first.result == second.result
    assert not any(event.kind == "driver_fault" for event in first.result.events)
    assert first.result.race_s >= 2.9


def test_a_checkpoint_drives_an_opponent_in_training(tmp_path):
    checkpoint.save(tmp_path / "a.pt", make_checkpoint("lidar"))
    cfg = EnvConfig(sim=SimConfig(kind="head_to_head", num_cars=2), mode="training")
    env = RacingVecEnv(
        TrackSet(files.load("peanut")),
        cfg,
        num_worlds=3,
        opponents={1: str(tmp_path / "a.pt")},
    )
    try:
        env.step(torch.zeros(3, 2))
        assert (env.race_env.world.cars["action_steering"][:, 1] != 0).any()
    finally:
        env.close()


def test_weights_begin_where_wide_loads_are_quick():
    for senses in SENSES:
        policy = Policy(make_checkpoint(senses), CAR)
        assert policy._network.weights.ctypes.data % 64 == 0
