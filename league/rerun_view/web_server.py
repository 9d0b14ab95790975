"""Serve the Rerun web viewer and one recording from our own origin, on this machine only.

The viewer's page, script and WebAssembly come out of the installed rerun-sdk wheel: its command
line program is asked for them once. (The SDK's own servers listen on all interfaces, without
authentication; so they are not used.)
"""

from __future__ import annotations

import importlib.util
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
from dataclasses import dataclass
from functools import lru_cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, urlsplit

from league.errors import ReplayError

HOST = "127.0.0.1"
"""The only address ever listened on."""
RECORDING = "race.rrd"
FILES = {
    "index.html": "text/html; charset=utf-8",
    "re_viewer.js": "text/javascript",
    "re_viewer_bg.wasm": "application/wasm",
    "sw.js": "text/javascript",
    "favicon.ico": "image/x-icon",
}
"""What the viewer is made of; the first three are needed."""
NEEDED = ("index.html", "re_viewer.js", "re_viewer_bg.wasm")
OPTIONS = "renderer=webgl&theme=dark&persist=0&hide_welcome_screen"
"""WebGL works wherever WebGPU does, and the viewer does not change over by itself where WebGPU
fails; nothing is kept in the browser, so an old layout never meets a new race."""
START_LIMIT_S = 30.0
CHUNK = 1 << 20


def rerun_program() -> Path:
    """Return where the wheel's viewer program lies, without importing rerun."""
    found = importlib.util.find_spec("rerun_cli")
    folders = list(found.submodule_search_locations or []) if found else []
    name = "rerun.exe" if sys.platform == "win32" else "rerun"
    inside = (name, os.path.join("Rerun.app", "Contents", "MacOS", "Rerun"))
    for folder in folders:
        for part in inside:
            if (Path(folder) / part).is_file():
                return Path(folder) / part
    raise ReplayError(
        "the Rerun viewer is not installed: run `pip install rerun-sdk` in this environment"
    )


def free_port() -> int:
    """Return a port that nothing listens on now."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def quiet_environment(home: str) -> dict[str, str]:
    """Return an environment in which the viewer program keeps to itself.

    It would otherwise read and write the user's own viewer settings, and report usage to its makers
    from the second run on; in a home of its own every run is the first, which reports nothing.
    """
    own = {"HOME": home, "XDG_CONFIG_HOME": home, "XDG_DATA_HOME": home, "RERUN_APP_ONLY": "true"}
    return {**os.environ, **own}


@lru_cache(maxsize=1)
def assets() -> dict[str, bytes]:
    """Return the web viewer's files by name, as the installed wheel serves them."""
    port, grpc_port = free_port(), free_port()
    command = [str(rerun_program()), "--serve-web", "--bind", HOST]
    command += ["--port", str(grpc_port), "--web-viewer-port", str(port)]
    with tempfile.TemporaryDirectory(prefix="league-") as home:
        child = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=quiet_environment(home),
        )
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


def wait_until_open(port: int, child: subprocess.Popen) -> None:
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
    """Return the page without the fonts it would fetch from elsewhere, under our own title."""
    text = page.decode("utf-8")
    text = re.sub(r"<link\b[^>]*https?://[^>]*>", "", text)
    return text.replace("<title>Rerun Viewer</title>", "<title>Race</title>").encode()


@dataclass(frozen=True)
class _Site:
    """What a server hands out."""

    files: dict[str, bytes]
    recording: Path | None
    connect: str
    """Further addresses that the page may talk to."""

    @property
    def policy(self) -> str:
        """Content-Security-Policy: nothing from any other origin."""
        return (
            "default-src 'self' blob: data:; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; "
            f"style-src 'self' 'unsafe-inline'; connect-src 'self' {self.connect}".strip()
        )


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: _HttpServer

    def do_GET(self) -> None:
        """Answer a request."""
        self._answer(body=True)

    def do_HEAD(self) -> None:
        """Answer with the headers alone."""
        self._answer(body=False)

    def log_message(self, format: str, *args: object) -> None:
        """Keep silent: the command line owns the terminal."""

    def _answer(self, *, body: bool) -> None:
        site = self.server.site
        # A page elsewhere that rebinds its name to this address must not read races.
        host = (self.headers.get("Host") or "").rsplit(":", 1)[0]
        if host not in (HOST, "localhost"):
            self._plain(HTTPStatus.FORBIDDEN, body)
            return
        name = urlsplit(self.path).path.lstrip("/") or "index.html"
        if name == RECORDING and site.recording is not None:
            self._send_recording(site.recording, body)
        elif name in site.files:
            content = site.files[name]
            self._head(FILES[name], len(content))
            if body:
                self._write(content)
        else:
            self._plain(HTTPStatus.NOT_FOUND, body)

    def _send_recording(self, path: Path, body: bool) -> None:
        try:
            with path.open("rb") as file:
                self._head("application/octet-stream", os.fstat(file.fileno()).st_size)
                while body and (chunk := file.read(CHUNK)):
                    self._write(chunk)
        except FileNotFoundError:
            self._plain(HTTPStatus.GONE, body)

    def _head(self, kind: str, size: int) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(size))
        # The page's progress display reads the unpacked size from here.
        self.send_header("rerun-final-length", str(size))
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Security-Policy", self.server.site.policy)
        self.send_header("X-Content-Type-Options", "nosniff")
        self.end_headers()

    def _plain(self, status: HTTPStatus, body: bool) -> None:
        content = f"{status.value} {status.phrase}\n".encode()
        self.send_response(status)
        self.send_header("Content-Type", "text/plain")
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        if body:
            self._write(content)

    def _write(self, content: bytes) -> None:
        try:
            self.wfile.write(content)
        except (BrokenPipeError, ConnectionResetError):
            self.close_connection = True  # the browser left


class _HttpServer(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, port: int, site: _Site) -> None:
        self.site = site
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request, client_address) -> None:  # noqa: ANN001
        """Keep silent where a browser hangs up; anything else is told as usual."""
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class Server:
    """A running server; close it, or use it in a with block."""

    def __init__(self, server: _HttpServer, query: str) -> None:
        self._server, self._query = server, query
        self._closed = threading.Event()
        self._thread = threading.Thread(target=server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def __enter__(self) -> Server:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def port(self) -> int:
        """The port it listens on."""
        return self._server.server_address[1]

    @property
    def origin(self) -> str:
        """Address of the site."""
        return f"http://{HOST}:{self.port}"

    @property
    def url(self) -> str:
        """Address that opens the viewer with the race."""
        query = self._query.replace("{origin}", quote(self.origin, safe=""))
        return f"{self.origin}/?{query}&{OPTIONS}"

    def wait(self) -> None:
        """Wait until the server is closed; Ctrl-C closes it."""
        try:
            while not self._closed.wait(0.5):
                pass
        except KeyboardInterrupt:
            self.close()

    def close(self) -> None:
        """Stop serving."""
        if self._closed.is_set():
            return
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
        self._closed.set()


def serve(rrd_path: str | os.PathLike[str], port: int = 0) -> Server:
    """Serve the viewer with a recording on this machine, and return the running server.

    Args:
        rrd_path: a .rrd file; it is read anew at each request.
        port: to listen on; 0 takes any that is free.
    """
    path = Path(rrd_path)
    if not path.is_file():
        raise ReplayError(f"there is no recording at {path}: write one with `league view --rrd`")
    return _start(port, _Site(assets(), path, ""), "url={origin}" + quote(f"/{RECORDING}", safe=""))


def serve_stream(grpc_url: str, grpc_port: int, port: int = 0) -> Server:
    """Serve the viewer for a recording that is still being streamed on this machine.

    Args:
        grpc_url: the stream, as Rerun names it (rerun+http://127.0.0.1:.../proxy).
        grpc_port: the port it is on, which the page may talk to.
        port: to listen on; 0 takes any that is free.
    """
    site = _Site(assets(), None, f"http://{HOST}:{grpc_port}")
    return _start(port, site, f"url={quote(grpc_url, safe='')}")


def _start(port: int, site: _Site, query: str) -> Server:
    try:
        return Server(_HttpServer(port, site), query)
    except OSError as error:
        raise ReplayError(
            f"port {port} cannot be listened on ({error.strerror}): give another, or 0 for any"
        ) from error
