"""Time-attack boards: the fastest clean laps on each track, for each kind of race."""

from __future__ import annotations

from typing import cast

from league.matchmaking.scores import BestLap, Boards, time_attack
from league.sim.config import RaceKind
from league.track import files
from league.web import medals
from league.web.reader import Document, NotFoundError, Reader

MOST = 50
"""Drivers on a board."""
TITLES = {
    "head_to_head": "Head to head",
    "time_trial": "Time trial",
    "obstacle_avoidance": "Obstacle avoidance",
}


def document(reader: Reader, races: str = "") -> Document:
    """Return the boards of one kind of race; by default that of the present rules."""
    kinds = sorted({rules.kind for rules in reader.store.rulesets().values()})
    asked = races or reader.store.settings.ruleset.kind
    shown = cast(RaceKind, asked)
    if shown not in kinds:
        raise NotFoundError(f"This league has races of the kinds {', '.join(kinds)}.")
    voided = reader.snapshot().races.voided
    kept: list[Boards | None] = reader.kept(("boards", shown, voided), lambda: [None])
    kept[0] = boards = time_attack(reader.store, shown, kept[0])
    return {
        "kind": shown,
        "kinds": [{"kind": one, "title": TITLES.get(one, one)} for one in kinds],
        "boards": [_board(reader, track, laps) for track, laps in sorted(boards.laps.items())],
    }


def _board(reader: Reader, name: str, laps: list[BestLap]) -> Document:
    track = files.load(name)
    bound_s = reader.bound_s(track)
    drivers = {lap.number: reader.entry(lap.number) for lap in laps[:MOST]}
    rows = {number: reader.row(number) for number in drivers}
    return {
        "track": name,
        "title": track.title,
        "bound_s": bound_s,
        "laps": [
            {
                "entry": lap.number,
                "name": drivers[lap.number].name,
                "owner": drivers[lap.number].owner,
                "lap_s": lap.lap_s,
                "behind_s": lap.lap_s - laps[0].lap_s,
                "medal": medals.medal(lap.lap_s, bound_s),
                "rank": row.rank if (row := rows[lap.number]) else None,
                "heat": lap.heat,
                "race": lap.race,
            }
            for lap in laps[:MOST]
        ],
    }
