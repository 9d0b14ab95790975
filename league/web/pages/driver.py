"""A driver: rating, record, heats, card, family; and two drivers against each other."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from league.errors import StoreError
from league.matchmaking import standings
from league.matchmaking.pairing import matchmaker
from league.matchmaking.scores import (
    HistoryPoint,
    RaceScore,
    final_ratings,
    heat_scores,
    history,
    own_history,
    race_scores,
)
from league.matchmaking.standings import HeadToHead, OwnRaces, Row, Standings
from league.matchmaking.store import (
    HeatRecord,
    HeatState,
    LeagueEntry,
    Season,
    StoredResult,
)
from league.video import stills
from league.web import charts
from league.web.pages import table
from league.web.pages.laps import lap_line
from league.web.pages.seasons import frozen
from league.web.reader import Document, NotFoundError, Reader, accepted, heat_number, raced
from league.web.snapshot import digest_of, parents_of

FIRST_HEATS = 8
"""Heats of a new entry that are followed live."""
WAITING = ("planned", "claimed")
"""States of the heats that are still to be raced, or are being raced."""
HEATS = 14
"""Newest heats that are listed."""
NEIGHBOURS = 10
"""Entries above, and below, in the standings; the records against them are shown."""
EXTREMES = 5
"""Best, and worst, heats that are listed."""
HISTORY_POINTS = 24
"""Moments of the rating's history."""
FITTED_RACES = 20_000
"""Races of a league up to which each moment is fitted to all races up to then."""
GENERATIONS = 8
"""Generations of ancestors that are shown."""
MOST_ANCESTORS = 40
"""Ancestors that are shown; cards are strangers' texts, and may name any number."""
HEATS_MET = 40
"""Heats on one page."""
OVER = ("done", "quarantined", "error")
"""States of the heats that are listed."""


def document(reader: Reader, number: int) -> Document:
    """Return an entry: its rating and how it came about, its record, its heats, its card."""
    entry, now = reader.entry(number), reader.snapshot()
    rated, row = now.rated, now.rows.get(number)
    states = reader.store.heat_states(number)
    newest = [heat for heat, state in states.items() if state in OVER][: -HEATS - 1 : -1]
    own = rated.own_races(number) if rated and row else None
    best, worst = _extremes(own) if own else ([], [])
    wanted = {*newest, *(one["number"] for one in best + worst)}
    records = reader.store.heats(numbers=[*wanted])
    results = reader.results(records)
    listed = {line["number"]: line for line in reader.listed(records, results=results)}
    moments = _history(reader, entry, rated, own) if rated and own and row and row.races else []
    return {
        "entry": entry,
        "standing": row,
        "marks": table.marks_of(reader, [row]).get(number) if row else None,
        "trophies": _trophies(reader, number),
        "history": moments,
        "fitted": bool(rated and rated.num_races <= FITTED_RACES),
        "chart": charts.rating_history(moments, table.season_moments(reader, number))
        if moments and moments[0].races < moments[-1].races
        else None,
        "against": _neighbours(rated, row, own) if rated and row and own else [],
        "best": [{**listed[one["number"]], **one} for one in best],
        "worst": [{**listed[one["number"]], **one} for one in worst],
        "laps": _laps(reader, number),
        "heats": [listed[heat] for heat in newest],
        "num_heats": sum(state == "done" for state in states.values()),
        "waiting": sum(state in WAITING for state in states.values()),
        "joining": _joining(reader, entry, states),
        "camera": _camera(entry, [one for one in records[::-1] if one.number in newest], results),
        "card": _card(entry),
        "ancestors": ancestors(now.by_digest, entry),
        "children": [
            {"number": one.number, "name": one.name}
            for one in now.by_parent.get(digest_of(entry), [])
        ],
    }


def _joining(
    reader: Reader, entry: LeagueEntry, states: Mapping[int, HeatState]
) -> Document | None:
    """Return how far a new entry is: what it waits for, and its first heats; None for others."""
    first = [*states][:FIRST_HEATS]
    over = len(first) == FIRST_HEATS and not any(states[heat] in WAITING for heat in first)
    if entry.anchor or over or entry.state not in ("pending", "validating", "placement"):
        return None
    waits = "" if entry.state == "placement" else matchmaker.waits_for(reader.store, entry)
    return {"waits_for": waits, "heats": reader.listed(reader.store.heats(numbers=first))}


def _neighbours(rated: Standings, row: Row, own: OwnRaces) -> list[tuple[Row, HeadToHead | None]]:
    """Return the entries around one in the standings, and its record against each."""
    first, met = max(0, row.rank - 1 - NEIGHBOURS), standings.meetings(rated, own)
    return [
        (other, met.get(other.number, standings.UNMET) if other.number != row.number else None)
        for other in rated.rows[first : row.rank + NEIGHBOURS]
    ]


def _extremes(own: OwnRaces) -> tuple[list[Document], list[Document]]:
    """Return the heats that went better than the ratings promised, and worse, the most so first."""
    heats, points, expected = heat_scores(own)
    beyond = points - expected

    def first(surplus: np.ndarray) -> list[Document]:
        order = np.argsort(-surplus, kind="stable")[:EXTREMES]
        order = order[surplus[order] > 0]
        columns = (column[order].tolist() for column in (heats, points, expected))
        return [
            {"number": heat, "points": made, "expected": promised}
            for heat, made, promised in zip(*columns, strict=True)
        ]

    return first(beyond), first(-beyond)


def _laps(reader: Reader, number: int) -> list[Document]:
    """Return an entry's best clean lap on each track: its place among all, its medal, its race."""
    lines, now = [], reader.snapshot()
    for name, laps in now.clean_laps.items():
        place = now.lap_places[name].get(number)
        if place is None:
            continue
        lap, bound_s = laps[place], reader.bound_s(name)
        over = lap.lap_s / bound_s if bound_s else None
        own = {"track": name, "place": place + 1, "over_bound": over}
        lines.append({**lap_line(lap, bound_s), **own})
    return lines


def _trophies(reader: Reader, number: int) -> list[Document]:
    """Return what an entry won in the seasons that are over."""
    return [
        {**trophy, "season": season.number, "of": season.name}
        for season in reader.snapshot().seasons
        for trophy in (frozen(reader, season) or {}).get("trophies", ())
        if trophy["number"] == number
    ]


def _camera(
    entry: LeagueEntry, records: Sequence[HeatRecord], results: Mapping[int, list[StoredResult]]
) -> Document | None:
    """Return the newest recorded race of an entry, and the moments that its film strip shows."""
    for record in records:
        for number, race, result in raced(record, results[record.number]):
            if not result.replay or entry.id not in race.grid:
                continue
            car = race.grid.index(entry.id)
            row = next(row for row in result.result["order"] if row["car"] == car)
            total_s = row["total_s"] if row["finished"] else math.inf
            return {
                "heat": record.number,
                "race": number,
                "car": car + 1,
                "track": race.track,
                "moments_s": stills.strip_moments(total_s, result.result["race_s"]),
            }
    return None


def _history(
    reader: Reader, entry: LeagueEntry, rated: Standings, own: OwnRaces
) -> list[HistoryPoint]:
    """Return an entry's history, as of the league's newest race; none before its first race."""
    if rated.num_races > FITTED_RACES:
        return own_history(rated, own, points=HISTORY_POINTS)

    def moments() -> list[HistoryPoint]:
        try:
            return history(reader.store, entry, points=HISTORY_POINTS)
        except StoreError:
            return []

    return reader.kept(("history", entry.number, rated.races.last), moments)


def _card(entry: LeagueEntry) -> dict[str, str]:
    """Return what a checkpoint's card says, in the words of the page."""
    card = entry.card
    if entry.kind == "scripted":
        return {"driver": str(card.get("driver", entry.name)), "kind": "scripted"}
    network = _mapping(card.get("network"))
    shape = [f"{name}: {size}" for name, size in network.items() if name != "normalise"]
    sensors = _mapping(card.get("sensors"))
    actions = [
        f"{name.replace('_', ' ')} {value}"
        for name, value in _mapping(card.get("action_space")).items()
    ]
    lines = {
        "trained for": card.get("kind"),
        "sensors": ", ".join(name for name in sensors if isinstance(sensors[name], Mapping)),
        "network": "; ".join(shape),
        "actions": ", ".join(actions),
        "reward": _mapping(card.get("reward")).get("name"),
        "tracks": ", ".join(map(str, card.get("tracks") or ())),
        "decisions": f"{card['steps']:,}" if isinstance(card.get("steps"), int) else None,
        "licence": card.get("licence"),
        "made": card.get("created"),
        "league": card.get("league_version"),
        "command": card.get("command"),
        "nearly a copy of": entry.near_copy_of,
    }
    return {name: str(value) for name, value in lines.items() if value}


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


@dataclass(frozen=True)
class Ancestor:
    """A checkpoint that a policy was trained from."""

    digest: str
    """Of its file."""
    number: int | None
    """Number of the entry it is; None if it was never entered in this league."""
    name: str
    """Name of that entry; empty if unknown."""
    parents: list[Ancestor] = field(default_factory=list)
    """What it was trained from, as far as its entry tells."""


def ancestors(by_digest: Mapping[str, LeagueEntry], entry: LeagueEntry) -> list[Ancestor]:
    """Return the parents of an entry, each with its own."""
    left = MOST_ANCESTORS

    def parents(one: LeagueEntry, above: tuple[str, ...]) -> list[Ancestor]:
        nonlocal left
        found = []
        for digest in parents_of(one):
            # A card may name its own descendant.
            if digest in above or len(above) > GENERATIONS or left <= 0:
                continue
            left -= 1
            known = by_digest.get(digest)
            own = parents(known, (*above, digest)) if known else []
            found.append(
                Ancestor(digest, known.number if known else None, known.name if known else "", own)
            )
        return found

    return parents(entry, (digest_of(entry),))


def matchup(reader: Reader, one: int, other: int, before: str = "", season: str = "") -> Document:
    """Return who is stronger, how sure that is, and their meetings, the newest first.

    Points count for the entry of number `one`; only heats `before` the one of that number, if any,
    and only those of the `season` of that number, are listed.
    """
    pair = reader.entry(one), reader.entry(other)
    if one == other:
        raise NotFoundError("A driver does not meet itself: name two different ones.")
    end = heat_number(before) if before else None
    now = reader.snapshot()
    chosen = reader.season(season) if season else None
    seasons: dict[int | None, Season] = {one.number: one for one in now.seasons}
    rows = now.rows.get(one), now.rows.get(other)
    both = now.rated if all(rows) else None
    met = reader.store.heats(entries=[one, other])
    scores, record = [], standings.UNMET if both else None
    if both and met:
        scores = race_scores(both.own_races(one), both.tracks, other)
        record = standings.head_to_head(both, one, other)
    by_season = _by_season(reader, both, one, other, met) if both else {}
    scored = [score for own in by_season.values() for score in own]
    records = [record for record in met if record.state in OVER]
    if end is not None:
        records = [record for record in records if record.number < end]
    if chosen:
        records = [record for record in records if chosen.has(record.number)]
    return {
        "one": pair[0],
        "other": pair[1],
        "standings": rows,
        "difference": both.ratings.difference(one, other) if both else None,
        "season": both.season if both else None,
        "record": record,
        "chart": charts.points_chart(scores) if len(scores) > 1 else None,
        "tracks": _points_by_track(scores),
        "heats": _races_met(reader, pair, records[-HEATS_MET:][::-1], scored),
        "records": [
            {
                "season": seasons.get(number),
                "present": bool(both and both.season and both.season.number == number),
                **_record(own),
            }
            for number, own in reversed(by_season.items())
        ],
        "whole": _record(scored),
        "chosen": chosen,
        "waiting": sum(record.state in WAITING for record in met),
        "older": records[-HEATS_MET].number if len(records) > HEATS_MET else None,
    }


def _by_season(
    reader: Reader, both: Standings, one: int, other: int, met: Sequence[HeatRecord]
) -> dict[int | None, list[RaceScore]]:
    """Return the races of two entries, points of the one, by number of the season, the first first.

    None is for races in no season; a season that is over promised what its final ratings say. `met`
    are their heats: under other rules than the present ones most have none.
    """
    now, hashes = reader.snapshot(), {record.heat.ruleset for record in met}
    seasons = {season.number: season for season in now.seasons}
    found: dict[int | None, list[RaceScore]] = {}
    for hash, rules in now.rulesets.items():
        if hash not in hashes:
            continue
        races = now.races
        if hash != now.settings.ruleset.hash:
            races = reader.store.races(hash, entries=(one, other))
        races = races.of_entry(one)
        races = races.where((races.entries == other).any(axis=1))
        within = np.zeros(len(races.heat), int)
        for season in now.seasons:
            within[season.has(races.heat)] = season.number
        for number in np.unique(within).tolist():
            document, ratings = frozen(reader, seasons[number]) if number else None, both.ratings
            if document is not None:
                final = partial(final_ratings, document)
                ratings = reader.kept(("ratings", number), final)
            own = standings.own_races(races.where(within == number), ratings, one)
            scores = race_scores(own, rules.tracks, other)
            found.setdefault(number or None, []).extend(scores)
    return dict(sorted(found.items(), key=lambda item: item[0] or 0))


def _record(scores: Sequence[RaceScore]) -> Document:
    """Return how often two entries met, and what the one made of it."""
    return {
        "heats": len({score.heat for score in scores}),
        "races": len(scores),
        "wins": sum(score.points == 1.0 for score in scores),
        "ties": sum(score.points == 0.5 for score in scores),
        "points": sum(score.points for score in scores),
        "expected": sum(score.expected for score in scores),
    }


def _points_by_track(scores: Sequence[RaceScore]) -> list[Document]:
    lines: dict[str, Document] = {}
    for score in scores:
        line = {"track": score.track, "races": 0, "points": 0.0, "expected": 0.0}
        line = lines.setdefault(score.track, line)
        line["races"] += 1
        line["points"] += score.points
        line["expected"] += score.expected
    return [line for _, line in sorted(lines.items())]


def _races_met(
    reader: Reader,
    pair: tuple[LeagueEntry, LeagueEntry],
    records: list[HeatRecord],
    scores: Sequence[RaceScore],
) -> list[Document]:
    """Return each race of some heats: who came in ahead, by how much, and what was promised."""
    results = reader.results(records)
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
