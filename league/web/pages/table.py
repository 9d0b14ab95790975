"""The standings: of all races or of some, filtered, a page at a time; what their numbers mean."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, TypeVar

from league.matchmaking import divisions, safety, scores, standings
from league.matchmaking.scope import SEASON_SD
from league.matchmaking.standings import HeadToHead, Row, Standings
from league.web import charts
from league.web.pages.heats import WINDOW_S
from league.web.pages.laps import MEDALS
from league.web.reader import Document, NotFoundError, Reader, address, is_number, paging
from league.web.snapshot import kind_of

PATH = "/standings"
"""Address of the standings."""
MOST_OPTIONS = 200
"""Owners, or drivers, that can be chosen from a list; with more, their names are typed."""

MOST_NAMED = 12
"""Known values that a sentence about an unknown one lists."""

T = TypeVar("T")
ORDERS: dict[str, Callable[[str, Row], Any]] = {
    "": lambda _, row: row.rank,
    "races": lambda _, row: -row.races,
    "wins": lambda _, row: -row.wins,
    "finishes": lambda _, row: 1.0 if row.unfinished is None else row.unfinished,
    "lap": lambda track, row: row.clean_laps_s.get(track, math.inf),
    "name": lambda _, row: row.name.casefold(),
    "owner": lambda _, row: row.owner.casefold(),
}
"""What the lines may be sorted by, a key of the track of the laps and of a line, the first first;
equals stay in the order of their ranks."""


@dataclass(frozen=True)
class Original:
    """The earlier entry with nearly the same weights."""

    number: int
    name: str


@dataclass(frozen=True)
class Marks:
    """What the standings show of one entry besides its rating."""

    division: int | None
    """From 1, the top one; None without a season, or before it has one."""
    safety: safety.Safety | None
    """None before its first race."""
    trend: float | None
    """By how much the season's newest heats changed its rating [Elo]; None for newcomers."""
    copy_of: Original | None
    """The earlier entry with nearly the same weights; None for none."""


WHY = {
    "start": "at the start of the season",
    "new": "as a newcomer",
    "rating": "by rating",
    "place": "as a place was free, or none was left",
    "safety": "by safety rating",
    "left": "left",
}
"""What the reasons of moves between divisions mean."""


def season_moments(reader: Reader, number: int) -> list[tuple[int, str, str]]:
    """Return what a driver's history marks: newest heat before it, label, and what happened.

    That is the ends of seasons, and its own moves between divisions.
    """
    now = reader.snapshot()
    ruleset = now.settings.ruleset.hash
    marks = [
        (one.until, "S", f"{one.name} ended")
        for one in now.seasons
        if one.ruleset == ruleset and one.until is not None
    ]
    for one, move in now.moves_by_entry.get(number, ()):
        if move.division:
            title = f"Division {move.division}, {WHY[move.reason]}, in {one.name}"
            marks.append((move.heat, f"D{move.division}", title))
    return marks


def marks_of(reader: Reader, rows: Iterable[Row]) -> dict[int, Marks]:
    """Return the marks of some entries in the standings, by number."""
    now = reader.snapshot()
    copies = {row.number: now.by_number[row.number].near_copy_of for row in rows}
    numbers = {one.name: one.number for one in now.entries} if any(copies.values()) else {}
    return {
        number: Marks(
            now.divisions.get(number),
            now.safety.by_entry.get(number),
            now.trends.get(number),
            Original(numbers[name], name) if name in numbers else None,
        )
        for number, name in copies.items()
    }


def document(
    reader: Reader,
    owner: str = "",
    kind: str = "",
    track: str = "",
    cars: str = "",
    against: str = "",
    sort: str = "",
    page: str = "",
) -> Document:
    """Return one page of the standings; for the arguments, all empty by default, see PAGES.

    Filters by `track` and `cars` rate everyone again, by those races alone.
    """
    rules, now = reader.rules(), reader.snapshot()
    known = {
        "track": (track, list(rules["tracks"]), "races are on"),
        "cars": (cars, list(map(str, now.car_counts)), "rated races have"),
        "kind": (kind, now.kinds, "kinds are"),
        "owner": (owner, now.owners, "owners are"),
    }
    unknown = [
        _unknown(name, text, found, are)
        for name, (text, found, are) in known.items()
        if text and text not in found
    ]
    # What is not known filters nothing: whoever mistyped it sees the table, and why.
    track, cars, kind, owner = (text if text in found else "" for text, found, _ in known.values())
    rated = reader.standings_of(track, int(cars or 0))
    rows = rated.rows if rated else ()
    rival = _rival(rated, against) if rated and against else None
    if against and rival is None:
        names = sorted(row.name for row in rows)
        unknown.append(_unknown("driver", against, names, "drivers are"))
        against = ""
    shown = rows
    if owner and rated:
        own = [rated.by_number.get(entry.number) for entry in now.by_owner[owner]]
        shown = sorted(filter(None, own), key=lambda row: row.rank)
    if kind:
        shown = [row for row in shown if kind_of(now.by_number[row.number]) == kind]
    if sort not in ORDERS:
        raise NotFoundError(f"Standings are sorted by {', '.join(ORDERS)[2:]}, not {sort[:20]}.")
    lap_track = track or rules["tracks"][0]
    if sort:
        shown = sorted(shown, key=partial(ORDERS[sort], lap_track))
    filters = {"owner": owner, "kind": kind, "track": track, "cars": cars}
    asked = {name: text for name, text in {**filters, "against": against}.items() if text}
    lines, paged = paging(
        len(shown), page, "standings", PATH, {**asked, "sort": sort} if sort else asked
    )
    on_page = shown[lines]
    laps = _laps(reader, rated, cars, lap_track) if rated and cars else {}
    return {
        "rules": rules,
        "unknown": unknown,
        "races": rated.num_races if rated else 0,
        "rejected": bool(rated and rated.goodness.rejected),
        "p_value": rated.goodness.p_value if rated else None,
        "scale": charts.interval_scale(on_page) if on_page else None,
        "rows": on_page,
        "season": rated.season if rated else None,
        "marks": marks_of(reader, on_page),
        "laps": {row.number: laps[row.number] for row in on_page if row.number in laps},
        "entries": len(shown),
        **paged,
        "sort": sort,
        "sorts": {
            name: "" if name == sort else address(PATH, {**asked, "sort": name} if name else asked)
            for name in ORDERS
        },
        "against": rival,
        "records": _records(rated, rival, on_page) if rated and rival else {},
        "drivers": sorted((row.name, row.number) for row in _options(now.rows.values())),
        "owners": [*_options(now.owners)],
        "kinds": now.kinds,
        "car_counts": now.car_counts,
        **filters,
    }


def _rival(rated: Standings, against: str) -> Row | None:
    """Return the line of the driver with this number, or name."""
    number = int(against) if is_number(against) else 0
    return rated.by_number.get(number) or next((r for r in rated.rows if r.name == against), None)


def _laps(reader: Reader, rated: Standings, cars: str, track: str) -> dict[int, scores.BestLap]:
    """Return where clean laps of these races alone were driven on a track, by entry number."""
    key = ("laps", rated.races.last, rated.races.voided, cars, track, rated.num_races)
    laps = reader.kept(key, lambda: scores.clean_laps(rated.races, rated.tracks)[track])
    return {lap.number: lap for lap in laps}


def _options(found: Collection[T]) -> Collection[T]:
    return found if len(found) <= MOST_OPTIONS else ()


def _unknown(name: str, text: str, known: Sequence[str], are: str) -> str:
    """Return the sentence that says that a value is not known, and which ones are."""
    listed = ", ".join(known[:MOST_NAMED]) + (", ..." if len(known) > MOST_NAMED else "")
    have = f"{are} {listed}" if known else "there is none"
    return f"There is no {name} {text[:40]!r} in these standings, so all are shown; {have}."


def _records(rated: Standings, rival: Row, rows: Sequence[Row]) -> dict[int, HeadToHead]:
    """Return the record of each entry against the rival, by its number; only those that met it."""
    met = standings.meetings(rated, rated.own_races(rival.number))
    return {row.number: met[row.number].turned for row in rows if row.number in met}


def definitions(reader: Reader) -> Document:
    """Return the definitions, with the numbers in them."""
    season = next(iter(reader.store.seasons()[::-1]), None)
    settings = divisions.SeasonSettings.of(season) if season else divisions.SeasonSettings()
    return {
        "settings": settings,
        "safety_margin": divisions.SAFETY_MARGIN,
        "safety_races": safety.RACES,
        "safety_half": safety.HALF,
        "safety_best": safety.BEST,
        "safety_corners": safety.ENOUGH_CORNERS,
        "season_sd": SEASON_SD,
        "trend_heats": scores.TREND_HEATS,
        "medals": MEDALS,
        "window_s": WINDOW_S,
    }
