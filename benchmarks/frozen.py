"""What a large season and a large cup are frozen as, made up."""

from __future__ import annotations

from typing import Any

from league.matchmaking import cups
from league.matchmaking.store import Store

NAME = "a driver with quite a long name"
DIVISIONS = 60
"""Divisions of the season, each with a trophy for its winner."""


def _row(number: int) -> dict[str, Any]:
    """Return a line of a frozen table."""
    return {
        "rank": number, "best_rank": number, "worst_rank": number + 3, "number": number,
        "id": "0" * 64, "name": f"{NAME} {number}", "owner": f"owner {number}", "anchor": False,
        "state": "ranked", "elo": 1000.0 - number, "sd": 20.0, "low95": 900.0 - number,
        "high95": 1100.0 - number, "listed_by": 1000.0 - number, "provisional": False,
        "connected": True, "one_sided": False, "races": 40, "wins": 3, "score": 0.5,
        "unfinished": 0.1, "best_laps_s": {"ring": 12.5}, "clean_laps_s": {"ring": 12.6},
    }  # fmt: skip


def season(entries: int) -> dict[str, Any]:
    """Return what a season of so many entries was frozen as."""
    rows = [_row(number) for number in range(1, entries + 1)]
    trophies = [
        {"title": f"Winner of division {one}", "number": one, "name": f"{NAME} {one}",
         "owner": "someone", "value": "1234 Elo", "heat": 0}
        for one in range(1, DIVISIONS + 1)
    ]  # fmt: skip
    safe = {"rating": 4.0, "incidents": 5.0, "points": 7, "corners": 140.0, "races": 9, "heats": []}
    return {
        "standings": {"entries": rows, "races": 9999},
        "laps": {"ring": [{"number": one, "lap_s": 12.5, "heat": 1, "race": 1} for one in (1, 2)]},
        "safety": {str(one["number"]): safe for one in rows},
        "divisions": {str(one["number"]): 1 + one["number"] // 20 for one in rows},
        "trophies": trophies,
    }


def cup(entrants: int) -> dict[str, Any]:
    """Return what a cup of so many entrants was frozen as; the lower number always wins."""

    def run(entry: int, advances: bool, places: list[int]) -> dict[str, Any]:
        lap_s = None if places else 12.5
        return {"entry": entry, "name": f"{NAME} {entry}", "seed": entry, "places": places,
                "lap_s": lap_s, "distance": 30.0, "advances": advances}  # fmt: skip

    size = cups.field_size(entrants)
    alone = [
        {"number": n, "state": "done", "track": "ring", "runs": [run(n, n <= size, [])]}
        for n in range(1, entrants + 1)
    ]
    stages = [{"name": "Qualifying", "heats": alone}]
    left, number = list(range(1, size + 1)), entrants
    while True:
        heats = len(left) // 4
        groups = [sorted(left[at::heats]) for at in range(heats)]
        drawn = []
        for group in groups:
            number += 1
            runs = [run(one, place < 2, [place + 1] * 2) for place, one in enumerate(group)]
            drawn.append({"number": number, "state": "done", "track": "ring", "runs": runs})
        stages.append({"name": cups.stage_name(heats), "heats": drawn})
        if heats == 1:
            break
        left = sorted(one for group in groups for one in group[:2])
    return {"stages": stages, "order": [{"entry": 1, "name": f"{NAME} 1"}]}


def freeze(store: Store, entries: int, entrants: int) -> None:
    """Begin and end a season of so many entries, with a cup of so many entrants in it."""
    rules = store.settings.ruleset
    large = store.start_season("Large", {"division_size": 20})
    settings = {"entrants": [], "qualifying": rules.hash, "knock_out": rules.hash}
    wide = store.start_cup("Wide", settings, [rules])
    store.freeze(wide, cup(entrants))
    store.close_season(large.number)
    store.freeze(large, season(entries))
