"""A Gymnasium loop: one learner against a driver of the league, then many learners at once.

Run it with `python examples/gymnasium_loop.py`.
"""

import sys

import gymnasium
import numpy as np

import league.envs

gymnasium.register_envs(league.envs)  # the import has done it; this says so to your editor


def one(steps: int = 300) -> float:
    """Drive against the scripted driver `cautious` and return the sum of rewards."""
    env = gymnasium.make(
        "league/HeadToHead-v0",
        opponents=["cautious"],
        sensors=["lidar"],
        privileged=True,  # the truth too, as group `state`: for a first controller, or a critic
    )
    observation, _ = env.reset(seed=0)
    total = 0.0
    for _ in range(steps):
        lateral, heading_error = observation["state"][1:3]  # see docs/observations.md
        steering = np.clip(-2.0 * lateral - 2.0 * heading_error, -1.0, 1.0)
        observation, reward, terminated, truncated, info = env.step(
            np.array([steering, -0.4], np.float32)
        )
        total += float(reward)
        if terminated or truncated:
            print(f"the episode ended after {info['distance']:.1f} m in place {info['place']}")
            observation, _ = env.reset()
    env.close()
    return total


def many(num_envs: int = 64, steps: int = 100) -> float:
    """Drive many cars at random in one batch and return the mean reward of a step."""
    envs = gymnasium.make_vec("league/TimeTrial-v0", num_envs=num_envs, sensors=[])
    envs.action_space.seed(0)
    envs.reset(seed=0)
    rewards = [envs.step(envs.action_space.sample())[1].mean() for _ in range(steps)]
    envs.close()
    return float(np.mean(rewards))


if __name__ == "__main__":
    print(f"one learner: {one(*map(int, sys.argv[1:2])):.1f} reward in all")
    print(f"64 at random: {many():.3f} reward for each step")
