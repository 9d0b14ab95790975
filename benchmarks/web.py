"""How fast a large league's pages are: 10,000 entries, 1,000,000 races, and a season that goes on.

Times of single pages are processor time, because the machine is shared. The league's server runs on
one core. On the other one `league run` races the season, and visitors ask at a steady rate.
"""

import gzip
import http.client
import itertools
import json
import os
import re
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Generator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from starlette.testclient import TestClient

from benchmarks import web_browser, web_scene
from benchmarks.report import figure, heading, note, table
from league.matchmaking.store import RaceOutcome, Store
from league.matchmaking.workers.worker import race_outcome
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.racing.race import FinishedRace
from league.replay import format as replay_format
from league.web.app import make_app

ENTRIES, HEATS = 10_000, 500_000
NEW_HEATS = 25
"""That come in before the standings are asked for again."""
RATE, VISIT_S, VISITORS = 310.0, 40.0, 24
"""Requests in a second, for how long [s], and how many connections they come over."""
FIRST_S = 10.0
"""Until then [s] most pages are asked for the first time."""
STARTS_S = 900.0
"""A season has a result by then [s]: first it rates all entries, and pairs a round of them."""
SERVER_CORE, OTHER_CORE = min(os.sched_getaffinity(0)), max(os.sched_getaffinity(0))
GOAL_RATE, GOAL_P99_MS = 300.0, 150.0
GOAL_PAGE_KB, GOAL_REPLAY_KB = 200.0, 60.0
GOAL_WARM_MS, GOAL_NEW_MS = 50.0, 200.0
ORIGIN = "http://127.0.0.1"
PAGES = (
    "/", "/standings?sort=wins", "/standings?page={page}", "/standings?against=77", "/drivers/77",
    "/matchups/{one}/{other}", "/heats", "/heats/{heat}", "/tracks", "/live", "/ghosts",
    "/feed.atom", "/time-attack", "/seasons", "/seasons/1", "/cups/1", "/definitions", "/submit",
)  # fmt: skip
MIX = {
    "/": 12, "/standings": 12, "/standings?page={page}": 8, "/standings?sort={sort}": 4,
    "/standings?owner=owner {driver}": 4, "/standings?against={driver}": 2,
    "/standings?track={track}": 1, "/drivers/{driver}": 20, "/matchups/{driver}/{other}": 8,
    "/heats": 4, "/heats?page={page}": 4, "/heats/{heat}": 8, "/tracks": 3, "/live": 2,
    "/time-attack": 1, "/api/v1/standings?page={page}": 4, "/api/v1/drivers/{driver}": 2,
    "/api/v1/heats/{heat}/races/1/replay": 1,
}  # fmt: skip
"""What visitors ask for, and how often of a hundred times."""
DRIVERS = 200
"""Drivers that are looked at."""


def eight_cars() -> FinishedRace:
    """Return a recorded race of eight cars of about a minute."""
    names = ("racing_line", "cautious", "blocker", "duelist") * 2
    entries = tuple(Entry(name=name) for name in names)
    return race.run(RaceSpec(entries=entries, laps=4, solver="planar"))


def recorded(finished: FinishedRace) -> RaceOutcome:
    """Return a race as a league keeps it."""
    assert finished.replay is not None
    return race_outcome(finished.replay, replay_format.encode(finished.replay))


def processor_s(pid: int) -> float:
    """Return the processor time that a process has taken [s]."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextmanager
def served(url: str) -> Generator[tuple[int, int]]:
    """Serve a league; yield the port and the process."""
    command = [sys.executable, "-m", "league.cli", "serve", "--league", url, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        os.sched_setaffinity(process.pid, {SERVER_CORE})  # its threads begin later, and inherit it
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
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {OTHER_CORE})
    try:
        _load(url, outcome, names)
    finally:
        os.sched_setaffinity(0, cores)  # for the benchmarks that follow


def _load(url: str, outcome: RaceOutcome, names: dict[str, int]) -> None:
    with served(url) as (port, pid):
        ask(port, ["/", "/standings", f"/heats/{names['heat']}"], 3, [])  # the first snapshot
        seen = {"home": "/", "standings": "/standings", "a heat": f"/heats/{names['heat']}"}
        web_browser.measure(f"http://127.0.0.1:{port}", seen, f"/heats/{names['eight']}")
        kept = visited(port, pid, ["/", "/standings", "/heats"])
        figure("a kept page from the server, processor time", kept.cost_ms, "ms", 1e3 / GOAL_RATE,
               most=True)  # fmt: skip
        _after_new_results(url, outcome, port, pid)
        with _season(url) as season_pid, Store(url) as league:
            done, worked = league.counts()["done"], tree_s(season_pid)
            found = visited(port, pid, addresses())
            done, worked = league.counts()["done"] - done, tree_s(season_pid) - worked
    figure("while a season runs: requests answered", found.rate, "1/s", GOAL_RATE)
    figure("while a season runs: 99 % of them within", found.p99_ms, "ms", GOAL_P99_MS, most=True)
    figure(
        f"while a season runs: 99 % within, the first {FIRST_S:g} s left out", found.later_ms, "ms"
    )
    figure("while a season runs: half of them within", found.p50_ms, "ms")
    figure("while a season runs: a request, the server's processor time", found.cost_ms, "ms",
           1e3 / GOAL_RATE, most=True)  # fmt: skip
    figure("while a season runs: the server's share of its core", 100 * found.share, "%")
    figure("while a season runs: the visitors' share of the other core", 100 * found.own, "%")
    figure("while a season runs: the season's share of it", 100 * worked / found.taken_s, "%")
    figure("while a season runs: heats that came in", done / found.taken_s, "1/s")
    note(
        f"The server is one process on core {SERVER_CORE}; `league run --workers 1` races policies "
        f"with cameras in planar physics on core {OTHER_CORE}, which it shares with the visitors: "
        f"{VISITORS} connections that ask {RATE:g} times a second, {VISIT_S:g} s long, for "
        f"{len(MIX)} kinds of pages and {DRIVERS} drivers. Times count from when a request is due, "
        "so one that waits for the answer before counts in full."
    )


def addresses() -> list[str]:
    """Return what visitors ask for, in the order in which they do."""
    generator = np.random.default_rng(7)
    weights = np.array(list(MIX.values()), float)
    drawn = generator.choice(list(MIX), size=int(RATE * VISIT_S), p=weights / weights.sum())

    def number(most: int) -> int:
        return int(generator.integers(1, most + 1))

    return [
        address.format(
            driver=number(DRIVERS),
            other=DRIVERS + number(DRIVERS),
            page=number(10),
            heat=HEATS - number(100),
            sort=generator.choice(["wins", "races", "lap", "name"]),
            track=web_scene.RULES.tracks[0],
        ).replace(" ", "%20")
        for address in drawn.tolist()
    ]


def busy() -> None:
    """Say how busy other programs keep the machine, which makes all wall times longer."""
    start, worked = time.perf_counter(), time.process_time()
    while time.process_time() - worked < 1.0:
        pass
    note(
        f"Other programs run meanwhile: {os.getloadavg()[0]:.1f} wanted a processor in the last "
        f"minute, and work of 1 s took {time.perf_counter() - start:.1f} s."
    )


def tree_s(pid: int) -> float:
    """Return the processor time that a process and those that it started have taken [s]."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
        return processor_s(pid) + sum(map(tree_s, map(int, children)))
    except OSError:  # it has ended
        return 0.0


@contextmanager
def _season(url: str) -> Generator[int]:
    """Let a season go on, on the other core; yield its process once it has a result."""
    command = [sys.executable, "-m", "league.cli", "run", "--league", url, "--workers", "1"]
    with (
        Store(url) as league,
        subprocess.Popen([*command, "--plain"], stdout=subprocess.DEVNULL) as season,
    ):
        os.sched_setaffinity(season.pid, {OTHER_CORE})
        before, start = league.counts()["done"], time.monotonic()
        try:
            while league.counts()["done"] == before:
                assert season.poll() is None and time.monotonic() < start + STARTS_S
                time.sleep(0.5)
            yield season.pid
        finally:
            season.send_signal(2)


@dataclass(frozen=True)
class Visit:
    """What a crowd of visitors found."""

    cost_ms: float
    """The server's processor time for a request."""
    rate: float
    """Requests answered in a second."""
    p50_ms: float
    p99_ms: float
    later_ms: float
    """The same of the requests after `FIRST_S`."""
    share: float
    """The server's processor time in that time."""
    own: float
    """The visitors' own."""
    taken_s: float


def visited(port: int, pid: int, paths: list[str]) -> Visit:
    """Ask for pages at a steady rate, over some connections."""
    took: list[tuple[float, float]] = []  # when a request was due [s], and how long it took [ms]
    due = itertools.count()
    start = time.monotonic()

    def ask_on(visitor: int) -> None:
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=300)
        # As from behind a proxy: limits are those of one visitor, not of all together.
        headers = {"Accept-Encoding": "gzip", "X-Forwarded-For": f"10.0.0.{visitor + 1}"}
        while (number := next(due)) < RATE * VISIT_S:
            due_s = start + number / RATE
            time.sleep(max(0.0, due_s - time.monotonic()))
            path = paths[number % len(paths)]
            connection.request("GET", path, headers=headers)
            answer = connection.getresponse()
            answer.read()
            assert answer.status == 200, (path, answer.status)
            took.append((due_s - start, 1000 * (time.monotonic() - due_s)))

    worked, own = processor_s(pid), time.process_time()
    visitors = [threading.Thread(target=ask_on, args=(one,)) for one in range(VISITORS)]
    for visitor in visitors:
        visitor.start()
    for visitor in visitors:
        visitor.join()
    worked, taken_s = processor_s(pid) - worked, time.monotonic() - start
    assert len(took) >= RATE * VISIT_S, "a visitor gave up"
    p50, p99 = np.percentile([one for _, one in took], (50, 99)).tolist()
    later = float(np.percentile([one for due_s, one in took if due_s >= FIRST_S], 99))
    own = (time.process_time() - own) / taken_s
    count, share = len(took), worked / taken_s
    return Visit(1e3 * worked / count, count / taken_s, p50, p99, later, share, own, taken_s)


def main() -> None:
    """Print the figures."""
    heading("The league in the browser")
    entries = (Entry(name="racing_line"), Entry(name="cautious"))
    outcome = recorded(race.run(RaceSpec(entries=entries, solver="planar")))
    eight = recorded(eight_cars())
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
