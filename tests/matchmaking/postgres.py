"""A scratch PostgreSQL server for tests: its own folder, a free port, gone afterwards."""

from __future__ import annotations

import itertools
import os
import pwd
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import psycopg

START_S = 60


def binaries() -> Path | None:
    """Return the folder of PostgreSQL's programs, if they are installed."""
    found = sorted(Path("/usr/lib/postgresql").glob("*/bin/initdb"), key=lambda p: p.parts[-3])
    named = shutil.which("initdb")
    if found:
        return found[-1].parent
    return Path(named).resolve().parent if named else None


@contextmanager
def server(*, durable: bool = False) -> Iterator[Server]:
    """Start a server and stop it again; as another user when we are root, which it refuses.

    Args:
        durable: write through to the disk, for measurements; tests need not.
    """
    programs = binaries()
    assert programs is not None, "PostgreSQL is not installed"
    who = _user()
    memory = Path("/dev/shm")  # a disk takes a second for each database, and a minute to forget
    at = memory if not durable and os.access(memory, os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="league-postgres-", dir=at))
    if who:
        os.chown(folder, who["user"], who["group"])
    try:
        yield from _serve(programs, folder, who, durable)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


class Server:
    """A running server; each call of `database` makes a new one in it."""

    def __init__(self, port: int) -> None:
        self.port = port
        self._count = itertools.count()
        self._own: psycopg.Connection | None = None

    def url(self, database: str) -> str:
        return f"postgresql://league@127.0.0.1:{self.port}/{database}"

    def database(self) -> str:
        name = f"league_{next(self._count)}"
        own = self._connection()
        # A copy of the template's files, where it may be chosen, not of each of its pages.
        how = " STRATEGY file_copy" if own.info.server_version >= 150000 else ""
        own.execute(f"CREATE DATABASE {name}{how}".encode())
        return self.url(name)

    def drop(self, url: str) -> None:
        """Remove a database that `database` made, whoever is still connected to it."""
        name = url.rsplit("/", 1)[1]
        self._connection().execute(f"DROP DATABASE {name} WITH (FORCE)".encode())

    def close(self) -> None:
        """Close the connection by which databases are made."""
        if self._own is not None:
            self._own.close()

    def _connection(self) -> psycopg.Connection:
        # The server begins a process for each connection, so one is kept.
        if self._own is None:
            self._own = psycopg.connect(self.url("postgres"), autocommit=True)
        return self._own


def _user() -> dict[str, Any]:
    if os.geteuid() != 0:
        return {}
    known = {user.pw_name: user for user in pwd.getpwall()}
    user = known.get("postgres") or known["nobody"]
    return {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}


def _serve(programs: Path, folder: Path, who: dict[str, Any], durable: bool) -> Iterator[Server]:
    files, quiet = folder / "files", {"cwd": folder, **who}
    make = ["-D", files, "-U", "league", "-A", "trust", "-E", "UTF8", "--locale=C", "--no-sync"]
    subprocess.run([programs / "initdb", *make], check=True, capture_output=True, **quiet)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    settings = {
        "listen_addresses": "127.0.0.1",
        "port": port,
        "unix_socket_directories": folder,
        "fsync": "on" if durable else "off",
    }
    options = [part for name, value in settings.items() for part in ("-c", f"{name}={value}")]
    with (folder / "log").open("wb") as log:
        running = subprocess.Popen(
            [programs / "postgres", "-D", files, *options], stdout=log, stderr=log, **quiet
        )
    started = Server(port)
    try:
        _wait(started, running, folder / "log")
        yield started
    finally:
        started.close()
        running.send_signal(signal.SIGINT)  # ends connections and stops
        try:
            running.wait(20)
        except subprocess.TimeoutExpired:
            running.kill()
            running.wait()


def _wait(started: Server, running: subprocess.Popen[bytes], log: Path) -> None:
    give_up = time.monotonic() + START_S
    while True:
        try:
            psycopg.connect(started.url("postgres"), connect_timeout=5).close()
            return
        except psycopg.OperationalError:
            ended = running.poll() is not None
            assert not ended and time.monotonic() < give_up, log.read_text(errors="replace")
            time.sleep(0.05)
