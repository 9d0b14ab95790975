"""Two drivers against each other: all their heats, expected and actual score."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from typing import Any

from league.matchmaking import standings
from league.matchmaking.scores import RaceScore, race_scores
from league.matchmaking.store import Entry
from league.web import charts
from league.web.reader import Document, NotFoundError, Reader, accepted, heat_number

HEATS = 40
"""Heats on one page."""
OVER = ("done", "quarantined", "error")
"""States of the heats that are listed."""


def document(reader: Reader, one: int, other: int, before: str = "") -> Document:
    """Return who is stronger, how sure that is, and their meetings, the newest first.

    Args:
        reader: reads the league.
        one: number of the entry that points count for.
        other: number of the other entry.
        before: number of a heat: only earlier ones are listed; empty for all.
    """
    pair = reader.entry(one), reader.entry(other)
    if one == other:
        raise NotFoundError("A driver does not meet itself: name two different ones.")
    end = heat_number(before) if before else None
    rated = reader.standings()
    rows = reader.row(one), reader.row(other)
    both = rated if all(rows) else None
    scores = race_scores(both, one, other) if both else []
    met = reader.store.heats(entries=[one, other])
    records = [
        record for record in met if record.state in OVER and (end is None or record.number < end)
    ]
    return {
        "one": pair[0],
        "other": pair[1],
        "standings": rows,
        "difference": both.ratings.difference(one, other) if both else None,
        "record": standings.head_to_head(both, one, other) if both else None,
        "chart": charts.points_chart(scores) if len(scores) > 1 else None,
        "tracks": _by_track(scores),
        "heats": _races(reader, pair, records[-HEATS:][::-1], scores),
        "waiting": sum(record.state in ("planned", "claimed") for record in met),
        "older": records[-HEATS].number if len(records) > HEATS else None,
    }


def _by_track(scores: Sequence[RaceScore]) -> list[Document]:
    by_track = defaultdict(list)
    for score in scores:
        by_track[score.track].append(score)
    return [
        {
            "track": track,
            "races": len(some),
            "points": sum(score.points for score in some),
            "expected": sum(score.expected for score in some),
        }
        for track, some in sorted(by_track.items())
    ]


def _races(
    reader: Reader, pair: tuple[Entry, Entry], records: list[Any], scores: Sequence[RaceScore]
) -> list[Document]:
    """Return each race of some heats: who came in ahead, by how much, and what was promised."""
    results = defaultdict(list)
    for result in reader.store.results(*(record.number for record in records)):
        results[result.heat].append(result)
    expected = {(score.heat, score.race): score.expected for score in scores}
    lines = []
    for record in records:
        for half, race in enumerate(record.heat.halves):
            result = accepted(results[record.number], half)
            slots = [race.grid.index(entry.id) for entry in pair if entry.id in race.grid]
            if len(slots) < 2:
                continue
            line: Document = {
                "heat": record.number,
                "race": half + 1,
                "purpose": record.heat.purpose,
                "state": record.state,
                "track": race.track,
                "done_s": record.done_s,
                "front": pair[slots.index(min(slots))].name,
                "expected": expected.get((record.number, half + 1)),
                "ahead": None,
                "margin_s": None,
            }
            if result is not None:
                places = [result.places[slot] for slot in slots]
                if places[0] != places[1]:
                    line["ahead"] = pair[places.index(min(places))].name
                cars = {car["car"]: car for car in result.result["order"]}
                ends = [cars[slot] for slot in slots if cars[slot]["finished"]]
                if len(ends) == 2:
                    line["margin_s"] = abs(ends[0]["total_s"] - ends[1]["total_s"])
            lines.append(line)
    return lines
