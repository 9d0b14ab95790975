"""A PettingZoo loop: every car is an agent with two cameras and a lidar of its own.

Run it with `python examples/pettingzoo_loop.py`; it writes a picture of the end, pettingzoo.png.
"""

import sys

import cv2
import numpy as np

from league.envs import parallel_env


def follow_the_road(observation: dict[str, np.ndarray], speed: float) -> np.ndarray:
    """Steer towards where the road lies in the picture: it is darker than the field next to it."""
    height, width = observation["stereo"].shape[1:]
    ahead = observation["stereo"][0, height // 2 : 3 * height // 4].astype(np.float32)
    road = ahead < np.percentile(ahead, 40)
    column = np.nonzero(road)[1].mean() if road.any() else width / 2
    steering = np.clip(1.6 * (width / 2 - column) / (width / 2), -1.0, 1.0)  # 1 is full left
    return np.array([steering, speed], dtype=np.float32)


def main(seconds: float = 10.0, picture: str = "pettingzoo.png") -> dict[str, float]:
    """Race two cars for a while and return how far each came [m]."""
    env = parallel_env(track="reinvent_2018", num_cars=2, render_mode="rgb_array")
    observations, infos = env.reset(seed=1)
    speeds = {"car_0": -0.6, "car_1": -0.5}  # -1 is 0.1 m/s, 1 is 4 m/s

    for _ in range(round(seconds * 15)):
        actions = {
            agent: follow_the_road(observations[agent], speeds[agent]) for agent in env.agents
        }
        observations, _rewards, _terminated, _truncated, infos = env.step(actions)
        for agent, info in infos.items():
            if info["off_track"] or info["crashed"]:
                print(f"{info['time_s']:5.1f} s  {agent} waits {info['penalty_s']:.0f} s")

    cv2.imwrite(picture, env.render()[:, :, ::-1])
    env.close()
    return {agent: info["distance"] for agent, info in infos.items()}


if __name__ == "__main__":
    for agent, distance in main(*map(float, sys.argv[1:2]), *sys.argv[2:3]).items():
        print(f"{agent} came {distance:.1f} m far")
