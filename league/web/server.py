"""Serving a league's pages with uvicorn."""

from __future__ import annotations

import socket
from collections.abc import Callable

import uvicorn

from league.errors import ConfigError
from league.matchmaking.store import Store
from league.web.app import make_app

HOST = "127.0.0.1"


def serve(store: Store, port: int, *, host: str = HOST, ready: Callable[[str], None]) -> None:
    """Serve a league's pages until Ctrl-C.

    Args:
        store: the league.
        port: to listen on; 0 takes a free one.
        host: address to listen on; only 127.0.0.1 is possible.
        ready: receives the address of the pages once the port is open.

    Raises:
        ConfigError: another address than 127.0.0.1, or a port that cannot be opened.
    """
    if host != HOST:
        raise ConfigError(
            f"the address {host!r} would show this league to other machines, which needs the "
            "tokens that come together with submitting in the browser: use --host 127.0.0.1"
        )
    if not 0 <= port < 65536:
        raise ConfigError(f"the port {port} is not possible: give 0 to 65535")
    with socket.socket() as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            listener.bind((host, port))
            listener.listen()
        except OSError as error:
            raise ConfigError(
                f"the port {port} cannot be opened ({error.strerror}): give another --port"
            ) from error
        ready(f"http://{host}:{listener.getsockname()[1]}/")
        config = uvicorn.Config(
            make_app(store), log_level="warning", server_header=False, lifespan="off"
        )
        uvicorn.Server(config).run(sockets=[listener])
