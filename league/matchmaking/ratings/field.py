"""A field made ready for the rating: its races each once, its entries by index, its pairs counted.

The fit, the test of fit and the standings all read these tables, so they are made once.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from league.matchmaking.ratings.pair_counts import Evidence, evidence_of
from league.matchmaking.ratings.results import NOBODY, Results


@dataclass(frozen=True)
class Field:
    """The races of some entries, condensed."""

    entries: np.ndarray
    """Entry numbers, ascending, (entries,)."""
    results: Results
    """Each race once, sorted by heat; their entries are indices into `entries`."""
    races: np.ndarray
    """Races each entry started in, (entries,)."""
    evidence: Evidence
    """Counts of the pairs that met, by index."""

    @classmethod
    def of(cls, results: Results, extra: Iterable[int] = ()) -> Field:
        """Count the races of a field.

        Args:
            results: the races, in any order, delivered once or more often.
            extra: entry numbers that belong to the field even if they have not raced yet.

        Raises:
            ConfigError: contradicting results.
        """
        results = results.distinct()
        wanted = np.fromiter(extra, dtype=np.int64)
        top = int(max(results.entries.max(initial=NOBODY), wanted.max(initial=NOBODY))) + 1
        there = results.entries.ravel()
        whole = bool(there.min(initial=0) >= 0)
        counts = np.bincount(there if whole else there[there >= 0], minlength=top)
        known = counts > 0
        known[wanted] = True
        names = np.flatnonzero(known)
        index = np.full(top + 1, NOBODY)  # its last place is where -1 looks
        index[names] = np.arange(len(names))
        indexed = Results(results.heats, index[results.entries], results.places)
        return cls(names, indexed, counts[names], evidence_of(indexed, len(names)))
