"""Self-play: a learner races frozen snapshots of itself."""

from league.training.selfplay.self_play import SelfPlay
from league.training.selfplay.settings import SelfPlayConfig

__all__ = ["SelfPlay", "SelfPlayConfig"]
