"""How fast a large league's pages are: 10,000 entries, 1,000,000 races, and a season that goes on.

Times of single pages are processor time, because the machine is shared; the league's server runs
as a process of its own, and so does the season, which adds ten heats in a second.
"""

import gzip
import http.client
import json
import multiprocessing
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from starlette.testclient import TestClient

from benchmarks import web_browser, web_scene
from benchmarks.report import figure, heading, note, table
from league.matchmaking.store import RaceOutcome, Store
from league.matchmaking.workers.worker import outcome_of
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.racing.race import FinishedRace
from league.web.app import make_app

ENTRIES, HEATS = 10_000, 500_000
HEATS_A_SECOND = 10.0
"""Of the season that goes on."""
NEW_HEATS = 25
"""That come in before the standings are asked for again."""
REQUESTS, THREADS = 40_000, 8
GOAL_RATE, GOAL_P99_MS = 300.0, 150.0
GOAL_PAGE_KB, GOAL_REPLAY_KB = 200.0, 60.0
GOAL_WARM_MS, GOAL_NEW_MS = 50.0, 200.0
ORIGIN = "http://127.0.0.1"
PAGES = (
    "/", "/standings?sort=wins", "/standings?page={page}", "/standings?against=77", "/drivers/77",
    "/matchups/{one}/{other}", "/heats", "/heats/{heat}", "/tracks", "/live", "/ghosts",
    "/feed.atom", "/time-attack", "/seasons", "/seasons/1", "/cups/1", "/definitions", "/submit",
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
def served(url: str) -> Generator[tuple[int, int]]:
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


def ask(port: int, paths: list[str], count: int, took_ms: list[float]) -> bytes:
    """Ask for so many pages one after the other over one connection; return the last one."""
    connection, content = http.client.HTTPConnection("127.0.0.1", port, timeout=300), b""
    for number in range(count):
        start = time.perf_counter()
        connection.request("GET", paths[number % len(paths)], headers={"Accept-Encoding": "gzip"})
        answer = connection.getresponse()
        content = answer.read()
        assert answer.status == 200, paths[number % len(paths)]
        took_ms.append(1000 * (time.perf_counter() - start))
    return content


def single_pages(league: Store, names: dict[str, int]) -> None:
    """Print how long each page takes when it is made, and how large it is."""
    with TestClient(make_app(league), base_url=ORIGIN) as client:
        start, worked = time.perf_counter(), time.process_time()
        client.get("/standings")
        figure("the first standings after the start, processor time", time.process_time() - worked,
               "s")  # fmt: skip
        figure("the same, wall time", time.perf_counter() - start, "s")
        row = table("page", "made, processor time [ms]", "size [kB]", "sent [kB]")
        largest = max(_made(client, path, path.format(**names), row) for path in PAGES)
        note("Pages are made by the application itself, without a server or a network between.")
        figure("the largest page", largest, "kB", GOAL_PAGE_KB, most=True)
        warm = [_answered(client, "/standings") for _ in range(200)]
        worked_ms, took_ms = 1e3 * np.median(warm, axis=0)
        figure("/standings when warm, processor time", worked_ms, "ms", GOAL_WARM_MS, most=True)
        figure("the same, wall time", took_ms, "ms", GOAL_WARM_MS, most=True)
        for what in ("heat", "eight"):
            replay = client.get(f"/api/v1/heats/{names[what]}/races/1/replay")
            assert len(replay.json()["cars"]) == (8 if what == "eight" else 2)
            size = int(replay.headers["content-length"]) / 1e3
            cars = "eight cars, four laps" if what == "eight" else "two cars, three laps"
            figure(f"a replay of {cars}, in one request", size, "kB", GOAL_REPLAY_KB, most=True)


def _made(client: TestClient, path: str, address: str, row: Callable[..., None]) -> float:
    """Print what it takes to make a page; return its size [kB]."""
    worked = time.process_time()
    answer = client.get(address)
    worked = time.process_time() - worked
    assert answer.status_code == 200, address
    size, sent = len(answer.content) / 1e3, int(answer.headers["content-length"]) / 1e3
    name = re.sub(r"\{\w+\}|\d+", "N", path)
    row(f"`{name}`", f"{1e3 * worked:.0f}", f"{size:.1f}", f"{sent:.1f}")
    return size


def _answered(client: TestClient, address: str) -> tuple[float, float]:
    """Return the processor time of an answer and its wall time [s]."""
    worked, start = time.process_time(), time.perf_counter()
    assert client.get(address).status_code == 200
    return time.process_time() - worked, time.perf_counter() - start


def _after_new_results(url: str, outcome: RaceOutcome, port: int, pid: int) -> None:
    """Print the slowest answer in the time in which new results come in and are rated."""

    def races() -> int:
        return json.loads(gzip.decompress(ask(port, ["/api/v1/standings"], 1, [])))["races"]

    before = races()
    with Store(url) as league:
        for draw in range(NEW_HEATS):
            web_scene.race_heat(league, outcome, 10**6 + draw)
    start, worked, took_ms = time.monotonic(), processor_s(pid), []
    while races() == before and time.monotonic() - start < 300:
        ask(port, ["/standings"], 1, took_ms)
        time.sleep(0.05)
    assert races() > before, "new results did not show"
    figure("slowest answer while new results are rated, wall time", max(took_ms), "ms",
           GOAL_NEW_MS, most=True)  # fmt: skip
    figure("99 % of these answers within", float(np.percentile(took_ms, 99)), "ms")
    figure("new results show after, wall time", time.monotonic() - start, "s")
    figure("the server's processor time until then", processor_s(pid) - worked, "s")


def load(url: str, outcome: RaceOutcome, names: dict[str, int]) -> None:
    """Print what requests cost a server when nothing happens, and while a season runs."""
    with served(url) as (port, pid):
        paths = [path.format(**names) for path in ASKED]
        ask(port, paths, len(paths), [])  # the first snapshot, and each page once
        seen = {"home": "/", "standings": "/standings", "a heat": f"/heats/{names['heat']}"}
        web_browser.measure(f"http://127.0.0.1:{port}", seen, f"/heats/{names['eight']}")
        cost, _, _ = _visited(port, pid, paths)
        figure("a kept page from the server, processor time", cost, "ms", 1e3 / GOAL_RATE,
               most=True)  # fmt: skip
        _after_new_results(url, outcome, port, pid)
        with _season(url, outcome):
            cost, rate, p99_ms = _visited(port, pid, paths)
    figure("the same while a season runs, with all that has to be made again", cost, "ms",
           1e3 / GOAL_RATE, most=True)  # fmt: skip
    figure("requests answered while a season runs", rate, "1/s", GOAL_RATE)
    figure("99 % of them within", p99_ms, "ms", GOAL_P99_MS, most=True)
    note(
        f"{REQUESTS:,} requests by {THREADS} visitors at a time, and a season of "
        f"{HEATS_A_SECOND:g} heats in a second, share the machine's {os.cpu_count()} cores with "
        "the server, which is one process."
    )


def busy() -> None:
    """Say how busy other programs keep the machine, which makes all wall times longer."""
    start, worked = time.perf_counter(), time.process_time()
    while time.process_time() - worked < 1.0:
        pass
    note(
        f"Other programs run meanwhile: {os.getloadavg()[0]:.1f} wanted a processor in the last "
        f"minute, and work of 1 s took {time.perf_counter() - start:.1f} s."
    )


@contextmanager
def _season(url: str, outcome: RaceOutcome) -> Generator[None]:
    """Let a season go on in a process of its own."""
    context = multiprocessing.get_context("spawn")
    stop = context.Event()
    asked = url, outcome, HEATS_A_SECOND, stop, 2 * 10**6
    season = context.Process(target=web_scene.race_on, args=asked, daemon=True)
    with Store(url) as league:
        before = league.counts()["done"]
        season.start()
        while league.counts()["done"] == before:
            assert season.is_alive()
            time.sleep(0.05)
    try:
        yield
    finally:
        stop.set()
        season.join()


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


def main() -> None:
    """Print the figures."""
    heading("The league in the browser")
    entries = (Entry(name="racing_line"), Entry(name="cautious"))
    outcome = outcome_of(race.run(RaceSpec(entries=entries, solver="planar")))
    eight = outcome_of(eight_cars())
    with tempfile.TemporaryDirectory() as folder:
        url = f"sqlite:///{Path(folder) / 'league.db'}"
        strengths = np.random.default_rng(5).normal(0, 200, ENTRIES)
        start = time.process_time()
        with web_scene.founded(url, strengths, HEATS, outcome) as league:
            figure("the league is written, processor time", time.process_time() - start, "s")
            heat = HEATS - 5
            one, other = (league.entry(id).number for id in league.heat(heat).heat.entries)
            names = {"page": ENTRIES // 200, "heat": heat, "one": one, "other": other}
            names["eight"] = web_scene.race_cup_heat(league, eight)
            single_pages(league, names)
        busy()
        load(url, outcome, names)
        busy()


if __name__ == "__main__":
    main()
