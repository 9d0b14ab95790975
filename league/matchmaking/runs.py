"""How the races of each entry went: wins, finishes and laps, for all entries at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from league.matchmaking.store import BEST_MS, CLEAN, FINISHED, KNOWN, LeagueEntry, Races


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

    def best_laps_s(self, numbers: Sequence[int]) -> list[dict[str, float]]:
        """Return the best laps of some entries [s] by track."""
        return self._laps_s(0, numbers)

    def clean_laps_s(self, numbers: Sequence[int]) -> list[dict[str, float]]:
        """Return the best clean laps of some entries [s] by track."""
        return self._laps_s(1, numbers)

    def _laps_s(self, clean: int, numbers: Sequence[int]) -> list[dict[str, float]]:
        return [
            {
                track: lap_ms / 1000
                for track, lap_ms in zip(self.tracks, laps_ms, strict=True)
                if lap_ms < np.inf
            }
            for laps_ms in self.laps_ms[clean][:, numbers].T.tolist()
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
