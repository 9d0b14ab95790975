"""Ratings as a table: strengths of a field, how sure they are, and what they were found from."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr

from league.errors import ConfigError
from league.matchmaking.ratings.pair_counts import ELO
from league.matchmaking.ratings.systems import System

SIGMAS_95 = 1.959963984540054  # half width of a 95 % interval in standard deviations
PROVISIONAL_SD = 50.0  # ratings less sure than this are marked provisional [Elo]


def expected_score(gap_elo: float | np.ndarray) -> float | np.ndarray:
    """Return the chance to finish ahead of an opponent weaker by this gap [Elo], ties half."""
    return 1.0 / (1.0 + 10.0 ** (-np.asarray(gap_elo, dtype=float) / 400.0))


@dataclass(frozen=True)
class Carried:
    """What is known of a field before its first race: the ratings of an earlier season."""

    entries: np.ndarray  # entry numbers, one or more, ascending, (entries,)
    elo: np.ndarray
    """Their ratings then [Elo], (entries,); all others are expected at the mean of these."""
    sd: np.ndarray  # how sure these still are [Elo], (entries,)
    prior_sd: float  # spread of entries that are not among them [Elo]; it is not learned again

    def at(self, entries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the means [natural units] of some entries, and their precisions, NaN if new."""
        mean, place = _strengths(self, entries)
        return mean, np.where(place >= 0, (ELO / self.sd[place]) ** 2, np.nan)


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

    @property
    def sureness(self) -> str:
        """That probability in words that never say 0 or 100 %, which no races prove."""
        if self.superiority > 0.999:
            return "more than 99.9 %"
        if self.superiority < 0.001:
            return "less than 0.1 %"
        return f"{100 * self.superiority:.1f} %"


@dataclass(frozen=True)
class Posterior:
    """The best parameters under one prior."""

    parameters: np.ndarray  # strengths and slots [natural units]
    system: System  # the curvature there
    prior_sd: float  # spread of the strengths [Elo]
    weights: np.ndarray  # what each entry counts in the field's average, (entries,)


@dataclass(frozen=True)
class Strengths:
    """Ratings, as far as what they promise depends on them."""

    entries: np.ndarray  # entry numbers, ascending, (entries,)
    elo: np.ndarray
    """Strength [Elo], the anchor's 1000; 400 more are ten times the odds, (entries,)."""
    slot_advantages: np.ndarray
    """What each grid slot is worth [Elo], 0 on average, slot 0 in front, (slots,)."""


@dataclass(frozen=True)
class Ratings(Strengths):
    """Strengths of a field, all from one table of races."""

    sd: np.ndarray
    """Standard deviation of the place above or below the average of all others [Elo], (entries,).

    The average counts each entry by the information in its races, so newcomers do not blur it.
    """
    low95: np.ndarray
    """Lower end of the 95 % interval of `elo`, as it stands relative to the anchor, (entries,)."""
    high95: np.ndarray  # upper end of it; the anchor's own interval is a point, (entries,)
    races: np.ndarray  # races started, (entries,)
    pairs: np.ndarray  # cars met in them, (entries,)
    points: np.ndarray  # those of these it came in ahead of, ties half, (entries,)
    connected: np.ndarray
    """False where no chain of races leads to the anchor (or the largest group), (entries,)."""
    slot_sd: np.ndarray  # standard deviations of the slots' advantages [Elo], (slots,)
    prior_sd: float  # spread of the field, learned from it [Elo]
    anchor: int | None  # entry pinned to 1000; without one the field's mean is
    num_races: int  # races that counted
    num_spreads: int  # spreads of the field tried before the likeliest was settled
    posterior: Posterior = field(repr=False, compare=False)  # what all this follows from
    gap_variance: Callable[[int, int], float] = field(repr=False, compare=False)
    """Variance [Elo^2] of a difference of two ratings, from their indices."""

    def index(self, entry: int) -> int:
        """Return where an entry stands in the tables; a ConfigError if it is not in the field."""
        place = int(np.searchsorted(self.entries, entry))
        if place >= len(self.entries) or self.entries[place] != entry:
            raise ConfigError(
                f"entry {entry} is not rated: name one of the {len(self.entries)} entries of "
                "this field"
            )
        return place

    def line(self, at: int, *names: str) -> dict[str, Any]:
        """Return what some of the tables hold of an entry, by its index."""
        return {name: getattr(self, name)[at].item() for name in names}

    def difference(self, one: int, other: int) -> Difference:
        """Return how far one entry is ahead of another, with its own interval."""
        a, b = self.index(one), self.index(other)
        gap = float(self.elo[a] - self.elo[b])
        sd = math.sqrt(self.gap_variance(a, b))
        return Difference(
            elo=gap,
            sd=sd,
            low95=gap - SIGMAS_95 * sd,
            high95=gap + SIGMAS_95 * sd,
            superiority=float(ndtr(gap / sd)) if sd > 0 else 0.5,
        )

    @cached_property
    def provisional(self) -> np.ndarray:
        """True while sd is above 50, or the entry is not connected, (entries,)."""
        return (self.sd > PROVISIONAL_SD) | ~self.connected

    @property
    def one_sided(self) -> np.ndarray:
        """True for entries that raced and won, or lost, every pair: only the prior holds them."""
        return (self.pairs > 0) & ((self.points == 0) | (self.points == self.pairs))

    @cached_property
    def listed_by(self) -> np.ndarray:
        """What entries are listed by: the rating, of provisional ones rating - 2 sd [Elo]."""
        return np.where(self.provisional, self.elo - 2 * self.sd, self.elo)

    def at(self, entries: np.ndarray, size: int) -> np.ndarray:
        """Return so many parameters [natural units]: of some entries, 0 if new, then of slots."""
        parameters = np.zeros(size)
        parameters[: len(entries)], _ = _strengths(self, entries)
        slots = min(size - len(entries), len(self.slot_advantages))
        parameters[len(entries) :][:slots] = self.slot_advantages[:slots] / ELO
        return parameters

    def order(self) -> np.ndarray:
        """Return indices from best to worst, see `listed_by`.

        Equals stay in the order of their numbers: rounding, which depends on the order in which
        races were read, must not change their order.
        """
        return np.argsort(-np.round(self.listed_by, 6), kind="stable")

    def possible_ranks(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the best and the worst rank (from 0) that the races allow, in order of rank.

        An entry counts as above (below) another if its whole 95 % interval within the field is
        above (below) the other's: the anchor's uncertainty moves all of them together.
        """
        order = self.order()
        rank = np.arange(len(order))
        low, high = self.elo - SIGMAS_95 * self.sd, self.elo + SIGMAS_95 * self.sd
        above = len(order) - np.searchsorted(np.sort(low), high, side="right")
        below = np.searchsorted(np.sort(high), low, side="left")
        return np.minimum(rank, above[order]), np.maximum(rank, len(order) - 1 - below[order])


def _strengths(rated: Carried | Ratings, entries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return strengths of some entries [natural units], 0 if new, and their places, -1 if new.

    Strengths count from the mean of all that are rated.
    """
    nearest = np.searchsorted(rated.entries, entries).clip(max=len(rated.entries) - 1)
    place = np.where(rated.entries[nearest] == entries, nearest, -1)
    return np.where(place >= 0, (rated.elo[place] - rated.elo.mean()) / ELO, 0.0), place
