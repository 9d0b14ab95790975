"""A training loop of your own with rsl-rl; `league train` does the same and more.

Run it: python examples/rsl_rl_loop.py [iterations]
"""

import sys

from rsl_rl.runners import OnPolicyRunner

from league.agents import checkpoint, convert
from league.agents.checkpoint import Card
from league.agents.network import NetworkConfig, from_learner
from league.envs import RacingVecEnv

HIDDEN = (64, 64)


def main(iterations: int, path: str = "rsl_rl.pt") -> None:
    """Learn with a lidar, and write a checkpoint."""
    env = RacingVecEnv("reinvent_2018", num_worlds=64, sensors="lidar", reward="progress")
    network = {"class_name": "rsl_rl.models.MLPModel", "hidden_dims": HIDDEN, "activation": "elu"}
    noise = {"class_name": "rsl_rl.modules.GaussianDistribution", "init_std": 0.5}
    cfg = {
        "num_steps_per_env": 64,
        "save_interval": 1000,
        "obs_groups": {"actor": ["lidar", "motion"], "critic": ["lidar", "motion", "state"]},
        "actor": {**network, "distribution_cfg": noise},
        "critic": network,
        "algorithm": {"class_name": "rsl_rl.algorithms.PPO", "rnd_cfg": None, "symmetry_cfg": None},
    }
    runner = OnPolicyRunner(env, cfg, log_dir=None, device="cpu")
    runner.learn(iterations, init_at_random_ep_len=True)
    card = Card(
        name="mine",
        sensors=env.cfg.sensors_of(0),
        action_space=convert.DIRECT,  # the env's own actions, [-1, 1]
        network=NetworkConfig(hidden=HIDDEN, activation="elu"),
    )
    weights = from_learner(runner.alg.get_policy().state_dict())
    checkpoint.save(path, checkpoint.Checkpoint(card, weights))
    print(f"{path}: drive it with `league race {path} centerline`")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 50)
