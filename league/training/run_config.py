"""The settings of a training run: checked, kept in its folder, and given more time by a resume."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from league.atomic_file import replacing
from league.errors import ConfigError, PolicyError
from league.racing.evaluate import MAX_TRIALS
from league.training.settings import TrainConfig


@dataclass(frozen=True)
class RunConfig:
    """All that decides a run; kept beside it as settings.json, so that it can be gone on with."""

    train: TrainConfig = field(default_factory=TrainConfig)
    """The learner and its worlds."""
    name: str = "policy"
    """What the policy is called."""
    tracks: tuple[str, ...] = ("reinvent_2018",)
    """Names or files of tracks, or generated:N for N random ones."""
    reward: str = "progress"
    """A built-in reward, or the path of a reward file."""
    minutes: float = 5.0
    """Longest learning time [min]; 0: without limit."""
    steps: int = 0
    """Most decisions to learn from; 0: without limit."""
    stop_when_complete: int = 0
    """Stop after so many evaluations in a row with every lap complete; 0: never."""
    exam_tracks: tuple[str, ...] = ()
    """Where policies are judged; none: on up to four tracks of training, or twelve random ones."""
    exam_laps: int = 3
    """Laps of each run of an evaluation."""
    exam_trials: int = 1
    """Runs of an evaluation on each track."""
    exam_every: int = 1
    """Save points between two evaluations."""
    exam_opponents: tuple[str, ...] = ()
    """Who races against the policy in an evaluation."""
    opponents: tuple[str, ...] = ()
    """Drivers or checkpoints that race against the learner."""
    self_play: bool = False
    """Race against past selves instead."""
    scripted_share: float = 0.1
    """Share of self-play that is against scripted drivers."""
    handicap: bool = True
    """Hold past selves back in self-play, so that they can be passed, and the learner in some of
    its lone episodes."""
    init_from: str = ""
    """Checkpoint to begin from."""
    threads: int = 1
    """Threads of torch, on which the last bits depend."""
    licence: str = "CC-BY-4.0"
    """Licence of the weights."""
    command: str = ""
    """The command line."""

    def __post_init__(self) -> None:
        known = 0 <= self.minutes < math.inf and self.steps >= 0
        if not known or not (self.minutes or self.steps):
            raise ConfigError(
                f"the run is to last {self.minutes:g} minutes and {self.steps} steps: give one of "
                "them, more than 0"
            )
        if self.exam_every < 1 or self.exam_laps < 1 or self.exam_trials < 1:
            raise ConfigError("an evaluation needs at least 1 lap, 1 run and 1 save point")
        if self.exam_trials > MAX_TRIALS:
            raise ConfigError(f"exam_trials is {self.exam_trials}: give 1 to {MAX_TRIALS}")
        if self.stop_when_complete < 0:
            raise ConfigError(
                f"stop_when_complete is {self.stop_when_complete}: give 0, which is never, or a "
                "number of evaluations in a row"
            )

    def with_budget(self, minutes: float | None, steps: int | None) -> RunConfig:
        """Return the settings with a larger budget, counted from the run's beginning.

        Args:
            minutes: longest learning time [min]; 0: without limit; None: as it was.
            steps: most decisions; 0: without limit; None: as it was.

        Raises:
            ConfigError: a limit lies below the one the run was begun with.
        """
        for given, before, flag in (
            (minutes, self.minutes, "--minutes"),
            (steps, self.steps, "--steps"),
        ):
            if given and 0 < given < before:
                raise ConfigError(
                    f"{flag} is {given:g}, and the run was begun with {before:g}: give more, "
                    "counted from the run's beginning, or omit it"
                )
        return replace(
            self,
            minutes=self.minutes if minutes is None else minutes,
            steps=self.steps if steps is None else steps,
        )

    def has_budget_of(self, other: RunConfig) -> bool:
        """Whether both are to last equally long."""
        return (self.minutes, self.steps) == (other.minutes, other.steps)


_SETTINGS = TypeAdapter(RunConfig)


def settings(folder: Path) -> RunConfig:
    """Return the settings of the run in a folder.

    Raises:
        PolicyError: there is no run.
    """
    path = folder / "settings.json"
    try:
        return _SETTINGS.validate_json(path.read_bytes())
    except (OSError, ValidationError, ConfigError) as error:
        raise PolicyError(
            f"{path} holds no settings of a run ({type(error).__name__}): give the --out of a run "
            "that was begun, or omit --resume"
        ) from None


def keep(cfg: RunConfig, folder: Path) -> None:
    """Write a run's settings into its folder.

    Raises:
        PolicyError: they cannot be written.
    """
    with replacing(folder / "settings.json", "the settings", PolicyError) as file:
        file.write_bytes(_SETTINGS.dump_json(cfg, indent=2))
