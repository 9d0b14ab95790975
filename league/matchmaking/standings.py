"""Standings of a league as people read them; a pure function of its races."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from league.errors import StoreError, brief
from league.matchmaking.ratings import Carried, RatingData, Ratings, Results, expected_score, fit
from league.matchmaking.ratings import updated as updated_ratings
from league.matchmaking.ratings.goodness_of_fit import Goodness, goodness_of_fit
from league.matchmaking.ratings.pair_counts import score
from league.matchmaking.ratings.table import Strengths
from league.matchmaking.scope import RatingScope, Runs, scope
from league.matchmaking.store import RATED, EntryState, LeagueEntry, Races, Season, Store

ENTRY_FIELDS = ("id", "name", "owner", "anchor", "state")  # what a line takes from its entry
RATING_FIELDS = (
    "elo", "sd", "low95", "high95", "listed_by", "provisional", "connected", "one_sided", "races",
)  # fmt: skip
"""What it takes from the fit."""


@dataclass(frozen=True)
class Row:
    """One entry's line."""

    rank: int
    """From 1."""
    best_rank: int
    """The best rank that the races allow."""
    worst_rank: int
    """The worst rank that the races allow."""
    number: int
    id: str
    name: str
    owner: str
    anchor: bool
    """Whether it is one of the league's own drivers."""
    state: EntryState
    elo: float
    """Strength [Elo]."""
    sd: float
    """Standard deviation of its place within the field [Elo]."""
    low95: float
    """Lower end of the 95 % interval of `elo`, relative to the anchor [Elo]."""
    high95: float
    """Upper end of it [Elo]."""
    listed_by: float
    """What the table is sorted by: `elo`, or `elo` - 2 `sd` of provisional ones [Elo]."""
    provisional: bool
    """Known to worse than sd 50, or not connected."""
    connected: bool
    """Whether a chain of races leads to the anchor."""
    one_sided: bool
    """Won, or lost, every pair: only the prior holds the number."""
    races: int
    """Rated races."""
    wins: int
    """Rated races in which it took the first place, alone or with others."""
    score: float
    """Share of opponents it came in ahead of, ties half; 0 without a race."""
    unfinished: float | None
    """Share of its rated races in which it did not drive all laps; None if unknown."""
    best_laps_s: Mapping[str, float]
    """Best complete lap of its rated races, penalties included [s], by track."""
    clean_laps_s: Mapping[str, float]
    """Best lap of its rated races in which it made no mistake [s], by track."""


@dataclass(frozen=True)
class Standings:
    """A league's table, and what it was made of."""

    rows: tuple[Row, ...]  # best first; the provisional ones by rating - 2 sd
    ratings: Ratings
    goodness: Goodness  # whether one number a driver explains the results
    ruleset: str  # hash of the ruleset they belong to
    num_races: int  # rated races that count
    races: Races  # the races as the store has them
    runs: Runs = field(repr=False)  # how the races of each entry went
    tracks: tuple[str, ...] = ()
    season: Season | None = None
    """The season that the races belong to; None in a league without seasons."""

    @cached_property
    def by_number(self) -> dict[int, Row]:
        """The lines by the entries' numbers, best first."""
        return {row.number: row for row in self.rows}

    def own_races(self, number: int) -> OwnRaces:
        """Return the races of an entry."""
        return own_races(self.races, self.ratings, number)

    def row(self, number: int, name: str = "") -> Row:
        """Return an entry's line by its number, else a StoreError with its name."""
        row = self.by_number.get(number)
        if row is None:
            what = brief(name) if name else f"entry {number}"
            raise StoreError(
                f"{what} is not rated yet: it must pass its validation heats first, "
                "`league entries` shows where it stands"
            )
        return row


def results_of(races: Races, *, before: int | None = None) -> Results:
    """Return the store's races as the rating reads them; only heats numbered below `before`."""
    keep = slice(None) if before is None else races.heat < before
    return Results(
        heats=races.heat[keep],
        entries=races.entries[keep].astype(np.int64),
        places=races.places[keep].astype(np.int64),
    )


def rated(
    results: Results,
    entries: Sequence[LeagueEntry],
    also: Collection[int] = (),
    carried: Carried | None = None,
    near: Ratings | None = None,
    pause: Callable[[], None] = lambda: None,
) -> tuple[RatingData, Ratings] | None:
    """Return a league's counted results and their fit, pinned to the first anchor.

    Rated are entries in a rated state, those that raced, and those with the numbers `also`.
    `carried` is what is known from an earlier season, `near` are ratings by nearly the same races,
    `pause` is called between steps of the fit. None without an entry to rate.
    """
    numbers = {entry.number for entry in entries if entry.state in RATED} | set(also)
    data = RatingData.of(results, sorted(numbers))
    if not len(data.entries):
        return None
    anchor = anchor_of(data.entries, entries)
    pause()
    return data, fit(data, anchor=anchor, carried=carried, near=near, pause=pause)


def anchor_of(numbers: np.ndarray, entries: Sequence[LeagueEntry]) -> int | None:
    """Return the first of some entries (numbers) that is an anchor."""
    known = set(numbers.ravel().tolist())
    return min((e.number for e in entries if e.anchor and e.number in known), default=None)


def of(store: Store, ruleset: str | None = None, season: Season | None = None) -> Standings:
    """Return the standings of a league as they are now; a StoreError if no entry is rated yet.

    By default those under the present ruleset (its hash), and of the last season under it.
    """
    ruleset = ruleset or store.settings.ruleset.hash
    known = store.rulesets().get(ruleset)
    within = scope(store, ruleset, season)
    tracks = known.tracks if known else ()
    found = table(store.entries(), within, ruleset, tracks)
    if found is None:
        raise StoreError(
            "no entry is rated in this league yet: submit entries with `league submit`, then let "
            "them race with `league run`"
        )
    return found


def table(
    entries: Sequence[LeagueEntry],
    within: RatingScope,
    ruleset: str,
    tracks: tuple[str, ...],
    *,
    near: Ratings | None = None,
    pause: Callable[[], None] = lambda: None,
) -> Standings | None:
    """Return the standings that follow from some races; None if no entry is rated.

    The races are all of one ruleset, given by its hash and tracks. Ratings by nearly the same
    races (`near`) make this quick. `pause` is called between its steps.
    """
    found = rated(results_of(within.races), entries, (), within.carried, near, pause)
    if found is None:
        return None
    pause()
    data, fitted = found
    runs = Runs.of(within.races, tracks, entries)
    rows = _rows(fitted, entries, runs)
    pause()
    return Standings(
        rows=rows,
        ratings=fitted,
        runs=runs,
        goodness=goodness_of_fit(data, fitted),
        ruleset=ruleset,
        num_races=len(data.results),
        races=within.races,
        tracks=tracks,
        season=within.season,
    )


def updated(
    fitted: Standings, races: Races, later: Races, entries: Sequence[LeagueEntry]
) -> Standings | None:
    """Return standings of all `races`, of which some are later than a fit; see `ratings.updated`.

    The test of fit and the dispersion of heats stay as they were. None if a fit is needed.
    """
    ratings = updated_ratings(fitted.ratings, results_of(later))
    if ratings is None:
        return None
    runs = fitted.runs.joined(Runs.of(later, fitted.tracks, entries))
    return replace(
        fitted,
        rows=tuple(_later_rows(fitted.rows, ratings, runs, later)),
        ratings=ratings,
        runs=runs,
        num_races=ratings.num_races,
        races=races,
    )


def _numbers(fitted: Ratings, runs: Runs) -> dict[str, list[Any]]:
    """Return the columns of the table that races change but for the laps, the best entry first."""
    order = fitted.order()
    numbers, (best, worst) = fitted.entries[order], fitted.possible_ranks()
    finishes = zip(runs.known[numbers].tolist(), runs.finished[numbers].tolist(), strict=True)
    return {
        "number": numbers.tolist(),
        "rank": list(range(1, len(order) + 1)),
        "best_rank": (best + 1).tolist(),
        "worst_rank": (worst + 1).tolist(),
        **{name: getattr(fitted, name)[order].tolist() for name in RATING_FIELDS},
        "wins": runs.first[numbers].astype(int).tolist(),
        "score": (fitted.points / np.maximum(fitted.pairs, 1))[order].tolist(),
        "unfinished": [1.0 - finished / known if known else None for known, finished in finishes],
    }


def _rows(fitted: Ratings, entries: Sequence[LeagueEntry], runs: Runs) -> tuple[Row, ...]:
    columns = _numbers(fitted, runs)
    by_number = {entry.number: entry for entry in entries}
    ordered = [by_number[number] for number in columns["number"]]
    columns |= {name: [getattr(entry, name) for entry in ordered] for name in ENTRY_FIELDS}
    columns["best_laps_s"] = runs.laps_s(columns["number"], clean=False)
    columns["clean_laps_s"] = runs.laps_s(columns["number"], clean=True)
    return tuple(map(Row, *(columns[name] for name in Row.__dataclass_fields__)))


def _later_rows(earlier: Sequence[Row], fitted: Ratings, runs: Runs, later: Races) -> list[Row]:
    """Return the lines after some later races."""
    columns = _numbers(fitted, runs)
    old = {row.number: vars(row) for row in earlier}
    raced = np.unique(later.entries[later.entries >= 0]).tolist()
    best_s, clean_s = (runs.laps_s(raced, clean=clean) for clean in (False, True))
    laps_s = dict(zip(raced, zip(best_s, clean_s, strict=True), strict=True))
    rows = []
    for values in zip(*columns.values(), strict=True):
        # The constructor of frozen data would set its fields one by one: five times as long.
        row, number = object.__new__(Row), values[0]
        vars(row).update(old[number])
        vars(row).update(zip(columns, values, strict=True))
        if number in laps_s:
            vars(row)["best_laps_s"], vars(row)["clean_laps_s"] = laps_s[number]
        rows.append(row)
    return rows


@dataclass(frozen=True)
class HeadToHead:
    """Record of one entry against another."""

    races: int
    """Races they met in."""
    wins: int
    """Races in which the one came in ahead."""
    ties: int
    """Races in which they shared a place."""
    expected: float
    """Points that the ratings promise the one."""
    residual: float
    """(points - expected) / standard deviation; beyond 3 either way the ratings miss something."""

    @property
    def points(self) -> float:
        """Wins, and ties half."""
        return self.wins + 0.5 * self.ties

    @property
    def turned(self) -> HeadToHead:
        """The record of the other against the one."""
        lost = self.races - self.wins - self.ties
        return HeadToHead(self.races, lost, self.ties, self.races - self.expected, -self.residual)


UNMET = HeadToHead(0, 0, 0, 0.0, 0.0)  # the record of two entries that never met


def head_to_head(standings: Standings, one: int, other: int) -> HeadToHead:
    """Return the record of two entries, by number."""
    return meetings(standings, standings.own_races(one)).get(other, UNMET)


@dataclass(frozen=True)
class OwnRaces:
    """An entry's rated races by heat and half, seen from its seat; all but two (races, cars)."""

    number: int  # of the entry
    races: Races
    slot: np.ndarray  # where it stood on the grid, (races, 1)
    met: np.ndarray  # whether a car is another entry's
    points: np.ndarray  # its points against each car: 1, 0.5 for a tie, or 0
    strengths: np.ndarray  # what the ratings, and the grid slots, give each car [Elo]

    @property
    def expected(self) -> np.ndarray:
        """Points that the ratings promise it against each car."""
        mine = np.take_along_axis(self.strengths, self.slot, axis=1)
        return np.asarray(expected_score(mine - self.strengths))


def own_races(races: Races, ratings: Strengths, number: int) -> OwnRaces:
    """Return those of some races that an entry was in."""
    races = races.of_entry(number)
    mine = races.entries == number
    slot = mine.argmax(axis=1)[:, None]
    places = races.places.astype(int)
    place = np.take_along_axis(places, slot, axis=1)
    known = np.searchsorted(ratings.entries, races.entries).clip(max=len(ratings.entries) - 1)
    return OwnRaces(
        number=number,
        races=races,
        slot=slot,
        met=(races.entries >= 0) & ~mine,
        points=score(place, places),
        strengths=ratings.elo[known] + ratings.slot_advantages[: mine.shape[1]],
    )


def meetings(standings: Standings, own: OwnRaces) -> dict[int, HeadToHead]:
    """Return an entry's record against each one that it met, by the other's number."""
    others, at = np.unique(own.races.entries[own.met], return_inverse=True)
    races, wins, ties = (
        np.bincount(at, counted[own.met], len(others)).astype(int).tolist()
        for counted in (own.met, own.points == 1.0, own.points == 0.5)
    )
    chance = own.expected[own.met]
    expected, room = (
        np.bincount(at, some, len(others)) for some in (chance, chance * (1.0 - chance))
    )
    beyond = np.bincount(at, own.points[own.met], len(others)) - expected
    residual = beyond / np.sqrt(np.maximum(room, 1e-12) * standings.goodness.dispersion)
    columns = races, wins, ties, expected.tolist(), residual.tolist()
    return {
        other: HeadToHead(*record)
        for other, record in zip(others.tolist(), zip(*columns, strict=True), strict=True)
    }


def records(standings: Standings, number: int) -> list[tuple[Row, HeadToHead]]:
    """Return an entry's record against each one that it met, the best of them first."""
    met = meetings(standings, standings.own_races(number))
    return [(row, met[row.number]) for row in standings.rows if row.number in met]
