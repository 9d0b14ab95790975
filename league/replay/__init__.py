"""Replays: one race on disk, from which all pictures of it are drawn."""

from league.replay.format import read, write
from league.replay.replay import Agreement, Columns, Recorder, Replay, compare

__all__ = ["Agreement", "Columns", "Recorder", "Replay", "compare", "read", "write"]
