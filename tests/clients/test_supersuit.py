"""SuperSuit's wrappers take the PettingZoo races."""

import numpy as np
import pytest

supersuit = pytest.importorskip("supersuit", reason="pip install '.[clients]' for these tests")

from pettingzoo.test import parallel_api_test

from league.envs import parallel_env


def test_supersuit_wraps_and_batches_the_agents(capsys):
    def race():
        return parallel_env(solver="planar", sensors="lidar", max_cycles=20)

    parallel_api_test(supersuit.clip_actions_v0(race()), num_cycles=30)
    env = supersuit.pettingzoo_env_to_vec_env_v1(race())
    env = supersuit.concat_vec_envs_v1(env, 2, base_class="gymnasium")
    observations, _ = env.reset(seed=1)
    assert observations["lidar"].shape == (4, 64)  # two races of two cars
    for _ in range(25):
        observations, rewards, *_ = env.step(np.zeros((4, 2), np.float32))
    assert rewards.shape == (4,)
    env.close()
