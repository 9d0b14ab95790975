"""How fields of a dataclass appear as flags of a command line."""

from typing import Annotated, TypeVar

from tyro.conf import Fixed, Suppress, arg

_T = TypeVar("_T")
Hidden = Annotated[_T, Fixed, Suppress]  # a setting without a flag
Unset = Annotated[_T, arg(help_behavior_hint="")]
"""A flag without a value by default, such as None or (): its help does not print that."""
