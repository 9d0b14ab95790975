"""Flags of a command by the names of its fields: which were given, and which would be ignored."""

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
        needs: for fields that mean something in some company only: whether it is there, and what
            it is called.

    Raises:
        ConfigError: one was given without its company.
    """
    for name in given(command, needs):
        there, needed = needs[name]
        if not there:
            raise ConfigError(
                f"{spelled(name)} means nothing without {needed}: give both, or neither"
            )


def at_least(command: DataclassInstance, name: str, least: int) -> None:
    """Refuse a field that is smaller than what makes sense.

    Raises:
        ConfigError: it is.
    """
    value = getattr(command, name)
    if value is not None and value < least:
        raise ConfigError(f"{spelled(name)} {value}: give {least} or more")
