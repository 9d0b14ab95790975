"""Standings: the ratings of a league as people read them; a pure function of its races."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from league.errors import StoreError, brief
from league.matchmaking import ratings
from league.matchmaking.ratings import Field, Ratings, Results
from league.matchmaking.ratings.intransitivity import Goodness, goodness_of_fit
from league.matchmaking.ratings.pair_counts import points_of
from league.matchmaking.store import (
    BEST_MS,
    FINISHED,
    KNOWN,
    RATED,
    Entry,
    EntryState,
    Races,
    Store,
)


@dataclass(frozen=True)
class Row:
    """One entry's line."""

    rank: int
    """From 1."""
    best_rank: int
    """The rank it may have: only those count above it whose whole interval is above its own."""
    worst_rank: int
    """The rank it may have: only those count below it whose whole interval is below its own."""
    number: int
    """Entry number."""
    id: str
    """Entry id."""
    name: str
    """Name."""
    owner: str
    """Whose it is."""
    anchor: bool
    """Whether it is one of the league's own drivers."""
    state: EntryState
    """Where it stands."""
    elo: float
    """Strength [Elo]."""
    sd: float
    """Standard deviation [Elo]."""
    low95: float
    """Lower end of the 95 % interval [Elo]."""
    high95: float
    """Upper end of the 95 % interval [Elo]."""
    provisional: bool
    """Known to worse than sd 50, or not connected."""
    connected: bool
    """Whether a chain of races leads to the anchor."""
    one_sided: bool
    """Won, or lost, every pair: only the prior holds the number."""
    races: int
    """Rated races."""
    score: float
    """Share of opponents it came in ahead of, ties half; 0 without a race."""
    unfinished: float | None
    """Share of its rated races in which it did not drive all laps; None if none tells."""
    best_laps_s: Mapping[str, float]
    """Best complete lap of its rated races, penalties included [s], by track."""


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
    tracks: tuple[str, ...] = ()
    """Tracks of the ruleset."""

    def row(self, number: int, name: str = "") -> Row:
        """Return an entry's line by its number; its name is for the error only.

        Raises:
            StoreError: it is not rated.
        """
        found = next((row for row in self.rows if row.number == number), None)
        if found is None:
            who = brief(name) if name else f"entry {number}"
            raise StoreError(
                f"{who} is not rated yet: it must pass its validation heats first, "
                "`league entries` shows where it stands"
            )
        return found


def results_of(races: Races, *, before: int | None = None) -> Results:
    """Return the store's races as the rating reads them.

    Args:
        races: from the store.
        before: only those of heats with a smaller number.
    """
    keep = slice(None) if before is None else races.heat < before
    return Results(
        heats=races.heat[keep],
        entries=races.entries[keep].astype(np.int64),
        places=races.places[keep].astype(np.int64),
    )


def rated(results: Results, entries: Sequence[Entry], also: Collection[int] = ()) -> Ratings | None:
    """Return the fit of a league's results, pinned to its first anchor; None without a field.

    Args:
        results: the races.
        entries: all entries of the league.
        also: numbers of entries to rate besides those in a rated state and those that raced.
    """
    field = field_of(results, entries, also)
    return None if field is None else _fit(field, entries)


def field_of(
    results: Results, entries: Sequence[Entry], also: Collection[int] = ()
) -> Field | None:
    """Return who is rated by some results, and the races counted; None without anybody.

    Args:
        results: the races.
        entries: all entries of the league.
        also: numbers of entries to rate besides those in a rated state and those that raced.
    """
    wanted = {entry.number for entry in entries if entry.state in RATED} | set(also)
    field = Field.of(results, sorted(wanted))
    return field if len(field.entries) else None


def _fit(field: Field, entries: Sequence[Entry]) -> Ratings:
    """Return the fit of a field, pinned to its first anchor."""
    there = set(field.entries.tolist())
    pinned = min((e.number for e in entries if e.anchor and e.number in there), default=None)
    return ratings.rate(field, anchor=pinned)


def of(store: Store, ruleset: str | None = None) -> Standings:
    """Return the standings of a league as they are now.

    Args:
        store: the league.
        ruleset: hash; by default the present one.

    Raises:
        StoreError: nobody is rated yet.
    """
    ruleset = ruleset or store.settings.ruleset.hash
    known = store.rulesets().get(ruleset)
    tracks = known.tracks if known else ()
    return table(store.entries(), store.races(ruleset), ruleset, tracks)


def table(
    entries: Sequence[Entry], races: Races, ruleset: str, tracks: tuple[str, ...] = ()
) -> Standings:
    """Return standings of some entries and races.

    Args:
        entries: all of the league.
        races: those that count.
        ruleset: hash of the ruleset they were raced by.
        tracks: its tracks.

    Raises:
        StoreError: nobody is rated yet.
    """
    results = results_of(races)
    field = field_of(results, entries)
    if field is None:
        raise StoreError(
            "nobody is rated in this league yet: submit entries with `league submit`, then let "
            "them race with `league run`"
        )
    fitted = _fit(field, entries)
    rows = _rows(field, fitted, entries, _Runs.of(races, tracks))
    goodness = goodness_of_fit(field, fitted)
    return Standings(rows, fitted, results, goodness, ruleset, len(field.results), tracks)


def _rows(field: Field, fitted: Ratings, entries: Sequence[Entry], runs: _Runs) -> tuple[Row, ...]:
    by_number = {entry.number: entry for entry in entries}
    pairs, points = points_of(field.evidence)
    # How many have their whole interval above one's own, and how many below it.
    above = len(pairs) - np.searchsorted(np.sort(fitted.low95), fitted.high95, side="right")
    below = np.searchsorted(np.sort(fitted.high95), fitted.low95, side="left")
    columns = {
        "elo": fitted.elo,
        "sd": fitted.sd,
        "low95": fitted.low95,
        "high95": fitted.high95,
        "provisional": fitted.provisional,
        "connected": fitted.connected,
        "one_sided": fitted.one_sided,
        "races": fitted.races,
        "score": points / np.maximum(pairs, 1),
    }
    order = fitted.order()
    best = np.minimum(np.arange(len(order)), above[order]) + 1
    worst = np.maximum(np.arange(len(order)) + 1, len(order) - below[order])
    table = zip(*(column[order].tolist() for column in columns.values()), strict=True)
    ranked = zip(fitted.entries[order].tolist(), best.tolist(), worst.tolist(), table, strict=True)
    return tuple(
        _row(
            by_number[number],
            runs,
            rank,
            best_rank,
            worst_rank,
            dict(zip(columns, told, strict=True)),
        )
        for rank, (number, best_rank, worst_rank, told) in enumerate(ranked, 1)
    )


def _row(
    entry: Entry, runs: _Runs, rank: int, best_rank: int, worst_rank: int, told: dict[str, Any]
) -> Row:
    return Row(
        rank=rank,
        best_rank=best_rank,
        worst_rank=worst_rank,
        number=entry.number,
        id=entry.id,
        name=entry.name,
        owner=entry.owner,
        anchor=entry.anchor,
        state=entry.state,
        unfinished=runs.unfinished(entry.number),
        best_laps_s=runs.best_laps_s(entry.number),
        **told,
    )


@dataclass(frozen=True)
class _Runs:
    """How the races of each entry went, by its number."""

    tracks: tuple[str, ...]
    told: np.ndarray
    """Races of which it is known, (numbers,)."""
    finished: np.ndarray
    """Races in which all laps were driven, (numbers,)."""
    best_ms: np.ndarray
    """Best lap, infinite for none, (tracks, numbers)."""

    @classmethod
    def of(cls, races: Races, tracks: tuple[str, ...]) -> _Runs:
        """Count the races that count."""
        size = int(races.entries.max(initial=-1)) + 1
        told, finished = np.zeros(size), np.zeros(size)
        best_ms = np.full(len(tracks) * size, np.inf)
        for slot in range(races.entries.shape[1]):
            known = np.flatnonzero(races.runs[:, slot] & KNOWN)
            who, run = races.entries[known, slot], races.runs[known, slot]
            told += np.bincount(who, minlength=size)
            finished += np.bincount(who, (run & FINISHED) > 0, size)
            lap_ms, track = run & BEST_MS, races.track[known]
            timed = (lap_ms > 0) & (track < len(tracks))
            place = track[timed].astype(np.int64) * size + who[timed]
            np.minimum.at(best_ms, place, lap_ms[timed].astype(float))
        return cls(tracks, told, finished, best_ms.reshape(len(tracks), size))

    def unfinished(self, number: int) -> float | None:
        """Return the share of an entry's races that it did not finish."""
        if number >= len(self.told) or not self.told[number]:
            return None
        return 1.0 - float(self.finished[number] / self.told[number])

    def best_laps_s(self, number: int) -> dict[str, float]:
        """Return an entry's best lap on each track that it completed one on."""
        if number >= len(self.told):
            return {}
        laps = zip(self.tracks, self.best_ms[:, number].tolist(), strict=True)
        return {track: lap_ms / 1000 for track, lap_ms in laps if lap_ms < np.inf}


@dataclass(frozen=True)
class Record:
    """How one entry did against another."""

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


def record(standings: Standings, one: int, other: int) -> Record:
    """Return the head-to-head record of two entries, by number."""
    results = standings.results
    mine = results.entries == one
    theirs = results.entries == other
    met = mine.any(axis=1) & theirs.any(axis=1)
    ahead = (results.places[met] * theirs[met]).sum(1) - (results.places[met] * mine[met]).sum(1)
    expected = residual = 0.0
    pairs = standings.goodness.pairs
    low, high = min(one, other), max(one, other)
    found = np.flatnonzero((pairs.one == low) & (pairs.other == high))
    if len(found):
        sign = 1.0 if one == low else -1.0
        promised = float(pairs.expected[found[0]])
        expected = promised if one == low else float(pairs.races[found[0]]) - promised
        residual = sign * float(pairs.residual[found[0]])
    return Record(
        int(met.sum()), int((ahead > 0).sum()), int((ahead == 0).sum()), expected, residual
    )


@dataclass(frozen=True)
class Moment:
    """An entry's rating at some time."""

    heat: int
    """Number of the last heat counted."""
    races: int
    """Races of the entry up to then."""
    elo: float
    """Strength [Elo]."""
    low95: float
    """Lower end of the 95 % interval [Elo]."""
    high95: float
    """Upper end of the 95 % interval [Elo]."""


def history(store: Store, entry: Entry, *, points: int = 20) -> list[Moment]:
    """Return an entry's rating as it was after evenly many of its heats, and last as it is now.

    Each is worked out anew from the races up to then, so later corrections of results count.
    """
    races, entries = store.races(), store.entries()
    mine = np.unique(races.heat[(races.entries == entry.number).any(axis=1)])
    if not len(mine):
        raise StoreError(
            f"{brief(entry.name)} has not raced for its rating yet: let the league run first"
        )
    picked = np.unique(np.linspace(0, len(mine) - 1, min(points, len(mine))).round().astype(int))
    # Others may have raced since its last heat, and their races move its rating too.
    moments_at = [*mine[picked[:-1]].tolist(), int(races.heat.max())]
    moments = []
    for heat in moments_at:
        fitted = rated(results_of(races, before=heat + 1), entries)
        assert fitted is not None
        at = fitted.index(entry.number)
        moments.append(
            Moment(
                heat=heat,
                races=int(fitted.races[at]),
                elo=float(fitted.elo[at]),
                low95=float(fitted.low95[at]),
                high95=float(fitted.high95[at]),
            )
        )
    return moments
