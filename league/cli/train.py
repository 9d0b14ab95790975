"""`league train`: bring a reward function, press go, watch it learn, own a checkpoint."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from league.cli import resuming, train_settings
from league.errors import ConfigError, RewardError

if TYPE_CHECKING:
    from league.training.monitor.callback import TrainingCallback
    from league.training.run import Outcome, Run
    from league.training.selfplay.payoff_matrix import PayoffMatrix


@dataclass
class Train:
    """Train a driver with PPO on many worlds, judged in Bullet from the start line."""

    out: Path = Path("policy.pt")
    """Where the best policy goes; the run's own files go into a folder beside it, NAME.run."""
    track: tuple[str, ...] = ("reinvent_2018",)
    """Tracks or track files to learn on; generated:N are N random ones."""
    kind: Literal["time_trial", "obstacle_avoidance", "head_to_head"] = "time_trial"
    """Kind of race."""
    reward: str = "progress"
    """centerline, progress, race or racing_line, or a DeepRacer reward file (FILE.py)."""
    minutes: float | None = None
    """Stop after this long; 0: no limit; by default 5, or no limit where --steps is given."""
    steps: int | None = None
    """Stop after so many decisions; 0: no limit, which is the default."""
    stop_when_complete: int = 0
    """Stop after so many evaluations in a row with every lap complete; 0: never."""
    action_space: str | None = None
    """Speeds LOW-HIGH [m/s] or LOW-HIGH@DEG for other than 30 deg of steering; NxM@SPEED for the
    classic grid of N steering angles and M speeds; or a model_metadata.json. By default that of
    --init-from, or else 0.5-4."""
    sensors: tuple[str, ...] | None = None
    """stereoWxH, monoWxH, leftWxH, lidar, sectors, discretised; or a model_metadata.json. By
    default what --init-from or the model_metadata.json of --action-space has, or else
    stereo64x48."""
    opponents: tuple[str, ...] = ()
    """Drivers or checkpoints to race against, in head_to_head."""
    self_play: bool = False
    """Race against past selves, in head_to_head."""
    cars: int = 2
    """Cars of each world in self-play, the learner's included."""
    scripted_share: float = 0.1
    """Share of self-play against scripted drivers."""
    no_handicap: bool = False
    """Let past selves drive as fast as they can in self-play; by default they are held back, for
    cars of like pace do not pass each other, and so is the learner in some of its lone episodes."""
    hyperparameters: Path | None = None
    """A hyperparameters.json with DeepRacer's names."""
    resume: bool = False
    """Go on with the run of --out as it was begun; --minutes or --steps may give it more."""
    overwrite: bool = False
    """Begin anew where --out or its run are there already."""
    init_from: str = ""
    """Begin with the weights of this checkpoint, or policy of the garage."""
    seed: int = 0
    """Seed of weights, worlds and exploration."""
    device: str = "cpu"
    """cpu, or cuda; under torchrun each process takes a card of its own."""
    num_worlds: int = 64
    """Worlds in the batch."""
    both_directions: bool = False
    """Learn the tracks in both directions."""
    random_cars: bool = False
    """Draw grip, mass, latency, steering and camera of each car."""
    car_spread: float = 1.0
    """How far drawn cars differ: 1 as cars of one model do, less in proportion."""
    random_looks: bool = False
    """Draw light, colours, noise and blur of the pictures."""
    no_mirror: bool = False
    """Do not learn from mirror images."""
    obstacles: int = 6
    """Boxes or bots in obstacle avoidance."""
    bots: bool = False
    """Slow bot cars instead of boxes."""
    learning_rate: tuple[float, float] | None = None
    """First and last step size."""
    noise: tuple[float, float] | None = None
    """First and last standard deviation of exploration."""
    gamma: float | None = None
    """Discount for each step."""
    lam: float | None = None
    """Lambda of the advantages."""
    forgiving: bool = False
    """A mistake costs what the reward takes for it, not also all that would have been earned after
    it: bolder at the edge of the road."""
    tutor: float = 0.0
    """Share of the budget in which a driver that is told the truth learns first, for the policy to
    learn from: 0.4, say, for the fastest laps. The policy begins with three eighths of --noise."""
    epochs: int | None = None
    """Passes over what was collected."""
    mini_batches: int | None = None
    """Gradient steps in each pass."""
    rollout: int | None = None
    """Steps of each world between updates."""
    exam_track: tuple[str, ...] = ()
    """Where to judge it; none: where it learns."""
    exam_opponents: tuple[str, ...] = ()
    """Who races against it in each evaluation."""
    exam_trials: int = 1
    """Runs of each evaluation."""
    exam_every: int = 1
    """Save points between two evaluations."""
    threads: int = 1
    """Threads of torch; the evaluations take one more."""
    plain: bool = False
    """One line now and then instead of the live page."""
    watch: bool = False
    """Stream a few cars to the Rerun viewer."""
    tensorboard: bool = True
    """Write TensorBoard scalars into the run's folder."""
    licence: str = "CC-BY-4.0"
    """Licence of the weights, an SPDX name."""

    def run(self) -> int:
        """Run the command."""
        return _train(self)


COMMANDS = {"train": Train}


def _train(command: Train) -> int:
    if command.out.suffix != ".pt":
        raise ConfigError(f"--out is {command.out}: give the name of a checkpoint, NAME.pt")
    if command.out.is_dir():
        raise ConfigError(f"--out is {command.out}, which is a folder: give a file, NAME.pt")
    folder = command.out.with_suffix(".run")
    if command.resume:
        cfg = resuming.continued(command, folder, train_settings.config)
    else:
        cfg = train_settings.config(command)
        resuming.refuse_taken(command, folder)
    from league.training.ppo import distributed
    from league.training.ppo.learner import threads
    from league.training.run import Run

    if distributed.is_first() and any(name.startswith("generated:") for name in cfg.tracks):
        print("Drawing the tracks; hundreds take half a minute.", flush=True)
    with threads(cfg.threads), _saved_on_sigterm():
        run = Run(cfg, folder)
        if command.resume:
            _resume(command, run)
        if not distributed.is_first():
            return _learn_along(run)
        try:
            outcome = run.learn(_looking_on(command, run))
        except KeyboardInterrupt:
            print(f"\nStopped. {_kept(command, folder)}", file=sys.stderr)
            return 130
        except RewardError:
            _tell_printed(folder)
            print(f"{_kept(command, folder)}", file=sys.stderr)
            raise
    _report(command, outcome)
    return 0


def _learn_along(run: Run) -> int:
    """Learn as one of several processes of torchrun, in silence: the first one speaks."""
    try:
        run.learn()
    except KeyboardInterrupt:
        return 130
    return 0


@contextmanager
def _saved_on_sigterm() -> Iterator[None]:
    """Let SIGTERM be what Ctrl-C is: what was learnt is saved, and the cursor comes back."""

    def stop(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield  # only the main thread hears signals
        return
    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _kept(command: Train, folder: Path) -> str:
    """Keep the best policy of a run that ends early under the name asked for; say what is kept."""
    if not (folder / "state.pt").exists():
        return "Nothing was learnt yet."
    if not (folder / "last.pt").exists():
        return f"Kept: {folder / 'state.pt'}, with what the tutor has learnt; go on with --resume."
    kept = f"Kept: {folder / 'last.pt'}"
    if (folder / "best.pt").exists():
        _hand_over(folder / "best.pt", command.out)
        kept += f", and the best so far as {command.out}"
    return f"{kept}; go on with --resume."


def _hand_over(best: Path, out: Path) -> None:
    """Copy a run's best policy to where it was asked for."""
    import shutil

    from league.atomic_file import replacing
    from league.errors import PolicyError

    with replacing(out, "the checkpoint", PolicyError) as file:
        shutil.copyfile(best, file)


def _tell_printed(folder: Path) -> None:
    """Show the last of what a reward function has printed before it failed."""
    from league.training.run_folder import PRINTED

    printed = folder / PRINTED
    if printed.exists():
        print(f"The last lines it printed (more of them: {printed}):", file=sys.stderr)
        for line in printed.read_text(encoding="utf-8").splitlines()[-5:]:
            print(f"  {line[:160]}", file=sys.stderr)


def _resume(command: Train, run: Run) -> None:
    from league.training.ppo import distributed
    from league.training.run_config import settings

    try:
        before = settings(run.folder)
        run.resume()
        resuming.check_unfinished(command, run)
    except BaseException:
        run.close()
        raise
    if distributed.is_first():
        print(resuming.going_on(run, before), flush=True)


def _report(command: Train, outcome: Outcome) -> None:
    from league.cli.evaluate import print_table

    if outcome.evaluation is not None:
        print_table(outcome.evaluation)
    _hand_over(outcome.best, command.out)
    if outcome.matrix is not None:
        print(_told_of(outcome.matrix, command.out.with_suffix(".run")))
    print(
        f"{outcome.samples} decisions in {outcome.time_s:.0f} s; stopped because {outcome.why}.\n"
        f"Best policy: {command.out}   (race it: league race {command.out} centerline)\n"
        f"The run, with best.pt, last.pt and training.png: {command.out.with_suffix('.run')}"
    )


def _told_of(matrix: PayoffMatrix, folder: Path) -> str:
    """Return who the best of self-play beats, and whom not."""
    from league.training.selfplay.pool import PARENT

    whom = {"its parent": matrix.against(PARENT), "centerline": matrix.against("centerline")}
    rates = {whose: rate for whose, rate in whom.items() if rate is not None}
    parts = [f"{100 * rate:.0f} % against {whose}" for whose, rate in rates.items()]
    if matrix.smallest is not None:
        parts.append(f"at least {100 * matrix.smallest:.0f} % against its past")
    said = f"It wins {', '.join(parts)}" if parts else "It has nobody to be compared with"
    lines = [f"{said}, in mirrored races: {folder / 'win_matrix.png'}"]
    lost = [whose for whose, rate in rates.items() if rate < 0.5]
    if lost:
        lines.append(f"It loses to {' and '.join(lost)}: give it more time, or another --reward.")
    return "\n".join(lines)


def _looking_on(command: Train, run: Run) -> list[TrainingCallback]:
    """Return who looks on; where somebody cannot (no viewer, say), the run is let go of."""
    try:
        return _onlookers(command, run)
    except BaseException:
        run.close()
        raise


def _onlookers(command: Train, run: Run) -> list[TrainingCallback]:
    from league.training.monitor.dashboard import Dashboard
    from league.training.monitor.plot import TrainingPlot

    cfg = run.cfg
    found: list[TrainingCallback] = []
    if command.watch:
        from league.training.monitor.viewer import LiveView

        view = LiveView(*run.learner.shown)
        # Before the page, which draws over what is told while it is open.
        print(f"Watching live: {view.address}", file=sys.stderr, flush=True)
        found.append(view)
    dashboard = Dashboard(
        run.train,
        60.0 * cfg.minutes or None,
        cfg.steps or None,
        cfg.name,
        plain=command.plain,
    )
    found += [dashboard, TrainingPlot(run.folder / "training.png")]
    if command.tensorboard:
        from league.training.monitor.tensorboard import TensorBoard

        found.append(TensorBoard(run.folder / "tensorboard"))
    return found
