"""What the flags of `league train` ask for, as the settings of a run."""

from __future__ import annotations

import re
import shlex
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from league.cli import flags
from league.errors import ConfigError, brief

if TYPE_CHECKING:
    from league.agents.network import NetworkConfig
    from league.cli.train import Train
    from league.envs.actions import ActionSpace
    from league.sim.config import DynamicsRandomization, SensorConfig
    from league.training.run_config import RunConfig
    from league.training.settings import PpoConfig, TrainConfig


_WORK = 16_384
"""Decisions of usual settings that take 10 to 20 s on two cores."""
_STEPS_OF_LAPS = 256
"""Steps in which a policy that has learnt a little comes round most tracks: 17 s."""


def config(command: Train) -> RunConfig:
    """Return the settings of a new run.

    Raises:
        LeagueError: a flag cannot be understood, or contradicts another.
    """
    from league.training.run_config import RunConfig

    _check(command)
    minutes = command.minutes
    if minutes is None:
        minutes = 0.0 if command.steps else 5.0
    return RunConfig(
        train=_learner(command),
        name=command.out.stem,
        tracks=command.track,
        reward=command.reward,
        minutes=minutes,
        steps=command.steps or 0,
        stop_when_complete=command.stop_when_complete,
        exam_tracks=command.exam_track,
        exam_trials=command.exam_trials,
        exam_every=command.exam_every,
        opponents=command.opponents,
        self_play=command.self_play,
        scripted_share=command.scripted_share,
        handicap=not command.no_handicap,
        exam_opponents=command.exam_opponents,
        init_from=_parent(command.init_from),
        threads=command.threads,
        licence=command.licence,
        command=_printable(shlex.join(["league", *sys.argv[1:]]))[:2000],
    )


def _check(command: Train) -> None:
    """Refuse flags that would be ignored, or that contradict each other."""
    avoiding = (command.kind == "obstacle_avoidance", "--kind obstacle_avoidance")
    racing = (command.kind == "head_to_head", "--kind head_to_head")
    needs = {
        "obstacles": avoiding,
        "bots": avoiding,
        "opponents": racing,
        "self_play": racing,
        "scripted_share": (command.self_play, "--self-play"),
        "no_handicap": (command.self_play, "--self-play"),
        "cars": (command.self_play, "--self-play"),
        "car_spread": (command.random_cars, "--random-cars"),
    }
    flags.refuse_ignored(command, needs)
    if command.kind == "head_to_head" and command.self_play == bool(command.opponents):
        raise ConfigError(
            "--kind head_to_head needs somebody to race: give either --opponents NAME ... or "
            "--self-play"
        )
    if command.forgiving and command.reward == "centerline":
        raise ConfigError(
            "--forgiving makes a mistake cost what the reward takes for it, and centerline takes "
            "nothing: omit it, or give another reward"
        )
    if not 2 <= command.cars <= 8:
        raise ConfigError(f"--cars is {command.cars}: give 2 to 8")
    if not 1 <= command.threads <= 1024:
        raise ConfigError(f"--threads is {command.threads}: give 1 to 1024")


def _parent(name: str) -> str:
    """Return the checkpoint to begin from; a policy of the garage may be given by its name."""
    from league.agents import roster

    return str(roster.garage().get(name, name))


def _printable(text: str) -> str:
    return "".join(sign if sign.isprintable() else " " for sign in text)


def _learner(command: Train) -> TrainConfig:
    from league.sim.config import VisualRandomization
    from league.training.settings import PpoConfig, TrainConfig

    space, sensors, network = _body(command)
    given = {
        "learning_rate": command.learning_rate,
        "noise": command.noise,
        "gamma": command.gamma,
        "lam": command.lam,
        "forgiving": command.forgiving or None,
        "epochs": command.epochs,
        "mini_batches": command.mini_batches,
        "steps": command.rollout,
    }
    base = PpoConfig().refining() if command.init_from else PpoConfig()
    if command.kind == "head_to_head":
        base = base.racing()
    if command.hyperparameters is not None:
        base = _from_deepracer(command.hyperparameters, base, command, space)
    from dataclasses import replace

    ppo = replace(base, **{name: value for name, value in given.items() if value is not None})
    cars = 1
    if command.kind == "head_to_head":
        cars = command.cars if command.self_play else 1 + len(command.opponents)
    return TrainConfig(
        kind=command.kind,
        num_worlds=command.num_worlds,
        num_cars=cars,
        seed=command.seed,
        device=command.device,
        action_space=space,
        sensors=sensors,
        network=network,
        ppo=ppo,
        critic_hidden=(256, 256) if command.kind == "head_to_head" else (128, 128),
        mirror=not command.no_mirror,
        both_directions=command.both_directions,
        looks=VisualRandomization(light=0.3, colour=0.15, noise=6.0, blur=0.6)
        if command.random_looks
        else None,
        spread=_spread(command.car_spread) if command.random_cars else None,
        obstacles=command.obstacles,
        bots=command.bots,
        tutor=command.tutor,
        save_every=_save_every(command.device, command.num_worlds, ppo, sensors),
    )


def _save_every(device: str, num_worlds: int, ppo: PpoConfig, sensors: SensorConfig) -> int:
    """Return the updates between two save points: as many as take 10 to 20 s, by their work.

    How long a card takes is not known: there it is as many as take a car round most tracks, for
    rows restart at a save point.

    Decisions count, passes over them, and pixels where they are more than usual. Where a single
    update takes long, that is told: it can neither be saved nor ended before it is over.
    """
    if not device.startswith("cpu"):
        return max(1, _STEPS_OF_LAPS // ppo.steps)
    camera, usual = sensors.camera, 2 * 64 * 48
    pixels = camera.width * camera.height * camera.num_eyes if camera else 0
    work = num_worlds * ppo.steps * max(ppo.epochs / 6, 0.5) * max(pixels / usual, 1.0)
    if work > 2 * _WORK:
        print(
            f"an update is some {work / 4096:.0f} times the work of a usual one, which takes 4 s "
            "on two cores: --minutes and save points wait for its end; fewer --num-worlds, "
            "--rollout or --epochs make it shorter",
            file=sys.stderr,
        )
    return int(max(1, min(8, _WORK // max(work, 1))))


def _body(command: Train) -> tuple[ActionSpace, SensorConfig, NetworkConfig]:
    """Return what the policy may ask for, what its car carries, and its layers.

    What is not asked for is the parent's, if there is one.
    """
    from league.agents import checkpoint
    from league.training.settings import TrainConfig

    actions, senses = command.action_space, command.sensors
    if senses is None and actions is not None and actions.endswith(".json"):
        senses = (actions,)  # a model_metadata.json sets both
    if not command.init_from:
        space = parse_actions(actions or "0.5-4")
        return space, parse_sensors(senses or ("stereo64x48",)), TrainConfig().network
    parent = checkpoint.load(_parent(command.init_from)).card
    space = parse_actions(actions) if actions else parent.action_space
    sensors = parent.sensors if senses is None else parse_sensors(senses)
    if sensors != parent.sensors:
        raise ConfigError(
            f"--sensors are not those of {command.init_from}, whose eyes learnt to see with its "
            "own: omit --sensors, or start a new run without --init-from"
        )
    if type(space) is not type(parent.action_space) or space.size != parent.action_space.size:
        raise ConfigError(
            f"--action-space is of another kind than that of {command.init_from}: omit it, "
            "or start a new run without --init-from"
        )
    if space != parent.action_space:
        print(
            f"--action-space is another than that of {command.init_from}: what it has learnt to "
            "ask for now means something else",
            file=sys.stderr,
        )
    return space, sensors, parent.network


def _spread(share: float) -> DynamicsRandomization:
    """Return how far cars differ: 1 as far as ones of one model do, less in proportion."""
    from league.sim.config import DynamicsRandomization

    if not 0 < share <= 2:
        raise ConfigError(f"--car-spread is {share}: give more than 0, at most 2")
    return DynamicsRandomization(
        grip=0.15 * share,
        mass=0.1 * share,
        latency_s=0.03 * share,
        steering_offset=0.02 * share,
        camera_position=0.01 * share,
        camera_angle=0.02 * share,
    )


def _from_deepracer(path: Path, ppo: PpoConfig, command: Train, space: ActionSpace) -> PpoConfig:
    """Return the learner's settings with those that a hyperparameters.json names."""
    from dataclasses import replace

    from league.deepracer import hyperparameters
    from league.envs.actions import DiscreteActions

    asked = hyperparameters.read(path)
    rollout = command.num_worlds * (command.rollout or ppo.steps)
    if asked.lr is not None:
        ppo = replace(ppo, learning_rate=(asked.lr, asked.lr))
    if asked.discount_factor is not None:
        ppo = replace(ppo, gamma=asked.discount_factor)
    if asked.num_epochs is not None:
        ppo = replace(ppo, epochs=asked.num_epochs)
    if asked.batch_size is not None:
        ppo = replace(ppo, mini_batches=max(1, rollout // asked.batch_size))
        if asked.batch_size > rollout:
            print(
                f"{path}: batch_size is {asked.batch_size}, and a rollout has {rollout} decisions, "
                "which are one batch",
                file=sys.stderr,
            )
    taken = {"lr", "discount_factor", "num_epochs", "batch_size", "stack_size"}
    if asked.beta_entropy is not None and isinstance(space, DiscreteActions):
        ppo = replace(ppo, entropy=(asked.beta_entropy, asked.beta_entropy))
        taken.add("beta_entropy")
    left = [name for name in asked.model_dump(exclude_none=True) if name not in taken]
    if left:
        print(f"{path}: {', '.join(left)} not used here (docs/training.md)", file=sys.stderr)
    return ppo


def parse_actions(text: str) -> ActionSpace:
    """Return the action space of `0.5-4`, `1-4@25`, `5x2@1.0` or a model_metadata.json.

    Raises:
        ConfigError: it is none of these.
    """
    from league.envs.actions import ContinuousActions, grid

    if text.endswith(".json"):
        from league.deepracer import model_metadata as metadata

        found = metadata.read(text)
        for note in found.notes:
            print(f"{text}: {note}", file=sys.stderr)
        return found.action_space
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
    from league.sim.config import CameraConfig, LidarConfig, SensorConfig

    if len(names) == 1 and names[0].endswith(".json"):
        from league.deepracer import model_metadata as metadata

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
