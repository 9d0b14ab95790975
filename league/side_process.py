"""Processes beside this one: quick to start, deaf to Ctrl-C, and gone when this one has died.

On Linux a server loads the libraries once and forks each process off, before anything in it has
begun a thread of its own; a plain fork would inherit torch's threads and the database's
connections. Elsewhere each process loads them for itself.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from multiprocessing.process import BaseProcess

from league.errors import ConfigError

_SERVED = sys.platform == "linux"
CONTEXT = (
    multiprocessing.get_context("forkserver") if _SERVED else multiprocessing.get_context("spawn")
)
"""Makes the pipes and queues that such processes are handed."""


_LOADED = (
    "league.agents.policy",
    "league.agents.roster",
    "league.evaluation",
    "league.race",
    "league.sim.bullet",
    "league.sim.camera.paint",
)
"""What such processes import, and what takes them seconds without a server."""


def prepare() -> None:
    """Begin to load what processes to come will import, without waiting for it."""
    if _SERVED:
        CONTEXT.set_forkserver_preload(list(_LOADED))
        _serve()


def start(target: Callable[..., None], *arguments: object) -> BaseProcess:
    """Start a process; the first waits until what was prepared is loaded.

    Args:
        target: a function of a module, which it runs.
        arguments: of the function; pipes and queues of CONTEXT may be among them.

    Raises:
        ConfigError: none can be started on this machine.
    """
    process = CONTEXT.Process(target=target, args=arguments, daemon=True)
    try:
        try:
            _begin(process)
        except (EOFError, ConnectionError):  # the server has just died: let that be noticed
            time.sleep(0.1)
            _begin(process)
    except (EOFError, OSError) as error:
        raise ConfigError(
            "no process could be started beside this one: look at the messages above, and whether "
            f"memory is short ({type(error).__name__})"
        ) from None
    return process


def orphaned() -> bool:
    """Whether the process that started this one is no more."""
    parent = multiprocessing.parent_process()
    return parent is not None and not parent.is_alive()


def end_with_parent() -> None:
    """End this process as soon as the one that started it is no more, whatever it is doing."""

    def watch() -> None:
        parent = multiprocessing.parent_process()
        if parent is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _begin(process: BaseProcess) -> None:
    if _SERVED:
        _serve()
        process.start()
    else:
        with _deaf():
            process.start()


def _serve() -> None:
    """See that the server runs; what it forks off is as deaf as it is."""
    from multiprocessing import forkserver

    with _deaf():
        forkserver.ensure_running()


@contextlib.contextmanager
def _deaf() -> Iterator[None]:
    """Ignore Ctrl-C while a process begins, which inherits that: it is this one's affair."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
