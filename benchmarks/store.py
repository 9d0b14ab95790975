"""How fast a league's database is: heats through the queue, and a million races for the standings.

Every transaction is on the disk when it returns (SQLite: WAL and synchronous=FULL). Workers claim
and complete one heat at a time, each in a transaction of its own: that is the first figure. Blocks
of heats in one transaction show what the tables can do apart from the disk.
"""

import json
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.report import figure, heading, note, seconds
from league.matchmaking import standings, store
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset, mirrored
from league.matchmaking.store import FINISHED, KNOWN, database, results, schema

RULES = Ruleset()
ENTRIES = 5000
"""Entries of the league of a million races."""
FRONT_WORTH = 150.0
"""What the front slot is worth in its races [Elo]."""
RESULT = {"order": [{"car": car, "laps_s": [11.25, 11.5, 11.75]} for car in (0, 1)], "steps": 540}


def founded(url: str, entries: int) -> store.Store:
    """Return a new league with some entries."""
    league = store.create(url, ruleset=RULES)
    for number in range(entries):
        league.submit(f"e{number}", f"o{number}", weights=str(number).encode())
    return league


def queue_rate(league: store.Store, block: int, count: int, draw: int) -> float:
    """Return heats claimed and completed per second, two races and two results each."""
    ids = [entry.id for entry in league.entries()]
    tracks = RULES.tracks[0], RULES.tracks[0]
    league.plan([mirrored(RULES.hash, tracks, (ids[0], ids[1]), draw + n) for n in range(count)])
    done, start = 0, time.perf_counter()
    while claims := league.claim("bench", block):
        outcomes = [
            store.HeatOutcome(
                claim.heat.key,
                tuple(store.RaceOutcome((1, 2), {**RESULT, "seed": seed}) for seed in claim.seeds),
            )
            for claim in claims
        ]
        done += len(league.complete("bench", outcomes).accepted)
    assert done == count, "heats were lost"
    return done / (time.perf_counter() - start)


def sync_s(folder: Path) -> float:
    """Return how long the disk takes to make 4 kB durable [s]: what a transaction cannot beat."""
    import os

    with (folder / "probe").open("wb") as probe:

        def once() -> None:
            probe.write(b"x" * 4096)
            probe.flush()
            os.fsync(probe.fileno())

        return seconds(once, repeats=50)


def fill(url: str, strengths: np.ndarray, heats: int) -> None:
    """Write many finished heats of two cars at once, past the queue.

    Args:
        url: a league with as many entries.
        strengths: of its entries in the order of their numbers [Elo].
        heats: how many; each is two races, the second with the grid turned round.
    """
    there, generator = database.Database(url), np.random.default_rng(3)
    for start in range(0, heats, 50_000):
        numbers = list(range(start + 1, min(start + 50_000, heats) + 1))
        grids = _grids(generator, len(strengths), len(numbers))
        rows = [_heat(number, grid) for number, grid in zip(numbers, grids.tolist(), strict=True)]
        with there.writing() as connection:
            connection.execute(schema.heats.insert(), rows)
            connection.execute(schema.heat_entries.insert(), _heat_entries(numbers, grids))
            connection.execute(schema.races.insert(), _races(generator, strengths, numbers, grids))
    there.close()


def _grids(generator: np.random.Generator, size: int, count: int) -> np.ndarray:
    """Return the numbers of two entries for each of some heats, drawn from all."""
    one = generator.integers(0, size, count)
    other = (one + generator.integers(1, size, count)) % size
    return np.stack([one, other], axis=1) + 1


def _heat_entries(numbers: list[int], grids: np.ndarray) -> list[dict[str, int]]:
    return [
        {"heat": heat, "entry": entry}
        for heat, grid in zip(numbers, grids.tolist(), strict=True)
        for entry in grid
    ]


def _races(
    generator: np.random.Generator, strengths: np.ndarray, numbers: list[int], grids: np.ndarray
) -> list[dict[str, object]]:
    """Return two races of each of some heats, the second with the grid turned round."""
    count = len(numbers)
    one, other = grids.T - 1
    lead = (strengths[one] - strengths[other])[:, None] + [FRONT_WORTH, -FRONT_WORTH]
    won = generator.random((count, 2)) < 1 / (1 + 10 ** (-lead / 400))
    best_ms = generator.integers(11_000, 13_000, (count, 2, 2)).tolist()
    races = []
    for number, grid, wins, laps in zip(
        numbers, grids.tolist(), won.tolist(), best_ms, strict=True
    ):
        for half, first in enumerate(wins):
            turn = 1 - 2 * half
            places = ((1, 2) if first else (2, 1))[::turn]
            runs = [KNOWN | FINISHED | lap_ms for lap_ms in laps[half]]
            packed = results.packed(number, half, grid[::turn], places, track=0, runs=runs)
            row = {"heat": number, "half": half, "ruleset": 1, "rated": True, "cars": 2}
            races.append({**row, "packed": packed})
    return races


def _heat(number: int, grid: list[int]) -> dict[str, object]:
    track = RULES.tracks[0]
    return {
        "key": heat_spec.digest(str(number).encode()),
        "ruleset": 1,
        "purpose": "rated",
        "priority": 2,
        "halves": json.dumps([[track, grid], [track, grid[::-1]]], separators=(",", ":")),
        "draw": 0,
        "state": "done",
        "attempts": 1,
        "traceback": "",
        "created_s": 0.0,
        "done_s": float(number),
    }


def measure(url: str, name: str, goal: float | None) -> None:
    """Print the figures of one database."""
    with founded(url, 2) as league:
        queue_rate(league, 64, 640, 0)  # the first transactions make files and caches
        rate = queue_rate(league, 1, 300, 30_000)
        figure(f"{name}: heats claimed and completed one at a time, as workers do", rate, "heats/s")
        rate = queue_rate(league, 8, 1600, 20_000)
        figure(f"{name}: the same in blocks of 8, one writer", rate, "heats/s")
        rate = queue_rate(league, 64, 6400, 10_000)
        figure(f"{name}: the same in blocks of 64, one writer", rate, "heats/s", goal)


def million(url: str, name: str) -> None:
    """Print how long a million races take to read, and the standings of their league whole."""
    strengths = np.random.default_rng(5).normal(0, 200, ENTRIES)
    with founded(url, ENTRIES) as league:
        fill(url, strengths, 500_000)
        assert league.races().entries.shape == (1_000_000, 2), "races were lost"
        taken = seconds(league.races, repeats=5)
        figure(f"{name}: 1,000,000 races read for the rating", taken, "s", 1.0, most=True)
        last = league.races().last - 1000
        taken = seconds(lambda: league.races(since=last), repeats=5)
        figure(f"{name}: the newest 1,000 of them", 1e3 * taken, "ms")
        taken = seconds(lambda: standings.of(league), repeats=5)
        figure(f"{name}: standings of 5,000 entries, 1,000,000 races", taken, "s", 2.0, most=True)
        start = time.process_time()
        table = standings.of(league)
        figure(f"{name}: the same, processor time", time.process_time() - start, "s")
    _check(table, strengths)


def _check(table: standings.Standings, strengths: np.ndarray) -> None:
    """Fail unless the standings are those of the strengths that the races were drawn from."""
    fitted = table.ratings
    miss = fitted.elo - fitted.elo.mean() - (strengths - strengths.mean())
    assert np.corrcoef(fitted.elo, strengths)[0, 1] > 0.98, (
        "the ratings do not follow the strengths"
    )
    assert abs((np.abs(miss) <= 1.96 * fitted.sd).mean() - 0.95) < 0.03, "intervals are not honest"
    lead = fitted.slot_advantages[0] - fitted.slot_advantages[1]
    assert abs(lead - FRONT_WORTH) < 5, "the front slot's worth is wrong"
    assert len(table.rows) == ENTRIES and table.num_races == 1_000_000, "standings lost something"
    assert not table.goodness.rejected, "there is no cycle in these races"


def main() -> None:
    """Print the figures."""
    heading("The league's database")
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        figure("the disk: 4 kB made durable", 1e3 * sync_s(place), "ms")
        measure(f"sqlite:///{place / 'queue.db'}", "SQLite", 1000)
        million(f"sqlite:///{place / 'million.db'}", "SQLite")
        size = (place / "million.db").stat().st_size
        figure("SQLite: file of 500,000 heats and their races", size / 1e6, "MB")
    _postgres()


def _postgres() -> None:
    try:
        from tests.matchmaking import postgres
    except ImportError:
        note("PostgreSQL: not measured, psycopg is not installed")
        return
    if postgres.binaries() is None:
        note("PostgreSQL: not measured, it is not installed")
        return
    with postgres.server(durable=True) as server:
        measure(server.database(), "PostgreSQL", None)
        million(server.database(), "PostgreSQL")


if __name__ == "__main__":
    main()
