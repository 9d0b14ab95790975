"""kill -9 of the server under load loses nothing acknowledged; readers never block the writer."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import pytest
import sqlalchemy as sa
from starlette.testclient import TestClient

from league.agents.network import NetworkConfig
from league.errors import StoreError
from league.matchmaking import loop, submission
from league.matchmaking.loop import Dispatcher
from league.matchmaking.remote import Client, RemoteQueue
from league.matchmaking.store import Store, database, schema
from league.web.app import make_app
from league.web.security import Access
from tests.agents.trained import make_checkpoint
from tests.matchmaking import leagues
from tests.matchmaking.season_kit import Here
from tests.web.serving import FREE
from tests.web.small_league import ORIGIN, queued_league


def packed(seed: int) -> bytes:
    network = NetworkConfig(hidden=(8,))
    return submission.pack(make_checkpoint("blind", network=network, seed=seed))


def test_kill_nine_of_the_server_loses_nothing_acknowledged(tmp_path):
    url = f"sqlite:///{tmp_path / 'league.db'}"
    with queued_league(url) as store:
        secrets = [store.tokens.create(f"o{n}", ("submit", "worker"))[0] for n in range(4)]
    command = [sys.executable, "-m", "league.cli", "serve", "--league", url, "--port", "0"]
    entered: list[str] = []
    raced: list[str] = []
    with subprocess.Popen(
        [*command, "--entries", "99", "--per-day", "99"], stdout=subprocess.PIPE, text=True
    ) as server:
        try:
            address = re.search(r"http://\S+/", server.stdout.readline()).group()

            def submit(number: int) -> None:
                client = Client.of(address, secrets[number])
                for turn in range(12):
                    seed = 100 + 12 * number + turn
                    entered.append(client.submit(packed(seed), f"driver {seed}")["id"])

            def work() -> None:
                queue = RemoteQueue(Client.of(address, secrets[3]), folder=tmp_path / "weights")
                loop.run(
                    None,
                    Dispatcher(queue, Here()),
                    None,
                    watch=lambda _, done: raced.extend(one.report.key for one in done),
                )

            def until_killed(job, *arguments) -> None:
                with suppress(StoreError):  # the server is gone
                    job(*arguments)

            with ThreadPoolExecutor() as pool:
                jobs = [pool.submit(until_killed, submit, number) for number in range(3)]
                jobs.append(pool.submit(until_killed, work))
                give_up_s = time.monotonic() + 600
                while (len(entered) < 9 or len(raced) < 2) and time.monotonic() < give_up_s:
                    assert server.poll() is None and not all(job.done() for job in jobs)
                    time.sleep(0.02)
                os.kill(server.pid, signal.SIGKILL)
                for job in jobs:
                    job.result()
        finally:
            server.kill()
    assert len(entered) >= 9 and len(raced) >= 2
    with Store(url) as store:
        known = {entry.id: entry for entry in store.entries()}
        assert set(entered) <= set(known)
        assert all(leagues.keeps(store, known[id].blob) for id in entered)
        assert set(raced) <= {record.heat.key for record in store.heats(("done",))}
        assert store.verify().mismatches == []


@pytest.fixture
def impatient(monkeypatch):
    """Make a writer fail that would have to wait."""
    monkeypatch.setattr(database, "PATIENCE_S", 0.0)


def test_a_reader_never_blocks_the_writer_and_sees_one_state(tmp_path, impatient):
    with queued_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        done = sa.select(sa.func.count()).select_from(schema.results)
        with store._database.reading() as connection:
            assert connection.scalar(done) == 0
            loop.run(store, Dispatcher(store, Here()), None, heats=3)
            assert connection.scalar(done) == 0
        assert len(store.results(*(one.number for one in store.heats()))) == 6


def test_pages_under_load_never_block_the_seasons_writer(tmp_path, impatient):
    with queued_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        app = make_app(store, access=Access(limits=FREE))
        over, answers = threading.Event(), []

        def look(path: str) -> None:
            with TestClient(app, base_url=ORIGIN) as client:
                while not over.is_set():
                    answers.append(client.get(path).status_code)

        paths = ("/api/v1/live", "/api/v1/standings", "/api/v1/drivers/1", "/api/v1/heats/1")
        with ThreadPoolExecutor() as pool:
            looks = [pool.submit(look, path) for path in paths]
            try:
                tally = loop.run(store, Dispatcher(store, Here()), None, heats=7)
            finally:
                over.set()
            for one in looks:
                one.result()
        assert (tally.heats, tally.failures) == (7, 0)
        assert len(answers) > 8 and set(answers) == {200}
