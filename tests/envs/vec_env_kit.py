"""check_vec_env: judges an environment by rsl-rl's contract, as check_env does for Gymnasium."""

from __future__ import annotations

from collections.abc import Callable

import torch
from rsl_rl.env import VecEnv
from rsl_rl.runners import OnPolicyRunner
from tensordict import TensorDict


def check_vec_env(make: Callable[[], VecEnv], *, rows_per_world: int = 1) -> None:
    """Fail with a sentence where an environment breaks the contract.

    Args:
        make: builds the environment; each call the same, down to the seed.
        rows_per_world: rows that see each other; others must not touch.
    """
    check_attributes(make())
    check_steps(make())
    check_clipping(make)
    check_episode_length_buf(make())
    check_rows_are_apart(make, rows_per_world)
    check_repeats(make)
    check_learns(make())


def check_attributes(env: VecEnv) -> None:
    assert isinstance(env, VecEnv), "is no rsl_rl.env.VecEnv"
    assert isinstance(env.num_envs, int) and env.num_envs > 0, "num_envs is no positive int"
    assert isinstance(env.num_actions, int) and env.num_actions > 0, "num_actions likewise"
    assert int(env.max_episode_length) > 1, "max_episode_length must be larger than 1"
    assert torch.device(env.device).type in ("cpu", "cuda"), "device is not a torch device"
    assert env.cfg is not None, "cfg is missing"
    assert env.episode_length_buf.shape == (env.num_envs,), "episode_length_buf has a wrong shape"
    assert env.episode_length_buf.dtype == torch.int64, "episode_length_buf must be int64"
    assert bool((env.episode_length_buf == 0).all()), "was not reset once at construction"
    _check_observations(env, env.get_observations())
    first, second = env.get_observations(), env.get_observations()
    assert bool((first == second).all()), "get_observations changes something"


def check_steps(env: VecEnv, steps: int = 60) -> None:
    keys, generator = None, torch.Generator().manual_seed(1)
    ended = 0
    for _ in range(steps):
        before = env.episode_length_buf.clone()
        obs, rewards, dones, extras = env.step(_random_actions(env, generator))
        _check_observations(env, obs)
        assert rewards.shape == (env.num_envs,), "rewards have a wrong shape"
        assert rewards.dtype == torch.float32, "rewards must be float32"
        assert bool(torch.isfinite(rewards).all()), "a reward is not finite"
        assert dones.shape == (env.num_envs,), "dones have a wrong shape"
        done = dones.to(torch.bool)
        time_outs = extras["time_outs"]
        assert time_outs.shape == (env.num_envs,), "time_outs have a wrong shape"
        assert not bool((time_outs.to(torch.bool) & ~done).any()), "a time-out that is not done"
        in_time = before + 1 < int(env.max_episode_length)
        assert not bool((time_outs.to(torch.bool) & in_time).any()), "a time-out before its time"
        now = torch.where(done, 0, before + 1)
        assert torch.equal(env.episode_length_buf, now), "episode_length_buf does not count steps"
        assert keys in (None, tuple(extras["log"])), "log keys change from step to step"
        keys = tuple(extras["log"])
        assert all(key.startswith("/") for key in keys), "a log key does not start with /"
        for key, value in extras["log"].items():
            assert torch.isfinite(torch.as_tensor(value)).all(), f"log {key} is not finite"
        ended += int(done.sum())
    assert ended > 0, "no episode ended: the check is too short to see a restart"


def check_clipping(make: Callable[[], VecEnv]) -> None:
    wild, tame = make(), make()
    actions = torch.full((wild.num_envs, wild.num_actions), 7.0)
    for _ in range(3):
        far, near = wild.step(actions), tame.step(actions.clamp(-1, 1))
    assert bool((far[0] == near[0]).all()), "actions beyond [-1, 1] are not cut off there"


def check_episode_length_buf(env: VecEnv) -> None:
    steps = torch.zeros_like(env.episode_length_buf)
    steps[0] = int(env.max_episode_length) - 1
    env.episode_length_buf = steps
    assert torch.equal(env.episode_length_buf, steps), "episode_length_buf cannot be set"
    _, _, dones, extras = env.step(torch.zeros(env.num_envs, env.num_actions))
    assert bool(dones[0]) and bool(extras["time_outs"][0]), "a row set to its last step goes on"
    assert env.num_envs == 1 or not bool(dones[1:].any()), "setting one row ends others"


def check_rows_are_apart(make: Callable[[], VecEnv], rows_per_world: int) -> None:
    """Restart row 0 in one of two equal environments; the other worlds' rows must not notice."""
    calm, restarted = make(), make()
    generator = torch.Generator().manual_seed(2)
    others = slice(rows_per_world, None)
    for step in range(20):
        if step == 5:
            steps = restarted.episode_length_buf.clone()
            steps[0] = int(restarted.max_episode_length) - 1
            restarted.episode_length_buf = steps
        actions = _random_actions(calm, generator) * 0.2
        one, two = calm.step(actions), restarted.step(actions)
        assert step != 5 or (two[2][0] and not one[2][0]), "row 0 was not restarted"
        for name in one[0].keys():  # noqa: SIM118
            assert torch.equal(one[0][name][others], two[0][name][others]), (
                f"the restart of row 0 changed what other rows observe in {name}"
            )
        assert torch.equal(one[1][others], two[1][others]), "and their rewards"
        assert torch.equal(one[2][others], two[2][others]), "and their dones"


def check_repeats(make: Callable[[], VecEnv]) -> None:
    one, two = make(), make()
    for seed in range(10):
        generator = torch.Generator().manual_seed(seed)
        actions = _random_actions(one, generator)
        first, second = one.step(actions), two.step(actions)
        assert bool((first[0] == second[0]).all()), "the same seed and actions tell other things"
        assert torch.equal(first[1], second[1]), "the same seed and actions bring other rewards"


def check_learns(env: VecEnv) -> None:
    """Run two iterations of PPO with small networks; the weights must move and stay numbers."""
    groups = set(env.get_observations().keys())
    runner = OnPolicyRunner(env, train_cfg(groups), log_dir=None, device="cpu")
    before = [weight.clone() for weight in runner.alg.get_policy().parameters()]
    runner.learn(1, init_at_random_ep_len=True)
    runner.learn(1)
    after = list(runner.alg.get_policy().parameters())
    assert all(bool(torch.isfinite(weight).all()) for weight in after), "a weight is not a number"
    moved = any(not torch.equal(a, b) for a, b in zip(before, after, strict=True))
    assert moved, "learning changed no weight"


def train_cfg(groups: set[str]) -> dict:
    """Return settings of a short PPO run: the actor sees sensors, the critic the truth too."""
    sensors = [name for name in ("stereo", "lidar", "motion") if name in groups]
    network: dict = {"hidden_dims": [16], "activation": "elu"}
    if "stereo" in groups:
        network["class_name"] = "rsl_rl.models.CNNModel"
        network["cnn_cfg"] = {
            "output_channels": [4, 4],
            "kernel_size": [5, 3],
            "stride": [3, 2],
            "activation": "elu",
        }
    else:
        network["class_name"] = "rsl_rl.models.MLPModel"
    noise = {"class_name": "rsl_rl.modules.GaussianDistribution", "init_std": 0.5}
    return {
        "num_steps_per_env": 4,
        "save_interval": 1000,
        "obs_groups": {"actor": sensors, "critic": [*sensors, "state"]},
        "actor": {**network, "distribution_cfg": noise},
        "critic": dict(network),
        "algorithm": {
            "class_name": "rsl_rl.algorithms.PPO",
            "num_learning_epochs": 1,
            "num_mini_batches": 1,
            "rnd_cfg": None,
            "symmetry_cfg": None,
        },
    }


def _check_observations(env: VecEnv, obs: TensorDict) -> None:
    assert isinstance(obs, TensorDict), "observations are no TensorDict"
    assert tuple(obs.batch_size) == (env.num_envs,), "observations have a wrong batch size"
    for name, group in obs.items():
        assert group.shape[0] == env.num_envs, f"group {name} has a wrong number of rows"
        assert group.dtype == torch.float32, f"group {name} is not float32"
        assert group.dim() in (2, 4), f"group {name} is neither numbers nor pictures"
        assert bool(torch.isfinite(group).all()), f"group {name} is not finite"


def _random_actions(env: VecEnv, generator: torch.Generator) -> torch.Tensor:
    return torch.rand(env.num_envs, env.num_actions, generator=generator) * 2 - 1
