"""Train with Stable-Baselines3 in a batch of races, then drive the league's own evaluation.

Run it: pip install stable-baselines3; python examples/sb3.py [decisions]
"""

import sys

import torch
from stable_baselines3 import PPO

from league.agents import checkpoint, convert
from league.envs import SB3VecEnv
from league.racing.evaluate import evaluate

SENSORS = "stereo64x48"


def main(decisions: int, path: str = "sb3.pt") -> None:
    """Learn, write a checkpoint, and drive a lap with it."""
    env = SB3VecEnv(16, "reinvent_2018", sensors=SENSORS, reward="progress")
    model = PPO(
        "MultiInputPolicy",
        env,
        n_steps=64,
        batch_size=256,
        policy_kwargs={"activation_fn": torch.nn.ReLU},  # as SB3's convolutions: see convert.py
        device="cpu",
        verbose=1,
    )
    model.learn(decisions)
    made = convert.from_sb3(model, name="sb3", sensors=SENSORS, tracks=("reinvent_2018",))
    checkpoint.save(path, made)
    lap = evaluate(path, "reinvent_2018", laps=1)
    print(f"{path}: {lap.completion:.0f} % of a lap, {lap.off_tracks} times off the road")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 200_000)
