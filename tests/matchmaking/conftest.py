"""A league's address in SQLite and in PostgreSQL: every test of the store runs on both."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator

import pytest

from league.matchmaking.store import Store
from tests.matchmaking import leagues, postgres


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[postgres.Server]:
    """Return a scratch server; LEAGUE_NEEDS_POSTGRES=1 makes its absence a failure."""
    if postgres.binaries() is None:
        assert os.environ.get("LEAGUE_NEEDS_POSTGRES") != "1", "PostgreSQL is not installed"
        pytest.skip("PostgreSQL is not installed: apt-get install postgresql")
    with postgres.server() as server:
        yield server


@pytest.fixture
def new_postgres(postgres_server: postgres.Server) -> Iterator[Callable[[], str]]:
    """Return a factory of addresses of empty databases, which are gone after the test."""
    made: list[str] = []

    def database() -> str:
        made.append(postgres_server.database())
        return made[-1]

    yield database
    for url in made:
        postgres_server.drop(url)


@pytest.fixture(params=["sqlite", "postgresql"])
def url(request: pytest.FixtureRequest, tmp_path) -> str:
    """Return the address of a place for a league, where there is none yet."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'league.db'}"
    return request.getfixturevalue("new_postgres")()


@pytest.fixture
def clock() -> leagues.Clock:
    """Return a clock that a test sets."""
    return leagues.Clock()


@pytest.fixture
def league(url: str, clock: leagues.Clock) -> Iterator[Store]:
    """Return a league by that clock."""
    with leagues.founded(url, clock=clock) as league:
        yield league
