"""Replays: one race on disk, from which every picture of it is drawn again."""

from league.replay.columns import Columns
from league.replay.format import read, write
from league.replay.recording import Recorder
from league.replay.replay import Agreement, Replay, compare

__all__ = ["Agreement", "Columns", "Recorder", "Replay", "compare", "read", "write"]
