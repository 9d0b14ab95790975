"""Serving a league's pages with uvicorn."""

from __future__ import annotations

import contextlib
import gc
import socket
import sys
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import replace

import uvicorn

from league.errors import ConfigError, LeagueError, explaining
from league.matchmaking.store import Store
from league.web.app import App, make_app
from league.web.security import Access

HOST = "127.0.0.1"
CONNECTIONS = 500
"""Connections at the same time; more are answered 503."""
TURN_S = 0.0005
"""A thread that others wait for runs so long [s]."""
LOOKS_S, MOST, REST = 1.0, 64, 24.0
"""So often [s] it looks whether likely pages should be made before they are asked for, at most so
many; then it rests so many times as long as they took: for a 25th of a processor."""
WILDCARDS = ("0.0.0.0", "::", "")
"""Addresses that stand for all addresses of a machine."""


def serve(
    store: Store,
    port: int,
    *,
    host: str = HOST,
    access: Access | None = None,
    ready: Callable[[str], None],
) -> None:
    """Serve a league's pages until Ctrl-C.

    Args:
        store: the league.
        port: to listen on; 0 takes a free one.
        host: address to listen on; others than 127.0.0.1 are possible once there are tokens.
        access: who may reach it; its `hosts` are the names that browsers may use.
        ready: receives the address of the pages once the port is open.

    Raises:
        ConfigError: an address without tokens or names, or a port that cannot be opened.
    """
    access = access or Access()
    if host != HOST:
        access = replace(access, hosts=(*access.hosts, *_names(store, host, access)))
    if not 0 <= port < 65536:
        raise ConfigError(f"the port {port} is not possible: give 0 to 65535")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    # asyncio sends small packets at once (TCP_NODELAY) only where the protocol is named: else each
    # answer waits 40 ms for the acknowledgement of its head.
    with socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        failure = f"the port {port} of {host} cannot be opened"
        with explaining(failure, ConfigError, "give another --port, or an address of this machine"):
            listener.bind((host, port))
            listener.listen()
        shown = f"[{host}]" if ":" in host else host
        ready(f"http://{shown}:{listener.getsockname()[1]}/")
        # Uvicorn takes a client's address from X-Forwarded-For only if a proxy here sends it.
        app = make_app(store, access=access)
        over = threading.Event()
        threading.Thread(target=prepare, args=(app, over), daemon=True).start()
        config = uvicorn.Config(
            app,
            log_level="warning",
            server_header=False,
            lifespan="off",
            limit_concurrency=CONNECTIONS,
        )
        try:
            with _settings_of_a_server():
                uvicorn.Server(config).run(sockets=[listener])
        finally:
            over.set()


def prepare(app: App, over: threading.Event) -> None:
    """Make what visitors are likely to ask for while none of them waits, until it is `over`."""
    app.warm()
    worked_s = 0.0
    while not over.wait(max(LOOKS_S, REST * worked_s)):
        start_s = time.thread_time()
        with contextlib.suppress(LeagueError):  # the next look tries again
            for _ in range(MOST):
                if over.is_set() or not app.prepare():
                    break
        worked_s = time.thread_time() - start_s


@contextmanager
def _settings_of_a_server() -> Generator[None]:
    """Change how Python collects garbage and lets threads take turns.

    A league of 10,000 entries is half a million objects without cycles; looking through them holds
    up all requests for 0.15 s, several times while a snapshot is taken: so old objects are looked
    through a hundred times less often. Threads that make pages give way to the event loop after
    half a millisecond, not five: it gives its turn away with each packet that it reads or sends.
    """
    before, turn_s = gc.get_threshold(), sys.getswitchinterval()
    gc.set_threshold(700, 10, 1000)
    sys.setswitchinterval(TURN_S)
    try:
        yield
    finally:
        gc.set_threshold(*before)
        sys.setswitchinterval(turn_s)


def _names(store: Store, host: str, access: Access) -> tuple[str, ...]:
    """Return the names by which other machines may know this one; refuse if there are no tokens."""
    if not store.tokens.active():
        raise ConfigError(
            f"the address {host!r} shows this league to other machines, and it has no tokens by "
            "which it would know who submits: make one with `league token create OWNER`, or use "
            "--host 127.0.0.1"
        )
    if host not in WILDCARDS:
        return (host,)
    if access.hosts == Access().hosts:
        raise ConfigError(
            f"the address {host!r} stands for all addresses of this machine: say with --name under "
            "which name or address browsers reach it, as in --name league.example.org"
        )
    return ()
