"""A league at one moment: entries, races that count, standings, and what pages look up in them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from league.matchmaking import divisions, safety, scores, standings
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.scope import RatingScope, scope
from league.matchmaking.scores import BestLap, clean_laps, joined_laps
from league.matchmaking.standings import Row, Standings
from league.matchmaking.store import LeagueEntry, Move, Races, Season, SeasonView, Store
from league.matchmaking.store.records import LeagueSettings

FROZEN = [field.name for field in fields(Row)]
"""What a frozen line may tell; those of older versions tell less."""
PASSING = frozenset({"plan", "claim", "complete", "fail", "lose", "retry", "reap"})
"""What happens to heats all the time, and changes nothing but the races."""
SHARED = (
    "by_number", "by_id", "by_owner", "by_digest", "by_parent", "owners", "kinds", "moves_by_entry",
)  # fmt: skip
"""What follows from entries and divisions alone."""


@dataclass(frozen=True)
class Snapshot:
    """A league at one moment."""

    revision: int
    """Store.revision at that moment, or shortly before."""
    settings: LeagueSettings
    entries: tuple[LeagueEntry, ...]
    races: Races
    """Those of the present rules that count, of all seasons."""
    rulesets: Mapping[str, Ruleset]
    """All that the league ever had, by their hashes."""
    seasons: tuple[Season, ...]
    """All of the league, the first one first."""
    season: Season | None
    """The last season under these rules; None in a league without seasons."""
    rated: Standings | None
    """Of the season; None if no entry is rated."""
    moves: Mapping[int, tuple[Move, ...]]
    """Moves between divisions in each season under these rules, by its number."""
    divisions: Mapping[int, int]
    """Division of each entry of the season, by its number."""
    safety: safety.Record
    """Safety ratings."""
    trends: Mapping[int, float]
    """By how much the season's newest heats changed each rating [Elo], by entry number."""
    settled: Snapshot | None = None
    """The last snapshot with fitted ratings, if this is that one a few races later."""

    def prepare(self, pause: Callable[[], None] = lambda: None) -> None:
        """Compute now what pages look up, so that no request has to; see `take`."""
        for name in (*SHARED, "rows", "clean_laps", "car_counts"):
            pause()
            getattr(self, name)
        pause()
        _ = self.counted.index
        if self.rated:
            self.rated.ratings.gap_variance(0, 0)  # the first one prepares all

    @cached_property
    def by_number(self) -> dict[int, LeagueEntry]:
        """The entries by their numbers."""
        return {entry.number: entry for entry in self.entries}

    @cached_property
    def by_id(self) -> dict[str, LeagueEntry]:
        """The entries by their ids."""
        return {entry.id: entry for entry in self.entries}

    @cached_property
    def by_owner(self) -> dict[str, list[LeagueEntry]]:
        """The entries of each owner."""
        found: dict[str, list[LeagueEntry]] = {}
        for entry in self.entries:
            found.setdefault(entry.owner, []).append(entry)
        return found

    @cached_property
    def by_digest(self) -> dict[str, LeagueEntry]:
        """The entries by the digests of their checkpoints."""
        return by_digest(self.entries)

    @cached_property
    def by_parent(self) -> dict[str, list[LeagueEntry]]:
        """The entries that were trained from a checkpoint, by its digest."""
        return by_parent(self.entries)

    @property
    def rows(self) -> dict[int, Row]:
        """The lines of the standings by the entries' numbers, best first."""
        return self.rated.by_number if self.rated else {}

    @cached_property
    def clean_laps(self) -> dict[str, list[BestLap]]:
        """The fastest clean lap of each entry on each track, the fastest first."""
        return clean_laps(self.rated.races, self.rated.tracks) if self.rated else {}

    @cached_property
    def lap_places(self) -> dict[str, dict[int, int]]:
        """Where each entry stands among these laps, from 0, by track and number."""
        return {
            track: {lap.number: place for place, lap in enumerate(laps)}
            for track, laps in self.clean_laps.items()
        }

    @cached_property
    def moves_by_entry(self) -> dict[int, list[tuple[Season, Move]]]:
        """Moves between divisions of each entry that made one, the oldest first."""
        found: dict[int, list[tuple[Season, Move]]] = {}
        for season in self.seasons:
            for move in self.moves.get(season.number, ()):
                found.setdefault(move.entry, []).append((season, move))
        return found

    @property
    def counted(self) -> Races:
        """The races that the standings are made of."""
        return self.rated.races if self.rated else self.races

    @cached_property
    def car_counts(self) -> list[int]:
        """How many cars these races have, each number once."""
        return _car_counts(self.counted)

    @cached_property
    def kinds(self) -> list[str]:
        """Kinds of the entries, each once."""
        return sorted({kind_of(entry) for entry in self.entries})

    def rated_by(self, track: str, cars: int) -> Standings | None:
        """Return the standings of those who raced on a track (empty: all), by these races alone.

        Only races of so many cars count; 0 for all.
        """
        rules, counted = self.settings.ruleset, self.counted
        kept = np.ones(len(counted.heat), np.bool_)
        if track:
            kept &= counted.track == rules.tracks.index(track)
        if cars:
            kept &= (counted.entries >= 0).sum(axis=1) == cars
        if kept.all():
            if self.rated and not self._carries and self.rated.ratings.races.all():
                return self.rated
            races = counted
        else:
            races = counted.where(kept)
        numbers = set(np.unique(races.entries).tolist())
        entries = [entry for entry in self.entries if entry.number in numbers]
        within, near = RatingScope(races, self.season, None), self.rated and self.rated.ratings
        return standings.table(entries, within, rules.hash, rules.tracks, near=near)

    @property
    def _carries(self) -> bool:
        """Whether ratings of the season before count in this one, see `scope`."""
        hash, last = self.settings.ruleset.hash, self.season.number - 1 if self.season else None
        return any(one.number == last and one.ruleset == hash for one in self.seasons)

    @cached_property
    def owners(self) -> list[str]:
        """Owners of rated entries, in order."""
        return sorted({row.owner for row in self.rows.values()})


def digest_of(entry: LeagueEntry) -> str:
    """Return the digest of an entry's checkpoint; empty if its card has none."""
    return str(entry.card.get("digest", ""))


def parents_of(entry: LeagueEntry) -> list[str]:
    """Return the digests of the checkpoints that an entry was trained from."""
    match entry.card.get("parents"):
        case [*digests]:
            return [str(digest) for digest in digests]
    return []


def by_digest(entries: Iterable[LeagueEntry]) -> dict[str, LeagueEntry]:
    """Return some entries by the digests of their checkpoints."""
    return {digest: entry for entry in entries if (digest := digest_of(entry))}


def by_parent(entries: Iterable[LeagueEntry]) -> dict[str, list[LeagueEntry]]:
    """Return those that were trained from a checkpoint, by its digest."""
    found: dict[str, list[LeagueEntry]] = {}
    for entry in entries:
        for digest in filter(None, parents_of(entry)):
            found.setdefault(digest, []).append(entry)
    return found


def kind_of(entry: LeagueEntry) -> str:
    """Return what an entry is, in one word."""
    return "anchor" if entry.anchor else entry.kind


def take(
    store: Store, before: Snapshot | None = None, pause: Callable[[], None] = lambda: None
) -> Snapshot:
    """Return a league as it is now; what has not changed since `before` is not computed again.

    `pause` is called between steps that take a tenth of a second in a large league; it may wait.
    """
    revision, settings = store.revision, store.settings
    if before is not None and before.settings != settings:
        before = None
    before = before and (before.settled or before)
    if before is not None and "quarantine" in store.happened(before.revision):
        before = None  # races were taken back, and perhaps given again
    entries = tuple(store.entries_again(before.entries if before else ()))
    races = _races(store, before)
    rules = settings.ruleset
    within = scope(store, rules.hash, races=races)
    season = within.season
    known = before is not None and before.races is races
    if before and known and (before.entries, before.season) == (entries, season):
        rated, trends = before.rated, before.trends
    else:
        rated = standings.table(
            entries,
            within,
            rules.hash,
            rules.tracks,
            near=before.rated.ratings if before and before.rated else None,
            pause=pause,
        )
        pause()
        trends = scores.trends(rated, within.carried, pause) if rated else {}
        if rated and isinstance(store, SeasonView):
            rated = replace(rated, rows=_frozen(rated.rows, store.rows))
    seasons = tuple(store.seasons())
    moves = {
        one.number: tuple(store.division_moves(one.number))
        for one in seasons
        if one.ruleset == rules.hash
    }
    earlier = before.safety if before and before.races.voided == races.voided else None
    drives = store.drives(rules.hash, since=earlier.drives.last if earlier else 0)
    return Snapshot(
        revision=revision,
        settings=settings,
        entries=entries,
        races=races,
        rulesets=store.rulesets(),
        seasons=seasons,
        season=season,
        rated=rated,
        moves=moves,
        divisions=divisions.assigned(moves.get(season.number, ())) if season else {},
        safety=safety.rated(drives, rules.tracks, earlier),
        trends=trends,
    )


def _frozen(rows: Sequence[Row], frozen: Sequence[Mapping[str, Any]]) -> tuple[Row, ...]:
    """Return the lines of a season's standings as they were frozen."""
    by_number = {row.number: row for row in rows}
    return tuple(
        replace(by_number[one["number"]], **{name: one[name] for name in FROZEN if name in one})
        for one in frozen
    )


def updated(store: Store, before: Snapshot) -> Snapshot | None:
    """Return a league some races later, without fitting its ratings; None where they need that.

    It follows from the last fitted snapshot and all races since then, so how often it is made
    changes nothing. The next `take` settles it: ratings and intervals of a whole fit, trends and
    the test of fit with them.
    """
    base, revision = before.settled or before, store.revision
    if not store.happened(base.revision) <= PASSING:
        return None
    later = store.races(since=base.races.last)
    if later.voided != base.races.voided:
        return None
    if not len(later.heat):
        now = copy(base)  # with all that pages look up
        vars(now)["revision"] = revision
        return now
    if base.rated is None:
        return None
    races, counted = base.races.joined(later), later
    if base.season is not None:
        counted = later.where(base.season.has(later.heat))
    same = base.rated.races is base.races and len(counted.heat) == len(later.heat)
    within = races if same else base.rated.races.joined(counted)
    rated = standings.updated(base.rated, within, counted, base.entries)
    if rated is None:
        return None
    rules = base.settings.ruleset
    drives = store.drives(rules.hash, since=base.safety.drives.last)
    now = replace(
        base,
        revision=revision,
        races=races,
        rated=rated,
        safety=safety.rated(drives, rules.tracks, base.safety),
        settled=base,
    )
    laps = joined_laps(base.clean_laps, clean_laps(counted, rated.tracks))
    cars = {*base.car_counts, *_car_counts(counted)}
    vars(now).update(  # what is cached otherwise
        {name: getattr(base, name) for name in SHARED},
        clean_laps=laps,
        car_counts=sorted(cars),
    )
    return now


def _car_counts(races: Races) -> list[int]:
    return np.flatnonzero(np.bincount((races.entries >= 0).sum(axis=1))).tolist()


def _races(store: Store, before: Snapshot | None) -> Races:
    if before is not None:
        later = store.races(since=before.races.last)
        if later.voided == before.races.voided:
            return before.races.joined(later) if len(later.heat) else before.races
    return store.races()
