"""Progress per step, kept in an object that lives as long as the car: the usual way to go fast.

Each car has this file to itself, so the object remembers one car only.
Try it: league reward check examples/reward_progress.py
"""


class Pace:
    """Remembers the progress of the step before."""

    def __init__(self):
        """Know nothing yet."""
        self.progress = 0.0

    def reward(self, params):
        """Pay each percent of the lap, and the whole lap."""
        if params["steps"] <= 1:
            self.progress = 0.0  # a new episode
        gained = params["progress"] - self.progress
        self.progress = params["progress"]
        if params["is_offtrack"] or params["is_crashed"]:
            return -1.0
        reward = gained
        if params["progress"] == 100:
            reward += 10.0
        return float(reward)


pace = Pace()


def reward_function(params):
    """Ask the object."""
    return pace.reward(params)
