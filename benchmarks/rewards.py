"""What a reward function costs on top of its own code: making params and checking answers."""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.report import fastest, figure, heading
from league.deepracer import user_reward
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.sim.config import RaceKind, SimConfig
from league.track import files
from league.track.track import TrackSet

CALLS = 100
GOAL_US = 25.0


class _Kept:
    """A reward that remembers what it was called with, to call it again."""

    terms = ()

    def __init__(self):
        self.given = None

    def restart(self, world, who):
        pass

    def __call__(self, *given):
        self.given = given
        return np.zeros(given[-1].shape, np.float32), {}


def overhead_us(kind: RaceKind, num_worlds: int, path: Path) -> float:
    """Return the time of a call of a trivial function, in a batch of one row for each world."""
    sim = SimConfig(kind=kind, num_cars=2 if kind == "head_to_head" else 1)
    kept = _Kept()
    tracks = TrackSet(files.load("reinvent_2018"))
    cfg = EnvConfig(sim=sim, mode="training")
    env = RaceEnv(tracks, cfg, num_worlds=num_worlds, seed=1, reward=kept)
    for _ in range(10):
        env.step(np.zeros((num_worlds, sim.num_cars, 2)))
    reward = user_reward(path, num_worlds, (0,), sim=sim)
    reward.restart(env.world, np.ones((num_worlds, sim.num_cars), np.bool_))

    def call() -> None:
        for _ in range(CALLS):
            reward(*kept.given)

    return 1e6 * fastest(call) / CALLS / num_worlds


def main() -> None:
    """Print the figures."""
    heading("Reward functions: our overhead for each call, the fastest of 40 times a hundred")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "trivial.py"
        path.write_text("def reward_function(params):\n    return 1.0\n", encoding="utf-8")
        for kind in ("time_trial", "obstacle_avoidance", "head_to_head"):
            for num_worlds in (64, 1):
                rows = f"{num_worlds} row{'s' if num_worlds > 1 else ''}"
                taken = overhead_us(kind, num_worlds, path)
                figure(f"{kind}, {rows}", taken, "us/call", GOAL_US, most=True)


if __name__ == "__main__":
    main()
