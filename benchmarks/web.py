"""How fast a large league's pages are: 10,000 entries, 1,000,000 races, and a season that goes on.

Times of single pages are processor time, because the machine is shared; the league's server runs
as a process of its own, and so does the season, which adds ten heats in a second.
"""

import gzip
import http.client
import json
import os
import re
import statistics
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from starlette.testclient import TestClient

from benchmarks import web_scene
from benchmarks.report import figure, heading, note
from league.matchmaking.store import RaceOutcome, Store
from league.matchmaking.workers.worker import outcome_of
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.racing.race import FinishedRace
from league.web.app import make_app
from league.web.reader import FRESH_S
from league.web.replay_data import player_data

ENTRIES, HEATS = 10_000, 500_000
HEATS_A_SECOND = 10.0
"""Of the season that goes on."""
REQUESTS, THREADS = 4000, 8
GOAL_RATE, GOAL_P99_MS = 300.0, 150.0
GOAL_PAGE_KB, GOAL_REPLAY_KB = 200.0, 60.0
PAGES = (
    "/", "/standings", "/standings?page={page}", "/standings?against=77", "/drivers/77",
    "/matchups/{one}/{other}", "/heats", "/heats/{heat}", "/tracks", "/live", "/ghosts",
    "/feed.atom",
)  # fmt: skip
ASKED = (
    "/",
    "/standings",
    "/standings?page=2",
    "/heats",
    "/heats/{heat}",
    "/tracks",
    "/drivers/77",
)
"""What visitors ask for, one after the other."""


def eight_cars() -> FinishedRace:
    """Return a recorded race of eight cars of about a minute."""
    names = ("racing_line", "cautious", "blocker", "duelist") * 2
    entries = tuple(Entry(name=name) for name in names)
    return race.run(RaceSpec(entries=entries, laps=4, solver="planar"))


def processor_s(pid: int) -> float:
    """Return the processor time that a process has taken [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def served(url: str) -> Iterator[tuple[int, int]]:
    """Serve a league; yield the port and the process."""
    command = [sys.executable, "-m", "league.cli", "serve", "--league", url, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            found = re.search(r"http://127\.0\.0\.1:(\d+)", process.stdout.readline())
            assert found is not None
            yield int(found.group(1)), process.pid
        finally:
            process.send_signal(2)


def ask(port: int, paths: list[str], count: int, took_ms: list[float]) -> None:
    """Ask for so many pages one after the other over one connection."""
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=60)
    for number in range(count):
        start = time.perf_counter()
        connection.request("GET", paths[number % len(paths)], headers={"Accept-Encoding": "gzip"})
        answer = connection.getresponse()
        answer.read()
        assert answer.status == 200, paths[number % len(paths)]
        took_ms.append(1000 * (time.perf_counter() - start))


def single_pages(league: Store, outcome: RaceOutcome, names: dict[str, int]) -> None:
    """Print how long each page takes when it is made, and how large it is."""
    with TestClient(make_app(league), base_url="http://127.0.0.1") as client:
        start, worked = time.perf_counter(), time.process_time()
        client.get("/standings")
        figure("the first standings after the start, processor time", time.process_time() - worked,
               "s")  # fmt: skip
        figure("the same, wall time", time.perf_counter() - start, "s")
        largest = 0
        for path in PAGES:
            address = path.format(**names)
            worked = time.process_time()
            answer = client.get(address)
            assert answer.status_code == 200, address
            largest = max(largest, len(answer.content))
            what = re.sub(r"\{\w+\}|\d+", "N", path)
            figure(f"{what}: made, processor time", 1e3 * (time.process_time() - worked), "ms")
            figure(f"{what}: size", len(answer.content) / 1e3, "kB", GOAL_PAGE_KB, most=True)
        warm = []
        for _ in range(200):
            worked = time.process_time()
            client.get("/standings")
            warm.append(1e3 * (time.process_time() - worked))
        figure("/standings when warm, processor time", statistics.median(warm), "ms", 50, most=True)
        _after_new_results(league, outcome, client)
        replay = client.get("/api/v1/heats/{heat}/races/1/replay".format(**names))
        size = int(replay.headers["content-length"]) / 1e3
        figure("a replay of two cars, in one request", size, "kB", GOAL_REPLAY_KB, most=True)


def _after_new_results(league: Store, outcome: RaceOutcome, client: TestClient) -> None:
    """Print the slowest answer in the time in which new results come in and are rated."""
    before = client.get("/api/v1/standings").json()["races"]
    stop = threading.Event()
    threading.Timer(0.5, stop.set).start()
    web_scene.race_on(league.url, outcome, 50, stop, draw=10**6)
    time.sleep(FRESH_S)
    slowest, start = 0.0, time.monotonic()
    now = before
    while now == before and time.monotonic() - start < 300:
        worked = time.thread_time(), time.perf_counter()
        now = client.get("/api/v1/standings").json()["races"]
        slowest = max(slowest, time.perf_counter() - worked[1])
        time.sleep(0.05)
    assert now > before, "new results did not show"
    figure("slowest answer while new results are rated, wall time", 1e3 * slowest, "ms", 200,
           most=True)  # fmt: skip
    figure("new results show after", time.monotonic() - start + FRESH_S, "s")


def load(url: str, outcome: RaceOutcome, names: dict[str, int]) -> None:
    """Print what requests cost a server when nothing happens, and while a season runs."""
    with served(url) as (port, pid):
        paths = [path.format(**names) for path in ASKED]
        ask(port, paths, len(paths), [])  # the first snapshot, and each page once
        cost, _, _ = _visited(port, pid, paths)
        figure("a kept page from the server, processor time", cost, "ms", 1e3 / GOAL_RATE,
               most=True)  # fmt: skip
        stop = threading.Event()
        asked = url, outcome, HEATS_A_SECOND, stop, 2 * 10**6
        season = threading.Thread(target=web_scene.race_on, args=asked, daemon=True)
        season.start()
        cost, rate, p99_ms = _visited(port, pid, paths)
        stop.set()
    season.join()
    figure("the same while a season runs, with all that has to be made again", cost, "ms",
           1e3 / GOAL_RATE, most=True)  # fmt: skip
    figure("requests answered while a season runs", rate, "1/s", GOAL_RATE)
    figure("99 % of them within", p99_ms, "ms", GOAL_P99_MS, most=True)
    note(
        f"{REQUESTS:,} requests by {THREADS} visitors at a time. Visitors and season share the "
        "machine with the server."
    )


def _visited(port: int, pid: int, paths: list[str]) -> tuple[float, float, float]:
    """Return the server's processor time for a request [ms], requests in a second, and the 99 %."""
    took_ms: list[float] = []
    worked, start = processor_s(pid), time.monotonic()
    visitors = [
        threading.Thread(target=ask, args=(port, paths, REQUESTS // THREADS, took_ms))
        for _ in range(THREADS)
    ]
    for visitor in visitors:
        visitor.start()
    for visitor in visitors:
        visitor.join()
    worked, taken = processor_s(pid) - worked, time.monotonic() - start
    return 1e3 * worked / len(took_ms), len(took_ms) / taken, float(np.percentile(took_ms, 99))


def eight(finished: FinishedRace) -> None:
    """Print the size of a minute of eight cars, as the player gets it."""
    assert finished.replay is not None
    content = json.dumps(player_data(finished.replay), separators=(",", ":")).encode()
    minutes = finished.result.race_s / 60
    size = len(gzip.compress(content, 5)) / 1e3
    figure("a recorded race of eight cars", size, "kB", GOAL_REPLAY_KB, most=True)
    figure("the same, of one minute", size / minutes, "kB/min")


def main() -> None:
    """Print the figures."""
    heading("The league in the browser")
    entries = (Entry(name="racing_line"), Entry(name="cautious"))
    outcome = outcome_of(race.run(RaceSpec(entries=entries, solver="planar")))
    eight(eight_cars())
    with tempfile.TemporaryDirectory() as folder:
        url = f"sqlite:///{Path(folder) / 'league.db'}"
        strengths = np.random.default_rng(5).normal(0, 200, ENTRIES)
        start = time.process_time()
        with web_scene.founded(url, strengths, HEATS, outcome) as league:
            figure("the league is written, processor time", time.process_time() - start, "s")
            heat = HEATS - 5
            one, other = (league.entry(id).number for id in league.heat(heat).heat.entries)
            names = {"page": ENTRIES // 200, "heat": heat, "one": one, "other": other}
            single_pages(league, outcome, names)
        load(url, outcome, names)


if __name__ == "__main__":
    main()
