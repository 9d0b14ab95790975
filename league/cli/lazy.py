"""Modules that only some commands need, each imported at its first use: `lazy.roster.load(...)`.

So `league --help` loads none of them, and a command only its own.
"""
# ruff: noqa: F401, I001
# pyright: reportUnusedImport=false

from __future__ import annotations

import importlib
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from league import race_spec, replay, rerun_view, subprocesses, video
    from league.agents import checkpoint, export, roster
    from league.deepracer import check, rescore, reward_file
    from league.envs import rewards
    from league.matchmaking import (
        cups, divisions, documents, gauntlet, loop, remote, scores, seasons, standings, store,
        submission, workers,
    )  # fmt: skip
    from league.matchmaking.pairing import heat_spec, matchmaker
    from league.matchmaking.ratings import sprt
    from league.matchmaking.workers import worker
    from league.racing import evaluate, race, trace
    from league.replay import broadcast, format
    from league.track import files, generate, importer, markings, track
    from league.training import run
    from league.training.monitor import dashboard, sinks
    from league.training.ppo import distributed, learner
    from league.web import security, server, site

_PACKAGES = {
    "": "race_spec replay rerun_view subprocesses video",
    ".agents": "checkpoint export roster",
    ".deepracer": "check rescore reward_file",
    ".envs": "rewards",
    ".matchmaking": "cups divisions documents gauntlet loop remote scores seasons standings "
    "store submission workers",
    ".matchmaking.pairing": "heat_spec matchmaker",
    ".matchmaking.ratings": "sprt",
    ".matchmaking.workers": "worker",
    ".racing": "evaluate race trace",
    ".replay": "broadcast format",
    ".track": "files generate importer markings track",
    ".training": "run",
    ".training.monitor": "dashboard sinks",
    ".training.ppo": "distributed learner",
    ".web": "security server site",
}


def __getattr__(name: str) -> ModuleType:
    for package, names in _PACKAGES.items():
        if name in names.split():
            return importlib.import_module(f"league{package}.{name}")
    raise AttributeError(name)
