"""A large league with a season that goes on, for the benchmark of its pages."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import sqlalchemy as sa

from benchmarks import frozen
from benchmarks import store as stores
from league.agents import checkpoint
from league.matchmaking import submission
from league.matchmaking.divisions import SeasonSettings
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Half, Heat, mirrored
from league.matchmaking.store import (
    HeatOutcome,
    Move,
    RaceOutcome,
    Store,
    create,
    database,
    results,
    schema,
)

RECORDED = 200
"""Newest heats that have results and recordings."""
DRIVER = 77
"""The entry that visitors look at: its heats have results and recordings, too."""
POLICY = checkpoint.load(Path(__file__).parents[1] / "garage" / "racer.pt")
"""What all entries race with."""
RULES = replace(stores.RULES, solver="planar")
ENTRANTS = 1024
"""Of the cup in the season that is over."""
EARLIER_RULES = replace(RULES, laps=RULES.laps + 1)
"""Of that season, so that the next one begins from nothing."""
RACING = 80
"""Entries that the season's further heats are drawn from."""


def founded(url: str, strengths: np.ndarray, heats: int, outcome: RaceOutcome) -> Store:
    """Return a league of many entries and heats, with a season that is over and one that runs.

    Args:
        url: of the new league.
        strengths: of its entries [Elo], (entries,).
        heats: how many are over, two races of two cars each.
        outcome: of the races that pages show, with its recording.
    """
    league = create(url, ruleset=RULES)
    league.set_ruleset(EARLIER_RULES)
    frozen.freeze(league, len(strengths), ENTRANTS)
    league.set_ruleset(RULES)
    _enter(url, len(strengths))
    stores.fill(url, strengths, heats)
    _record(url, heats, outcome)
    _begin_season(league, strengths, heats)
    return league


def _enter(url: str, count: int) -> None:
    """Write entries past the checks of their names, each of an owner of its own."""
    numbers, weights = range(1, count + 1), submission.pack(POLICY)
    digest = heat_spec.digest(weights)
    card = json.dumps({**json.loads(POLICY.text), "blob": digest})
    owners = [{"number": n, "name": f"owner {n}", "created_s": 0.0} for n in numbers]
    there = database.Database(url)
    with there.writing() as connection:
        connection.execute(schema.owners.insert(), owners)
        connection.execute(schema.entries.insert(), [_entry(number, card) for number in numbers])
        _keep(connection, digest, weights)
    there.close()


def _keep(connection: sa.Connection, digest: str, content: bytes) -> None:
    row = {"digest": digest, "size": len(content), "created_s": 0.0, "content": content}
    connection.execute(schema.blobs.insert().values(row))


def _entry(number: int, card: str) -> dict[str, object]:
    return {
        "number": number,
        "id": _id(number),
        "name": f"driver {number}",
        "owner": number,
        "kind": "policy",
        "anchor": False,
        "state": "ranked",
        "reason": "",
        "card": card,
        "created_s": float(number),
    }


def _id(number: int) -> str:
    return heat_spec.digest(f"entry {number}".encode())


def _record(url: str, heats: int, outcome: RaceOutcome) -> None:
    """Give the newest heats, and those of one entry, results and a recording."""
    assert outcome.replay is not None
    digest = heat_spec.digest(outcome.replay)
    text = heat_spec.canonical({"places": outcome.places, "result": outcome.result})
    packed = results.PackedResult.of(text, digest, "")
    kept = {"worker": "bench", "received_s": 0.0, "replay": digest}
    there = database.Database(url)
    with there.writing() as connection:
        of_entry = sa.select(schema.heat_entries.c.heat).where(
            schema.heat_entries.c.entry == DRIVER
        )
        recorded = {*range(max(1, heats - RECORDED + 1), heats + 1), *connection.scalars(of_entry)}
        rows = [
            {"heat": heat, "half": half, "hash": packed.hash, "document": packed.document, **kept}
            for heat in sorted(recorded)
            for half in (0, 1)
        ]
        connection.execute(schema.results.insert(), rows)
        _keep(connection, digest, outcome.replay)
    there.close()


def _begin_season(league: Store, strengths: np.ndarray, heats: int) -> None:
    """Begin a season that has all races so far, with divisions by strength."""
    settings = SeasonSettings()
    season = league.start_season("", asdict(settings))
    ranked = enumerate(np.argsort(-strengths).tolist())
    league.move_divisions(
        season.number,
        [
            Move(1, entry + 1, 1 + rank // settings.division_size, heats, "start")
            for rank, entry in ranked
        ],
    )


def race_heat(league: Store, outcome: RaceOutcome, draw: int) -> None:
    """Plan, claim and complete a heat of two entries; `draw` tells it from others."""
    one = draw % RACING
    other = (one + 1 + draw // RACING % (RACING - 1)) % RACING
    tracks = RULES.tracks[0], RULES.tracks[0]
    league.plan([mirrored(RULES.hash, tracks, (_id(one + 1), _id(other + 1)), draw)])
    for claim in league.claim("bench", 1):
        league.complete("bench", [HeatOutcome(claim.heat.key, (outcome, outcome))])


def race_cup_heat(league: Store, outcome: RaceOutcome) -> int:
    """Race a heat of many cars that counts for no rating, and return its number."""
    grid = tuple(_id(number) for number in range(1, len(outcome.places) + 1))
    heat = Heat(RULES.hash, (Half(RULES.tracks[0], grid),), purpose="cup")
    league.plan([heat])
    (claim,) = league.claim("bench", 1)
    league.complete("bench", [HeatOutcome(heat.key, (outcome,))])
    return claim.number
