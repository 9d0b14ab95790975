"""Checks of flags, which are called by the names of their fields."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import MISSING, fields
from typing import TYPE_CHECKING

from league.errors import ConfigError

if TYPE_CHECKING:
    from _typeshed import DataclassInstance


def spelled(name: str) -> str:
    """Return a field's flag."""
    return f"--{name.replace('_', '-')}"


def given(command: DataclassInstance, names: Iterable[str]) -> list[str]:
    """Return those of some fields that hold another value than their default."""
    defaults = {}
    for field in fields(command):
        if field.default is not MISSING:
            defaults[field.name] = field.default
        elif field.default_factory is not MISSING:
            defaults[field.name] = field.default_factory()
    return [name for name in names if getattr(command, name) != defaults[name]]


def refuse_ignored(command: DataclassInstance, needs: Mapping[str, tuple[bool, str]]) -> None:
    """Refuse flags that would be ignored.

    Args:
        command: the command line.
        needs: for each field that needs another flag whether that was given, and its name.

    Raises:
        ConfigError: a field was given without the flag it needs.
    """
    for name in given(command, needs):
        present, needed = needs[name]
        if not present:
            raise ConfigError(
                f"{spelled(name)} means nothing without {needed}: give both, or neither"
            )


def refuse(*cases: tuple[bool, str]) -> None:
    """Raise ConfigError with the sentence of the first case that holds."""
    for holds, sentence in cases:
        if holds:
            raise ConfigError(sentence)


def at_least(command: DataclassInstance, name: str, least: int) -> None:
    """Refuse a field that is smaller than what makes sense.

    Raises:
        ConfigError: it is.
    """
    value = getattr(command, name)
    if value is not None and value < least:
        raise ConfigError(f"{spelled(name)} {value}: give {least} or more")
