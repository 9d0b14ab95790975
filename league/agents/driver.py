"""Driver, and the actions that ask for a steering angle and a speed."""

from league.envs.actions import encode as actions_from
from league.envs.driver import Driver

__all__ = ["Driver", "actions_from"]
