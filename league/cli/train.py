"""`league train`: bring a reward function, press go, watch it learn, own a checkpoint."""

from __future__ import annotations

import os
import shlex
import shutil
import signal
import sys
from contextlib import AbstractContextManager, closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from league import precompile
from league.atomic_file import replacing
from league.cli import commands, lazy, train_settings
from league.cli.evaluate import print_table
from league.errors import ConfigError, PolicyError, RewardError
from league.flags import Unset
from league.subprocesses import handling
from league.training import config, run_folder
from league.training.config import RunConfig

if TYPE_CHECKING:
    from league.training.monitor.history import TrainingCallback

OLD_FLAGS = {
    "--exam-track": "--eval-track",
    "--exam-opponents": "--eval-opponents",
    "--exam-trials": "--eval-trials",
    "--exam-every": "--eval-every",
    "--forgiving": "--bootstrap-on-failure",
    "--tutor": "--teacher",
    "--random-looks": "--visual-randomization",
    "--random-cars": "--dynamics-randomization=1",
    "--car-spread": "--dynamics-randomization",
    "--no-mirror": "--no-symmetry",
}
"""Flags of older versions, and what they are called now."""
_PACE = "the pace of the other cars in self-play now follows success: omit it"
REMOVED_FLAGS = {
    "--scripted-share": "self-play meets scripted drivers in a fixed share of its worlds: "
    "omit it, or give --opponents NAME ... instead of --self-play",
    "--handicap": _PACE,
    "--no-handicap": _PACE,
}
"""Flags of older versions that are gone, with the reason and what to do."""


@dataclass(frozen=True)
class Train:
    """Train a driver with PPO on many worlds, evaluated in Bullet from the start line."""

    out: Path = Path("policy.pt")
    """Where the best policy goes; the run's own files go into a folder next to it, NAME.run."""
    cfg: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)
    """Settings of the run."""
    action_space: Unset[str | None] = None
    """Speeds LOW-HIGH [m/s] or LOW-HIGH@DEG for other than 30 deg of steering; NxM@SPEED for the
    classic grid of N steering angles and M speeds; or a model_metadata.json. By default that of
    --init-from, or else 0.5-4."""
    sensors: Annotated[Unset[tuple[str, ...] | None], tyro.conf.arg(metavar="SENSOR ...")] = None
    """stereoWxH, monoWxH, leftWxH, lidar, sectors, discretised, discretisedSxB@D (S sectors with B
    bins up to D metres), historyN, framesN, motion, truth, ahead; or a model_metadata.json. By
    default what --init-from or the model_metadata.json of --action-space has, or else
    stereo64x48."""
    hyperparameters: Unset[Path | None] = None
    """A hyperparameters.json with DeepRacer's names; flags take precedence."""
    resume: bool = False
    """Go on with the run of --out as it was started; --minutes or --steps may give it more."""
    overwrite: bool = False  # Start a new run where --out or its run exist already.
    plain: bool = False  # One line now and then instead of the live page.
    watch: bool = False  # Stream a few cars to the Rerun viewer.
    tensorboard: bool = True  # Write TensorBoard scalars into the run's folder.

    @property
    def folder(self) -> Path:
        """The run's own folder."""
        return self.out.with_suffix(".run")

    def run(self) -> int:
        precompile.ensure()
        cfg, is_first = self.cfg, lazy.distributed.is_first()
        if is_first and any(name.startswith("generated:") for name in cfg.tracks):
            print("Drawing the tracks; hundreds take half a minute.", flush=True)
        with (
            lazy.learner.threads(cfg.threads),
            _interrupted_by_sigterm(),
            closing(lazy.run.Run(cfg, self.folder)) as run,
        ):
            if self.resume:
                _resume(self, run)
            callbacks = _callbacks(self, run) if is_first else []
            try:
                outcome = run.learn(callbacks)
            except KeyboardInterrupt:
                if is_first:
                    print(f"\nStopped. {_kept(self)}", file=sys.stderr)
                return 130
            except RewardError:
                if is_first:
                    _show_printed(self.folder)
                    print(_kept(self), file=sys.stderr)
                raise
        if is_first:
            _report(self, outcome)
        return 0


def parse(arguments: list[str]) -> Train:
    """Return the command with all its settings.

    Arguments are read twice: some flags, such as --resume, decide what the others' defaults are.
    """
    arguments = _with_new_names(arguments)
    command = commands.parse(Train, "train", arguments)
    if command.out.suffix != ".pt":
        raise ConfigError(f"--out is {command.out}: give the name of a checkpoint, NAME.pt")
    if command.out.is_dir():
        raise ConfigError(f"--out is {command.out}, which is a folder: give a file, NAME.pt")
    if command.resume and command.overwrite:
        raise ConfigError("--resume goes on and --overwrite starts a new run: give one of them")
    default = train_settings.defaults(command)
    command = commands.parse(Train, "train", arguments, replace(command, cfg=default))
    parent = train_settings.parent_path(command.cfg.init_from)
    command = replace(command, cfg=replace(command.cfg, init_from=parent))
    if command.resume:
        config.check_resumed(command.cfg, config.read(command.folder), command.folder)
        return command
    command = replace(command, cfg=train_settings.finished(command))
    _refuse_taken(command)
    return command


def _with_new_names(arguments: list[str]) -> list[str]:
    """Return arguments with today's names of flags; refuse those that have been removed."""
    flags = [argument.partition("=")[0].replace("_", "-") for argument in arguments]
    renamed = []
    for argument, flag in zip(arguments, flags, strict=True):
        if flag in REMOVED_FLAGS:
            raise ConfigError(f"{flag} has been removed, because {REMOVED_FLAGS[flag]}")
        if flag in OLD_FLAGS:
            if flag == "--random-cars" and "--car-spread" in flags:
                continue  # which says how much
            argument = OLD_FLAGS[flag] + argument[len(flag) :]
        renamed.append(argument)
    return renamed


def _refuse_taken(command: Train) -> None:
    """Refuse to replace a run or a checkpoint unless that is asked for."""
    if command.overwrite:
        return
    folder = command.folder
    if run_folder.is_taken(folder):
        raise ConfigError(
            f"{folder} holds {run_folder.summary(folder)}: give --resume to go on with it, "
            "--overwrite to start a new run in its place, or another --out"
        )
    if command.out.exists():
        raise ConfigError(
            f"{command.out} exists already: give --overwrite to have it replaced, or another --out"
        )


def _interrupted_by_sigterm() -> AbstractContextManager[None]:
    """Treat SIGTERM as Ctrl-C, so that what was learnt is saved and the cursor comes back."""
    return handling(signal.default_int_handler, signal.SIGTERM)


def _resume(command: Train, run: lazy.run.Run) -> None:
    """Load the run's state, and print how far it has come and how far it goes."""
    before = config.read(run.folder)
    run.resume()
    decisions = f"{run.learner.samples:,} decisions"
    if run.over and command.out.exists():
        raise ConfigError(
            f"the run in {run.folder} is finished ({run.over}: {decisions}, "
            f"{run.spent_s / 60:.3g} minutes): give --minutes or --steps above that, counted from "
            "its beginning, to go on"
        )
    if not lazy.distributed.is_first():
        return
    rest = ", with the settings the run was started with."
    if run.cfg.budget != before.budget:
        rest = (
            f", to {_budget(run.cfg)} in all instead of {_budget(before)}; learning rate and noise "
            "follow the whole budget."
        )
    print(f"Going on after {decisions} and {run.spent_s:.0f} s{rest}", flush=True)


def _budget(cfg: RunConfig) -> str:
    parts = [f"{cfg.minutes:g} min"] if cfg.minutes else []
    if cfg.steps:
        parts.append(f"{cfg.steps:,} decisions")
    return " or ".join(parts)


def _callbacks(command: Train, run: lazy.run.Run) -> list[TrainingCallback]:
    cfg = run.cfg
    callbacks: list[TrainingCallback] = []
    if command.watch:
        watching = lazy.sinks.LiveView(*run.learner.shown)
        # Before the page, which draws over whatever is printed while it is open.
        print(f"Watching live: {watching.address}", file=sys.stderr, flush=True)
        callbacks.append(watching)
    budget = 60.0 * cfg.minutes or None, cfg.steps or None
    page = lazy.dashboard.Dashboard(run.train, *budget, cfg.name, plain=command.plain)
    callbacks += [page, lazy.sinks.TrainingPlot(run.folder / "training.png")]
    if command.tensorboard:
        callbacks.append(lazy.sinks.TensorBoard(run.folder / "tensorboard"))
    return callbacks


def _kept(command: Train) -> str:
    """Keep the best policy of a run that ends early as --out; return what is kept, as a line."""
    state, last, best = (command.folder / name for name in ("state.pt", "last.pt", "best.pt"))
    if not state.exists():
        return "Nothing was learnt yet."
    kept = f"{last}" if last.exists() else f"{state}, with what the teacher has learnt"
    if best.exists():
        _copy(best, command.out)
        kept += f", and the best so far as {command.out}"
    return f"Kept: {kept}; go on with --resume."


def _copy(best: Path, out: Path) -> None:
    with replacing(out, "the checkpoint", PolicyError) as file:
        shutil.copyfile(best, file)


def _show_printed(folder: Path) -> None:
    """Show the last of what a reward function has printed before it failed."""
    printed = folder / run_folder.PRINTED
    if printed.exists():
        print(f"The last lines it printed (more of them: {printed}):", file=sys.stderr)
        for line in printed.read_text(encoding="utf-8").splitlines()[-5:]:
            print(f"  {line[:160]}", file=sys.stderr)


def _report(command: Train, outcome: lazy.run.Outcome) -> None:
    if outcome.evaluation is not None:
        print_table(outcome.evaluation)
    _copy(outcome.best, command.out)
    if (found := outcome.duels) is not None:
        none = "no pace that was tried"
        passes = f"{100 * found.pace:.0f} % of its own pace" if found.pace else none
        holds = f"up to {100 * found.hold:.0f} %" if found.hold else none
        print(
            f"Against itself, slowed: it passes rivals of {passes} cleanly in half of the races, "
            f"and keeps behind it rivals of {holds}"
        )
    print(
        f"{outcome.samples} decisions in {outcome.time_s:.0f} s; stopped because {outcome.why}.\n"
        f"Best policy: {command.out}\n"
        f"The run, with best.pt, last.pt and training.png: {command.folder}\n"
        f"{_next_step(command, outcome)}"
    )


def _next_step(command: Train, outcome: lazy.run.Outcome) -> str:
    """Return what to do after a run: race its policy, or train on if no lap was complete."""
    out = shlex.quote(os.fspath(command.out))
    if outcome.evaluation is None or outcome.evaluation.complete_laps:
        return f"Race it: league race {out} centerline"
    cfg = command.cfg
    more = [f"--minutes {2 * cfg.minutes:g}"] if cfg.minutes else []
    # A whole update may have driven more than was asked for.
    more += [f"--steps {2 * max(cfg.steps, outcome.samples)}"] if cfg.steps else []
    return (
        "No lap is complete yet. Train on with twice the budget: "
        f"league train --resume --out {out} {' '.join(more)}"
    )
