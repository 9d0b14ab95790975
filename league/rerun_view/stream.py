"""A recording that a viewer shows as it is written: in a window, or on a page of this machine."""

from __future__ import annotations

import atexit
import contextlib
import subprocess
import tempfile
import uuid

import rerun as rr
import rerun.blueprint as rrb

from league import web_viewer
from league.rerun_view import paths
from league.rerun_view.live import has_display

MEMORY = "512MiB"
"""What the viewer keeps; the oldest is dropped beyond it, so that it can run for days."""


class Stream:
    """A viewer and what is sent to it; bound to this machine alone."""

    def __init__(self, layout: rrb.Blueprint, *, window: bool | None = None) -> None:
        """Open a viewer.

        Args:
            layout: what it shows.
            window: the native viewer rather than a web page; by default where there is a display.

        Raises:
            ReplayError: the viewer does not start.
        """
        window = has_display() if window is None else window
        port = web_viewer.free_port()
        url = f"rerun+http://{web_viewer.HOST}:{port}/proxy"
        self._window = window
        self._home = tempfile.TemporaryDirectory(prefix="league-", ignore_cleanup_errors=True)
        self._server: web_viewer.Server | None = None
        self._child = subprocess.Popen(
            _command(port, window),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=None if window else web_viewer.quiet_environment(self._home.name),
            # Ctrl-C is for us alone, and a window stays when all is over.
            start_new_session=True,
        )
        self.address = url
        """Where it can be watched."""
        try:
            web_viewer.wait_until_open(port, self._child)
            self.recording = rr.RecordingStream(paths.APPLICATION, recording_id=str(uuid.uuid4()))
            self.recording.connect_grpc(url, default_blueprint=layout)
            if not window:
                self._server = web_viewer.serve_stream(url, port)
                self.address = self._server.url
        except BaseException:
            self._child.kill()
            self._child.wait()
            self._home.cleanup()
            raise
        atexit.register(self.close)  # no server outlives the program

    @property
    def is_open(self) -> bool:
        """Whether there is still a viewer: a window may have been closed."""
        return self._child.poll() is None

    def close(self) -> None:
        """Send what is left and stop serving; a window stays open."""
        atexit.unregister(self.close)
        with contextlib.suppress(RuntimeError):  # the viewer may have been closed before us
            if self.is_open:
                self.recording.flush()
            self.recording.disconnect()
        if self._server is not None:
            self._server.close()
            self._server = None
        if not self._window and self.is_open:
            self._child.kill()
            self._child.wait()
        self._home.cleanup()


def _command(port: int, window: bool) -> list[str]:
    command = [str(web_viewer.rerun_program()), "--bind", web_viewer.HOST, "--port", str(port)]
    command += ["--memory-limit", MEMORY, "--server-memory-limit", MEMORY]
    return command if window else [*command, "--serve-grpc"]
