"""A heat, and one of its races: classification, laps, gaps, events, and what proves them."""

from __future__ import annotations

from league.matchmaking.documents import heat_document, names_of
from league.web import charts, race_charts
from league.web.reader import Document, NotFoundError, Reader, accepted
from league.web.replay_data import player_data


def document(reader: Reader, number: int, race: str = "") -> Document:
    """Return a heat, and the classification, laps and gaps of one of its races.

    Args:
        reader: reads the league.
        number: of the heat.
        race: number of the race within the heat; empty for the first.
    """
    record, entries = reader.record(number), reader.store.entries()
    results = reader.store.results(number)
    valid = [str(half + 1) for half in range(len(record.heat.halves))]
    if (race or "1") not in valid:
        raise NotFoundError(f"Heat {number} has the races {' and '.join(valid)}.")
    half = int(race or "1") - 1
    result = accepted(results, half)
    replay = reader.replay(result.replay) if result and result.replay else None
    grid = record.heat.halves[half].grid
    laps_s = [lap for car in result.result["order"] for lap in car["lap_times_s"]] if result else []
    by_id = {entry.id: entry for entry in entries}
    return {
        "heat": heat_document(record, names_of(entries)),
        "race": half + 1,
        "track": record.heat.halves[half].track,
        "seed": record.seeds[half] if record.seeds else None,
        "ruleset": record.heat.ruleset,
        "cars": [
            {"number": slot + 1, "entry": by_id[id].number, "name": by_id[id].name}
            for slot, id in enumerate(grid)
        ],
        "result": result.result if result else None,
        "places": result.places if result else (),
        "best_lap_s": min(laps_s, default=None),
        "hash": result.hash if result else None,
        "recording": result.replay if result else None,
        "disputed": len(results) > len(record.heat.halves),
        "map": charts.track_map(replay.track) if replay else None,
        "gaps": race_charts.gap_chart(replay) if replay else None,
        "events": player_data(replay)["events"] if replay else [],
        "physics": replay.physics if replay else None,
        "league_version": replay.league_version if replay else None,
    }


def replay(reader: Reader, number: int, race: int) -> Document:
    """Return what the player draws of a race."""
    reader.record(number)
    result = accepted(reader.store.results(number), race - 1)
    if result is None or not result.replay:
        raise NotFoundError(f"Heat {number} has no recording of a race {race}.")
    return player_data(reader.replay(result.replay))
