"""What standings are made of: a season's races, how they went, and the ratings before it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from league.matchmaking.ratings import Carried
from league.matchmaking.store import LeagueEntry, Races, Season, Store, records

SEASON_SD = 100.0
"""How far strengths may move from one season to the next, besides what was not known [Elo]: drivers
are retrained, and a rating is a comparison with a field that changes, too."""


@dataclass(frozen=True)
class RatingScope:
    """What ratings are made of: a season's races, and what was known before them."""

    races: Races  # rated races
    season: Season | None  # None in a league without seasons: all its races count
    carried: Carried | None  # ratings of the season before, if it had the same rules


def scope(
    store: Store,
    ruleset: str | None = None,
    season: Season | None = None,
    races: Races | None = None,
) -> RatingScope:
    """Return what the ratings of a season are made of, by default the last one under a ruleset.

    By default `ruleset`, a hash, is the present one; `races` are all rated races under it, if they
    have been read already.
    """
    ruleset = ruleset or store.settings.ruleset.hash
    own = [one for one in store.seasons() if one.ruleset == ruleset]
    races = store.races(ruleset) if races is None else races
    season = season or (own[-1] if own else None)
    if season is None:
        return RatingScope(races, None, None)
    before = next((one for one in own if one.number == season.number - 1), None)
    own = season.has(races.heat)
    counted = races if own.all() else races.where(own)
    return RatingScope(counted, season, _carried(store, before))


def _carried(store: Store, season: Season | None) -> Carried | None:
    """Return a season's ratings as they are known at the start of the next one.

    Whoever was less sure than a newcomer is stays as sure as that.
    """
    document = store.frozen(season) if season else None
    if document is None:
        return None
    prior_sd = document["standings"]["prior_sd"]
    entries, elo, sd = frozen_columns(document, "number", "elo", "sd")
    sd = np.minimum(np.hypot(sd, SEASON_SD), np.maximum(sd, prior_sd))
    return Carried(entries, elo, sd, prior_sd)


def frozen_columns(document: Mapping[str, Any], *names: str) -> list[np.ndarray]:
    """Return what a season's frozen standings say of its entries, by their numbers."""
    rows = sorted(document["standings"]["entries"], key=lambda row: row["number"])
    return [np.array([row[name] for row in rows]) for name in names]


@dataclass(frozen=True)
class Runs:
    """How the races of each entry went, by its number."""

    tracks: tuple[str, ...]
    first: np.ndarray  # races in which it came first, (numbers,)
    known: np.ndarray  # races of which it is known, (numbers,)
    finished: np.ndarray  # races in which all laps were driven, (numbers,)
    laps_ms: np.ndarray  # best lap, and best clean lap, infinite for none, (2, tracks, numbers)

    @classmethod
    def of(cls, races: Races, tracks: tuple[str, ...], entries: Sequence[LeagueEntry]) -> Runs:
        """Count the races, finishes and best laps of all entries."""
        size = 1 + max((entry.number for entry in entries), default=0)
        first, known, finished = np.zeros(size), np.zeros(size), np.zeros(size)
        best_ms, clean_ms = laps_ms = np.full((2, len(tracks) * size), np.inf)
        for slot in range(races.entries.shape[1]):
            first += np.bincount(races.entries[races.places[:, slot] == 1, slot], minlength=size)
            rows = np.flatnonzero(races.runs[:, slot] & records.KNOWN)
            entry, run = races.entries[rows, slot], races.runs[rows, slot]
            known += np.bincount(entry, minlength=size)
            finished += np.bincount(entry, (run & records.FINISHED) > 0, size)
            lap_ms, track = run & records.BEST_MS, races.track[rows]
            timed = (lap_ms > 0) & (track < len(tracks))
            place = track[timed].astype(np.int64) * size + entry[timed]
            clean, lap_ms = (run[timed] & records.CLEAN) > 0, lap_ms[timed].astype(float)
            np.minimum.at(best_ms, place, lap_ms)
            np.minimum.at(clean_ms, place[clean], lap_ms[clean])
        return cls(tracks, first, known, finished, laps_ms.reshape(2, len(tracks), size))

    def laps_s(self, numbers: Sequence[int], *, clean: bool) -> list[dict[str, float]]:
        """Return the best laps, or best clean laps, of some entries [s] by track."""
        return [
            {
                track: lap_ms / 1000
                for track, lap_ms in zip(self.tracks, laps_ms, strict=True)
                if lap_ms < np.inf
            }
            for laps_ms in self.laps_ms[int(clean)][:, numbers].T.tolist()
        ]

    def joined(self, later: Runs) -> Runs:
        """Return how these races and later ones of the same entries went."""
        return Runs(
            self.tracks,
            self.first + later.first,
            self.known + later.known,
            self.finished + later.finished,
            np.minimum(self.laps_ms, later.laps_ms),
        )
