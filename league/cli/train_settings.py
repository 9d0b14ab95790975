"""Defaults of `league train` that depend on other flags, and what its flags must not contradict."""

from __future__ import annotations

import re
import shlex
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from league.agents import checkpoint, roster
from league.cli.race import print_remark
from league.deepracer import hyperparameters
from league.deepracer import model_metadata as metadata
from league.envs import make
from league.envs.actions import ActionSpace, ContinuousActions, DiscreteActions, grid
from league.errors import ConfigError, brief
from league.sim.config import USUAL_OBSTACLES, SensorConfig
from league.training.config import PpoConfig, RunConfig, TrainConfig, read

if TYPE_CHECKING:
    from league.cli.train import Train

_WORK = 16_384  # Decisions of usual settings that take 10 to 20 s on two cores.
_SHORT_MIN, _SHORT_STEPS, _FEW_WORLDS = 2.0, 65_536, 16
"""Budgets up to which a run is short, and its worlds: few, for an update after few decisions."""
_STEPS_OF_LAPS = 256  # Steps, 17 s, in which a beginner comes round most tracks.


def defaults(command: Train) -> RunConfig:
    """Return the settings of which the flags change some: of the resumed run, or of a new one."""
    if command.sensors == ():
        raise ConfigError(
            "--sensors names no sensor: give some, such as stereo64x48, or motion to drive by "
            "speed and yaw rate alone"
        )
    cfg = _stored(command) if command.resume else _new(command)
    if command.hyperparameters is None:
        return cfg
    return replace(cfg, train=_from_deepracer(command.hyperparameters, cfg.train))


def _stored(command: Train) -> RunConfig:
    cfg = read(command.folder)
    train = cfg.train
    if command.action_space is not None:
        train = replace(train, action_space=parse_actions(command.action_space))
    if command.sensors is not None:
        train = replace(train, sensors=parse_sensors(command.sensors))
    return replace(cfg, train=train)


def _new(command: Train) -> RunConfig:
    cfg = command.cfg
    train = _with_body(command, cfg.train)
    ppo = PpoConfig(rollout=train.ppo.rollout)
    if cfg.init_from:
        ppo = ppo.refining()
    elif train.kind != "head_to_head" and (
        0 < cfg.minutes <= _SHORT_MIN or 0 < cfg.steps <= _SHORT_STEPS
    ):  # a usual batch would have too few updates
        ppo = ppo.hurrying()
        if train.num_worlds == TrainConfig.num_worlds:  # else a flag says how many
            train = replace(train, num_worlds=_FEW_WORLDS)
    cars = 1
    if train.kind == "head_to_head":
        cars = 2 if cfg.self_play else 1 + len(cfg.opponents)
        train = replace(train, critic_hidden=(256, 256))
        ppo = ppo.racing()
        if cfg.self_play:
            cfg = replace(cfg, reward="race")
            train = replace(
                train, teacher=0.0 if cfg.init_from or train.sensors.privileged else 0.5
            )
            if not cfg.init_from:
                train = replace(train, network=replace(train.network, hidden=(256, 128)))
    minutes = 0.0 if cfg.steps else cfg.minutes
    return replace(cfg, minutes=minutes, train=replace(train, num_cars=cars, ppo=ppo))


def finished(command: Train) -> RunConfig:
    """Return the settings of a new run, from all flags; refuse flags that contradict each other."""
    cfg, train = command.cfg, command.cfg.train
    _check(cfg)
    number = USUAL_OBSTACLES if train.obstacles is None else train.obstacles
    print_remark(train.kind, number, train.num_cars)
    line = shlex.join(["league", *sys.argv[1:]])[:2000]
    obstacles = number if train.bots else train.obstacles
    train = replace(train, save_every=_save_every(train), obstacles=obstacles)
    if cfg.self_play and train.sensors.privileged:
        train = train.on_truth()
    elif cfg.self_play and train.num_worlds == TrainConfig.num_worlds:  # else a flag says how many
        train = replace(train, num_worlds=train.num_worlds // train.num_cars)
    return replace(
        cfg,
        name=command.out.stem,
        train=train,
        command="".join(sign if sign.isprintable() else " " for sign in line),
    )


def _check(cfg: RunConfig) -> None:
    """Refuse flags that would be ignored, or that contradict each other."""
    train, plain, racing = cfg.train, RunConfig(), cfg.train.kind == "head_to_head"
    obstacles = train.obstacles != plain.train.obstacles
    cars = train.num_cars != 1 + racing * len(cfg.opponents)
    in_company = "--kind obstacle_avoidance or head_to_head", train.kind != "time_trial"
    in_a_race = "--kind head_to_head", racing
    for flag, is_given, (needed, is_there) in (
        ("--obstacles", obstacles, in_company),
        ("--bots", train.bots, in_company),
        ("--opponents", cfg.opponents, in_a_race),
        ("--self-play", cfg.self_play, in_a_race),
        ("--rules", train.rules != plain.train.rules, in_a_race),
        ("--cars", cars, ("--self-play", cfg.self_play)),
    ):
        if is_given and not is_there:
            raise ConfigError(f"{flag} means nothing without {needed}: give both, or neither")
    if racing and cfg.self_play == bool(cfg.opponents):
        raise ConfigError(
            "--kind head_to_head needs opponents: give either --opponents NAME ... or --self-play"
        )
    own = cfg.reward.endswith(".py") and not train.sensors.privileged
    if cfg.self_play and cfg.reward != "race" and not own:
        raise ConfigError(
            f"--self-play on the true state learns with the reward race, not {cfg.reward}: omit "
            "--reward, or give a reward file (FILE.py) to a policy with sensors of its own"
        )
    if cfg.self_play and not 2 <= train.num_cars <= 8:
        raise ConfigError(f"--cars is {train.num_cars}: give 2 to 8")
    if train.ppo.bootstrap_on_failure and cfg.reward == "centerline":
        raise ConfigError(
            "--bootstrap-on-failure makes a mistake cost what the reward takes for it, and "
            "centerline takes nothing: omit it, or give another reward"
        )
    cfg.check()


def parent_path(name: str) -> str:
    """Return the checkpoint to begin from; a policy of the garage may be given by its name.

    PolicyError: it is neither a file nor such a name.
    """
    if not name or (name not in roster.garage() and Path(name).exists()):
        return name
    return roster.checkpoint_path(name)


def _save_every(train: TrainConfig) -> int:
    """Return the updates between two save points: as many as take 10 to 20 s, by their work.

    Work counts decisions, passes over them, and pixels where they are more than usual. How long a
    GPU takes is not known: there it is as many updates as take a car round most tracks, since rows
    restart at a save point.
    """
    ppo, camera = train.ppo, train.sensors.camera
    if not train.device.startswith("cpu"):
        return max(1, _STEPS_OF_LAPS // ppo.rollout)
    pixels = camera.width * camera.height * camera.num_eyes if camera else 0
    work = train.samples * max(ppo.epochs / 6, 0.5) * max(pixels / (2 * 64 * 48), 1.0)
    if work > 2 * _WORK:
        print(
            f"an update is some {work / 4096:.0f} times the work of a usual one, which takes 4 s "
            "on two cores: --minutes and save points wait for its end; fewer --num-worlds, "
            "--rollout or --epochs make it shorter",
            file=sys.stderr,
        )
    return int(max(1, min(8, _WORK // max(work, 1))))


def _with_body(command: Train, train: TrainConfig) -> TrainConfig:
    """Return settings with the action space, sensors and layers asked for, or the parent's."""
    actions, sensor_names = command.action_space, command.sensors
    if sensor_names is None and actions is not None and actions.endswith(".json"):
        sensor_names = (actions,)  # a model_metadata.json sets both
    name = command.cfg.init_from
    if not name:
        space = parse_actions(actions or "0.5-4")
        return replace(
            train, action_space=space, sensors=parse_sensors(sensor_names or ("stereo64x48",))
        )
    parent = checkpoint.load(parent_path(name)).card
    space = parse_actions(actions) if actions else parent.action_space
    sensors = parent.sensors if sensor_names is None else parse_sensors(sensor_names)
    if sensors != parent.sensors:
        raise ConfigError(
            f"--sensors are not those of {name}, which has learnt to see with its own: omit "
            "--sensors, or start a new run without --init-from"
        )
    if type(space) is not type(parent.action_space) or space.size != parent.action_space.size:
        raise ConfigError(
            f"--action-space is of another kind than that of {name}: omit it, "
            "or start a new run without --init-from"
        )
    if space != parent.action_space:
        print(
            f"--action-space is another than that of {name}: what it has learnt to "
            "ask for now means something else",
            file=sys.stderr,
        )
    return replace(train, action_space=space, sensors=sensors, network=parent.network)


def _from_deepracer(path: Path, train: TrainConfig) -> TrainConfig:
    """Return the settings with those that a hyperparameters.json names."""
    asked = hyperparameters.read(path)
    same = {"gamma": asked.discount_factor, "epochs": asked.num_epochs}
    changes: dict[str, object] = {name: one for name, one in same.items() if one is not None}
    if asked.lr is not None:
        changes["learning_rate"] = (asked.lr, asked.lr)
    if asked.batch_size is not None:
        changes["mini_batches"] = max(1, train.samples // asked.batch_size)
        if asked.batch_size > train.samples:
            print(
                f"{path}: batch_size is {asked.batch_size}, and a rollout has {train.samples} "
                "decisions, which are one batch",
                file=sys.stderr,
            )
    used = {"lr", "discount_factor", "num_epochs", "batch_size", "stack_size"}
    if asked.beta_entropy is not None and isinstance(train.action_space, DiscreteActions):
        changes["entropy"] = (asked.beta_entropy, asked.beta_entropy)
        used.add("beta_entropy")
    unused = [name for name in asked.model_dump(exclude_none=True) if name not in used]
    if unused:
        print(f"{path}: {', '.join(unused)} not used here (docs/training.md)", file=sys.stderr)
    return train.with_ppo(**changes)


def parse_actions(text: str) -> ActionSpace:
    """Return the action space of `0.5-4`, `1-4@25`, `5x2@1.0` or a model_metadata.json."""
    if text.endswith(".json"):
        model = metadata.read(text)
        for note in model.notes:
            print(f"{text}: {note}", file=sys.stderr)
        return model.action_space
    number = r"([0-9]{1,3}(?:\.[0-9]{1,6})?)"
    if match := re.fullmatch(rf"{number}-{number}(?:@{number})?", text):
        low, high, steering = match.groups()
        degrees = float(steering or 30.0)
        return ContinuousActions(-degrees, degrees, float(low), float(high))
    if match := re.fullmatch(rf"([0-9]{{1,3}})x([0-9]{{1,3}})(?:@{number})?", text):
        steerings, speeds, fastest = match.groups()
        return grid(int(steerings), 30.0, int(speeds), float(fastest or 1.0))
    raise ConfigError(
        f"--action-space is {brief(text)}: give speeds such as 0.5-4 [m/s], a grid such "
        "as 5x2@1.0, or a model_metadata.json"
    )


def parse_sensors(names: tuple[str, ...]) -> SensorConfig:
    """Return what a car carries, of `stereo64x48`, `lidar` and such or a model_metadata.json."""
    if len(names) == 1 and names[0].endswith(".json"):
        return metadata.read(names[0]).sensors
    return make.sensors_of_car(names)
