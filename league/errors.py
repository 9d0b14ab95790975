"""The errors that a user can meet; messages say what was given and expected, and a remedy."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pydantic import ValidationError
    from pydantic_core import ErrorDetails


class LeagueError(Exception):
    """Base of the errors of files, command lines and API calls."""


class TrackError(LeagueError):
    """A track file, array or request that does not describe a sound track."""


class ConfigError(LeagueError):
    """Settings that contradict each other or lie outside their range."""


class ActionError(LeagueError):
    """An action no car can take: NaN, out of range, of the wrong shape, for an unknown agent."""


class PolicyError(LeagueError):
    """A driver's name or checkpoint that cannot be used."""


class ReplayError(LeagueError):
    """A replay file that is truncated, foreign or of another version."""


class StoreError(LeagueError):
    """A league's database that cannot be opened, read or written, or a request it refuses."""


class DatabaseError(StoreError):
    """A database that cannot be reached, read or written now."""


class QuotaError(StoreError):
    """More entries than an owner may have, or may make in a day."""


class RewardError(LeagueError):
    """A reward function that cannot be run, or that answered with no reward."""


class WorldError(LeagueError):
    """A world that left the numbers: NaN or infinity in a car's state."""


@contextmanager
def explaining(
    failure: str, error: type[LeagueError], remedy: str, *also: type[Exception]
) -> Generator[None]:
    """Turn what the system, or by `also` a library, refuses into "failure (reason): remedy"."""
    try:
        yield
    except (OSError, *also) as refusal:
        reason = getattr(refusal, "strerror", None) or refusal
        raise error(f"{failure} ({reason}): {remedy}") from refusal


def nearest_names(name: str, known: list[str]) -> str:
    """Return a phrase for an error message: the nearest names, or all where none is near."""
    import difflib

    close = difflib.get_close_matches(name, known, n=3, cutoff=0.6)
    return f"nearest: {', '.join(close)}" if close else f"there are {', '.join(sorted(known))}"


def first_problem(error: ValidationError, whole: str) -> tuple[ErrorDetails, str, str]:
    """Return the first thing that pydantic found, in which field (or `whole`), and the reason."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part)[:40] for part in first["loc"]) or whole
    return first, where, first["msg"].removeprefix("Value error, ").replace("\n", " ")[:200]


def brief(value: object) -> str:
    """Return a value in at most 80 characters of one line, for an error message."""
    import reprlib

    try:
        line = " ".join(reprlib.repr(value).split())
    except ValueError:  # Python writes no whole number of more than 4,300 digits
        line = f"a {type(value).__name__} too long to write"
    return line if len(line) <= 80 else f"{line[:77]}..."
