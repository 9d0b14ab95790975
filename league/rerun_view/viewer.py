"""The Rerun viewer, in a window or on a page of this machine, for a file or a stream.

The page, its script and WebAssembly come out of the installed rerun-sdk wheel: its command line
program serves them once. (The SDK's own servers listen on all interfaces, without authentication;
so they are not used.)
"""

import atexit
import contextlib
import importlib.util
import io
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
import uuid
from collections.abc import Mapping
from functools import lru_cache
from http import HTTPStatus
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import BinaryIO
from urllib.parse import quote, urlsplit

import rerun as rr
import rerun.blueprint as rrb

from league.errors import ReplayError, explaining
from league.rerun_view import layout
from league.subprocesses import die_with_parent

HOST = "127.0.0.1"  # the only address ever listened on
RECORDING = "race.rrd"
FILES = {
    "index.html": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "sw.js": "text/javascript",
    "favicon.ico": "image/x-icon",
}
"""Content types of the viewer's files."""
NEEDED = ("index.html", "re_viewer.js", "re_viewer_bg.wasm")
OPTIONS = "renderer=webgl&theme=dark&persist=0&hide_welcome_screen"
"""WebGL works wherever WebGPU does, and the viewer does not change over by itself where WebGPU
fails; nothing is kept in the browser, so an old layout never meets a new race."""
START_LIMIT_S = 30.0
MEMORY = "512MiB"
"""Most that the viewer of a stream keeps; it drops the oldest data, so that it can run for days."""


def rerun_program() -> Path:
    """Return the path of the wheel's viewer program."""
    spec = importlib.util.find_spec("rerun_cli")
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    for folder in (spec.submodule_search_locations or []) if spec else []:
        for program in (Path(folder, name), Path(folder, "Rerun.app/Contents/MacOS/Rerun")):
            if program.is_file():
                return program
    raise ReplayError(
        "the Rerun viewer is not installed: run `pip install rerun-sdk` in this environment"
    )


def free_port() -> int:
    """Return a port that nothing listens on now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def _launch(command: list[str], home: str | None) -> subprocess.Popen[bytes]:
    """Start the viewer program, without our Ctrl-C, in a home folder of its own if one is given.

    With such a home it is a server, and ends with this program; a window may stay open. In the
    user's own home it would read and write the user's viewer settings, and report usage to its
    makers from the second run on; in an empty one every run is the first, which reports nothing.
    """
    environment = None
    if home is not None:
        own = dict.fromkeys(("HOME", "XDG_CONFIG_HOME", "XDG_DATA_HOME"), home)
        environment = {**os.environ, **own, "RERUN_APP_ONLY": "true"}
    return subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        env=environment,
        start_new_session=True,
        preexec_fn=None if home is None or sys.platform == "win32" else die_with_parent,
    )


@lru_cache(maxsize=1)
def assets() -> dict[str, bytes]:
    """Return the web viewer's files by name, as the installed wheel serves them."""
    port, grpc_port = free_port(), free_port()
    command = [str(rerun_program()), "--serve-web", "--bind", HOST]
    command += ["--port", str(grpc_port), "--web-viewer-port", str(port)]
    with tempfile.TemporaryDirectory(prefix="league-") as home:
        child = _launch(command, home)
        try:
            wait_until_open(port, child)
            files = {name: _fetch(port, name) for name in FILES}
        finally:
            child.kill()
            child.wait()
    missing = [name for name in NEEDED if not files[name]]
    if missing:
        raise ReplayError(
            f"the installed Rerun viewer does not serve {', '.join(missing)}: "
            "install the rerun-sdk version that this project pins"
        )
    files["index.html"] = _offline(files["index.html"])
    return {name: content for name, content in files.items() if content}


def wait_until_open(port: int, child: subprocess.Popen[bytes]) -> None:
    """Wait until the viewer program listens on its port."""
    deadline = time.monotonic() + START_LIMIT_S
    while time.monotonic() < deadline and child.poll() is None:
        try:
            socket.create_connection((HOST, port), timeout=1.0).close()
            return
        except OSError:
            time.sleep(0.05)
    raise ReplayError(
        "the Rerun viewer program did not start: try `python -m rerun_cli --version` and install "
        "rerun-sdk again if it fails"
    )


def _fetch(port: int, name: str) -> bytes:
    # No proxy: this never leaves the machine.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(f"http://{HOST}:{port}/{name}", timeout=START_LIMIT_S) as answer:
            return answer.read()
    except urllib.error.HTTPError:
        return b""


def _offline(page: bytes) -> bytes:
    """Return the page under our own title, without the fonts it would fetch from elsewhere."""
    text = page.decode("utf-8")
    text = re.sub(r"<link\b[^>]*https?://[^>]*>", "", text)
    return text.replace("<title>Rerun Viewer</title>", "<title>Race</title>").encode()


class Server(ThreadingHTTPServer):
    """Serves the viewer on this machine until it is closed; also a context manager."""

    daemon_threads = True

    def __init__(self, port: int, query: str, recording: Path | None, connect: str = "") -> None:
        """Listen on a port; 0 takes any that is free.

        In `query`, that of the viewer's address, {origin} stands for the address of this server.
        The recording is served as well, and the page may also connect to the address `connect`.
        """
        self.files: Mapping[str, bytes | Path] = assets()
        if recording is not None:
            self.files = {**self.files, RECORDING: recording}
        self.policy = (
            "default-src 'self' blob: data:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
            f"style-src 'self' 'unsafe-inline'; connect-src 'self' {connect}".strip()
        )
        """Content-Security-Policy: nothing from any other origin."""
        failure = f"port {port} cannot be listened on"
        with explaining(failure, ReplayError, "give another, or 0 for any"):
            super().__init__((HOST, port), _Handler)
        self.port = self.server_address[1]
        self.origin = f"http://{HOST}:{self.port}"
        self.url = f"{self.origin}/?{query.format(origin=quote(self.origin, safe=''))}&{OPTIONS}"
        """Address that opens the viewer with the race."""
        self._closing = threading.Lock()
        self._thread = threading.Thread(target=self.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Wait until the server is closed; Ctrl-C closes it."""
        with contextlib.suppress(KeyboardInterrupt):
            while self._thread.is_alive():
                self._thread.join(0.5)
        self.close()

    def close(self) -> None:
        """Stop serving."""
        # One at a time: of two threads the second would find the socket marked as closed, and go
        # on before it is.
        with self._closing:
            self.shutdown()
            self.server_close()
            self._thread.join()

    def __exit__(self, *_: object) -> None:
        self.close()

    def handle_error(self, request, client_address) -> None:  # noqa: ANN001
        """Ignore browsers that hang up."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class _Handler(SimpleHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: Server  # pyright: ignore[reportIncompatibleVariableOverride]

    def send_head(self) -> BinaryIO | None:
        """Send the headers of a known file and return the file, or send an error."""
        # A page elsewhere that rebinds its name to this address must not read races.
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        if host not in (HOST, "localhost"):
            self.send_error(HTTPStatus.FORBIDDEN)
            return None
        name = urlsplit(self.path).path.lstrip("/") or "index.html"
        try:
            content = self.server.files[name]
            file = content.open("rb") if isinstance(content, Path) else io.BytesIO(content)
        except (KeyError, FileNotFoundError):
            self.send_error(HTTPStatus.NOT_FOUND)
            return None
        size = str(file.seek(0, os.SEEK_END))
        file.seek(0)
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", FILES.get(name, "application/octet-stream"))
        self.send_header("Content-Length", size)
        # The page's progress display reads the unpacked size from here.
        self.send_header("rerun-final-length", size)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", self.server.policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()
        return file

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing: the terminal is the command line's."""


def serve(rrd_path: str | os.PathLike[str], port: int = 0) -> Server:
    """Serve the viewer with a .rrd file on this machine, and return the running server."""
    path = Path(rrd_path)
    if not path.is_file():
        raise ReplayError(f"there is no recording at {path}: write one with `league view --rrd`")
    return Server(port, "url={origin}" + quote(f"/{RECORDING}", safe=""), path)


def has_display() -> bool:
    """Whether a window can be opened here."""
    if sys.platform in ("darwin", "win32"):
        return True
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def open_viewer(rrd_path: str | os.PathLike[str]) -> int:
    """Open a recording in the native viewer and return its exit code when it is closed."""
    if not has_display():
        raise ReplayError(
            "there is no display for the viewer's window: use --web for a browser, or --rrd FILE"
        )
    return subprocess.call([*_command(free_port(), window=True, memory=None), str(rrd_path)])


class Stream:
    """A viewer and the recording that it shows as it is written; on this machine alone."""

    def __init__(
        self, views: rrb.Blueprint, *, window: bool | None = None, memory: str | None = MEMORY
    ) -> None:
        """Open a viewer with these views; ReplayError if it does not start.

        `window` is by default whether there is a display; `memory` is what the viewer keeps at
        most, and None leaves it to the viewer.
        """
        # whether it is a window, which stays open, rather than a page that this program serves
        self.has_window = has_display() if window is None else window
        port = free_port()
        self.address = f"rerun+http://{HOST}:{port}/proxy"  # where it can be watched
        self._home = tempfile.TemporaryDirectory(prefix="league-", ignore_cleanup_errors=True)
        self._server: Server | None = None
        command = _command(port, self.has_window, memory)
        self._child = _launch(command, None if self.has_window else self._home.name)
        try:
            wait_until_open(port, self._child)
            self.recording = rr.RecordingStream(layout.APPLICATION, recording_id=str(uuid.uuid4()))
            self.recording.connect_grpc(self.address, default_blueprint=views)
            if not self.has_window:
                query = f"url={quote(self.address, safe='')}"
                self._server = Server(0, query, None, connect=f"http://{HOST}:{port}")
                self.address = self._server.url
        except BaseException:
            self._kill()
            self._home.cleanup()
            raise
        atexit.register(self.close)  # no server outlives the program

    @property
    def is_open(self) -> bool:
        """Whether the viewer still runs: a window may have been closed."""
        return self._child.poll() is None

    def wait(self) -> None:
        """Wait for Ctrl-C, where a web page is served."""
        self.recording.flush()
        if self._server is not None:
            self._server.wait()

    def close(self) -> None:
        """Send what is left and stop serving; a window stays open."""
        atexit.unregister(self.close)
        with contextlib.suppress(RuntimeError):  # the viewer may have been closed before
            if self.is_open:
                self.recording.flush()
            self.recording.disconnect()
        if self._server is not None:
            self._server.close()
            self._server = None
        if not self.has_window:
            self._kill()
        self._home.cleanup()

    def _kill(self) -> None:
        self._child.kill()
        self._child.wait()


def _command(port: int, window: bool, memory: str | None = MEMORY) -> list[str]:
    command = [str(rerun_program()), "--bind", HOST, "--port", str(port)]
    if memory is not None:
        command += ["--memory-limit", memory, "--server-memory-limit", memory]
    return command if window else [*command, "--serve-grpc"]
