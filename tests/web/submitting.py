"""Submitting over HTTP: what is sent, from which owner, and to which server."""

from __future__ import annotations

from starlette.testclient import TestClient

from league.agents.network import NetworkConfig
from league.matchmaking import submission
from league.matchmaking.store import Store
from league.web.app import make_app
from league.web.security import Access
from tests.agents.trained import make_checkpoint
from tests.web.serving import FREE
from tests.web.small_league import ORIGIN

ENTRIES = "/api/v1/entries"
SAME = {"sec-fetch-site": "same-origin"}


def packed(seed: int = 0) -> bytes:
    return submission.pack(make_checkpoint("lidar", network=NetworkConfig(hidden=(8,)), seed=seed))


SOUND = packed()


def served(store: Store, **access) -> TestClient:
    return TestClient(make_app(store, access=Access(**{"limits": FREE, **access})), base_url=ORIGIN)


def token(store: Store, owner: str = "ann", *scopes: str) -> dict[str, str]:
    secret, _ = store.tokens.create(owner, scopes or ("submit",))
    return {"authorization": f"Bearer {secret}"}


def secret(store: Store) -> str:
    return store.tokens.create("ann", ("submit",))[0]
