"""Checks of settings: each value of its field's type, each number in its range."""

import math
from dataclasses import field, fields
from types import UnionType
from typing import Literal, TypeVar, get_args, get_origin

import numpy as np

from league.errors import ConfigError, brief

Number = TypeVar("Number", int, float)
Whole = int | np.integer
Real = Whole | float | np.floating


def ranged(default: Number, low: float, high: float) -> Number:
    """Return a field of a dataclass that `Checked` keeps from low to high, both included."""
    return field(default=default, metadata={"range": (low, high)})


class Checked:
    """Base of settings that are checked as they are made; `what` precedes the fields' names."""

    def __init_subclass__(cls, what: str = "") -> None:
        cls._what = what

    def __post_init__(self) -> None:
        """Raise a ConfigError for a field of the wrong type or a number out of its range.

        Types are written without quotes; tuples are left to their own class.
        """
        for item in fields(self):  # type: ignore[arg-type]
            value = getattr(self, item.name)
            wanted = _wanted(item.type, value, *item.metadata.get("range", (-math.inf, math.inf)))
            if wanted:
                name = f"{self._what} {item.name}".strip()
                raise ConfigError(f"{name} is {brief(value)}: {wanted}")


def is_number(value: object, low: float, high: float) -> bool:
    """Whether a value is a real number from low to high; NaN is not."""
    return isinstance(value, Real) and not isinstance(value, bool) and bool(low <= value <= high)


def _wanted(kind: object, value: object, low: float, high: float) -> str:
    """Return what is wanted instead of a value, or nothing where the value is right."""
    if kind is int:
        fits = isinstance(value, Whole) and is_number(value, low, high)
        return "" if fits else f"give a whole number, {low:g} to {high:g}"
    if kind is float:
        return "" if is_number(value, low, high) else f"give {low:g} to {high:g}"
    if kind is bool:
        return "" if isinstance(value, bool) else "give True or False"
    if get_origin(kind) is Literal:
        known = get_args(kind)
        fits = isinstance(value, str) and value in known
        return "" if fits else f"choose one of {', '.join(known)}"
    kinds = get_args(kind) if isinstance(kind, UnionType) else (kind,)
    plain = tuple(each for each in kinds if isinstance(each, type))
    if len(plain) == len(kinds) and not isinstance(value, plain):
        return f"give a {' or '.join(each.__name__.removesuffix('Type') for each in plain)}"
    return ""
