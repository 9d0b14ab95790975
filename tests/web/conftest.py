"""A small league with all races over, and its pages."""

import threading
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from league.matchmaking.store import Store
from league.web import answers, reader
from league.web.app import make_app
from league.web.routes import Page
from tests.web.small_league import ORIGIN, raced_league


@pytest.fixture(autouse=True)
def _nothing_is_kept(monkeypatch):
    """Let every request see what a test has changed a moment ago."""
    monkeypatch.setattr(answers, "MOST", 0)
    monkeypatch.setattr(reader, "COUNTS_REST", 0.0)


@pytest.fixture(scope="session")
def store(tmp_path_factory) -> Iterator[Store]:
    folder = tmp_path_factory.mktemp("league")
    with raced_league(f"sqlite:///{folder / 'league.db'}") as store:
        yield store


@pytest.fixture(scope="session")
def client(store) -> Iterator[TestClient]:
    with TestClient(make_app(store), base_url=ORIGIN) as client:
        yield client


@pytest.fixture
def making(monkeypatch):
    """Keep answers; return a switch that must be on for pages to be made, and what was made."""
    may, made, read = threading.Event(), [], Page.read
    may.set()

    def waiting(self, *asked):
        made.append(self.path)
        assert may.wait(60)
        return read(self, *asked)

    monkeypatch.setattr(Page, "read", waiting)
    monkeypatch.setattr(answers, "MOST", 8)
    monkeypatch.setattr(answers, "FRESH_S", 0.0)
    return may, made
