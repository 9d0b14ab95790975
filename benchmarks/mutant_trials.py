"""Trials of mutants.py: which test fails when a function has the code of a mutant.

A pytest session imports and collects once, and each mutant gets a fork of it. Functions take other
code in place, so every module that imported one has the mutant, too.
"""

import gc
import inspect
import os
import signal
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import CodeType, FunctionType
from typing import TextIO

import pytest
from numba.core.registry import CPUDispatcher

ENDED = "(the process ended)"
"""What caught a mutant that no test reported."""


class Loop:
    """Plugin of pytest that does something else with the collected tests than run them all."""

    def __init__(self, work: Callable[[pytest.Session], None]) -> None:
        self._work = work

    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        """Do the work."""
        self._work(session)
        return True


def in_fork(work: Callable[[TextIO], int]) -> tuple[int, str]:
    """Return what `work` returns in a fork of this process, and what it writes to its file.

    Args:
        work: gets the file that it writes to.
    """
    with tempfile.TemporaryFile("w+") as written:
        child = os.fork()
        if child == 0:
            os.setpgid(0, 0)
            status = 1
            with suppress(BaseException):
                status = work(written)
                written.flush()
            os._exit(status)
        _, status = os.waitpid(child, 0)
        # What a test started ends with it.
        with suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
        written.seek(0)
        return status, written.read()


def session(options: list[str], *plugins: object) -> tuple[int, str]:
    """Return the exit status and the output of pytest in a fork that loads the league by itself.

    The league comes from the working folder; the large libraries were loaded before the fork.
    """

    def run(printed: TextIO) -> int:
        os.dup2(printed.fileno(), 1)
        os.dup2(printed.fileno(), 2)
        for name in list(sys.modules):
            if name.partition(".")[0] in ("league", "benchmarks"):
                del sys.modules[name]
        sys.path.insert(0, os.getcwd())
        return int(pytest.main(options, plugins=plugins))

    return in_fork(run)


def first_failure(
    items: list[pytest.Item],
    known: dict[str, str | None],
    mutant: str,
    before: Callable[[], None] = lambda: None,
) -> str | None:
    """Return the test that fails first in a fork of a session, or None when all pass.

    Args:
        items: the tests, fastest first.
        known: which test caught which mutant; this mutant's comes first, then those with most.
        mutant: its name.
        before: what puts the mutant in place, in the fork.
    """
    caught = Counter(known.values())
    items = sorted(items, key=lambda one: (one.nodeid != known.get(mutant), -caught[one.nodeid]))

    def run(failed: TextIO) -> int:
        before()
        for one, following in zip(items, [*items[1:], None], strict=True):
            one.config.hook.pytest_runtest_protocol(item=one, nextitem=following)
            if one.session.testsfailed:
                failed.write(one.nodeid)
                return 1
        return 0

    status, failed = in_fork(run)
    return (failed or ENDED) if status else None


def _is_function(code: object) -> bool:
    return isinstance(code, CodeType) and bool(code.co_flags & inspect.CO_OPTIMIZED)


def functions_of(code: CodeType) -> dict[tuple[str, int], CodeType]:
    """Return the code of the functions of a module and its classes, by name and first line."""
    found: dict[tuple[str, int], CodeType] = {}
    for one in code.co_consts:
        if _is_function(one):
            found[one.co_qualname, one.co_firstlineno] = one
        elif isinstance(one, CodeType):
            found |= functions_of(one)
    return found


def _imported(code: CodeType) -> tuple[object, ...]:
    """Return what runs when a module is imported: all but the bodies of its functions."""
    inner = [
        _imported(one) if isinstance(one, CodeType) else one
        for one in code.co_consts
        if not _is_function(one)
    ]
    return code.co_code, code.co_names, inner


def live_functions(paths: list[Path]) -> list[FunctionType]:
    """Return the functions of imported files, wherever they are bound, but for compiled ones."""
    names = {str(path.resolve()) for path in paths}
    # Lazy objects of libraries answer isinstance with warnings.
    objects = gc.get_objects()
    compiled = {one.py_func for one in objects if type(one) is CPUDispatcher}
    functions = [one for one in objects if type(one) is FunctionType and one not in compiled]
    return [one for one in functions if one.__code__.co_filename in names]


def replacements(
    functions: list[FunctionType], path: Path, source: str, mutated: str
) -> dict[FunctionType, CodeType] | None:
    """Return the functions that a mutant of a file changes, and their new code.

    None when it changes what runs at import, or a function that is not among those given.
    """
    old, new = (compile(text, str(path), "exec") for text in (source, mutated))
    if _imported(old) != _imported(new):
        return None
    before, after = functions_of(old), functions_of(new)
    changed = {key: code for key, code in after.items() if before.get(key) != code}
    found: dict[FunctionType, CodeType] = {}
    for one in functions:
        key = one.__code__.co_qualname, one.__code__.co_firstlineno
        if one.__code__.co_filename == str(path.resolve()) and key in changed:
            found[one] = changed[key]
    names = {(one.co_qualname, one.co_firstlineno) for one in found.values()}
    return found if changed and names == set(changed) else None


def put(changed: dict[FunctionType, CodeType]) -> None:
    """Give functions their new code."""
    for function, code in changed.items():
        function.__code__ = code
