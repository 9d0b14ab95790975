"""A user's reward file: read, compiled once, and run in a module of its own for each car.

It is the user's own program on the user's own machine, as `python file.py` would be; the league
never runs anybody else's.
"""

from __future__ import annotations

import ast
import hashlib
import inspect
import io
import itertools
import math
import os
import re
import sys
import tokenize
import traceback
import weakref
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, ModuleType, TracebackType

from league.deepracer.params import KEYS
from league.deepracer.watchdog import NOT_ITS_OWN
from league.errors import RewardError, brief, nearest_names

NAME = "reward_function"
LIMIT = 1e5
"""Largest reward, as in the original."""
MAX_CHARACTERS = 140_000
"""Longest file, as in the original."""
KEPT_LINES = 200
"""Printed lines kept, the latest."""
_LONGEST_LINE = 2000
"""Characters kept of a printed line."""

Function = Callable[[dict], object]

_NUMBERS = itertools.count()
"""One for each module that is made of a file."""


class Prints:
    """What a file has printed: its last lines."""

    def __init__(self) -> None:
        """Begin with nothing."""
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._begun = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """The last lines, one that has not ended yet too."""
        return (*self._lines, *([self._begun] if self._begun else []))

    def keep(
        self,
        *values: object,
        sep: str | None = " ",
        end: str | None = "\n",
        file: object = None,
        flush: bool = False,
    ) -> None:
        """Take the place of `print`; what goes into a file of the user's own goes there."""
        text = (" " if sep is None else sep).join(map(str, values))
        text += "\n" if end is None else end
        if file is not None and file not in (sys.stdout, sys.stderr):
            print(text, end="", file=file, flush=flush)  # type: ignore
            return
        *whole, begun = (self._begun + text).split("\n")
        self._lines.extend(line[:_LONGEST_LINE] for line in whole[-KEPT_LINES:])
        self._begun = begun[:_LONGEST_LINE]


@dataclass(frozen=True, eq=False)
class Source:
    """A reward file, compiled."""

    path: Path
    """Where it was read from."""
    text: str
    """What it says."""
    digest: str
    """SHA-256 of the file, hexadecimal."""
    code: CodeType
    """What is run for each car."""
    prints: Prints = field(default_factory=Prints)
    """What it has printed."""

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> Source:
        """Read and compile a file.

        Raises:
            RewardError: there is no such file, it is too long, no text, or no Python.
        """
        path = Path(path)
        content, text = _text(path)
        try:
            code = compile(text, str(path), "exec", dont_inherit=True)
        except SyntaxError as error:
            raise RewardError(
                f"{path}, line {error.lineno or 1}: this is not Python ({error.msg}): "
                "mend the line and try again"
            ) from error
        except (ValueError, RecursionError, MemoryError) as error:
            raise RewardError(f"{path} cannot be compiled: {error}") from error
        return cls(path, text, hashlib.sha256(content).hexdigest(), code)

    def instance(self) -> Function:
        """Run the file in a new module and return its reward function.

        Raises:
            RewardError: the file fails, or has no function of one parameter.
        """
        module = ModuleType(f"{NAME}_{next(_NUMBERS)}")
        module.__file__ = str(self.path)
        vars(module)["print"] = self.prints.keep
        # What a file defines may look itself up by its module's name: dataclasses and pickle do.
        sys.modules[module.__name__] = module
        weakref.finalize(self, sys.modules.pop, module.__name__, None)
        try:
            exec(self.code, vars(module))
        except NOT_ITS_OWN:
            raise
        except BaseException as error:
            raise self.failed(error, "while the file was loaded") from error
        return self._checked(vars(module).get(NAME))

    def failed(
        self, error: BaseException, when: str, params: Mapping[str, object] | None = None
    ) -> RewardError:
        """Return what to tell of an exception in the user's code: file, line, and one sentence."""
        line = line_of(error.__traceback__, str(self.path)) or 1
        said = " ".join(str(error).split())[:200]
        what = type(error).__name__ + (f": {said}" if said else "")
        hint = self._hint(error, line, params)
        return RewardError(f"{self.path}, line {line}: {what} ({when}){hint}")

    def number(self, function: Function, value: object, when: str) -> float:
        """Return the value as a float.

        Raises:
            RewardError: it is not a number from -1e5 to 1e5.
        """
        try:
            # An array of one number is one, as it was with the numpy of the original.
            one = value.item() if getattr(value, "size", None) == 1 else value  # type: ignore
            number = math.nan if isinstance(one, str | bytes) else float(one)  # type: ignore
        except (TypeError, ValueError, OverflowError, AttributeError):
            number = math.nan
        if -LIMIT <= number <= LIMIT:
            return number
        raise RewardError(
            f"{self.path}, line {self._answering(function)}: {NAME} returned {brief(value)} "
            f"({when}): return a number from -1e5 to 1e5"
        )

    def _answering(self, function: Function) -> int:
        """Return the line of a function's only `return`, or its first line if there are several."""
        called = vars(type(function)).get("__call__")  # of an object that is called
        code = getattr(function, "__code__", None) or getattr(called, "__code__", None)
        if code is None or code.co_filename != str(self.path):
            return 1
        answers = [
            inner.lineno
            for node in ast.walk(ast.parse(self.text))
            if isinstance(node, ast.FunctionDef) and node.name == code.co_name
            for inner in ast.walk(node)
            if isinstance(inner, ast.Return)
        ]
        return answers[0] if len(answers) == 1 else code.co_firstlineno

    def _hint(self, error: BaseException, line: int, params: Mapping[str, object] | None) -> str:
        """Return what usually mends this, or nothing."""
        said = self.text.splitlines()[line - 1] if params is not None else ""
        if isinstance(error, KeyError) and error.args and isinstance(error.args[0], str):
            key, taken = error.args[0], re.search(rf"def {NAME}\(\s*(\w+)", self.text)
            if key not in KEYS and (taken[1] if taken else "params") in said:
                return f": params has no such key; nearest: {nearest_names(key, list(KEYS))}"
        alone = params is not None and not params.get("objects_location")
        if isinstance(error, IndexError) and alone and "object" in said:
            return ": the objects_* lists are empty when there is nothing else on the track"
        if isinstance(error, ModuleNotFoundError) and error.name:
            if (self.path.parent / f"{error.name}.py").exists():
                return f": a reward file stands alone, so move into it what {error.name}.py holds"
            return f": install {error.name} or do without it"
        return ""

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


def _text(path: Path) -> tuple[bytes, str]:
    """Return a file's bytes, and what they say in the encoding that its first lines name."""
    try:
        with path.open("rb") as file:
            content = file.read(4 * MAX_CHARACTERS + 1)  # a pipe may never end
        if len(content) > 4 * MAX_CHARACTERS:
            raise RewardError(_too_long(path, "more than 500,000"))
        encoding, _ = tokenize.detect_encoding(io.BytesIO(content).readline)
        text = io.TextIOWrapper(io.BytesIO(content), encoding).read()
    except FileNotFoundError:
        raise RewardError(
            f"there is no reward file {path}: give the path of a Python file that defines {NAME}"
        ) from None
    except (UnicodeDecodeError, SyntaxError) as error:
        raise RewardError(f"{path} is no UTF-8 text: give a Python file") from error
    except OSError as error:
        raise RewardError(f"{path} cannot be read: {error.strerror}") from error
    if len(text) > MAX_CHARACTERS:
        raise RewardError(_too_long(path, f"{len(text):,}"))
    return content, text


def _too_long(path: Path, given: str) -> str:
    return f"{path} has {given} characters: a reward file has at most {MAX_CHARACTERS:,}"
