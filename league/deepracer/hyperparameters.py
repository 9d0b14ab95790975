"""hyperparameters.json by DeepRacer's names; what is absent is None, and the league's own counts.

Facts section 6.1. Ranges are wider than the console's where the original's own code took more.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

from pydantic import ConfigDict, Field, ValidationError, create_model

from league.deepracer.json_file import load, reason
from league.errors import ConfigError, brief, nearest_names


@dataclass(frozen=True)
class Hyperparameters:
    """What a hyperparameters.json asks for."""

    batch_size: int | None = None
    """Samples in one minibatch, 1 to 8192."""
    num_epochs: int | None = None
    """Passes over what was collected, 1 to 100."""
    lr: float | None = None
    """Learning rate, 1e-8 to 0.1."""
    beta_entropy: float | None = None
    """Weight of the entropy, 0 to 1."""
    discount_factor: float | None = None
    """What a reward is worth one step later, 0 to 1."""
    loss_type: Literal["mse", "huber"] | None = None
    """Loss of the value function."""
    num_episodes_between_training: int | None = None
    """Episodes collected before each update, 1 to 10,000."""
    exploration_type: Literal["categorical", "e-greedy"] | None = None
    """How discrete actions are explored."""
    e_greedy_value: float | None = None
    """Share of random actions, 0 to 1."""
    epsilon_steps: int | None = None
    """Steps over which that share falls."""
    stack_size: int | None = None
    """Frames told at once; the original knows 1 only."""
    term_cond_max_episodes: int | None = None
    """Stop after so many episodes."""
    term_cond_avg_score: float | None = None
    """Stop at this mean reward of an episode."""
    sac_alpha: float | None = None
    """Weight of the entropy of SAC, 0 to 1; read, but SAC is not trained here."""

    def __post_init__(self) -> None:
        if self.stack_size not in (None, 1):
            raise ConfigError(
                f"stack_size is {self.stack_size}: give 1, a policy sees one picture at a time"
            )


_LIMITS: dict[str, tuple[float, float]] = {
    "batch_size": (1, 8192),
    "num_epochs": (1, 100),
    "lr": (1e-8, 0.1),
    "beta_entropy": (0, 1),
    "discount_factor": (0, 1),
    "num_episodes_between_training": (1, 10_000),
    "e_greedy_value": (0, 1),
    "epsilon_steps": (1, 1e9),
    "stack_size": (1, 16),
    "term_cond_max_episodes": (1, 1e9),
    "term_cond_avg_score": (-1e9, 1e9),
    "sac_alpha": (0, 1),
}
_INTEGERS = (
    "batch_size",
    "num_epochs",
    "num_episodes_between_training",
    "epsilon_steps",
    "stack_size",
    "term_cond_max_episodes",
)
_WORDS = {"loss_type": ("mse", "huber"), "exploration_type": ("categorical", "e-greedy")}
_ALIASES = {
    "learning_rate": "lr",
    "entropy": "beta_entropy",
    "mean squared error": "mse",
    "e_greedy": "e-greedy",
}
"""Other spellings in use, of keys and of words."""
NAMES = tuple(item.name for item in fields(Hyperparameters))


def read(path: str | os.PathLike[str]) -> Hyperparameters:
    """Return what a hyperparameters.json asks for.

    Raises:
        ConfigError: there is no such file, a key is unknown, or a value out of range.
    """
    return parse(load(path, "hyperparameters.json"), str(path))


def parse(given: Mapping[str, Any], name: str = "hyperparameters") -> Hyperparameters:
    """Return what the content of a hyperparameters.json asks for.

    Args:
        given: the file's object.
        name: how to call it in an error message.

    Raises:
        ConfigError: a key is unknown, or a value out of range.
    """
    asked: dict[str, Any] = {}
    for key, value in given.items():
        known = _ALIASES.get(key, key)
        if known not in NAMES:
            near = nearest_names(known, list(NAMES))
            raise ConfigError(f"{name}: {brief(key)} is no hyperparameter; nearest: {near}")
        asked[known] = _checked(name, known, value)
    try:
        return Hyperparameters(**asked)
    except ConfigError as error:
        raise ConfigError(f"{name}: {error}") from None


def _checked(name: str, key: str, value: object) -> object:
    """Return a value of the right type and in its range; numbers may be written as strings."""
    if key in _WORDS:
        word = _ALIASES.get(str(value).lower(), str(value).lower())
        if word not in _WORDS[key]:
            raise ConfigError(f"{name}: {key} is {brief(value)}: give {' or '.join(_WORDS[key])}")
        return word
    low, high = _LIMITS[key]
    kind = int if key in _INTEGERS else float
    model = create_model(
        "_Number",
        __config__=ConfigDict(allow_inf_nan=False),
        **{key: (kind, Field(ge=low, le=high))},  # type: ignore
    )
    try:
        if isinstance(value, bool):
            raise ConfigError(f"{name}: {key} is {brief(value)}: give {low:g} to {high:g}")
        return getattr(model.model_validate({key: value}), key)
    except ValidationError as error:
        if error.errors()[0]["type"] in ("greater_than_equal", "less_than_equal"):
            said = f"{key} is {brief(value)}: give {low:g} to {high:g}"
        else:
            said = reason(error)
        raise ConfigError(f"{name}: {said}") from None
