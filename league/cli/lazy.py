"""Modules that only some commands need, each imported at its first use: `lazy.roster.load(...)`.

So `league --help` loads none of them, and a command only its own.
"""
# ruff: noqa: F401, I001
# pyright: reportUnusedImport=false

import ast
import functools
import importlib
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from league import race_spec, replay, rerun_view, subprocesses, threads, video
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


@functools.cache
def _packages() -> dict[str, str | None]:
    """Return the package of each module, by the imports above, which only type checkers follow."""
    tree = ast.parse(Path(__file__).read_text("utf-8"))
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))
    return {module.name: node.module for node in imports for module in node.names}


def __getattr__(name: str) -> ModuleType:
    if name in (packages := _packages()):
        return importlib.import_module(f"{packages[name]}.{name}")
    raise AttributeError(name)
