"""Standings: the ratings of a league as people read them; a pure function of its races."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from league.errors import StoreError, brief
from league.matchmaking import ratings
from league.matchmaking.intransitivity import Goodness, goodness_of_fit
from league.matchmaking.ratings import Ratings, Results
from league.matchmaking.store import RATED, Entry, EntryState, Races, Store
from league.matchmaking.store.records import BEST_MS, FINISHED, TOLD


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
    raced = set(np.flatnonzero(np.bincount(results.entries.ravel() + 1)[1:]).tolist())
    wanted = {entry.number for entry in entries if entry.state in RATED} | set(also)
    if not wanted | raced:
        return None
    anchors = [e.number for e in entries if e.anchor and e.number in wanted | raced]
    pinned = min(anchors, default=None)
    return ratings.fit(results, entries=sorted(wanted), anchor=pinned)


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
    fitted = rated(results, entries)
    if fitted is None:
        raise StoreError(
            "nobody is rated in this league yet: submit entries with `league submit`, then let "
            "them race with `league run`"
        )
    by_number = {entry.number: entry for entry in entries}
    scores, runs = _scores(results), _Runs.of(races, tracks)
    order = fitted.order()
    rows = tuple(
        _row(rank, int(index), fitted, by_number, scores, runs)
        for rank, index in enumerate(order, 1)
    )
    goodness = goodness_of_fit(results, fitted)
    return Standings(rows, fitted, results, goodness, ruleset, len(results), tracks)


def _row(
    rank: int,
    index: int,
    fitted: Ratings,
    entries: Mapping[int, Entry],
    scores: Mapping[int, float],
    runs: _Runs,
) -> Row:
    entry = entries[int(fitted.entries[index])]
    low, high = float(fitted.low95[index]), float(fitted.high95[index])
    return Row(
        rank=rank,
        best_rank=min(rank, 1 + int((fitted.low95 > high).sum())),
        worst_rank=max(rank, len(fitted.entries) - int((fitted.high95 < low).sum())),
        number=entry.number,
        id=entry.id,
        name=entry.name,
        owner=entry.owner,
        anchor=entry.anchor,
        state=entry.state,
        elo=float(fitted.elo[index]),
        sd=float(fitted.sd[index]),
        low95=low,
        high95=high,
        provisional=bool(fitted.provisional[index]),
        connected=bool(fitted.connected[index]),
        one_sided=bool(fitted.one_sided[index]),
        races=int(fitted.races[index]),
        score=scores.get(entry.number, 0.0),
        unfinished=runs.unfinished(entry.number),
        best_laps_s=runs.best_laps_s(entry.number),
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
            known = np.flatnonzero(races.runs[:, slot] & TOLD)
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


def _scores(results: Results) -> dict[int, float]:
    """Return the share of opponents each entry came in ahead of."""
    there = results.entries >= 0
    size = int(results.entries.max(initial=-1)) + 1
    points, meetings = np.zeros(size), np.zeros(size)
    for one in range(results.entries.shape[1]):
        for other in range(results.entries.shape[1]):
            both = there[:, one] & there[:, other]
            if one == other or not both.any():
                continue
            ahead = results.places[both, other] - results.places[both, one]
            who = results.entries[both, one]
            points += np.bincount(who, 0.5 + 0.5 * np.sign(ahead), size)
            meetings += np.bincount(who, minlength=size)
    return {int(who): float(points[who] / meetings[who]) for who in np.flatnonzero(meetings)}


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
