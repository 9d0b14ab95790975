"""JSON objects from files people wrote by hand, refused with a reason."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from league.errors import ConfigError, brief

MAX_BYTES = 1_000_000


def load(path: str | os.PathLike[str], what: str) -> dict[str, Any]:
    """Return the object in a JSON file.

    Args:
        path: the file.
        what: which of DeepRacer's files is wanted, for an error message.

    Raises:
        ConfigError: there is no such file, or no JSON object in it.
    """
    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"{path} is larger than 1 MB: that is no {what}")
        found = json.loads(path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise ConfigError(f"there is no file {path}: give the path of a {what}") from None
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:
        said = str(error).splitlines()[0]
        raise ConfigError(f"{path} is no JSON ({said}): give a {what}") from None
    if not isinstance(found, dict):
        raise ConfigError(f"{path} holds {brief(found)}: a {what} is one object, {{...}}")
    return found


def reason(error: ValidationError) -> str:
    """Return pydantic's first complaint as one phrase."""
    first = error.errors(include_url=False)[0]
    where = ".".join(str(part)[:40] for part in first["loc"]) or "the file"
    said = first["msg"].replace("\n", " ")[:200]
    if first["type"] == "missing":
        return f"{where} is missing: give it"
    if first["type"] == "extra_forbidden":
        return f"{where} is not known: leave it out"
    return f"{where} is {brief(first['input'])}: {said[0].lower()}{said[1:]}"
