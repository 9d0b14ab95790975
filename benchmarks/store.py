"""How fast a league's database is: heats through the queue, and a million races for the standings.

Every transaction is on the disk when it returns (SQLite: WAL and synchronous=FULL). Workers claim
and complete one heat at a time, each in a transaction of its own: that is the first figure. Blocks
of heats in one transaction show what the tables can do apart from the disk.
"""

import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import sqlalchemy as sa

from benchmarks.report import figure, heading, note, seconds
from league.matchmaking import standings, store
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset, mirrored
from league.matchmaking.store import FINISHED, KNOWN, database, race_table, schema

RULES = Ruleset()
ENTRIES = 5000
"""Entries of the league of a million races."""
FRONT_WORTH = 150.0
"""What the front slot is worth in its races [Elo]."""
DISTANCE_CM = 5400
"""What each car drives in one of its races [cm]: three laps."""
BLOCK = 50_000
"""Heats written at a time."""
HEAT = (
    *("key", "ruleset", "purpose", "priority", "halves", "draw", "state"),
    *("attempts", "traceback", "created_s", "done_s"),
)
RACE = ("heat", "half", "ruleset", "rated", "cars", "packed", "driven")
"""Columns of the tables that are filled."""
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
    with there.writing() as connection:
        if there.is_sqlite:  # keys are hashes: their index is written all over
            connection.exec_driver_sql("PRAGMA cache_size = -1000000")
        for start in range(0, heats, BLOCK):
            numbers = np.arange(start + 1, min(start + BLOCK, heats) + 1)
            grids = _grids(generator, len(strengths), len(numbers))
            links = np.stack([numbers.repeat(2), np.sort(grids, axis=1).ravel()], axis=1)
            races = _races(generator, strengths, numbers, grids)
            _insert(connection, schema.heats, HEAT, _heats(numbers, grids))
            _insert(connection, schema.heat_entries, ("heat", "entry"), map(tuple, links.tolist()))
            _insert(connection, schema.races, RACE, races)
    there.close()


def _insert(
    connection: sa.Connection, table: sa.Table, names: Sequence[str], rows: Iterable[Any]
) -> None:
    """Insert rows by the driver alone: SQLAlchemy takes longer for a row than the database."""
    signs = ", ".join(["?" if connection.dialect.name == "sqlite" else "%s"] * len(names))
    text = f"INSERT INTO {table.name} ({', '.join(names)}) VALUES ({signs})"
    connection.exec_driver_sql(text, list(rows))


def _grids(generator: np.random.Generator, size: int, count: int) -> np.ndarray:
    """Return the numbers of two entries for each of some heats, drawn from all."""
    one = generator.integers(0, size, count)
    other = (one + generator.integers(1, size, count)) % size
    return np.stack([one, other], axis=1) + 1


def _heats(numbers: np.ndarray, grids: np.ndarray) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of some heats, see `HEAT`."""
    track = RULES.tracks[0]
    for number, (one, other) in zip(numbers.tolist(), grids.tolist(), strict=True):
        key = heat_spec.digest(str(number).encode())
        halves = f'[["{track}",[{one},{other}]],["{track}",[{other},{one}]]]'
        yield key, 1, "rated", 2, halves, 0, "done", 1, "", 0.0, float(number)


def _races(
    generator: np.random.Generator, strengths: np.ndarray, numbers: np.ndarray, grids: np.ndarray
) -> Iterator[tuple[Any, ...]]:
    """Yield the rows of two races of each of some heats, see `RACE`."""
    count = len(numbers)
    one, other = grids.T - 1
    lead = (strengths[one] - strengths[other])[:, None] + [FRONT_WORTH, -FRONT_WORTH]
    won = generator.random((count, 2)) < 1 / (1 + 10 ** (-lead / 400))
    best_ms = generator.integers(11_000, 13_000, (count, 2, 2))
    races = np.zeros((count, 2), race_table.race_type(2))
    races["heat"], races["half"] = numbers[:, None], [0, 1]
    races["entries"] = np.stack([grids, grids[:, ::-1]], axis=1)
    in_front = won ^ [False, True]  # whether the car in the front slot won
    races["places"] = np.where(in_front[:, :, None], [1, 2], [2, 1])
    races["runs"] = KNOWN | FINISHED | best_ms
    driven = np.zeros((count, 2, 2), race_table.DRIVEN)
    driven["points"], driven["distance_cm"] = generator.poisson(0.5, driven.shape), DISTANCE_CM
    driven["clean_ms"] = np.where(driven["points"], 0, best_ms)
    halves = zip(numbers.repeat(2).tolist(), [0, 1] * count, strict=True)
    for half, *texts in zip(halves, _digits(races), _digits(driven), strict=True):
        yield *half, 1, True, 2, *texts


def _digits(of_races: np.ndarray) -> list[str]:
    """Return what is known of each race, (heats, 2, ...), in hexadecimal."""
    text = of_races.tobytes().hex()
    digits = len(text) // (2 * len(of_races))
    return [text[at : at + digits] for at in range(0, len(text), digits)]


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
