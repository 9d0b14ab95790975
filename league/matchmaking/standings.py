"""Standings of a league as people read them; a pure function of its races."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from league.errors import StoreError, brief
from league.matchmaking.ratings import Carried, RatingData, Ratings, Results, fit
from league.matchmaking.ratings.fit import SIGMAS_95
from league.matchmaking.ratings.goodness_of_fit import Goodness, goodness_of_fit
from league.matchmaking.scope import RatingScope, scope
from league.matchmaking.store import (
    BEST_MS,
    CLEAN,
    FINISHED,
    KNOWN,
    RATED,
    EntryState,
    LeagueEntry,
    Races,
    Season,
    Store,
)

ENTRY_FIELDS = ("number", "id", "name", "owner", "anchor", "state")
"""What a line takes from its entry."""
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
    """Entry number."""
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

    rows: tuple[Row, ...]
    """Best first; the provisional ones by rating - 2 sd."""
    ratings: Ratings
    """The fit."""
    results: Results
    """The races it was made of."""
    goodness: Goodness
    """Whether one number a driver explains the results."""
    ruleset: str
    """Hash of the ruleset they belong to."""
    num_races: int
    """Rated races that count."""
    races: Races
    """The races as the store has them."""
    tracks: tuple[str, ...] = ()
    """Tracks of the ruleset."""
    season: Season | None = None
    """The season that the races belong to; None in a league without seasons."""

    def row(self, number: int, name: str = "") -> Row:
        """Return an entry's line by its number; its name is for the error only.

        Raises:
            StoreError: it is not rated.
        """
        row = next((row for row in self.rows if row.number == number), None)
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
) -> Ratings | None:
    """Return the fit of a league's results, pinned to its first anchor; None without an entry.

    Args:
        results: the races.
        entries: all entries of the league.
        also: numbers of entries to rate besides those in a rated state and those that raced.
        carried: what is known from an earlier season.
    """
    found = _fitted(results, entries, also, carried)
    return found[1] if found else None


def _fitted(
    results: Results,
    entries: Sequence[LeagueEntry],
    also: Collection[int],
    carried: Carried | None,
    near: Ratings | None = None,
) -> tuple[RatingData, Ratings] | None:
    numbers = {entry.number for entry in entries if entry.state in RATED} | set(also)
    data = RatingData.of(results, sorted(numbers))
    if not len(data.entries):
        return None
    anchor = anchor_of(data.entries, entries)
    return data, fit(data, anchor=anchor, carried=carried, near=near)


def anchor_of(numbers: np.ndarray, entries: Sequence[LeagueEntry]) -> int | None:
    """Return the first of some entries (numbers) that is an anchor."""
    known = set(numbers.ravel().tolist())
    return min((e.number for e in entries if e.anchor and e.number in known), default=None)


def of(store: Store, ruleset: str | None = None, season: Season | None = None) -> Standings:
    """Return the standings of a league as they are now.

    Args:
        store: the league.
        ruleset: hash; by default the present one.
        season: by default the last one under this ruleset.

    Raises:
        StoreError: no entry is rated yet.
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
) -> Standings | None:
    """Return the standings that follow from some races; None if no entry is rated.

    Args:
        entries: all of the league.
        within: the races, all of one ruleset, and what was known before them.
        ruleset: its hash.
        tracks: its tracks.
        near: ratings by nearly the same races, which make this quick.
    """
    results = results_of(within.races)
    found = _fitted(results, entries, (), within.carried, near)
    if found is None:
        return None
    data, fitted = found
    return Standings(
        rows=_rows(data, fitted, entries, Runs.of(within.races, tracks, entries)),
        ratings=fitted,
        results=results,
        goodness=goodness_of_fit(data, fitted),
        ruleset=ruleset,
        num_races=len(data.results),
        races=within.races,
        tracks=tracks,
        season=within.season,
    )


def possible_ranks(fitted: Ratings) -> tuple[np.ndarray, np.ndarray]:
    """Return the best and the worst rank (from 0) that the races allow, in order of rank.

    An entry counts as above (below) another if its whole 95 % interval within the field is above
    (below) the other's: the anchor's uncertainty moves all of them together.
    """
    order = fitted.order()
    rank = np.arange(len(order))
    low, high = fitted.elo - SIGMAS_95 * fitted.sd, fitted.elo + SIGMAS_95 * fitted.sd
    above = len(order) - np.searchsorted(np.sort(low), high, side="right")
    below = np.searchsorted(np.sort(high), low, side="left")
    return np.minimum(rank, above[order]), np.maximum(rank, len(order) - 1 - below[order])


def _rows(
    data: RatingData, fitted: Ratings, entries: Sequence[LeagueEntry], runs: Runs
) -> tuple[Row, ...]:
    by_number = {entry.number: entry for entry in entries}
    pairs, points = data.counts.points()
    scores = points / np.maximum(pairs, 1)
    best, worst = possible_ranks(fitted)
    laps_ms = runs.laps_ms.T.tolist()
    rows = []
    for rank, at in enumerate(fitted.order().tolist()):
        entry = by_number[int(fitted.entries[at])]
        number, known = entry.number, runs.known[entry.number]
        best_s, clean_s = (
            {runs.tracks[at]: lap_ms / 1000 for at, lap_ms in enumerate(own) if lap_ms < np.inf}
            for own in zip(*laps_ms[number], strict=True)
        )
        rows.append(
            Row(
                rank=rank + 1,
                best_rank=int(best[rank]) + 1,
                worst_rank=int(worst[rank]) + 1,
                **{name: getattr(entry, name) for name in ENTRY_FIELDS},
                **fitted.line(at, *RATING_FIELDS),
                wins=int(runs.first[number]),
                score=float(scores[at]),
                unfinished=1.0 - float(runs.finished[number] / known) if known else None,
                best_laps_s=best_s,
                clean_laps_s=clean_s,
            )
        )
    return tuple(rows)


@dataclass(frozen=True)
class Runs:
    """How the races of each entry went, by its number."""

    tracks: tuple[str, ...]
    first: np.ndarray
    """Races in which it came first, (numbers,)."""
    known: np.ndarray
    """Races of which it is known, (numbers,)."""
    finished: np.ndarray
    """Races in which all laps were driven, (numbers,)."""
    laps_ms: np.ndarray
    """Best lap, and best clean lap, infinite for none, (2, tracks, numbers)."""

    @classmethod
    def of(cls, races: Races, tracks: tuple[str, ...], entries: Sequence[LeagueEntry]) -> Runs:
        """Count the races, finishes and best laps of all entries."""
        size = 1 + max((entry.number for entry in entries), default=0)
        first, known, finished = np.zeros(size), np.zeros(size), np.zeros(size)
        best_ms, clean_ms = laps_ms = np.full((2, len(tracks) * size), np.inf)
        for slot in range(races.entries.shape[1]):
            first += np.bincount(races.entries[races.places[:, slot] == 1, slot], minlength=size)
            rows = np.flatnonzero(races.runs[:, slot] & KNOWN)
            entry, run = races.entries[rows, slot], races.runs[rows, slot]
            known += np.bincount(entry, minlength=size)
            finished += np.bincount(entry, (run & FINISHED) > 0, size)
            lap_ms, track = run & BEST_MS, races.track[rows]
            timed = (lap_ms > 0) & (track < len(tracks))
            place = track[timed].astype(np.int64) * size + entry[timed]
            clean, lap_ms = (run[timed] & CLEAN) > 0, lap_ms[timed].astype(float)
            np.minimum.at(best_ms, place, lap_ms)
            np.minimum.at(clean_ms, place[clean], lap_ms[clean])
        return cls(tracks, first, known, finished, laps_ms.reshape(2, len(tracks), size))


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


UNMET = HeadToHead(0, 0, 0, 0.0, 0.0)
"""The record of two entries that never met."""


def head_to_head(standings: Standings, one: int, other: int) -> HeadToHead:
    """Return the record of two entries, by number."""
    return meetings(standings, one).get(other, UNMET)


class Strengths(Protocol):
    """Ratings, as far as what they promise depends on them."""

    @property
    def entries(self) -> np.ndarray:
        """Entry numbers, ascending."""
        ...

    @property
    def elo(self) -> np.ndarray:
        """Strength of each [Elo]."""
        ...

    @property
    def slot_advantages(self) -> np.ndarray:
        """What each slot of the grid is worth [Elo]."""
        ...


@dataclass(frozen=True)
class OwnRaces:
    """An entry's rated races by heat and half, seen from its seat; all but two (races, cars)."""

    races: Races
    slot: np.ndarray
    """Where it stood on the grid, (races, 1)."""
    met: np.ndarray
    """Whether a car is another entry's."""
    points: np.ndarray
    """Its points against each car: 1, 0.5 for a tie, or 0."""
    strengths: np.ndarray
    """What the ratings, and the grid slots, give each car [Elo]."""


def own_races(races: Races, ratings: Strengths, number: int) -> OwnRaces:
    """Return those of some races that an entry was in."""
    races = races.where((races.entries == number).any(axis=1))
    races = races.where(np.lexsort((races.half, races.heat)))
    mine = races.entries == number
    slot = mine.argmax(axis=1)[:, None]
    places = races.places.astype(int)
    place = np.take_along_axis(places, slot, axis=1)
    known = np.searchsorted(ratings.entries, races.entries).clip(max=len(ratings.entries) - 1)
    return OwnRaces(
        races=races,
        slot=slot,
        met=(races.entries >= 0) & ~mine,
        points=(place < places) + 0.5 * (place == places),
        strengths=ratings.elo[known] + ratings.slot_advantages[: mine.shape[1]],
    )


def meetings(standings: Standings, number: int) -> dict[int, HeadToHead]:
    """Return an entry's record against each one that it met, by the other's number."""
    own = own_races(standings.races, standings.ratings, number)
    others, at = np.unique(own.races.entries[own.met], return_inverse=True)
    races, wins, ties = (
        np.bincount(at, counted[own.met], len(others)).astype(int).tolist()
        for counted in (own.met, own.points == 1.0, own.points == 0.5)
    )
    promised = _promised(standings, number)
    return {
        other: HeadToHead(races[at], wins[at], ties[at], *promised.get(other, (0.0, 0.0)))
        for at, other in enumerate(others.tolist())
    }


def _promised(standings: Standings, number: int) -> dict[int, tuple[float, float]]:
    """Return the points that the ratings promise an entry against each other one, and residuals."""
    pairs = standings.goodness.pairs
    found: dict[int, tuple[float, float]] = {}
    for pair in np.flatnonzero((pairs.one == number) | (pairs.other == number)).tolist():
        expected, residual = float(pairs.expected[pair]), float(pairs.residual[pair])
        if pairs.one[pair] == number:
            found[int(pairs.other[pair])] = expected, residual
        else:
            found[int(pairs.one[pair])] = float(pairs.races[pair]) - expected, -residual
    return found


def records(standings: Standings, number: int) -> list[tuple[Row, HeadToHead]]:
    """Return an entry's record against each one that it met, the best of them first."""
    met = meetings(standings, number)
    return [(row, met[row.number]) for row in standings.rows if row.number in met]
