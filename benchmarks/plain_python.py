"""Plugin of pytest for mutants.py: compiled modules as plain Python, and only fast, sound tests.

The first run writes the tests that pass within a second of processor time, which other programs
hardly change, to the file $MUTANTS_RECORD, and stops those that take longer; later runs leave these
out and begin with the fastest.
"""

import json
import os
import resource
import signal
import sys
from collections.abc import Generator
from pathlib import Path

import numba
import numpy as np
import pytest

SLOW_S = 1.0
RECORD = Path(os.environ["MUTANTS_RECORD"])
KNOWN: dict[str, float] | None = json.loads(RECORD.read_text()) if RECORD.exists() else None
took: dict[str, float] = {}
"""Processor time of each test, with its fixtures and processes [s]."""
failed: set[str] = set()


def _plain(function=None, *, allocates: bool = False):
    """Do what `compiled` and `inner` do, with or without their option, but compile nothing."""
    if function is None:
        return _plain
    function.py_func = function
    return function


def _plain_record(record: np.dtype) -> np.dtype:
    """Return a record for plain Python, its fields attributes as in compiled code.

    There the arithmetic of integers has 64 bits; NumPy's would wrap at the field's eight.
    """
    wide = {np.dtype(np.uint8): np.int64, np.dtype(np.uint32): np.int64}
    fields = [(name, wide.get(record[name], record[name])) for name in record.names or ()]
    return np.dtype((np.record, np.dtype(fields, align=True)))


if os.environ["NUMBA_DISABLE_JIT"] == "1":
    # Numba was loaded before it could read the variable.
    numba.config.DISABLE_JIT = 1  # pyright: ignore[reportAttributeAccessIssue]
    import league.jit

    league.jit.compiled = league.jit.inner = _plain
    import league.agents.policy
    import league.agents.scripted
    import league.envs.race_env
    import league.sim.physics.bullet

    for name, module in list(sys.modules.items()):
        if name.startswith("league."):
            for key, value in list(vars(module).items()):
                if isinstance(value, np.dtype) and value.names:
                    setattr(module, key, _plain_record(value))


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Keep the tests that are known to pass fast, fastest first."""
    if KNOWN is not None:
        config.hook.pytest_deselected(items=[one for one in items if one.nodeid not in KNOWN])
        items[:] = sorted(
            (one for one in items if one.nodeid in KNOWN), key=lambda one: KNOWN[one.nodeid]
        )


def _processor_s() -> float:
    spent = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in spent)


def _stop(*_: object) -> None:
    pytest.fail("it takes too long")


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Note how long a test takes."""
    began = _processor_s()
    if KNOWN is None:
        signal.signal(signal.SIGPROF, _stop)
        signal.setitimer(signal.ITIMER_PROF, 3 * SLOW_S)
    try:
        return (yield)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        took[item.nodeid] = _processor_s() - began


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note which tests fail."""
    if not report.passed:
        failed.add(report.nodeid)


def pytest_sessionfinish() -> None:
    """Write the first run's tests."""
    if KNOWN is None:
        fast = {one: s for one, s in took.items() if s <= SLOW_S and one not in failed}
        RECORD.write_text(json.dumps(fast))
