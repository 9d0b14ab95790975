"""Stable-Baselines3 learns in a batch of races, and its policies become checkpoints."""

import numpy as np
import pytest

pytest.importorskip("stable_baselines3", reason="pip install '.[clients]' for these tests")

import gymnasium
import torch
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.env_checker import check_env

from league.agents import checkpoint, convert
from league.agents.policy import Policy
from league.envs import SB3VecEnv
from league.envs.adapters.gym_env import GymEnv
from league.errors import ActionError, ConfigError, PolicyError
from league.sim.config import CarConfig

SMALL = ("stereo64x48", "lidar")


def test_a_race_in_the_batch_is_the_race_alone_and_restarts_in_the_same_step():
    batch = SB3VecEnv(3, sensors=SMALL, max_steps=20)
    alone = GymEnv(sensors=SMALL, max_steps=20)
    batch.seed(4)
    seen, (one, _) = batch.reset(), alone.reset(seed=5)  # the second race's seed
    generator, ends = np.random.default_rng(0), 0
    for _ in range(60):
        for name, group in one.items():
            assert np.array_equal(seen[name][1], group), name
        actions = generator.uniform(-1, 1, (3, 2)).astype(np.float32)
        seen, rewards, dones, infos = batch.step(actions)
        one, reward, terminated, truncated, info = alone.step(actions[1])
        assert (rewards[1], dones[1]) == (np.float32(reward), terminated or truncated)
        if not dones[1]:
            assert infos[1] == {}
            continue
        ends += 1
        assert infos[1]["TimeLimit.truncated"] == (truncated and not terminated)
        for name, group in infos[1]["terminal_observation"].items():
            assert np.array_equal(group, one[name]), name
        assert infos[1]["distance"] == pytest.approx(info["distance"])
        one, _ = alone.reset()
    assert ends >= 3


def test_a_seed_repeats_and_the_next_reset_goes_on():
    env = SB3VecEnv(2, sensors="lidar")
    env.seed(3)
    first = env.reset()["lidar"]
    other = env.reset()["lidar"]
    env.seed(3)
    assert np.array_equal(env.reset()["lidar"], first)
    assert not np.array_equal(other, first)


def test_sb3_accepts_the_single_environment():
    check_env(gymnasium.make("league/TimeTrial-v0", sensors="lidar").unwrapped)


@pytest.mark.parametrize("algorithm", [PPO, A2C])
@pytest.mark.parametrize("sensors", [(), SMALL])
def test_a_model_learns_and_its_checkpoint_drives_as_it_does(algorithm, sensors, tmp_path):
    env = SB3VecEnv(4, sensors=sensors, reward="progress")
    kwargs = {"activation_fn": torch.nn.ReLU}
    model = algorithm(
        "MultiInputPolicy", env, n_steps=16, seed=0, device="cpu", policy_kwargs=kwargs
    )
    model.learn(64)
    path = tmp_path / "mine.pt"
    checkpoint.save(path, convert.from_sb3(model, name="mine", sensors=sensors, steps=64))
    driver = Policy(checkpoint.load(path), CarConfig())
    driver.reset(None)
    seen = env.reset()
    actions, _ = model.predict(seen, deterministic=True)
    np.testing.assert_allclose(driver.act(seen), actions, atol=2e-5)


@pytest.mark.parametrize(
    ("make", "sensors", "sentence"),
    [
        (lambda: PPO("MultiInputPolicy", SB3VecEnv(1, sensors=SMALL), device="cpu"), SMALL,
         "one, which follows every layer"),
        (lambda: PPO("MultiInputPolicy", SB3VecEnv(1, sensors=()), device="cpu"), "lidar",
         "observes motion, a car with these sensors lidar, motion"),
        (lambda: SAC("MultiInputPolicy", SB3VecEnv(1, sensors=()), device="cpu"), (),
         "give a PPO or A2C model"),
    ],
)  # fmt: skip
def test_models_that_cannot_be_checkpoints_are_refused(make, sensors, sentence):
    with pytest.raises(PolicyError, match=sentence):
        convert.from_sb3(make(), name="x", sensors=sensors)


def test_mistakes_are_refused_with_a_sentence():
    with pytest.raises(ConfigError, match="no option 'num_worlds'; there are "):
        SB3VecEnv(2, num_worlds=3)
    with pytest.raises(ConfigError, match="num_envs is 0"):
        SB3VecEnv(0)
    env = SB3VecEnv(2, sensors=())
    with pytest.raises(ActionError, match="call reset"):
        env.step(np.zeros((2, 2)))
    env.reset()
    with pytest.raises(ActionError, match="row 1"):
        env.step(np.array([[0, 0], [0, 2]]))
