"""What `league train` does if --out has a run already: resume it, start a new one, or refuse."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from league.cli import flags
from league.errors import ConfigError

if TYPE_CHECKING:
    from league.cli.train import Train
    from league.training.run import Run
    from league.training.run_config import RunConfig

BUDGET = ("minutes", "steps")
"""What a resume may give more of."""
FREE = ("out", "resume", "overwrite", "plain", "watch", "tensorboard")
"""What may differ each time: it does not decide what is learnt."""
EXAM = {
    "exam_track": "exam_tracks",
    "exam_opponents": "exam_opponents",
    "exam_trials": "exam_trials",
    "exam_every": "exam_every",
}
"""What a resume may change, and where a run's settings hold it: how it is judged."""
KEPT = {
    "track": "tracks",
    "kind": "train.kind",
    "reward": "reward",
    "stop_when_complete": "stop_when_complete",
    "action_space": "train.action_space",
    "sensors": "train.sensors",
    "opponents": "opponents",
    "self_play": "self_play",
    "cars": "train.num_cars",
    "scripted_share": "scripted_share",
    "no_handicap": "handicap",
    "hyperparameters": "train.ppo",
    "init_from": "init_from",
    "seed": "train.seed",
    "device": "train.device",
    "num_worlds": "train.num_worlds",
    "both_directions": "train.both_directions",
    "random_cars": "train.spread",
    "car_spread": "train.spread",
    "random_looks": "train.looks",
    "no_mirror": "train.mirror",
    "obstacles": "train.obstacles",
    "bots": "train.bots",
    "learning_rate": "train.ppo.learning_rate",
    "noise": "train.ppo.noise",
    "gamma": "train.ppo.gamma",
    "lam": "train.ppo.lam",
    "forgiving": "train.ppo.forgiving",
    "tutor": "train.tutor",
    "epochs": "train.ppo.epochs",
    "mini_batches": "train.ppo.mini_batches",
    "rollout": "train.ppo.steps",
    "threads": "threads",
    "licence": "licence",
}
"""What a run keeps from its beginning to its end, and where its settings hold it."""


def refuse_taken(command: Train, folder: Path) -> None:
    """See that a new run takes nobody's place, unless that is asked for.

    Raises:
        ConfigError: there is a run, or a checkpoint, of that name.
    """
    if command.overwrite:
        return
    from league.training import run_folder

    if run_folder.is_taken(folder):
        raise ConfigError(
            f"{folder} holds {run_folder.told(folder)}: give --resume to go on with it, "
            "--overwrite to start a new run in its place, or another --out"
        )
    if command.out.exists():
        raise ConfigError(
            f"{command.out} is there already: give --overwrite to have it replaced, or another "
            "--out"
        )


def continued(command: Train, folder: Path, asked: Callable[[Train], RunConfig]) -> RunConfig:
    """Return the settings to go on with: the run's own, with the budget given now.

    Args:
        command: the command line.
        folder: of the run.
        asked: tells what a command line asks for.

    Raises:
        PolicyError: there is no run.
        ConfigError: the command line contradicts the run.
    """
    from league.training.run_config import settings

    if command.overwrite:
        raise ConfigError("--resume goes on and --overwrite begins anew: give one of them")
    stored = settings(folder)
    given = flags.given(command, KEPT)
    if given:
        wanted = asked(replace(command, minutes=1.0, steps=None))
        others = [
            flags.spelled(name)
            for name in given
            if attrgetter(KEPT[name])(wanted) != attrgetter(KEPT[name])(stored)
        ]
        if others:
            raise ConfigError(
                f"the run in {folder} was started with another {', '.join(others)}: omit what is "
                "not --minutes or --steps, or give --overwrite instead of --resume to start a new "
                "run"
            )
    exam = {EXAM[name]: getattr(command, name) for name in flags.given(command, EXAM)}
    return replace(stored.with_budget(command.minutes, command.steps), **exam)


def check_unfinished(command: Train, run: Run) -> None:
    """See that there is something left to do for a run that goes on.

    Raises:
        ConfigError: it has come to its end, and its checkpoint is there.
    """
    if run.over and command.out.exists():
        raise ConfigError(
            f"the run in {run.folder} is finished ({run.over}: {run.learner.samples:,} decisions, "
            f"{run.spent_s / 60:.3g} minutes): give --minutes or --steps above that, counted from "
            "its beginning, to go on"
        )


def going_on(run: Run, before: RunConfig) -> str:
    """Return what a resumed run does, as one line."""
    so_far = f"Going on after {run.learner.samples:,} decisions and {run.spent_s:.0f} s"
    if run.cfg.has_budget_of(before):
        return f"{so_far}, with the settings the run was begun with."
    return (
        f"{so_far}, to {_budget(run.cfg)} in all instead of {_budget(before)}; learning rate and "
        "noise follow the whole budget."
    )


def _budget(cfg: RunConfig) -> str:
    parts = [f"{cfg.minutes:g} min"] if cfg.minutes else []
    if cfg.steps:
        parts.append(f"{cfg.steps:,} decisions")
    return " or ".join(parts)
