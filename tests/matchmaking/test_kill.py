"""kill -9 at random moments: no heat is lost, none is counted twice, the ratings are the same."""

from __future__ import annotations

import os
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from season_kit import SHORT, new_league, submitted

from league.matchmaking import standings
from league.matchmaking.pairing.heat_spec import Half, Heat
from league.matchmaking.store import Store

WORK = [sys.executable, "-m", "league.cli", "work", "--lease-s", "3", "--workers", "2", "--plain"]


RULES = replace(SHORT, max_time_s=0.3)
"""Five steps: the shortest race whose cars are told apart."""


def planned(path: Path, heats: int) -> None:
    """Make a league with heats in its queue, of a driver without weights and two of chance."""
    with new_league(f"sqlite:///{path}", rules=RULES) as store:
        for number in range(2):
            submitted(store, f"e{number}", seed=number, senses="blind")
        ids = [entry.id for entry in store.entries()]
        pairs = [(a, b) for a in ids for b in ids if a < b]
        rules = store.settings.ruleset.hash
        tracks = ("reinvent_2018",) * 2
        store.plan(
            [
                Heat(rules, (Half(tracks[0], pair), Half(tracks[1], pair[::-1])), draw)
                for draw in range(heats)
                for pair in (pairs[draw % len(pairs)],)
            ]
        )


def below(pid: int) -> list[int]:
    """Return the processes of a dispatcher: its workers, and what they were forked off from."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:  # no Linux, or it is gone
        return []
    return [one for child in map(int, children) for one in (child, *below(child))]


def drain(path: Path, dice: random.Random | None, patience_s: float, heats: int) -> int:
    """Race until nothing is left, killing as the dice say; return how often was killed."""
    environment = {**os.environ, "LEAGUE_URL": f"sqlite:///{path}", "OMP_NUM_THREADS": "1"}
    kills, give_up = 0, time.monotonic() + patience_s
    with Store(f"sqlite:///{path}") as store:
        while time.monotonic() < give_up:
            if not left(store):
                return kills
            dispatcher = subprocess.Popen(WORK, env=environment, stdout=subprocess.DEVNULL)
            try:
                while dispatcher.poll() is None and left(store) and time.monotonic() < give_up:
                    kills += struck(store, dispatcher, dice, max(5, heats // 6))
            finally:
                dispatcher.kill()
                dispatcher.wait()
    raise AssertionError(f"heats are left: {store.counts()}")


def struck(
    store: Store, dispatcher: subprocess.Popen, dice: random.Random | None, most: int
) -> bool:
    """Wait for some results, then kill one of the dispatcher or whoever hands the heats out."""
    if dice is None:
        time.sleep(0.2)
        return False
    wanted = store.counts().get("done", 0) + dice.randint(1, most)
    while dispatcher.poll() is None and left(store) and store.counts().get("done", 0) < wanted:
        time.sleep(0.05)
    time.sleep(dice.uniform(0.0, 0.4))
    victims = below(dispatcher.pid)
    if victims and dice.random() < 0.6:
        try:
            os.kill(dice.choice(victims), signal.SIGKILL)
        except ProcessLookupError:  # a worker may come to its end first
            return False
    else:
        dispatcher.kill()
        dispatcher.wait()
    return True


def left(store: Store) -> bool:
    """Return whether anything is still to be raced; heats killed three times are asked for again.

    That is an operator's part, as `league retry` is.
    """
    for record in store.heats(("error",)):
        store.retry(record.heat.key)
    return any(count for state, count in store.counts().items() if state != "done")


def outcome(path: Path) -> tuple:
    with Store(f"sqlite:///{path}") as store:
        heats = store.heats()
        hashes = [(h.number, [r.hash for r in store.results(h.number)]) for h in heats]
        rows = [(row.number, row.elo, row.sd, row.races) for row in standings.of(store).rows]
        races = store.races()
        assert len(set(zip(races.heat, races.half, strict=True))) == len(races.heat)
        return hashes, rows, len(races.heat)


@pytest.mark.slow
def test_kill_nine_loses_nothing_and_counts_nothing_twice(tmp_path):
    heats = int(os.environ.get("LEAGUE_KILL_HEATS", "60"))
    calm, wild = tmp_path / "calm.db", tmp_path / "wild.db"
    planned(calm, heats)
    shutil.copy(calm, wild)  # the same secret, so the same seeds
    drain(calm, None, 120.0 + 5.0 * heats, heats)
    kills = drain(wild, random.Random(11), 240.0 + 10.0 * heats, heats)
    assert kills > 0
    undisturbed, disturbed = outcome(calm), outcome(wild)
    assert disturbed == undisturbed and undisturbed[2] == 2 * heats
    print(f"{heats} heats, {kills} times kill -9")
