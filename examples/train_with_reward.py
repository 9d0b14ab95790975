"""Train a driver with a reward of your own, from Python; the command line does the same.

Run it: python examples/train_with_reward.py [minutes]
"""

import sys
import tempfile
from pathlib import Path

from league.envs.actions import ContinuousActions
from league.racing.evaluate import evaluate
from league.training.config import TrainConfig
from league.training.run import Run, RunConfig

REWARD = '''
def reward_function(params):
    """Pay for speed on the road, less the further the car is from the middle."""
    if not params["all_wheels_on_track"]:
        return 1e-3
    off_centre = params["distance_from_center"] / (0.5 * params["track_width"])
    return float(params["speed"] * (1.0 - 0.5 * min(off_centre, 1.0)))
'''


def main(minutes: float) -> None:
    """Train, and drive a lap."""
    with tempfile.TemporaryDirectory() as place:
        reward = Path(place) / "fast_in_the_middle.py"
        reward.write_text(REWARD)
        cfg = RunConfig(
            train=TrainConfig(num_worlds=32, action_space=ContinuousActions(speed_high=1.5)),
            name="mine",
            reward=str(reward),
            minutes=minutes,
            eval_laps=1,
        )
        outcome = Run(cfg, Path(place) / "mine.run", background=False).learn()
        print(f"{outcome.samples} decisions; {outcome.why}")
        lap = evaluate(str(outcome.best), "reinvent_2018", laps=1)
        print(f"{lap.driver}: {lap.completion:.0f} % of a lap, {lap.off_tracks} times off the road")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 1.0)
