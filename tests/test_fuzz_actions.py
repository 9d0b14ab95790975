"""Actions of unknown origin at three interfaces; each steps, or is refused and changes nothing."""

import random

import numpy as np
import pytest
import torch

from league.envs import parallel_env
from league.envs.actions import ContinuousActions, grid
from league.envs.adapters.gym_env import GymEnv
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig
from league.errors import ActionError
from league.sim.config import SimConfig
from league.track.track import TrackSet
from tests.scenes import assert_same, make_ring

JUNK = (
    None, True, 0, 0.5, 10**400, "0", b"1", 1j, [], {}, (), set(), object(), len, [[0.0], [0.0, 1]],
    [[0.1, 0.2]], ["0", "1"], [10**400, 0], [None, 0], {"steering": 0, "speed": 1},
    np.zeros(0), np.zeros((3, 3)), np.array(["0", "1"]), np.ones(2, bool), np.ones(2, complex),
    torch.zeros(0), torch.zeros(2, 2, 2), torch.tensor(0.5),
)  # fmt: skip
NAMES = (None, 0, "", "car_2", "car_0 ", "CAR_0", b"car_0", "car_\n0", ("car_0",), 10**400, 1j)
"""Keys that name no agent of a race of two."""
STRANGE = (0.0, -0.0, 1.5, 5e-324, 1e30, 1e308, np.nan, np.inf, -np.inf)
FORMATS = (torch.float32, torch.float64, torch.float16, torch.bfloat16, torch.int64, torch.uint8)
NO_FORMATS = (torch.bool, torch.complex64, torch.float8_e4m3fn)


def numbers(dice, *shape):
    """Return a tensor in double precision, most of it from -1 to 1, now and then misshapen."""
    if dice.random() < 0.2:
        shape = dice.choice([(), (0,), (1,), (3,), (1, 2), (2, 1), (3, 3)])
    values = torch.zeros(shape, dtype=torch.float64).apply_(lambda _: dice.uniform(-1, 1))
    if values.numel() and dice.random() < 0.4:
        values.view(-1)[dice.randrange(values.numel())] = dice.choice(STRANGE)
    return values


def readable(error):
    said = str(error)
    return 10 < len(said) < 400 and "\n" not in said


def test_two_thousand_random_actions_at_gymnasiums_door_step_or_are_refused():
    env = GymEnv(make_ring(), sensors=())
    env.reset(seed=0)
    dice = random.Random(0)
    steps = refused = 0
    for _ in range(2000):
        made = numbers(dice, 2)
        action = dice.choice([made, made.to(torch.float32), made.numpy(), made.tolist()])
        try:
            observation, reward, *over, _ = env.step(
                dice.choice(JUNK) if dice.random() < 0.2 else action
            )
        except ActionError as error:
            assert readable(error)
            refused += 1
            continue
        steps += 1
        assert np.isfinite(reward) and np.isfinite(observation["motion"]).all()
        if over[0] or over[1]:
            env.reset()
    assert steps > 500 and refused > 500


@pytest.mark.parametrize("space", [None, ContinuousActions(), grid(3, 30, 2, 3)])
def test_thousand_random_actions_at_rsl_rls_door_step_or_are_refused(space):
    cfg = EnvConfig(sim=SimConfig(decimation=2), mode="training", episode_s=4.0)
    env = RacingVecEnv(TrackSet(make_ring()), cfg, num_worlds=2, action_space=space)
    dice = random.Random(0)
    steps = refused = 0
    for _ in range(1000):
        made = numbers(dice, env.num_envs, env.num_actions)
        formats = NO_FORMATS if dice.random() < 0.1 else FORMATS
        action = made.to(dice.choice(formats))
        junk = dice.choice([*JUNK, made.numpy(), made.tolist()])
        try:
            obs, rewards, *_ = env.step(junk if dice.random() < 0.2 else action)
        except ActionError as error:
            assert readable(error)
            refused += 1
            continue
        steps += 1
        driven = env.race_env.last_action
        assert torch.isfinite(rewards).all() and (np.abs(driven) <= 1).all()
        assert torch.isfinite(obs["motion"]).all() and torch.isfinite(obs["state"]).all()
    assert steps > 250 and refused > 250


def of_agents(dice, agents):
    """Return something like a dict of actions: mostly right, or wrong in one or two ways."""
    made = {}
    for agent in agents:
        action = numbers(dice, 2)
        made[agent] = dice.choice(
            [action, action.to(torch.float32), action.numpy(), action.tolist()]
        )
    if dice.random() < 0.3 and made:
        made[dice.choice(list(made))] = dice.choice(JUNK)
    if dice.random() < 0.1 and made:
        del made[dice.choice(list(made))]
    if dice.random() < 0.1:
        made[dice.choice([*NAMES, "car_0", "car_1"])] = dice.choice([[0.0, 0.0], *JUNK])
    if dice.random() < 0.1:
        return dice.choice([*JUNK, list(made), list(made.items()), str(made), {}])
    return made


@pytest.mark.parametrize("mode", ["race", "training"])
def test_two_thousand_random_dicts_at_pettingzoos_step_step_or_are_refused(mode):
    env = parallel_env(make_ring(), mode=mode, solver="planar", sensors=(), laps=1, max_steps=40)
    world = env.race_env.world
    env.reset(seed=0)
    dice = random.Random(0)
    steps = refused = 0
    for _ in range(2000):
        if not env.agents:
            env.reset()
        before, agents = world.copy(), list(env.agents)
        seen = {name: group.copy() for name, group in env.race_env.observations[0].items()}
        action = of_agents(dice, agents)
        try:
            observations, rewards, *_ = env.step(action)
        except ActionError as error:
            assert readable(error), error
            assert_same(before, world)
            assert_same(seen, dict(env.race_env.observations[0]))
            assert env.agents == agents
            refused += 1
            continue
        steps += 1
        assert list(observations) == list(rewards) == agents
        assert np.isfinite(list(rewards.values())).all()
        assert all(
            np.isfinite(observation["motion"]).all() for observation in observations.values()
        )
    assert steps > 300 and refused > 500
    env.close()


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 1.5, "0", None, 10**400, 1j])
@pytest.mark.parametrize("car", [0, 1])
def test_pettingzoo_names_the_agent_of_an_action_that_is_none(car, wrong):
    env = parallel_env(make_ring(), solver="planar", sensors=())
    env.reset(seed=0)
    before = env.race_env.world.copy()
    with pytest.raises(ActionError, match=f"car_{car}") as caught:
        env.step({f"car_{car}": [0.0, wrong], f"car_{1 - car}": [0.0, 0.0]})
    assert readable(caught.value)
    assert_same(before, env.race_env.world)
    # The race goes on as if nothing had been asked.
    env.step({"car_0": [0.0, 0.0], "car_1": [0.0, 0.0]})
    assert env.race_env.world.worlds["step"].tolist() == [1]
