"""What every test can ask for by name; every fixture is a factory."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator

import pytest

from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.sim.config import SimConfig
from league.track.track import TrackSet
from tests.scenes import assert_same, make_ring, make_straight

# Imports make a million objects that stay: looking through them is a sixth of the collection.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture
def ring() -> Callable[..., TrackSet]:
    """Return a factory of TrackSets of one ring of 12 m."""
    return lambda **settings: TrackSet(make_ring(**settings))


@pytest.fixture
def straight() -> Callable[..., TrackSet]:
    """Return a factory of TrackSets of one open straight of 10 m."""
    return lambda **settings: TrackSet(make_straight(**settings))


@pytest.fixture
def race_env() -> Iterator[Callable[..., RaceEnv]]:
    """Return a factory of RaceEnvs on the ring (or `tracks`), closed after the test."""
    made: list[RaceEnv] = []

    def build(
        *,
        tracks: TrackSet | None = None,
        num_worlds: int = 1,
        seed: int = 0,
        sim: SimConfig | None = None,
        **settings: object,
    ) -> RaceEnv:
        env = RaceEnv(
            tracks or TrackSet(make_ring()),
            EnvConfig(sim=sim or SimConfig(), **settings),  # pyright: ignore[reportArgumentType]
            num_worlds=num_worlds,
            seed=seed,
        )
        made.append(env)
        return env

    yield build
    for env in made:
        env.close()


@pytest.fixture
def same() -> Callable[[object, object], None]:
    """Return a check that two records are equal to the last bit."""
    return assert_same


@pytest.fixture
def league(monkeypatch, tmp_path, capsys) -> Callable[..., tuple[int, str, str]]:
    """Return a call of the command line in an empty folder: exit code, what it said, complaints."""
    from league import cli

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")

    def call(*arguments: str) -> tuple[int, str, str]:
        try:
            code = cli.main(list(arguments))
        except SystemExit as stop:
            code = int(stop.code or 0)
        said = capsys.readouterr()
        return code, said.out, said.err

    return call
