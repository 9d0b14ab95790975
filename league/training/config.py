"""Settings of a training run: its flags, its settings.json, and what a resumed run is held to.

`league train` reads its flags straight into these classes; fields marked `Hidden` have none.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, Any, get_type_hints

from pydantic import TypeAdapter
from tyro.conf import arg

from league.agents.network import NetworkConfig
from league.atomic_file import replacing
from league.envs.actions import ActionSpace, ContinuousActions
from league.envs.config import RewardConfig
from league.envs.rewards import PRESETS
from league.errors import ConfigError, PolicyError
from league.flags import Hidden, Unset
from league.racing.evaluate import MAX_TRIALS
from league.sim.config import CameraConfig, RaceKind, RulesName, SensorConfig

_RACING_ROWS = 1536  # cars in all worlds, where all learn to race on the true state
# Metadata of settings that a resume may change; without metadata a setting is kept.
FREE = {"resume": "free"}
GROWS = {"resume": "grows"}  # it may be raised, or set to 0, which is no limit


def _check(what: str, value: float, low: float, high: float, advice: str) -> None:
    if not low <= value <= high:
        raise ConfigError(f"{what} is {value}: give {advice}")


@dataclass(frozen=True)
class PpoConfig:
    """Proximal policy optimisation; pairs are values at the start and the end of the budget."""

    rollout: int = 64  # Steps of each world between two updates.
    epochs: int = 6  # Passes over what was collected.
    mini_batches: int = 16  # Gradient steps in each pass.
    gamma: float = 0.95  # Discount of each step (1/15 s); 0.987 by default in head_to_head.
    lam: float = 0.9  # Lambda of generalised advantage estimation.
    bootstrap_on_failure: bool = False
    """Add the critic's value where a mistake ends an episode: a mistake then costs what the reward
    takes for it, not also all that could have been earned after it. Bolder at the road's edge."""
    learning_rate: tuple[float, float] = (3e-3, 3e-4)
    """First and last step size, falling geometrically; 0.002 and 0.0003 by default with
    --init-from."""
    noise: tuple[float, float] = (0.4, 0.06)
    """First and last standard deviation of exploration of continuous actions, falling
    geometrically; 0.3 and 0.05 by default with --init-from, 1 and 0.06 in short runs."""
    clip: Hidden[float] = 0.2  # Largest change of a decision's probability ratio that still counts.
    pull: Hidden[float] = 0.1  # Strength by which means beyond [-1, 1] are pulled back (models.py).
    entropy: Hidden[tuple[float, float]] = (0.01, 0.0)  # Its weight, for discrete actions; linear.
    value_clip: Hidden[bool] = False  # Whether the critic may move by clip only, as in PPO2.
    max_gradient: Hidden[float] = 1.0  # Norm to which gradients are cut.

    def __post_init__(self) -> None:
        for name in ("rollout", "epochs", "mini_batches"):
            _check(f"PPO {name}", getattr(self, name), 1, math.inf, "at least 1")
        for name in ("gamma", "lam"):
            _check(f"PPO {name}", getattr(self, name), 0, 1, "0 to 1")
        if not all(1e-8 <= rate <= 0.1 for rate in self.learning_rate):
            raise ConfigError(f"learning rates are {self.learning_rate}: give 1e-8 to 0.1")
        if not all(1e-3 <= noise <= 5 for noise in self.noise):
            raise ConfigError(f"exploration noise is {self.noise}: give 0.001 to 5")

    def refining(self) -> PpoConfig:
        """Return the settings for a trained policy, which larger steps would spoil."""
        # With smaller ones it hardly learns to see what is new to it, such as other cars.
        return replace(self, learning_rate=(2e-3, 3e-4), noise=(0.3, 0.05))

    def hurrying(self) -> PpoConfig:
        """Return the settings for few decisions, in which strong exploration soon pays."""
        return replace(self, noise=(1.0, 0.06))

    def racing(self) -> PpoConfig:
        """Return the settings for racing others, where rewards come later: a pass takes 3 s."""
        return replace(
            self,
            epochs=3,
            gamma=0.987,
            lam=0.95,
            bootstrap_on_failure=True,
            learning_rate=(2e-3, 1e-4),
            noise=(0.4, 0.03),
        )


@dataclass(frozen=True)
class TrainConfig:
    """The worlds and the learner."""

    kind: RaceKind = "time_trial"  # Kind of race.
    num_worlds: int = 64
    """Worlds in the batch; 16 by default in runs of at most 2 minutes or 65,536 decisions, which
    would have too few updates with more, and 64 / cars in self-play, where all cars learn."""
    num_cars: Annotated[int, arg(name="cars")] = 1
    """Cars in each world, the learner's included; in self-play 2 by default."""
    seed: int = 0  # Seed of weights, worlds and exploration.
    device: str = "cpu"  # cpu, or cuda; under torchrun each process takes a card of its own.
    action_space: Hidden[ActionSpace] = field(default_factory=ContinuousActions)  # Of the policy.
    sensors: Hidden[SensorConfig] = field(
        default_factory=lambda: SensorConfig(camera=CameraConfig(width=64, height=48))
    )
    """What its car carries."""
    network: Hidden[NetworkConfig] = field(
        default_factory=lambda: NetworkConfig(strides=(4, 2, 1), activation="elu")
    )
    """Its layers."""
    critic_hidden: Hidden[tuple[int, ...]] = (128, 128)  # Layers of the critic, who sees the truth.
    reward: Hidden[RewardConfig] = field(default_factory=RewardConfig)  # Weights of built-in terms.
    teacher: float = 0.0
    """Share of the budget in which a teacher that sees the true state learns first, for the policy
    to learn from: 0.4, say, for the fastest laps. The policy begins with three eighths of
    --noise."""
    symmetry: bool = True  # Learn from mirror images too, where actions and sensors have them.
    both_directions: bool = False  # Learn the tracks in both directions.
    dynamics_randomization: float = 0.0
    """How far grip, mass, latency, steering and camera of the cars differ: 1 as cars of one model
    do, less in proportion; 0: not at all."""
    visual_randomization: bool = False  # Draw light, colours, noise and blur of the pictures.
    rules: RulesName = "league"
    """Which car is to blame and what it costs: as docs/rules.md has it, or as in the original."""
    obstacles: Unset[int | None] = None
    """Boxes or bots on the track, in obstacle_avoidance (by default 6) or in head_to_head."""
    bots: bool = False  # Slow bot cars instead of boxes.
    episode_s: Hidden[float] = 40.0  # Longest episode [s].
    save_every: Hidden[int] = 4
    """Updates between two save points, at which all rows restart, interrupted or not, so that a
    resumed run ends in the same weights."""
    ppo: Annotated[PpoConfig, arg(name="")] = field(default_factory=PpoConfig)  # The learner.

    def __post_init__(self) -> None:
        _check("num_worlds", self.num_worlds, 1, 65_536, "1 to 65536")
        _check("seed", self.seed, 0, 2**31 - 1, f"0 to {2**31 - 1}")
        none = "0, which is none, to"
        _check("the teacher's share of the budget", self.teacher, 0, 0.9, f"{none} 0.9")
        _check("dynamics_randomization", self.dynamics_randomization, 0, 2, f"{none} 2")
        _check("save_every", self.save_every, 1, math.inf, "at least 1")

    @property
    def samples(self) -> int:
        """Decisions between two updates."""
        return self.num_worlds * self.ppo.rollout

    def on_truth(self) -> TrainConfig:
        """Return the settings of learning to race on the true state, for a run with these."""
        ppo = PpoConfig(rollout=32, mini_batches=12)
        return replace(
            self,
            # What a camera cannot see helps no policy that learns from this one.
            sensors=SensorConfig(truth=self.sensors.truth, ahead=not self.sensors.truth),
            network=NetworkConfig(hidden=(128, 128), activation="elu", normalise=True),
            critic_hidden=(128, 128),
            num_worlds=max(_RACING_ROWS // self.num_cars, 1),
            reward=PRESETS["race"],
            episode_s=18.0,
            visual_randomization=False,
            symmetry=False,
            teacher=0.0,
            save_every=24,
            ppo=replace(ppo.racing(), epochs=2, learning_rate=(3e-3, 3e-4), noise=(0.4, 0.1)),
        )

    def with_ppo(self, **changes: object) -> TrainConfig:
        """Return the settings with some of the learner's changed."""
        return replace(self, ppo=replace(self.ppo, **changes))  # type: ignore


@dataclass(frozen=True)
class RunConfig:
    """All that decides a run; kept in its folder as settings.json, so that it can be resumed."""

    name: Hidden[str] = "policy"  # What the policy is called.
    tracks: Annotated[tuple[str, ...], arg(name="track")] = ("reinvent_2018",)
    """Tracks or track files to learn on; generated:N are N random ones."""
    reward: str = "progress"
    """centerline, progress, race or racing_line, or a DeepRacer reward file (FILE.py)."""
    minutes: float = field(default=5.0, metadata=GROWS)
    """Stop after this long; 0: no limit, which is the default where --steps is given."""
    steps: int = field(default=0, metadata=GROWS)  # Stop after so many decisions; 0: no limit.
    stop_when_complete: int = 0
    """Stop after so many evaluations in a row with every lap complete; 0: never."""
    opponents: Unset[tuple[str, ...]] = ()
    """Drivers or checkpoints to race against, in head_to_head."""
    self_play: bool = False
    """Learn to race against itself, in head_to_head: first a network that sees the true state, in
    --teacher of the budget, then the policy from it and by its own races."""
    init_from: str = ""  # Start with the weights of this checkpoint, or policy of the garage.
    train: Annotated[TrainConfig, arg(name="")] = field(default_factory=TrainConfig)
    """The learner and its worlds."""
    eval_tracks: Annotated[Unset[tuple[str, ...]], arg(name="eval-track")] = field(
        default=(), metadata=FREE
    )
    """Where to evaluate it; none: on up to four tracks of training, or twelve random ones."""
    eval_opponents: Unset[tuple[str, ...]] = field(default=(), metadata=FREE)
    """Drivers that race against it in each evaluation."""
    eval_laps: Hidden[int] = field(default=3, metadata=FREE)  # Laps of each run of an evaluation.
    eval_trials: int = field(default=1, metadata=FREE)  # Runs of each evaluation on each track.
    eval_every: int = field(default=1, metadata=FREE)  # Save points between two evaluations.
    simtrace: bool = field(default=False, metadata=FREE)
    """Write each step into NAME.run/simtrace, in the folders and files that community log tools
    read."""
    threads: int = 1
    """Threads of torch, on which the last bits depend; the evaluations take one more."""
    licence: str = "CC-BY-4.0"  # Licence of the weights, an SPDX name.
    command: Hidden[str] = ""  # The command line.

    def __post_init__(self) -> None:
        if self.eval_every < 1 or self.eval_laps < 1 or self.eval_trials < 1:
            raise ConfigError("an evaluation needs at least 1 lap, 1 run and 1 save point")
        _check("eval_trials", self.eval_trials, 1, MAX_TRIALS, f"1 to {MAX_TRIALS}")
        _check("threads", self.threads, 1, 1024, "1 to 1024")
        advice = "0, which is never, or a number of evaluations in a row"
        _check("stop_when_complete", self.stop_when_complete, 0, math.inf, advice)

    def check(self) -> None:
        """Check what depends on several settings; ConfigError says which of them do not fit."""
        valid = 0 <= self.minutes < math.inf and self.steps >= 0
        if not valid or not (self.minutes or self.steps):
            raise ConfigError(
                f"the run is to last {self.minutes:g} minutes and {self.steps} steps: give one of "
                "them, more than 0"
            )
        samples, mini_batches = self.train.samples, self.train.ppo.mini_batches
        if samples < mini_batches:
            raise ConfigError(
                f"{samples} decisions cannot be split into {mini_batches} mini-batches: "
                "give more worlds or a longer rollout"
            )

    @property
    def budget(self) -> tuple[float, int]:
        """Minutes and steps."""
        return self.minutes, self.steps


def check_resumed(cfg: RunConfig, stored: RunConfig, folder: Path) -> None:
    """Check that a run of the settings `stored` may go on with these; ConfigError says why not."""
    changed = list(_differences(cfg, stored))
    kept = [flag for flag, rule, *_ in changed if rule == "kept"]
    if kept:
        raise ConfigError(
            f"the run in {folder} was started with another {', '.join(kept)}: omit what is "
            "not --minutes or --steps, or give --overwrite instead of --resume to start a new run"
        )
    for flag, rule, asked, before in changed:
        if rule == "grows" and 0 < asked < before:
            raise ConfigError(
                f"{flag} is {asked:g}, and the run was started with {before:g}: give more, "
                "counted from the run's beginning, or omit it"
            )
    cfg.check()


def _differences(one: object, other: object) -> Iterator[tuple[str, str, Any, Any]]:
    """Yield the flag, the resume rule and both values of each setting that differs."""
    hints = get_type_hints(type(one), include_extras=True)
    for setting in fields(one):  # type: ignore
        mine, its = getattr(one, setting.name), getattr(other, setting.name)
        if isinstance(mine, TrainConfig | PpoConfig):
            yield from _differences(mine, its)
        elif mine != its:
            marks = getattr(hints[setting.name], "__metadata__", ())
            names = [mark.name for mark in marks if getattr(mark, "name", None)]
            flag = "--" + (names or [setting.name])[0].replace("_", "-")
            yield flag, setting.metadata.get("resume", "kept"), mine, its


_SETTINGS = TypeAdapter(RunConfig)
_OLD_NAMES = {
    "run": {
        "exam_tracks": "eval_tracks",
        "exam_opponents": "eval_opponents",
        "exam_laps": "eval_laps",
        "exam_trials": "eval_trials",
        "exam_every": "eval_every",
    },
    "train": {
        "tutor": "teacher",
        "mirror": "symmetry",
        "looks": "visual_randomization",
        "spread": "dynamics_randomization",
    },
    "ppo": {"steps": "rollout", "forgiving": "bootstrap_on_failure"},
}
"""Names of settings in the files of older versions, and what they are called now."""
GRIP_SPREAD = 0.15  # largest deviation of grip where `dynamics_randomization` is 1


def read(folder: Path) -> RunConfig:
    """Return the settings of the run in a folder; PolicyError if there is no run."""
    path = folder / "settings.json"
    try:
        cfg = _SETTINGS.validate_python(_renamed(json.loads(path.read_bytes())))
        cfg.check()
        return cfg
    except (OSError, ValueError, TypeError, AttributeError, KeyError, ConfigError) as error:
        raise PolicyError(
            f"{path} holds no settings of a run ({type(error).__name__}): give the --out of a run "
            "that was started, or omit --resume"
        ) from None


def write(cfg: RunConfig, folder: Path) -> None:
    """Write a run's settings into its folder; PolicyError if they cannot be written."""
    with replacing(folder / "settings.json", "the settings", PolicyError) as file:
        file.write_bytes(_SETTINGS.dump_json(cfg, indent=2))


def _renamed(run: dict[str, Any]) -> dict[str, Any]:
    """Return settings of any version under today's names; older versions had some more."""
    run = _named("run", run)
    train = run["train"] = _named("train", run["train"])
    train["ppo"] = _named("ppo", train["ppo"])
    # These two used to hold how far each thing is drawn, or null.
    looks, spread = train.get("visual_randomization"), train.get("dynamics_randomization")
    train["visual_randomization"] = bool(looks)
    if isinstance(spread, dict):
        spread = spread["grip"] / GRIP_SPREAD
    train["dynamics_randomization"] = spread or 0.0
    if "rules" not in train:  # the original's were the only ones
        train["rules"] = "deepracer"
        if train["kind"] != "obstacle_avoidance":
            train["obstacles"] = None  # it was not read
    return run


def _named(part: str, row: dict[str, Any]) -> dict[str, Any]:
    return {_OLD_NAMES[part].get(name, name): value for name, value in row.items()}
