"""`league train`: bring a reward function, press go, watch it learn, own a checkpoint."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from league.errors import ConfigError, brief

if TYPE_CHECKING:
    from league.envs.action_space import ActionSpace
    from league.sim.config import SensorConfig, Spread
    from league.training.onlooker import Onlooker
    from league.training.run import Outcome, Run, RunConfig
    from league.training.settings import TrainConfig


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
    """centerline, progress or race, or a DeepRacer reward file (FILE.py)."""
    minutes: float = 5.0
    """Stop after this long; 0: no limit."""
    steps: int = 0
    """Stop after so many decisions; 0: no limit."""
    stop_when_complete: int = 0
    """Stop after so many evaluations in a row with every lap complete; 0: never."""
    action_space: str = "0.5-4"
    """Speeds LOW-HIGH [m/s] or LOW-HIGH@DEG for other than 30 deg of steering; NxM@SPEED for the
    classic grid of N steering angles and M speeds; or a model_metadata.json."""
    sensors: tuple[str, ...] = ("stereo64x48",)
    """stereoWxH, monoWxH, leftWxH, lidar, sectors, discretised; or a model_metadata.json."""
    opponents: tuple[str, ...] = ()
    """Drivers or checkpoints to race against, in head_to_head."""
    self_play: bool = False
    """Race against past selves, in head_to_head."""
    scripted_share: float = 0.1
    """Share of self-play against scripted drivers, who teach to pass what is slower."""
    hyperparameters: Path | None = None
    """A hyperparameters.json with DeepRacer's names."""
    resume: bool = False
    """Go on with the run of --out, with the settings it was begun with."""
    init_from: str = ""
    """Begin with the weights of this checkpoint."""
    seed: int = 0
    """Seed of weights, worlds and exploration."""
    device: str = "cpu"
    """cpu, or cuda."""
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
    folder = command.out.with_suffix(".run")
    from league.training.learner import threads
    from league.training.run import Run, settings

    cfg = settings(folder) if command.resume else _config(command)
    with threads(command.threads):
        run = Run(cfg, folder)
        if command.resume:
            run.resume()
        try:
            outcome = run.learn(_onlookers(command, run))
        except KeyboardInterrupt:
            if (folder / "state.pt").exists():
                said = f"Stopped. Saved: {folder / 'last.pt'}; go on with --resume."
            else:
                said = "Stopped before anything was learnt."
            print(f"\n{said}", file=sys.stderr)
            return 130
    _report(command, outcome)
    return 0


def _report(command: Train, outcome: Outcome) -> None:
    import shutil

    from league.cli.evaluate import print_table
    from league.errors import PolicyError
    from league.whole_file import replacing

    if outcome.evaluation is not None:
        print_table(outcome.evaluation)
    with replacing(command.out, "the checkpoint", PolicyError) as file:
        shutil.copyfile(outcome.best, file)
    print(
        f"{outcome.samples} decisions in {outcome.time_s:.0f} s; stopped because {outcome.why}.\n"
        f"Best policy: {command.out}   (race it: league race {command.out} centerline)\n"
        f"The run, with best.pt, last.pt and training.png: {command.out.with_suffix('.run')}"
    )


def _onlookers(command: Train, run: Run) -> list[Onlooker]:
    from league.training.page import Page
    from league.training.picture import Picture

    cfg = run.cfg
    found: list[Onlooker] = [
        Page(
            run.train,
            60.0 * cfg.minutes or None,
            cfg.steps or None,
            cfg.name,
            plain=command.plain,
        ),
        Picture(run.folder / "training.png"),
    ]
    if command.tensorboard:
        from league.training.scalars import Scalars

        found.append(Scalars(run.folder / "tensorboard"))
    if command.watch:
        from league.training.watching import Watching

        found.append(Watching(run.env))
    return found


def _config(command: Train) -> RunConfig:
    from league.training.run import RunConfig

    return RunConfig(
        train=_learner(command),
        name=command.out.stem,
        tracks=command.track,
        reward=command.reward,
        minutes=command.minutes,
        steps=command.steps,
        stop_when_complete=command.stop_when_complete,
        exam_tracks=command.exam_track,
        exam_trials=command.exam_trials,
        exam_every=command.exam_every,
        opponents=command.opponents,
        self_play=command.self_play,
        scripted_share=command.scripted_share,
        exam_opponents=command.exam_opponents,
        init_from=command.init_from,
        licence=command.licence,
        command=_printable(shlex.join(["league", *sys.argv[1:]]))[:2000],
    )


def _printable(text: str) -> str:
    return "".join(sign if sign.isprintable() else " " for sign in text)


def _learner(command: Train) -> TrainConfig:
    from league.sim.config import LookConfig
    from league.training.settings import PpoConfig, TrainConfig

    given = {
        "learning_rate": command.learning_rate,
        "noise": command.noise,
        "gamma": command.gamma,
        "lam": command.lam,
        "epochs": command.epochs,
        "mini_batches": command.mini_batches,
        "steps": command.rollout,
    }
    base = PpoConfig()
    if command.hyperparameters is not None:
        rollout = command.num_worlds * (command.rollout or base.steps)
        base = _from_deepracer(command.hyperparameters, rollout)
    from dataclasses import replace

    ppo = replace(base, **{name: value for name, value in given.items() if value is not None})
    cars = 1
    if command.kind == "head_to_head":
        cars += 1 if command.self_play else len(command.opponents)
    return TrainConfig(
        kind=command.kind,
        num_worlds=command.num_worlds,
        num_cars=cars,
        seed=command.seed,
        device=command.device,
        action_space=parse_actions(command.action_space),
        sensors=parse_sensors(command.sensors),
        ppo=ppo,
        mirror=not command.no_mirror,
        both_directions=command.both_directions,
        looks=LookConfig(light=0.3, colour=0.15, noise=6.0, blur=0.6)
        if command.random_looks
        else None,
        spread=_spread(command.car_spread) if command.random_cars else None,
        obstacles=command.obstacles,
        bots=command.bots,
        # So that a save point comes every 10 to 20 s.
        save_every=max(1, min(8, 16_384 // max(command.num_worlds * ppo.steps, 1))),
    )


def _spread(share: float) -> Spread:
    """Return how far cars differ: 1 as far as ones of one model do, less in proportion."""
    from league.sim.config import Spread

    if not 0 < share <= 2:
        raise ConfigError(f"--car-spread is {share}: give more than 0, at most 2")
    return Spread(
        grip=0.15 * share,
        mass=0.1 * share,
        latency_s=0.03 * share,
        steering_offset=0.02 * share,
        camera_position=0.01 * share,
        camera_angle=0.02 * share,
    )


def _from_deepracer(path: Path, rollout: int):  # noqa: ANN202
    """Return PPO's settings of a hyperparameters.json; what it does not name stays ours.

    Args:
        path: the file.
        rollout: decisions between two updates.
    """
    from dataclasses import asdict, replace

    from league.envs.deepracer import hyperparameters
    from league.training.settings import PpoConfig

    asked, ppo = hyperparameters.read(path), PpoConfig()
    if asked.lr is not None:
        ppo = replace(ppo, learning_rate=(asked.lr, asked.lr))
    if asked.discount_factor is not None:
        ppo = replace(ppo, gamma=asked.discount_factor)
    if asked.num_epochs is not None:
        ppo = replace(ppo, epochs=asked.num_epochs)
    if asked.batch_size is not None:
        ppo = replace(ppo, mini_batches=max(1, rollout // asked.batch_size))
    if asked.beta_entropy is not None:
        ppo = replace(ppo, entropy=(asked.beta_entropy, asked.beta_entropy))
    taken = {"lr", "discount_factor", "num_epochs", "batch_size", "beta_entropy", "stack_size"}
    left = [name for name, value in asdict(asked).items() if value is not None]
    left = [name for name in left if name not in taken]
    if left:
        print(f"{path}: {', '.join(left)} not used here (docs/training.md)", file=sys.stderr)
    return ppo


def parse_actions(text: str) -> ActionSpace:
    """Return the action space of `0.5-4`, `1-4@25`, `5x2@1.0` or a model_metadata.json.

    Raises:
        ConfigError: it is none of these.
    """
    import re

    from league.envs.action_space import ContinuousActions, grid

    if text.endswith(".json"):
        from league.envs.deepracer import metadata

        return metadata.read(text).action_space
    number = r"([0-9]{1,3}(?:\.[0-9]{1,6})?)"
    if found := re.fullmatch(rf"{number}-{number}(?:@{number})?", text):
        low, high, steering = found.groups()
        degrees = float(steering or 30.0)
        return ContinuousActions(-degrees, degrees, float(low), float(high))
    if found := re.fullmatch(rf"([0-9]{{1,3}})x([0-9]{{1,3}})(?:@{number})?", text):
        steerings, speeds, fastest = found.groups()
        return grid(int(steerings), 30.0, int(speeds), float(fastest or 1.0))
    raise ConfigError(
        f"--action-space is {brief(text)}: give speeds such as 0.5-4 [m/s], a grid such "
        "as 5x2@1.0, or a model_metadata.json"
    )


def parse_sensors(names: tuple[str, ...]) -> SensorConfig:
    """Return what a car carries, of `stereo64x48`, `lidar` and the like or a model_metadata.json.

    Raises:
        ConfigError: it is none of these, or two of a kind.
    """
    import re

    from league.sim.config import CameraConfig, LidarConfig, SensorConfig

    if len(names) == 1 and names[0].endswith(".json"):
        from league.envs.deepracer import metadata

        return metadata.read(names[0]).sensors
    cameras, lidars = [], []
    for name in names:
        if found := re.fullmatch(r"(stereo|mono|left)([0-9]{1,4})x([0-9]{1,4})", name):
            eyes, width, height = found.groups()
            cameras.append(CameraConfig(int(width), int(height), eyes=eyes))  # type: ignore
        elif name in ("lidar", "sectors", "discretised"):
            lidars.append(LidarConfig(form="ranges" if name == "lidar" else name))  # type: ignore
        else:
            raise ConfigError(
                f"there is no sensor {brief(name)}: give stereoWxH, monoWxH, leftWxH, lidar, "
                "sectors, discretised, or a model_metadata.json"
            )
    if len(cameras) > 1 or len(lidars) > 1:
        raise ConfigError(
            f"the sensors {brief(' '.join(names))} hold two of a kind: "
            "give one camera and one lidar"
        )
    return SensorConfig(camera=cameras[0] if cameras else None, lidar=lidars[0] if lidars else None)
