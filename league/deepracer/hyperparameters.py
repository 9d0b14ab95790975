"""hyperparameters.json by DeepRacer's names; an absent value is None, and the league's own counts.

Ranges are wider than the console's where the original's own code accepted more.
"""

import os
from collections.abc import Mapping
from typing import Any, Literal

from pydantic import Field, ValidationError, field_validator

from league.deepracer.model_metadata import load_json, reason
from league.errors import ConfigError, brief, first_problem, nearest_names
from league.race_spec import FrozenModel

_WORDS = {"mean squared error": "mse", "e_greedy": "e-greedy"}  # Other spellings of words in use.
_KEYS = {"learning_rate": "lr", "entropy": "beta_entropy"}  # Other names of keys in use.


class Hyperparameters(FrozenModel):
    """The values of a hyperparameters.json."""

    batch_size: int | None = Field(None, ge=1, le=8192)  # Samples in one minibatch.
    num_epochs: int | None = Field(None, ge=1, le=100)  # Passes over the collected samples.
    lr: float | None = Field(None, ge=1e-8, le=0.1)  # Learning rate.
    beta_entropy: float | None = Field(None, ge=0, le=1)  # Weight of the entropy.
    discount_factor: float | None = Field(None, ge=0, le=1)  # Value of a reward one step later.
    loss_type: Literal["mse", "huber"] | None = None  # Loss of the value function.
    num_episodes_between_training: int | None = Field(None, ge=1, le=10_000)  # For one update.
    exploration_type: Literal["categorical", "e-greedy"] | None = None  # Of discrete actions.
    e_greedy_value: float | None = Field(None, ge=0, le=1)  # Share of random actions.
    epsilon_steps: int | None = Field(None, ge=1, le=10**9)  # Steps over which that share falls.
    stack_size: int | None = Field(None, ge=1, le=16)  # Frames seen at once; the original knows 1.
    term_cond_max_episodes: int | None = Field(None, ge=1, le=10**9)  # Stop after so many episodes.
    term_cond_avg_score: float | None = Field(None, ge=-1e9, le=1e9)  # Stop at this mean reward.
    sac_alpha: float | None = Field(None, ge=0, le=1)  # Of SAC, which is not trained here.

    @field_validator("*", mode="before")
    @classmethod
    def _is_value(cls, value: object) -> object:
        """Refuse what pydantic would take for a missing value or a number."""
        if value is None or isinstance(value, bool):
            raise ValueError("give a number or a word, or omit it")
        return value

    @field_validator("loss_type", "exploration_type", mode="before")
    @classmethod
    def _spelling(cls, value: object) -> str:
        word = str(value).lower()
        return _WORDS.get(word, word)

    @field_validator("stack_size")
    @classmethod
    def _is_one_picture(cls, value: int | None) -> int | None:
        if value not in (None, 1):
            raise ValueError("give 1, a policy sees one picture at a time")
        return value


NAMES = tuple(Hyperparameters.model_fields)


def read(path: str | os.PathLike[str]) -> Hyperparameters:
    """Return the values of a hyperparameters.json; ConfigError if there is none, or a bad one."""
    return parse(load_json(path, "hyperparameters.json"), str(path))


def parse(content: Mapping[str, Any], name: str = "hyperparameters") -> Hyperparameters:
    """Return the values of a hyperparameters.json's object.

    ConfigError, which begins with `name`, if a key is unknown, or a value out of range.
    """
    given = {_KEYS.get(key, key): value for key, value in content.items()}
    for key in given:
        if key not in NAMES:
            near = nearest_names(key, list(NAMES))
            raise ConfigError(f"{name}: {brief(key)} is no hyperparameter; {near}")
    try:
        return Hyperparameters.model_validate(given)
    except ValidationError as error:
        first, key, _ = first_problem(error, "the file")
        if first["type"] not in ("greater_than_equal", "less_than_equal"):
            raise ConfigError(f"{name}: {reason(error)}") from None
        low, high = Hyperparameters.model_fields[key].metadata
        limits = f"give {low.ge:g} to {high.le:g}"
        raise ConfigError(f"{name}: {key} is {brief(first['input'])}: {limits}") from None
