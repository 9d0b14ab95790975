"""A user's DeepRacer reward file: read, compiled once, and run in a module for each paid car.

It is the user's own program on the user's own machine, as `python file.py` would be; the league
never runs files of others.
"""

from __future__ import annotations

import hashlib
import importlib.util
import inspect
import io
import itertools
import logging
import math
import os
import re
import sys
import time
import traceback
import weakref
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import numpy as np
from numpy import ndarray

from league.deepracer.params import KEYS, Params, ParamsBuilder
from league.deepracer.watchdog import NOT_ITS_OWN, TIME_LIMIT_S, Watchdog
from league.envs.rewards import Paid
from league.errors import RewardError, brief, nearest_names
from league.sim.config import SimConfig
from league.sim.records import World
from league.track.track import TrackSet

NAME = "reward_function"
LARGE = 1e5  # Rewards beyond are noted: the original promises to learn up to here.
LARGEST = float(np.finfo(np.float32).max)  # Larger ones are infinite in single precision.
MAX_CHARACTERS = 140_000  # Longest file, as in the original.
KEPT_LINES = 200  # Printed lines kept, the latest.
_LONGEST_LINE = 2000  # Characters kept of a printed line.

TERM = "user"  # Name under which the reward is logged.

Function = Callable[[dict[str, Any]], object]

_MODULE_NUMBERS = itertools.count()
_LOG = logging.getLogger("league")
_TIMED_CALLS = 300  # Calls after which their share of the run's time is looked at.


class Prints:
    """The last lines that a file has printed."""

    def __init__(self) -> None:
        self._lines: deque[str] = deque(maxlen=KEPT_LINES)
        self._begun = ""

    @property
    def lines(self) -> tuple[str, ...]:
        """The last lines, including one that has not ended yet."""
        return (*self._lines, *([self._begun] if self._begun else []))

    def keep(self, *values: object, file: Any = None, **settings: Any) -> None:  # noqa: ANN401
        """Replace `print`; output to a file of the user's own still goes there."""
        if file not in (None, sys.stdout, sys.stderr):
            print(*values, file=file, **settings)
            return
        text = io.StringIO()
        print(*values, file=text, **settings)
        *whole, begun = (self._begun + text.getvalue()).split("\n")
        self._lines.extend(line[:_LONGEST_LINE] for line in whole[-KEPT_LINES:])
        self._begun = begun[:_LONGEST_LINE]


@dataclass(frozen=True, eq=False)
class RewardFile:
    """A reward file, compiled."""

    path: Path  # Where it was read from.
    text: str  # Its content.
    digest: str  # SHA-256 of the file, hexadecimal.
    code: CodeType  # Run once for each car.
    prints: Prints = field(default_factory=Prints)  # The last lines it has printed.

    @classmethod
    def read(cls, path: str | os.PathLike[str]) -> RewardFile:
        """Read and compile a file; RewardError if it is missing, too long, or not Python."""
        path = Path(path)
        content, text = _text(path)
        return _compiled(path, text, hashlib.sha256(content).hexdigest(), Prints())

    def __reduce__(self) -> tuple[object, ...]:
        """Compile the same text again; code cannot be pickled."""
        return _compiled, (self.path, self.text, self.digest, self.prints)

    def instance(self) -> Function:
        """Run the file in a new module; return its function, or RewardError if it has none."""
        module = ModuleType(f"{NAME}_{next(_MODULE_NUMBERS)}")
        module.__file__ = str(self.path)
        vars(module)["print"] = self.prints.keep
        # Dataclasses and pickle look classes up by their module's name.
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
        """Return the error for an exception in the user's code: file, line, and one sentence."""
        line = 1
        for frame, number in traceback.walk_tb(error.__traceback__):
            if frame.f_code.co_filename == str(self.path):
                line = number
        message = " ".join(str(error).split())[:200]
        what = type(error).__name__ + (f": {message}" if message else "")
        hint = self._hint(error, line, params)
        return RewardError(f"{self.path}, line {line}: {what} ({when}){hint}")

    def number(self, function: Function, value: object, when: str) -> float:
        """Return the value as a float; RewardError if it is no number, NaN or infinite."""
        try:
            # An array of one number is one, as it was with the numpy of the original.
            one = value.item() if getattr(value, "size", None) == 1 else value  # type: ignore
            number = math.nan if isinstance(one, str | bytes) else float(one)  # type: ignore
        except (TypeError, ValueError, OverflowError, AttributeError):
            number = math.nan
        if -LARGEST <= number <= LARGEST:
            return number
        raise RewardError(
            f"{self._place(function)} returned {brief(value)} ({when}): return a finite number, "
            "up to 3.4e38, best one of about 1"
        )

    def _place(self, function: object) -> str:
        """Return where a function begins, and its name."""
        line = getattr(getattr(function, "__code__", None), "co_firstlineno", 1)
        return f"{self.path}, line {line}: {NAME}"

    def _hint(self, error: BaseException, line: int, params: Mapping[str, object] | None) -> str:
        """Return the usual remedy for this error, or nothing."""
        if isinstance(error, ModuleNotFoundError) and error.name:
            if (self.path.parent / f"{error.name}.py").exists():
                return f": a reward file stands alone, so move into it what {error.name}.py holds"
            return f": install {error.name} or do without it"
        if params is None:
            return ""
        text = self.text.splitlines()[line - 1]
        if isinstance(error, KeyError) and error.args and isinstance(error.args[0], str):
            key, parameter = error.args[0], re.search(rf"def {NAME}\(\s*(\w+)", self.text)
            if key not in KEYS and (parameter[1] if parameter else "params") in text:
                return f": params has no such key; {nearest_names(key, list(KEYS))}"
        alone = not params.get("objects_location")
        if isinstance(error, IndexError) and alone and "object" in text:
            return ": the objects_* lists are empty when there is nothing else on the track"
        return ""

    def _checked(self, function: object) -> Function:
        if not callable(function):
            raise RewardError(
                f"{self.path} defines no {NAME}: it must say `def {NAME}(params):` and return a "
                "number"
            )
        try:
            signature = inspect.signature(function)
        except (TypeError, ValueError):
            return function
        takes = f"{self._place(function)} takes {len(signature.parameters)} parameters"
        if "on_track" in signature.parameters:
            raise RewardError(
                f"{takes}, the positional signature of November 2018, which is no longer used: "
                f"take one dict, `def {NAME}(params):`"
            )
        try:
            signature.bind({})
        except TypeError:
            raise RewardError(f"{takes}: it must take one, `def {NAME}(params):`") from None
        return function


def _compiled(path: Path, text: str, digest: str, prints: Prints) -> RewardFile:
    try:
        code = compile(text, str(path), "exec", dont_inherit=True)
    except SyntaxError as error:
        raise RewardError(
            f"{path}, line {error.lineno or 1}: this is not Python ({error.msg}): "
            "correct the line and try again"
        ) from error
    except (ValueError, RecursionError, MemoryError) as error:
        raise RewardError(f"{path} cannot be compiled: {error}") from error
    return RewardFile(path, text, digest, code, prints)


def _text(path: Path) -> tuple[bytes, str]:
    """Return a file's bytes, and its text in the encoding that its first lines name."""
    try:
        with path.open("rb") as file:
            content = file.read(4 * MAX_CHARACTERS + 1)  # a pipe may never end
        endless = len(content) > 4 * MAX_CHARACTERS
        text = "" if endless else importlib.util.decode_source(content)
    except FileNotFoundError:
        raise RewardError(
            f"there is no reward file {path}: give the path of a Python file that defines {NAME}"
        ) from None
    except (UnicodeDecodeError, SyntaxError) as error:
        raise RewardError(f"{path} is not UTF-8 text: give a Python file") from error
    except OSError as error:
        raise RewardError(
            f"{path} cannot be read ({error.strerror}): give the path of a Python file"
        ) from error
    if endless or len(text) > MAX_CHARACTERS:
        count = "more than 500,000" if endless else f"{len(text):,}"
        raise RewardError(
            f"{path} has {count} characters: a reward file has at most {MAX_CHARACTERS:,}"
        )
    return content, text


class UserReward:
    """Calls `reward_function(params)` for each paid car and step, each car in its own module.

    A car that stands a penalty or has finished is paid 0, and its function is not called.
    """

    terms = (TERM,)

    def __init__(
        self,
        source: RewardFile,
        sim: SimConfig,
        num_worlds: int,
        cars: Sequence[int],
        *,
        time_limit_s: float = TIME_LIMIT_S,
    ) -> None:
        """Run the file once for each paid car; RewardError if it fails or takes `time_limit_s`."""
        self.source, self.cars = source, tuple(cars)
        self._builder = ParamsBuilder(sim, cars)
        self._large = False
        self._began_s: float | None = None
        self._busy_s, self._calls = 0.0, 0
        self._load([(world, car) for world in range(num_worlds) for car in cars], time_limit_s)

    def __getstate__(self) -> dict[str, Any]:
        """Return what a copy or a pickle keeps: not the modules, which are loaded again."""
        state = vars(self).copy()
        del state["_watchdog"], state["_functions"]
        return {**state, "cells": list(self._functions), "time_limit_s": self._watchdog.limit_s}

    def __setstate__(self, state: dict[str, Any]) -> None:
        cells, time_limit_s = state.pop("cells"), state.pop("time_limit_s")
        vars(self).update(state)
        self._load(cells, time_limit_s)

    def _load(self, cells: Sequence[tuple[int, int]], time_limit_s: float) -> None:
        """Run the file once for each (world, car)."""
        self._watchdog = Watchdog(str(self.source.path), time_limit_s)
        self._functions: dict[tuple[int, int], Function] = {}
        with self._watchdog as watchdog:
            for cell in cells:
                watchdog.calls += 1
                self._functions[cell] = self.source.instance()

    @property
    def printed(self) -> tuple[str, ...]:
        """The last lines that the file has printed."""
        return self.source.prints.lines

    def restart(self, world: World, begun: ndarray) -> None:
        """Begin an episode for these cars; their modules keep their state."""
        self._builder.restart(begun)

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: ndarray, verdicts: ndarray
    ) -> Paid:
        """Return each car's reward, (num_worlds, num_cars), and its only term; see Reward.

        RewardError if the user's code fails, takes too long, or returns no finite number.
        """
        rows = self._builder.rows(tracks, before, world, verdicts)
        rewards = np.zeros(verdicts.shape, dtype=np.float32)
        start_s = time.perf_counter()
        with self._watchdog as watchdog:
            for place, car, params in rows:
                watchdog.calls += 1
                rewards[place, car] = self._call(place, car, params)
        self._note_time(start_s, len(rows))
        return rewards, {TERM: rewards}

    def _note_time(self, start_s: float, calls: int) -> None:
        """Warn once if the user's calls take most of the run's time."""
        if self._calls >= _TIMED_CALLS:
            return
        now_s = time.perf_counter()
        if self._began_s is None:  # the first step loads what the file imports
            self._began_s = now_s
            return
        self._busy_s += now_s - start_s
        self._calls += calls
        share = self._busy_s / (now_s - self._began_s)
        if self._calls >= _TIMED_CALLS and share > 0.5:
            _LOG.warning(
                "%s takes %.2g ms a call, %.0f %% of the run's time: move what does not change "
                "out of %s, or use fewer worlds",
                *(self.source.path, 1000 * self._busy_s / self._calls, 100 * share, NAME),
            )

    def _call(self, world: int, car: int, params: Params) -> float:
        function, steps = self._functions[world, car], params["steps"]
        try:
            value = function(params)
        except NOT_ITS_OWN:
            raise
        except BaseException as error:
            raise self.source.failed(error, _when(world, car, steps), params) from error
        if type(value) is float and -LARGE <= value <= LARGE:
            return value
        when = _when(world, car, steps)
        number = self.source.number(function, value, when)
        if abs(number) > LARGE and not self._large:
            self._large = True
            _LOG.warning(
                "%s returned %g (%s): rewards beyond %g are hard to learn from, aim at about 1",
                *(self.source.path, number, when, LARGE),
            )
        return number


def _when(world: int, car: int, steps: object) -> str:
    return f"car {car} of world {world}, steps {steps}"


def user_reward(
    path: str | os.PathLike[str],
    num_worlds: int,
    cars: Sequence[int] = (0,),
    *,
    sim: SimConfig | None = None,
) -> UserReward:
    """Return the reward of a DeepRacer reward file, which defines `reward_function(params)`.

    Args:
        path: of the file; RewardError if it cannot be read, is not Python, or fails.
        num_worlds: races in the batch.
        cars: the paid cars; all others get 0.
        sim: the world's settings, as of the RaceEnv; None: the usual car, 15 steps per second.
    """
    return UserReward(RewardFile.read(path), sim or SimConfig(), num_worlds, cars)
