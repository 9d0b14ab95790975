"""A recording that a viewer shows as it is written: in a window, or on a page of this machine."""

from __future__ import annotations

import atexit
import contextlib
import os
import subprocess
import sys
import tempfile
import uuid

import rerun as rr
import rerun.blueprint as rrb

from league.rerun_view import paths, web_server

MEMORY = "512MiB"
"""What the viewer keeps; the oldest is dropped beyond it, so that it can run for days."""


def has_display() -> bool:
    """Whether a window can be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


class Stream:
    """A viewer and what is sent to it; bound to this machine alone."""

    def __init__(
        self,
        layout: rrb.Blueprint,
        *,
        window: bool | None = None,
        memory: str | None = MEMORY,
    ) -> None:
        """Open a viewer.

        Args:
            layout: what it shows.
            window: the native viewer rather than a web page; by default where there is a display.
            memory: what it keeps at most; None: the viewer's own limits.

        Raises:
            ReplayError: the viewer does not start.
        """
        window = has_display() if window is None else window
        port = web_server.free_port()
        url = f"rerun+http://{web_server.HOST}:{port}/proxy"
        self._window = window
        self._home = tempfile.TemporaryDirectory(prefix="league-", ignore_cleanup_errors=True)
        self._server: web_server.Server | None = None
        self._child = subprocess.Popen(
            _command(port, window, memory),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=None if window else web_server.quiet_environment(self._home.name),
            # Ctrl-C is for us alone, and a window stays when all is over.
            start_new_session=True,
        )
        self.address = url
        """Where it can be watched."""
        try:
            web_server.wait_until_open(port, self._child)
            self.recording = rr.RecordingStream(paths.APPLICATION, recording_id=str(uuid.uuid4()))
            self.recording.connect_grpc(url, default_blueprint=layout)
            if not window:
                self._server = web_server.serve_stream(url, port)
                self.address = self._server.url
        except BaseException:
            self._kill()
            self._home.cleanup()
            raise
        atexit.register(self.close)  # no server outlives the program

    @property
    def is_open(self) -> bool:
        """Whether there is still a viewer: a window may have been closed."""
        return self._child.poll() is None

    def wait(self) -> None:
        """Wait until the watcher has seen enough: until Ctrl-C, where a web page is served."""
        self.recording.flush()
        if self._server is not None:
            self._server.wait()

    def close(self, *, leave_window: bool = True) -> None:
        """Send what is left and stop serving; a window stays open, unless told otherwise."""
        atexit.unregister(self.close)
        with contextlib.suppress(RuntimeError):  # the viewer may have been closed before us
            if self.is_open:
                self.recording.flush()
            self.recording.disconnect()
        if self._server is not None:
            self._server.close()
            self._server = None
        if not (self._window and leave_window):
            self._kill()
        self._home.cleanup()

    def _kill(self) -> None:
        self._child.kill()
        self._child.wait()


def _command(port: int, window: bool, memory: str | None = MEMORY) -> list[str]:
    command = [str(web_server.rerun_program()), "--bind", web_server.HOST, "--port", str(port)]
    if memory is not None:
        command += ["--memory-limit", memory, "--server-memory-limit", memory]
    return command if window else [*command, "--serve-grpc"]
