"""A user's reward file: read, compiled once, and run in a module of its own for each car.

It is the user's own program on the user's own machine, as `python file.py` would be; the league
never runs anybody else's.
"""

from __future__ import annotations

import hashlib
import inspect
import math
import os
import sys
import traceback
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, ModuleType, TracebackType

from league.envs.deepracer.situation import KEYS
from league.errors import RewardError, brief, nearest_names

NAME = "reward_function"
LIMIT = 1e5
"""Largest reward, as in the original."""
MAX_CHARACTERS = 140_000
"""Longest file, as in the original."""
KEPT_LINES = 200
"""Printed lines kept, the latest."""

Function = Callable[[dict], object]


@dataclass(frozen=True, eq=False)
class Source:
    """A reward file, compiled."""

    path: Path
    """Where it was read from."""
    text: str
    """What it says."""
    code: CodeType
    """What is run for each car."""
    printed: deque[str] = field(default_factory=lambda: deque(maxlen=KEPT_LINES))
    """What it has printed, the last lines."""

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Source:
        """Read and compile a file.

        Raises:
            RewardError: there is no such file, it is too long, no text, or no Python.
        """
        path = Path(path)
        text = _text(path)
        try:
            code = compile(text, str(path), "exec", dont_inherit=True)
        except SyntaxError as error:
            raise RewardError(
                f"{path}, line {error.lineno or 1}: this is not Python ({error.msg}): "
                "mend the line and try again"
            ) from error
        except (ValueError, RecursionError, MemoryError) as error:
            raise RewardError(f"{path} cannot be compiled: {error}") from error
        return cls(path=path, text=text, code=code)

    @property
    def digest(self) -> str:
        """SHA-256 of the text, hexadecimal."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    def instance(self) -> Function:
        """Run the file in a new module and return its reward function.

        Raises:
            RewardError: the file fails, or has no function of one parameter.
        """
        module = ModuleType(NAME)
        module.__file__ = str(self.path)
        vars(module)["print"] = self._print
        # Known by its name only while it runs: what it defines may look itself up (dataclasses do).
        before = sys.modules.get(NAME)
        sys.modules[NAME] = module
        try:
            exec(self.code, vars(module))
        except (Exception, SystemExit) as error:
            raise self.failed(error, "while the file was loaded") from error
        finally:
            del sys.modules[NAME]
            if before is not None:
                sys.modules[NAME] = before
        return self._checked(vars(module).get(NAME))

    def failed(
        self, error: BaseException, when: str, params: Mapping[str, object] | None = None
    ) -> RewardError:
        """Return what to tell of an exception in the user's code: file, line, and one sentence."""
        line = line_of(error.__traceback__, str(self.path)) or 1
        said = " ".join(str(error).split())[:200]
        what = type(error).__name__ + (f": {said}" if said else "")
        return RewardError(f"{self.path}, line {line}: {what} ({when}){_hint(error, params)}")

    def number(self, function: Function, value: object, when: str) -> float:
        """Return the value as a float.

        Raises:
            RewardError: it is not a number from -1e5 to 1e5.
        """
        try:
            number = math.nan if isinstance(value, str | bytes) else float(value)  # type: ignore
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if -LIMIT <= number <= LIMIT:
            return number
        code = getattr(function, "__code__", None)
        line = code.co_firstlineno if code else 1
        raise RewardError(
            f"{self.path}, line {line}: {NAME} returned {brief(value)} ({when}): "
            "return a number from -1e5 to 1e5"
        )

    def _print(self, *values: object, sep: str = " ", end: str = "\n", **options: object) -> None:
        """Keep what the user prints instead of showing it."""
        stream = options.get("file")
        text = (" " if sep is None else sep).join(map(str, values))
        if stream is not None and stream not in (sys.stdout, sys.stderr):
            print(text, end=end, file=stream)  # type: ignore
        else:
            self.printed.extend(text.splitlines() or [""])

    def _checked(self, function: object) -> Function:
        if not callable(function):
            raise RewardError(
                f"{self.path} defines no {NAME}: it must say `def {NAME}(params):` and return a "
                "number"
            )
        try:
            parameters = list(inspect.signature(function).parameters.values())
        except (TypeError, ValueError):
            return function
        needed = [p for p in parameters if p.default is p.empty and p.kind not in (2, 4)]
        takes_one = any(p.kind in (0, 1, 2) for p in parameters)
        line = getattr(getattr(function, "__code__", None), "co_firstlineno", 1)
        if any(p.name == "on_track" for p in parameters):
            raise RewardError(
                f"{self.path}, line {line}: {NAME} takes {len(parameters)} parameters, the "
                "positional signature of November 2018, which is no longer used: take one dict, "
                f"`def {NAME}(params):`"
            )
        if len(needed) > 1 or not takes_one or any(p.kind == p.KEYWORD_ONLY for p in needed):
            raise RewardError(
                f"{self.path}, line {line}: {NAME} takes {len(parameters)} parameters: it must "
                f"take one, `def {NAME}(params):`"
            )
        return function


def line_of(trace: TracebackType | None, path: str) -> int | None:
    """Return the line of the user's file that a traceback came through last."""
    found = None
    for frame, line in traceback.walk_tb(trace):
        if frame.f_code.co_filename == path:
            found = line
    return found


def _text(path: Path) -> str:
    try:
        if path.is_file() and path.stat().st_size > 4 * MAX_CHARACTERS:
            raise RewardError(_too_long(path, path.stat().st_size))
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        raise RewardError(
            f"there is no reward file {path}: give the path of a Python file that defines {NAME}"
        ) from None
    except UnicodeDecodeError as error:
        raise RewardError(f"{path} is no UTF-8 text: give a Python file") from error
    except OSError as error:
        raise RewardError(f"{path} cannot be read: {error.strerror}") from error
    if len(text) > MAX_CHARACTERS:
        raise RewardError(_too_long(path, len(text)))
    return text


def _too_long(path: Path, given: int) -> str:
    return f"{path} is {given:,} characters long: a reward file has at most {MAX_CHARACTERS:,}"


def _hint(error: BaseException, params: Mapping[str, object] | None) -> str:
    """Return what usually mends this, or nothing."""
    if isinstance(error, KeyError) and error.args and isinstance(error.args[0], str):
        key = error.args[0]
        if key not in KEYS:
            return f": params has no such key; nearest: {nearest_names(key, list(KEYS))}"
    if isinstance(error, IndexError) and params is not None and not params.get("objects_location"):
        return ": the objects_* lists are empty when there is nothing else on the track"
    if isinstance(error, ModuleNotFoundError):
        return f": install {error.name} or do without it"
    return ""
