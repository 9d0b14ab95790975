"""Self-play: a learner races frozen past selves, which it collects as it gets better."""

from league.training.selfplay.self_play import SelfPlay
from league.training.selfplay.settings import SelfPlayConfig

__all__ = ["SelfPlay", "SelfPlayConfig"]
