"""Checkpoints: trained actors as files that strangers may send; only data is ever read."""

from league.agents.checkpoint.file import Checkpoint, digest, load, save

__all__ = ["Checkpoint", "digest", "load", "save"]
