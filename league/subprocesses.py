"""Processes beside this one: quick to start, deaf to Ctrl-C, and gone when this one has died.

On Linux a server loads the libraries once and forks each process off, before anything in it has
begun a thread of its own; a plain fork would inherit torch's threads and the database's
connections. Elsewhere each process loads them for itself.
"""

from __future__ import annotations

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess

from league.errors import ConfigError

LOADED = (
    "league.agents.policy",
    "league.agents.roster",
    "league.cli",
    "league.racing.evaluate",
    "league.matchmaking.workers.processes",
    "league.racing.race",
    "league.sim.physics.bullet",
    "league.sim.camera.paint_renderer",
)
"""What such processes import, and what takes them seconds without a server."""

_SERVED = sys.platform == "linux"
_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of prctl(2)."""

CONTEXT = (
    multiprocessing.get_context("forkserver") if _SERVED else multiprocessing.get_context("spawn")
)
"""Makes the pipes and queues that such processes are handed."""


def prepare() -> None:
    """Begin to load what processes to come will import, without waiting for it.

    Raises:
        ConfigError: no process can be started on this machine.
    """
    if _SERVED:
        with _told():
            _serve()


def start(target: Callable[..., None], *arguments: object) -> BaseProcess:
    """Start a process; the first waits until what was prepared is loaded.

    Args:
        target: a function of a module, which it runs.
        arguments: of the function; pipes and queues of CONTEXT may be among them.

    Raises:
        ConfigError: none can be started on this machine.
    """
    process = CONTEXT.Process(target=_run, args=(target, *arguments), daemon=True)
    with _told():
        try:
            _begin(process)
        except (EOFError, ConnectionError):  # the server has just died: let that be noticed
            time.sleep(0.1)
            _begin(process)
    return process


def _run(target: Callable[..., None], *arguments: object) -> None:
    """Run a function in a process that has just begun."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    if _SERVED:
        # Without the server nobody could be told how this process ended, nor end it.
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
    threading.Thread(target=_end_with_parent, daemon=True).start()
    target(*arguments)


def _end_with_parent() -> None:
    """End this process as soon as the one that asked for it is no more, whatever it is doing.

    A queue would not tell: half a message in it is waited for, for ever.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _begin(process: BaseProcess) -> None:
    if _SERVED:
        _serve()
        process.start()
    else:
        with _deaf():
            process.start()


def _serve() -> None:
    """See that the server runs, or loads what is needed."""
    from multiprocessing import forkserver

    CONTEXT.set_forkserver_preload(list(LOADED))
    with _deaf(), _nothing_from_here():
        forkserver.ensure_running()


@contextlib.contextmanager
def _told() -> Iterator[None]:
    try:
        yield
    except (EOFError, OSError) as error:
        raise ConfigError(
            "no process could be started beside this one: look at the messages above, and whether "
            f"memory is short ({type(error).__name__})"
        ) from None


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Let what is started inherit that it does not hear Ctrl-C; this program hears it a bit later.

    Python's resource tracker, which begins with the first process, would undo that: it goes first.
    """
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def _nothing_from_here() -> Iterator[None]:
    """Start Python without the working folder among the places that modules come from."""
    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before
