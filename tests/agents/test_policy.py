"""A policy drives by its checkpoint alone: the same bits alone and in a batch."""

import random
from typing import get_args

import pytest
import torch
from trained import SENSES, make_checkpoint, told

from league.agents import checkpoint, roster
from league.agents.network import Activation, NetworkConfig
from league.agents.policy import Policy
from league.envs.action_space import ContinuousActions, grid, to_actions
from league.envs.config import EnvConfig
from league.envs.vec_env import RacingVecEnv
from league.errors import PolicyError
from league.race import run
from league.race_spec import Entry, RaceSpec
from league.sim.config import CarConfig, SimConfig
from league.track import files
from league.track.course import TrackSet

CAR = CarConfig()
MANY = grid(4, 30, 10, 4)
"""40 choices: threads would share them, with other bits from three threads on."""


@pytest.mark.parametrize("rows", [5, 16, 33])
@pytest.mark.parametrize("senses", SENSES)
def test_a_row_gets_the_same_bits_alone_and_among_many(senses, rows):
    trained = make_checkpoint(senses)
    policy, many = Policy(trained, CAR), told(trained.card, rows)
    together = policy.outputs(many)
    for row in range(rows):
        alone = policy.outputs({name: group[row : row + 1] for name, group in many.items()})
        assert torch.equal(alone[0], together[row])


def differing(trained, rows: int) -> list[int]:
    """Return the rows of a batch that are answered otherwise than alone."""
    policy, many = Policy(trained, CAR), told(trained.card, rows, seed=rows)
    together = policy.outputs(many)
    alone = [
        policy.outputs({name: group[row : row + 1] for name, group in many.items()})
        for row in range(rows)
    ]
    return [row for row in range(rows) if not torch.equal(alone[row][0], together[row])]


UNEVEN = (
    {"hidden": (129,)},
    {"hidden": (10, 50)},
    {"channels": (16, 33, 32)},
    {"channels": (3, 5, 7), "hidden": (1,)},
    {"channels": (1, 32, 32), "hidden": (200, 128), "activation": "mish"},
)


@pytest.mark.parametrize("layers", UNEVEN)
@pytest.mark.parametrize("senses", SENSES)
def test_a_row_of_an_uneven_network_gets_the_same_bits_alone_and_among_many(senses, layers):
    trained = make_checkpoint(senses, network=NetworkConfig(**layers))
    assert differing(trained, 13) == []


def test_many_networks_give_a_row_the_same_bits_alone_and_among_many():
    draw = random.Random(5)
    for number in range(60):
        number_of = draw.randint(1, 3)
        even = number % 2 == 0  # these decide four rows at a time

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
        assert differing(trained, draw.choice((5, 6, 7, 9))) == [], (network, senses)


@pytest.mark.parametrize("space", [ContinuousActions(), MANY])
@pytest.mark.parametrize("senses", SENSES)
def test_bits_do_not_depend_on_the_number_of_threads(senses, space):
    trained = make_checkpoint(senses, action_space=space)
    policy, many = Policy(trained, CAR), told(trained.card, 6)
    before = torch.get_num_threads()
    try:
        answers = []
        for threads in (1, 2, 3, 4, 8):
            torch.set_num_threads(threads)
            answers.append(policy.outputs(many))
            assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)
    assert all(torch.equal(answers[0], other) for other in answers[1:])


def test_an_inexact_policy_agrees_but_for_the_last_bits():
    trained = make_checkpoint()
    many = told(trained.card, 16)
    exact, quick = Policy(trained, CAR), Policy(trained, CAR, exact=False)
    torch.testing.assert_close(quick.outputs(many), exact.outputs(many), rtol=0, atol=1e-6)


def test_pictures_are_told_as_the_learner_was_told_them():
    trained = make_checkpoint("stereo")
    policy, many = Policy(trained, CAR), told(trained.card, 2)
    scaled = {**many, "stereo": many["stereo"].to(torch.float32) / 255.0}
    assert torch.equal(policy.outputs(many), policy.outputs(scaled))


def test_continuous_outputs_become_actions_by_the_space_of_the_card():
    space = ContinuousActions(-10, 10, 1, 2)
    trained = make_checkpoint("blind", action_space=space)
    for name, weight in trained.weights.items():
        if name.startswith("mlp"):
            weight.zero_()
    trained.weights["mlp.2.bias"][:] = torch.tensor([0.5, 3.0])
    # Steering 0.5 of 10 deg is 5 deg: 1/6 of 30. Speed is cut off at 2 m/s: (2 - 0.1) / 3.9.
    actions = Policy(trained, CAR).act(told(trained.card, 3))
    expected = torch.tensor([[1 / 6, 2 * 1.9 / 3.9 - 1]]).expand(3, 2)
    torch.testing.assert_close(actions, expected)


def test_discrete_outputs_choose_the_best_score():
    space = grid(3, 30, 1, 2)
    trained = make_checkpoint("blind", action_space=space)
    trained.weights["mlp.2.weight"].zero_()
    trained.weights["mlp.2.bias"][:] = torch.tensor([0.0, -1.0, 9.0])
    actions = Policy(trained, CAR).act(told(trained.card, 2))
    assert space.choices[2] == (-30.0, 2.0)
    assert torch.equal(actions, to_actions(space, torch.tensor([[0.0, 0.0, 1.0]] * 2), CAR))
    assert actions[:, 0].tolist() == [-1.0, -1.0]


def test_what_it_answers_is_a_plain_tensor():
    trained = make_checkpoint("blind")
    actions = Policy(trained, CAR).act(told(trained.card, 1))
    assert actions.dtype == torch.float32
    assert actions.shape == (1, 2)
    assert not actions.requires_grad
    assert not actions.is_inference()


@pytest.mark.parametrize("spoil", ["missing", "shape"])
def test_a_car_with_other_sensors_is_told_of(spoil):
    trained = make_checkpoint("stereo")
    groups = told(trained.card, 1)
    given = groups.pop("stereo")
    if spoil == "shape":
        groups["stereo"] = given[:, :, 1:]
    with pytest.raises(
        PolicyError, match=r"'rookie' was told .* needs stereo of shape \(2, 36, 48"
    ):
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
        assert bool((env.race_env.last_action[:, 1] != 0).any())
    finally:
        env.close()
