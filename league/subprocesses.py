"""Child processes: quick to start, immune to Ctrl-C, ended with the process that started them.

On Linux a server imports modules once and forks each process off, before anything in it has started
a thread; a plain fork would inherit torch's threads and the database's connections. Elsewhere each
process imports for itself.
"""

import contextlib
import ctypes
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Generator, Sequence
from multiprocessing import resource_tracker
from multiprocessing.process import BaseProcess
from types import FrameType

from league.errors import ConfigError

SERVER_STARTS = 5  # Starts of the server for one process before this machine is at fault.

_SERVED = sys.platform == "linux"
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG of prctl(2)
_LIBC = ctypes.CDLL(None) if _SERVED else None

CONTEXT = (
    multiprocessing.get_context("forkserver") if _SERVED else multiprocessing.get_context("spawn")
)
"""Makes the pipes and queues that are passed to such processes."""


def prepare(modules: Sequence[str]) -> None:
    """Start the server, which imports modules; ConfigError if no process can be started."""
    if _SERVED:
        CONTEXT.set_forkserver_preload(list(modules))
        with failing_in_one_sentence():
            _ensure_server()


def start(target: Callable[..., None], *arguments: object) -> BaseProcess:
    """Run a module's function in a process; the first waits until the server has its modules."""
    process = CONTEXT.Process(target=_run, args=(target, *arguments), daemon=True)
    with failing_in_one_sentence():
        for _ in range(SERVER_STARTS - 1):
            try:
                _begin(process)
                return process
            except (EOFError, ConnectionError):  # the server was killed, maybe as it started
                time.sleep(0.1)
        _begin(process)
    return process


def _run(target: Callable[..., None], *arguments: object) -> None:
    settle()
    target(*arguments)


def settle() -> None:
    """Let this new process ignore Ctrl-C, and end with the one that started it."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Without the server this process could be neither observed nor ended.
    die_with_parent()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def die_with_parent() -> None:
    """Let the kernel end this process when its parent ends, however that comes about (Linux)."""
    if _LIBC is not None:
        _LIBC.prctl(_DIE_WITH_PARENT, signal.SIGKILL)


def _end_with_parent() -> None:
    """End this process as soon as its parent has ended, whatever it is doing.

    A queue would not show it: reading half a message from one blocks for ever.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _begin(process: BaseProcess) -> None:
    if _SERVED:
        _ensure_server()
    with sigint_blocked():
        process.start()


def _ensure_server() -> None:
    """Start the server without the working folder among the places that modules come from."""
    from multiprocessing import forkserver

    before = os.environ.get("PYTHONSAFEPATH")
    os.environ["PYTHONSAFEPATH"] = "1"
    try:
        with sigint_blocked():
            forkserver.ensure_running()
    finally:
        if before is None:
            del os.environ["PYTHONSAFEPATH"]
        else:
            os.environ["PYTHONSAFEPATH"] = before


@contextlib.contextmanager
def failing_in_one_sentence() -> Generator[None]:
    """Raise a ConfigError, in one sentence, where no process can be started."""
    try:
        yield
    except (EOFError, OSError) as error:
        raise ConfigError(
            "no child process could be started: look at the messages above, and whether memory is "
            f"short ({type(error).__name__})"
        ) from None


@contextlib.contextmanager
def sigint_blocked() -> Generator[None]:
    """Block SIGINT while children start, so that they inherit the mask; it is delivered after.

    Python's resource tracker, which begins with the first process, would undo that: it goes first.
    """
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextlib.contextmanager
def handling(handler: Callable[[int, FrameType | None], None], *numbers: int) -> Generator[None]:
    """Have signals handled by a function; only the main thread receives any."""
    receives = threading.current_thread() is threading.main_thread()
    before = {number: signal.signal(number, handler) for number in numbers if receives}
    try:
        yield
    finally:
        for number, earlier in before.items():
            signal.signal(number, earlier)
