"""kill -9 of `league run`, matchmaker included: no heat is lost or counted twice; same ratings."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from collections import Counter
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from league.matchmaking import cups, standings
from league.matchmaking.pairing.matchmaker import ROUND, Matchmaker
from league.matchmaking.store import Store
from tests.matchmaking.season_kit import SHORT, new_league, submitted

LEAGUE = [sys.executable, "-m", "league.cli"]
SETTINGS = ["--lease-s", "3", "--workers", "2", "--plain"]
RULES = replace(SHORT, max_time_s=0.3)
"""Five steps: the shortest race in which cars differ."""
LONG = replace(SHORT, laps=3, max_time_s=20.0)
"""A cup's heat of these takes long enough to be met by a kill."""
ENTRANTS = 8
KILLS = max(3, int(os.environ.get("LEAGUE_KILL_HEATS", "40")) // 100)
"""In each part of a cup at most."""


def made(path: Path) -> None:
    """Make a league in which nothing is planned yet: an anchor and two newcomers."""
    with new_league(f"sqlite:///{path}", rules=RULES) as store:
        for number in range(2):
            submitted(store, f"e{number}", seed=number, senses="blind")


def descendants(pid: int) -> list[int]:
    """Return the processes that a process started, and those that they started."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # no Linux, or it has ended
        return []
    return [one for child in map(int, children) for one in (child, *descendants(child))]


def raced(path: Path, heats: int, dice: random.Random | None, patience_s: float) -> list[str]:
    """Run the season until so many heats are done; return what was killed."""
    environment = {**os.environ, "LEAGUE_URL": f"sqlite:///{path}", "OMP_NUM_THREADS": "1"}
    killed: list[str] = []
    give_up = time.monotonic() + patience_s
    with Store(f"sqlite:///{path}") as store:
        while done(store) < heats:
            run = subprocess.Popen(
                [*LEAGUE, "run", *SETTINGS], env=environment, stdout=subprocess.DEVNULL
            )
            try:
                while run.poll() is None and done(store) < heats:
                    assert time.monotonic() < give_up, f"heats are left: {store.counts()}"
                    if dice is None:
                        time.sleep(0.2)
                    else:
                        most = max(3, heats // 8) if killed else 0
                        killed += strike(store, run, dice, most, give_up)
            finally:
                run.kill()
                run.wait()
    return killed


def strike(
    store: Store, run: subprocess.Popen, dice: random.Random, most: int, give_up: float
) -> list[str]:
    """Wait for some results, then kill the matchmaker or another process, or suspend them all.

    Without results to wait for, the matchmaker is killed as it starts.
    """
    wanted = done(store) + dice.randint(min(1, most), most)
    while run.poll() is None and done(store) < wanted and time.monotonic() < give_up:
        time.sleep(0.05)
    time.sleep(dice.uniform(0.0, 0.4))
    victims, chance = descendants(run.pid), dice.random()
    waiting = "planned" if store.counts().get("planned") else "nothing planned"
    if not most or chance < 0.4:
        run.kill()
        run.wait()
        return [f"the matchmaker, {waiting}"]
    if chance < 0.5:
        send(signal.SIGSTOP, run.pid, *victims)
        time.sleep(4.0)  # longer than the lease
        send(signal.SIGCONT, run.pid, *victims)
        return []
    send(signal.SIGKILL, dice.choice(victims or [run.pid]))
    return [f"a process, {waiting}"]


def send(number: signal.Signals, *pids: int) -> None:
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):  # it may have ended
            os.kill(pid, number)


def done(store: Store) -> int:
    return store.counts().get("done", 0)


def finished(path: Path, rounds: int = 0) -> int:
    """Plan at least so many rounds, race all that is planned, and return the number of rounds."""
    environment = {**os.environ, "LEAGUE_URL": f"sqlite:///{path}", "OMP_NUM_THREADS": "1"}
    with Store(f"sqlite:///{path}") as store:
        while True:
            while store.counts().keys() - {"done"}:
                assert store.counts().keys() <= {"planned", "claimed", "done"}
                limit = ["--heats", str(sum(store.counts().values()) - done(store))]
                subprocess.run(
                    [*LEAGUE, "work", *SETTINGS, *limit],
                    env=environment,
                    stdout=subprocess.DEVNULL,
                    check=True,
                    timeout=600,
                )
            planned = max(record.heat.draw // ROUND for record in store.heats())
            if planned >= rounds:
                return planned
            assert Matchmaker(store).plan()


def outcome(path: Path) -> tuple:
    with Store(f"sqlite:///{path}") as store:
        heats = store.heats()
        hashes = sorted((h.heat.key, [r.hash for r in store.results(h.number)]) for h in heats)
        rows = [(row.number, row.elo, row.sd, row.races) for row in standings.of(store).rows]
        races = store.races(rated=None)
        assert len(set(zip(races.heat, races.half, strict=True))) == len(races.heat)
        return hashes, rows, len(races.heat)


@pytest.mark.slow
def test_kill_nine_loses_nothing_and_counts_nothing_twice(tmp_path):
    heats = int(os.environ.get("LEAGUE_KILL_HEATS", "40"))
    calm, wild = tmp_path / "calm.db", tmp_path / "wild.db"
    made(calm)
    shutil.copy(calm, wild)  # the same secret, so the same seeds
    raced(calm, heats, None, 180.0 + 5.0 * heats)
    killed = raced(wild, heats, random.Random(11), 600.0 + 15.0 * heats)
    assert {kill.split(",")[0] for kill in killed} == {"the matchmaker", "a process"}
    assert {kill.split(", ")[1] for kill in killed} == {"planned", "nothing planned"}
    rounds = max(finished(calm), finished(wild))
    assert finished(calm, rounds) == finished(wild, rounds) == rounds
    undisturbed, disturbed = outcome(calm), outcome(wild)
    assert disturbed == undisturbed and len(undisturbed[0]) >= heats
    print(f"{len(undisturbed[0])} heats, kill -9 of {sorted(killed)}")


def made_cup(path: Path) -> None:
    """Make a league of eight rated entries that begins a cup."""
    with new_league(f"sqlite:///{path}", rules=LONG) as store:
        for number in range(ENTRANTS):
            entry = submitted(store, f"e{number}", seed=number, senses="blind")
            for state in ("validating", "placement"):
                store.move({entry.id: state})
        cups.start(store)


def raced_cup(path: Path, dice: random.Random | None, patience_s: float) -> list[str]:
    """Run the season until its cup is over, again after each kill; return what was killed when."""
    environment = {**os.environ, "LEAGUE_URL": f"sqlite:///{path}", "OMP_NUM_THREADS": "1"}
    killed: list[str] = []
    give_up = time.monotonic() + patience_s
    with Store(f"sqlite:///{path}") as store, closing(sqlite3.connect(path)) as changes:
        while store.cups()[0].ended_s is None:
            run = subprocess.Popen(
                [*LEAGUE, "run", *SETTINGS], env=environment, stdout=subprocess.DEVNULL
            )
            try:
                before = cup_heats(store)
                version = changes.execute("PRAGMA data_version").fetchone()
                while store.cups()[0].ended_s is None:
                    assert time.monotonic() < give_up, f"the cup is not over: {cup_heats(store)}"
                    assert run.poll() is None or killed
                    if run.poll() is not None:
                        break
                    version = changed(changes, version, run)
                    now = cup_heats(store)
                    if dice is None or now == before:
                        continue
                    time.sleep(dice.uniform(0.0, 0.2))
                    stage = "qualifying" if now["done"] < ENTRANTS else "knock-out"
                    if sum(stage in kill for kill in killed) >= KILLS:
                        continue
                    victims, before = descendants(run.pid), now
                    victim = run.pid if dice.random() < 0.6 else dice.choice(victims or [run.pid])
                    send(signal.SIGKILL, victim)
                    what = "the matchmaker" if victim == run.pid else "a process"
                    killed.append(f"{what}, {stage}")
                    if victim == run.pid:
                        break
            finally:
                run.kill()
                run.wait()
    return killed


def changed(changes: sqlite3.Connection, version: tuple, run: subprocess.Popen) -> tuple:
    """Wait until another process has written to the league, one second at most; how it is now.

    To read the heats each time would take a core from those that race them.
    """
    give_up = time.monotonic() + 1.0
    while True:
        time.sleep(0.01)
        now = changes.execute("PRAGMA data_version").fetchone()
        if now != version or run.poll() is not None or time.monotonic() > give_up:
            return now


def cup_heats(store: Store) -> Counter[str]:
    """Return how many heats of the cup are in each state."""
    return Counter(heat.state for heat in store.heats() if heat.heat.purpose == "cup")


@pytest.mark.slow
def test_kill_nine_during_a_cup_changes_neither_bracket_nor_winner(tmp_path):
    calm, wild = tmp_path / "calm.db", tmp_path / "wild.db"
    made_cup(calm)
    shutil.copy(calm, wild)
    raced_cup(calm, None, 300.0)
    killed = raced_cup(wild, random.Random(5), 900.0)
    assert {kill.split(", ")[1] for kill in killed} == {"qualifying", "knock-out"}
    brackets = []
    for path in (calm, wild):
        with Store(f"sqlite:///{path}") as store:
            keys = sorted(h.heat.key for h in store.heats() if h.heat.purpose == "cup")
            frozen = store.frozen(store.cups()[0]) or {}
            assert len(frozen["order"]) == ENTRANTS
            # The heats have other numbers where rated ones were planned between them.
            heats = [heat for stage in frozen["stages"] for heat in stage["heats"]]
            runs = [(heat["track"], heat["runs"]) for heat in heats]
            brackets.append((frozen["order"], runs, keys))
    assert brackets[0] == brackets[1] and len(brackets[0][2]) == ENTRANTS + 2 + 1
    print(f"kill -9 of {sorted(killed)}")
