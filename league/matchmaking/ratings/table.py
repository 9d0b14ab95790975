"""The outcome of a rating: strengths with their intervals, and what they say about pairs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from league.errors import ConfigError

SIGMAS_95 = 1.959963984540054
"""Half width of a 95 % interval in standard deviations."""


def expected_score(gap_elo: float | np.ndarray) -> float | np.ndarray:
    """Return the chance to finish ahead of somebody weaker by this gap [Elo], ties half."""
    return 1.0 / (1.0 + 10.0 ** (-np.asarray(gap_elo, dtype=float) / 400.0))


@dataclass(frozen=True)
class Difference:
    """How far one entry is ahead of another."""

    elo: float
    """Difference of the ratings [Elo]."""
    sd: float
    """Its standard deviation [Elo]; usually less than the two entries' own would add up to."""
    low95: float
    """Lower end of its 95 % interval [Elo]."""
    high95: float
    """Upper end of its 95 % interval [Elo]."""
    superiority: float
    """Probability that the one is the stronger, given the races."""


@dataclass(frozen=True)
class Ratings:
    """Strengths of a field, all from one table of races."""

    entries: np.ndarray
    """Entry numbers, ascending, (entries,)."""
    elo: np.ndarray
    """Strength [Elo], the anchor's 1000; 400 more are ten times the odds, (entries,)."""
    sd: np.ndarray
    """Standard deviation of the place above or below the average of all others [Elo], (entries,).

    The average counts each entry by what its races tell, so newcomers do not blur it.
    """
    low95: np.ndarray
    """Lower end of the 95 % interval [Elo], (entries,)."""
    high95: np.ndarray
    """Upper end of the 95 % interval [Elo], (entries,)."""
    races: np.ndarray
    """Races started, (entries,)."""
    provisional: np.ndarray
    """True while sd is above 50, or the entry is not connected, (entries,)."""
    connected: np.ndarray
    """False where no chain of races leads to the anchor (or the largest group), (entries,)."""
    one_sided: np.ndarray
    """True for entries that raced and won, or lost, every pair: only the prior holds them."""
    slot_advantages: np.ndarray
    """What each grid slot is worth [Elo], 0 on average, slot 0 in front, (slots,)."""
    slot_sd: np.ndarray
    """Standard deviations of the slots' advantages [Elo], (slots,)."""
    prior_sd: float
    """DynamicsRandomization of the field, learned from it [Elo]."""
    anchor: int | None
    """Entry pinned to 1000; without one the field's mean is."""
    num_races: int
    """Races that counted."""
    num_spreads: int
    """Spreads of the field tried before the likeliest was found."""
    gap_variances: Callable[[np.ndarray, np.ndarray], np.ndarray] = field(repr=False, compare=False)
    """Variances [Elo^2] of rating differences, from two arrays of indices into `entries`."""

    def index(self, entry: int) -> int:
        """Return where an entry stands in the tables.

        Raises:
            ConfigError: it is not in the field.
        """
        place = int(np.searchsorted(self.entries, entry))
        if place >= len(self.entries) or self.entries[place] != entry:
            raise ConfigError(
                f"entry {entry} is not rated: name one of the {len(self.entries)} entries of "
                "this field"
            )
        return place

    def difference(self, one: int, other: int) -> Difference:
        """Return how far one entry is ahead of another, with its own interval."""
        return self.differences([(one, other)])[0]

    def differences(self, pairs: list[tuple[int, int]]) -> list[Difference]:
        """Return how far the one of each pair is ahead of the other."""
        from scipy.special import ndtr

        one = np.array([self.index(pair[0]) for pair in pairs], dtype=np.int64)
        other = np.array([self.index(pair[1]) for pair in pairs], dtype=np.int64)
        gaps = self.elo[one] - self.elo[other]
        sds = np.sqrt(self.gap_variances(one, other))
        return [
            Difference(
                elo=float(gap),
                sd=float(sd),
                low95=float(gap - SIGMAS_95 * sd),
                high95=float(gap + SIGMAS_95 * sd),
                superiority=float(ndtr(gap / sd)) if sd > 0 else 0.5,
            )
            for gap, sd in zip(gaps, sds, strict=True)
        ]

    def order(self) -> np.ndarray:
        """Return indices from best to worst; provisional ones by rating - 2 sd.

        Equals stay in the order of their numbers: rounding, which depends on the order in which
        races were read, must not turn them over.
        """
        shown = np.where(self.provisional, self.elo - 2 * self.sd, self.elo)
        return np.argsort(-np.round(shown, 6), kind="stable")
