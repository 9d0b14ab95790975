"""TorchRL takes the PettingZoo races, the single ones and the batch; see torchrl.txt."""

import warnings

import gymnasium
import pytest

pytest.importorskip("torchrl", reason="`make torchrl` installs it and runs these tests")

from torchrl.envs import GymWrapper, PettingZooWrapper
from torchrl.envs.utils import check_env_specs

from league.envs import parallel_env


def test_torchrl_accepts_the_agents_and_reads_their_infos():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it names the version of PettingZoo it was tried with
        env = PettingZooWrapper(parallel_env(solver="planar", sensors="lidar"))
    check_env_specs(env)
    infos = env.rollout(5)["next", "car", "info"]
    assert infos["reward_progress"].shape == (5, 2)
    assert infos["lidar_rate_hz"].unique().tolist() == [10.0]


def test_torchrl_accepts_the_single_race():
    check_env_specs(GymWrapper(gymnasium.make("league/TimeTrial-v0", sensors="lidar")))


@pytest.mark.parametrize("mode", ["SameStep", "Disabled"])
def test_torchrl_accepts_the_batch(mode):
    races = gymnasium.make_vec(
        "league/TimeTrial-v0", num_envs=4, sensors=(), max_steps=20, autoreset_mode=mode
    )
    env = GymWrapper(races)
    check_env_specs(env)
    assert env.rollout(30, break_when_any_done=False)["next", "reward"].shape == (4, 30, 1)
