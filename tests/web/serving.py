"""A league served by uvicorn on a port of its own, from a thread of this process."""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import uvicorn

from league.matchmaking.store import Store
from league.web.app import make_app
from league.web.security import Access, Limit, Limits

FREE = Limits(*(Limit(1e6, 1e6) for _ in range(5)))
"""No limits, for tests of other things."""


@contextmanager
def serving(store: Store, access: Access | None = None) -> Iterator[str]:
    """Serve a league; yield its address."""
    app = make_app(store, access=access or Access(limits=FREE))
    with socket.socket(proto=socket.IPPROTO_TCP) as listener:
        listener.bind(("127.0.0.1", 0))
        listener.listen()
        config = uvicorn.Config(app, log_level="warning", lifespan="off")
        server = uvicorn.Server(config)
        thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
        thread.start()
        try:
            while not server.started:
                assert thread.is_alive()
                time.sleep(0.01)
            yield f"http://127.0.0.1:{listener.getsockname()[1]}"
        finally:
            server.should_exit = True
            thread.join()
