"""Ends calls of a user's code that take too long, and reports the line on which they were."""

from __future__ import annotations

import ctypes
import signal
import sys
import threading
import weakref
from collections.abc import Iterator
from types import FrameType, TracebackType

from league.errors import RewardError

TIME_LIMIT_S = 20.0  # Longest call in training and scoring [s]: the first may load a large library.
_LOOKS = 10
"""Looks at a call within its time limit. Looks are counted instead of seconds, because a machine
that sleeps or a program that its terminal has stopped takes none."""

_WAKE = getattr(signal, "SIGURG", None)  # A signal that does nothing by itself; Windows has none.


class Stopped(BaseException):
    """Thrown into the thread that runs the user's code, to end it."""


NOT_ITS_OWN = (KeyboardInterrupt, Stopped)  # What leaves the user's code without being its fault.


class Watchdog:
    """Watches the calls that are made inside its `with`; count each in `calls`.

    A loop in Python ends at its next line, with a RewardError, and so does waiting for a clock, a
    file or the keyboard in the main thread. A loop inside a C library, or one that catches every
    exception, goes on until the program ends.
    """

    def __init__(self, path: str, time_limit_s: float = TIME_LIMIT_S) -> None:
        self.calls = 0
        self._path, self.limit_s = path, time_limit_s
        self._lock, self._begun = threading.Lock(), False
        self._busy, self._thread = False, 0
        self._error: RewardError | None = None
        self._seen = self._looks = 0

    # These two dominate the cost of a single call, so they take no lock. Either __exit__ sees the
    # error, or `look` sees that the call has ended: each writes before it reads.

    def __enter__(self) -> Watchdog:
        """Watch this thread from now on."""
        if not self._begun:
            self._begin()
        self._thread = threading.get_ident()
        self._busy = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: object, trace: TracebackType | None
    ) -> None:
        """Watch no longer; RewardError if a call took too long."""
        try:
            self._busy = False
            if self._error is not None:
                self._settle()
        except Stopped:  # thrown as the call returned
            self._settle()

    def look(self) -> None:
        """End the call under way if it is the one of so many looks ago."""
        with self._lock:
            if not self._busy or self.calls != self._seen:
                self._seen, self._looks = self.calls, 0
                return
            self._looks += 1
            if self._looks < _LOOKS or is_debugged(self._thread):
                return
            self._error = self._error or stuck(self._path, self._thread, self.limit_s)
            if self._busy:
                throw(self._thread, Stopped)
                _wake(self._thread)
            else:
                self._error = None

    def _begin(self) -> None:
        self._begun, over = True, threading.Event()
        if _WAKE is not None and threading.current_thread() is threading.main_thread():
            signal.signal(_WAKE, lambda number, frame: None)
        weakref.finalize(self, over.set)
        arguments = (weakref.ref(self), over, self.limit_s / _LOOKS)
        threading.Thread(target=_watch, args=arguments, daemon=True, name="watchdog").start()

    def _settle(self) -> None:
        with self._lock:
            error, self._error = self._error, None
            # The call may have returned just before it was to end.
            throw(self._thread, None)
        if error is not None:
            raise error


def _watch(reference: weakref.ref[Watchdog], over: threading.Event, pause_s: float) -> None:
    while not over.wait(pause_s):
        watchdog = reference()
        if watchdog is None:
            return
        watchdog.look()
        del watchdog


def stuck(path: str, thread: int, limit_s: float) -> RewardError:
    """Return the error for a thread that is still in a call of the user's file."""
    lines = (one.f_lineno for one in _frames(thread) if one.f_code.co_filename == path)
    line = next(lines, None) or 1
    return RewardError(
        f"{path}, line {line}: still running after {limit_s:g} s: a call must return at "
        "once, look for a loop that does not end, or a sleep or input"
    )


def is_debugged(thread: int) -> bool:
    """Return whether a debugger steps through the thread."""
    return any(frame.f_globals.get("__name__") == "bdb" for frame in _frames(thread))


def _frames(thread: int) -> Iterator[FrameType]:
    """Yield the frames of a thread, the innermost first."""
    frame = sys._current_frames().get(thread)  # pyright: ignore[reportPrivateUsage]
    while frame is not None:
        yield frame
        frame = frame.f_back


def _wake(thread: int) -> None:
    """Interrupt a call of the system in the main thread, so that it sees what was thrown.

    Python repeats such a call unless a handler of the signal raises: the handler's first line is
    where the exception arrives. Other threads run no handlers.
    """
    if _WAKE is not None and thread == threading.main_thread().ident:
        signal.pthread_kill(thread, _WAKE)


def throw(thread: int, error: type[BaseException] | None) -> None:
    """Raise an exception in a thread at its next line; None takes it back."""
    thrown = None if error is None else ctypes.py_object(error)
    ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(thread), thrown)
