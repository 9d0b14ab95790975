"""Many at once, killed, cut off, out of room: nothing is lost, nothing counted twice."""

from __future__ import annotations

import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor

import pytest

from league.errors import StoreError
from league.matchmaking import store
from league.matchmaking.store import database
from league.subprocesses import CONTEXT, prepare
from tests.matchmaking import leagues


@pytest.fixture(autouse=True, scope="module")
def prepared():
    prepare(["league.matchmaking.store"])


def _killed_while_holding(url, worker):
    """Claim heats, then die without a word."""
    store.Store(url).claim(worker, 5, lease_s=1.0)
    os.kill(os.getpid(), signal.SIGKILL)


def test_four_processes_never_get_the_same_heat(url):
    with leagues.founded(url) as league:
        heats = leagues.duels(league, 120)
        league.plan(heats)
        with ProcessPoolExecutor(4, mp_context=CONTEXT) as pool:
            jobs = [pool.submit(leagues.work, url, f"w{n}", 3, 0.002) for n in range(4)]
            shares = [job.result(timeout=120) for job in jobs]
        claimed = [key for share in shares for key in share]
        assert len(claimed) == len(set(claimed)) == 120
        assert league.counts() == {"done": 120}
        assert len(league.races().heat) == 240
        assert all(record.attempts == 1 for record in league.heats())


def test_threads_share_a_store(url):
    with leagues.founded(url) as league:
        league.plan(leagues.duels(league, 60))
        claimed = []

        def work(name):
            while claims := league.claim(name, 2):
                claimed.extend(claim.heat.key for claim in claims)
                league.complete(name, leagues.raced(claims))

        threads = [threading.Thread(target=work, args=(f"t{n}",)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(claimed) == len(set(claimed)) == 60
        assert league.counts() == {"done": 60}


def test_heats_of_a_killed_worker_are_raced_by_another(url):
    with leagues.founded(url) as league:
        league.plan(leagues.duels(league, 12))
        process = CONTEXT.Process(target=_killed_while_holding, args=(url, "doomed"))
        process.start()
        process.join(60)
        assert process.exitcode == -signal.SIGKILL
        assert league.counts() == {"claimed": 5, "planned": 7}
        give_up = time.monotonic() + 30
        while league.counts().get("done") != 12 and time.monotonic() < give_up:
            league.complete("heir", leagues.raced(league.claim("heir", 12)))
            time.sleep(0.1)
        assert league.counts() == {"done": 12}
        assert len(league.races().heat) == 24


def test_two_workers_that_send_the_same_heat_at_once_count_it_once(url):
    with leagues.founded(url) as league:
        league.plan(leagues.duels(league, 20))
        outcomes = leagues.raced(league.claim("w", 20))
        start, received = threading.Barrier(4), []

        def send(name):
            start.wait()
            received.extend(league.complete(name, [outcome]) for outcome in outcomes)

        threads = [threading.Thread(target=send, args=(f"t{n}",)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert sum(len(one.accepted) for one in received) == 20
        assert sum(len(one.repeated) for one in received) == 60
        assert len(league.races().heat) == 40


def test_a_store_is_not_used_across_a_fork(tmp_path):
    # In a process of its own: forking one with threads, as pytest's may be, is a hazard.
    program = (
        "import os, sys\n"
        "from tests.matchmaking import leagues\n"
        "league = leagues.founded(sys.argv[1], entries=0)\n"
        "if os.fork() == 0:\n"
        "    try: league.counts()\n"
        "    except Exception as refusal: print(refusal, flush=True)\n"
        "    os._exit(0)\n"
        "os.wait()\n"
        "print(league.counts())\n"
    )
    printed = _run(program, str(tmp_path / "league.db"))
    assert "open the league again in each process" in printed
    assert printed.endswith("{}\n")


WRITER = """
import sys
from tests.matchmaking import leagues
from league.matchmaking import store
with store.Store(sys.argv[1]) as league:
    print("begun", flush=True)
    while claims := league.claim("w", 2):
        league.complete("w", leagues.raced(claims))
        print(*(claim.heat.key for claim in claims), flush=True)
"""


@pytest.mark.parametrize("torn", [False, True], ids=["whole", "torn"])
def test_power_cut_at_any_moment_leaves_a_league_that_goes_on(tmp_path, torn):
    """The writer is stopped, its file and WAL are copied, and the copy is opened as after a crash.

    Torn: the end of the WAL did not reach the disk, as when the power fails within a write.
    """
    path, copies = tmp_path / "league.db", random.Random(1)
    with leagues.founded(str(path)) as league:
        league.plan(leagues.duels(league, 1_000))
    writer = _start(WRITER, str(path))
    try:
        assert writer.stdout is not None
        lines = [writer.stdout.readline()]
        for number in range(12):
            time.sleep(copies.uniform(0.005, 0.05))
            writer.send_signal(signal.SIGSTOP)
            _wait_until_stopped(writer.pid)
            lines += _lines_so_far(writer)
            copy = tmp_path / f"copy{number}" / "league.db"
            copy.parent.mkdir()
            for end in ("", "-wal"):
                if (tmp_path / f"league.db{end}").exists():
                    shutil.copy(f"{path}{end}", f"{copy}{end}")
            writer.send_signal(signal.SIGCONT)
            wal = copy.with_name("league.db-wal")
            if torn and wal.exists():
                length = wal.stat().st_size
                os.truncate(wal, max(0, length - copies.randrange(1, 5000)))
            acknowledged = {key for line in lines[1:] for key in line.split()}
            _goes_on(copy, set() if torn else acknowledged)
            if writer.poll() is not None:
                break  # all is raced: later copies would be the same
        assert acknowledged, "the writer got nothing done before the last copy"
    finally:
        writer.kill()
        writer.communicate()


def _goes_on(copy, acknowledged):
    with sqlite3.connect(copy) as raw:
        assert raw.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
        assert raw.execute("PRAGMA foreign_key_check").fetchall() == []
    raw.close()
    with store.Store(str(copy)) as league:
        done = league.heats(["done"])
        assert acknowledged <= {record.heat.key for record in done}
        assert len(league.races().heat) == 2 * len(done)  # whole heats or none
        claims = league.claim("after", 3)  # none, where a fast writer has raced them all
        assert len(league.complete("after", leagues.raced(claims)).accepted) == len(claims)
        assert len(league.races().heat) == 2 * len(done) + 2 * len(claims)


def test_a_full_database_is_reported_and_nothing_of_the_call_is_kept(tmp_path):
    path = tmp_path / "league.db"
    with leagues.founded(str(path)) as league:
        league.plan(leagues.duels(league, 50))
        claims = league.claim("w", 50)
        engine = league._database._engine
        with engine.connect() as connection:
            pages = connection.exec_driver_sql("PRAGMA page_count").scalar_one()
        engine.dispose()

        def small(raw, _):
            raw.execute(f"PRAGMA max_page_count = {pages + 2}")

        leagues_event = store.store.sa.event
        leagues_event.listen(engine, "connect", small)
        before = league.counts(), len(leagues.events(league))
        with pytest.raises(StoreError, match=r"league\.db cannot grow, the disk is full: free"):
            league.complete("w", _bulky(claims))
        assert (league.counts(), len(leagues.events(league))) == before
        assert len(league.races().heat) == 0
        leagues_event.remove(engine, "connect", small)
        engine.dispose()
        assert len(league.complete("w", _bulky(claims)).accepted) == 50
    _sound(path)


def test_a_disk_that_takes_no_more_bytes_corrupts_nothing(tmp_path):
    """RLIMIT_FSIZE stands for the disk: writes beyond it fail in the middle of a transaction."""
    path = tmp_path / "league.db"
    with leagues.founded(str(path)) as league:
        league.plan(leagues.duels(league, 200))
    printed = _run(
        "import resource, signal, sys, leagues\n"
        "from league.errors import StoreError\n"
        "from league.matchmaking import store\n"
        "signal.signal(signal.SIGXFSZ, signal.SIG_IGN)\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (400_000, resource.RLIM_INFINITY))\n"
        "league = store.Store(sys.argv[1])\n"
        "try:\n"
        "    while claims := league.claim('w', 10):\n"
        "        league.complete('w', leagues.raced(claims))\n"
        "except StoreError as refusal:\n"
        "    print(refusal)\n"
        "    print(league.counts().get('done', 0))\n",
        str(path),
    )
    sentence, done = printed.splitlines()
    assert "check the disk and its free space; nothing was changed" in sentence
    _sound(path)
    with store.Store(str(path)) as league:
        assert league.counts().get("done", 0) == int(done)
        assert len(league.races().heat) == 2 * int(done)


@pytest.fixture
def tiny_disk(tmp_path):
    """Return a folder with room for 1 MB."""
    place = tmp_path / "tiny"
    place.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", place], capture_output=True
    )
    if mounted.returncode:
        pytest.skip("a small disk cannot be mounted here: that needs root")
    yield place
    subprocess.run(["umount", place], check=True)


def test_a_disk_without_room_is_reported_and_the_league_goes_on_when_there_is_some(tiny_disk):
    (tiny_disk / "ballast").write_bytes(b"x" * 300_000)
    path = tiny_disk / "league.db"
    with leagues.founded(str(path)) as league:
        league.plan(leagues.duels(league, 40))
        claims = league.claim("w", 40)
        with pytest.raises(StoreError, match="the disk is full: free some space"):
            league.complete("w", _bulky(claims, 10_000))
        assert league.counts() == {"claimed": 40}
        (tiny_disk / "ballast").unlink()
        assert len(league.complete("w", leagues.raced(claims)).accepted) == 40
    _sound(path)


def test_a_database_that_does_not_exist_is_reported_in_a_sentence(postgres_server):
    with pytest.raises(StoreError, match="names a database that does not exist: make it with"):
        store.create(postgres_server.url("nobody_made_this"))


@pytest.mark.parametrize(
    ("said", "sentence"),
    [
        ('FATAL:  database "a" does not exist', "does not exist: make it"),
        ('FATAL:  permission denied for database "a"', "refuses this user"),
        ('FATAL:  too many connections for database "a"', "has no free connections"),
        ('FATAL:  too many connections for role "bob"', "has no free connections"),
        ("FATAL:  remaining connection slots are reserved for roles", "has no free connections"),
        ('FATAL:  role "bob" does not exist', "refused the user"),
        ("FATAL:  the database system is starting up", "is starting or recovering"),
        ('FATAL:  database "a" is not currently accepting connections', "cannot be reached"),
    ],
)
def test_a_refused_connection_is_explained_by_its_cause(said, sentence):
    assert sentence in database._sentence(ConnectionError(f"connection failed: {said}"))


def _bulky(claims, size=2000):
    """Return results that take room: noise does not deflate."""
    noise = random.Random(5)
    return [
        store.HeatOutcome(
            claim.heat.key,
            tuple(store.RaceOutcome((1, 2), {}, noise.randbytes(size)) for _ in claim.seeds),
        )
        for claim in claims
    ]


def _sound(path):
    with sqlite3.connect(path) as raw:
        assert raw.execute("PRAGMA integrity_check").fetchall() == [("ok",)]
    raw.close()


def _start(program, *arguments):
    path = os.pathsep.join(filter(None, sys.path))
    return subprocess.Popen(
        [sys.executable, "-c", program, *arguments],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
    )


def _run(program, *arguments):
    running = _start(program, *arguments)
    printed, _ = running.communicate(timeout=120)
    assert running.returncode == 0
    return printed


def _wait_until_stopped(pid):
    while True:
        try:
            with open(f"/proc/{pid}/stat", encoding="utf-8") as stat:
                state = stat.read().rsplit(")", 1)[1].split()[0]
        except FileNotFoundError:
            return  # on a fast machine it has written all there was
        if state in "TtZX":
            return
        time.sleep(0.001)


def _lines_so_far(writer):
    """Return what the stopped writer has printed: no more is coming."""
    os.set_blocking(writer.stdout.fileno(), False)
    return list(writer.stdout)
