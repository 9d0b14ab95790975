"""Maximum a posteriori Bradley-Terry ratings by damped Newton steps, their prior learned."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.special import ndtr, wrightomega

from league.errors import ConfigError
from league.matchmaking.ratings import systems
from league.matchmaking.ratings.pair_counts import ELO, RatingData, Results, slope
from league.matchmaking.ratings.systems import Squares, System, Variances

SIGMAS_95 = 1.959963984540054
"""Half width of a 95 % interval in standard deviations."""
ANCHOR_ELO = 1000.0
"""Where the anchor is pinned."""
SPREAD_LIMITS = 20.0, 400.0
"""A learned spread is at least, and at most, this [Elo]."""
PROVISIONAL_SD = 50.0
"""Ratings less sure than this are marked provisional [Elo]."""
USUAL_SPREAD = 300.0
"""Spread of a field of drivers before any race [Elo]."""
SPREAD_DOUBT = np.log(3.0)
"""Standard deviation of the logarithm of a field's spread: it is known to a factor of three."""
ENOUGH = 1e-6
"""A Newton step this small [natural units] is the last one: it leaves an error of its square."""
ENOUGH_FAR = 1e-3
"""The same while the spread of the field is still far from settled."""
MOST_SPREADS = 40
"""Spreads that are tried at most."""
FAR = 2.0
"""The logarithm of a field's variance is moved by this at most in one step."""
NEAR = 0.1
"""After a step of that logarithm this small the next spread is as good as settled."""
SETTLED = 1e-5
"""A step of that logarithm this small is the last one."""


def expected_score(gap_elo: float | np.ndarray) -> float | np.ndarray:
    """Return the chance to finish ahead of an opponent weaker by this gap [Elo], ties half."""
    return 1.0 / (1.0 + 10.0 ** (-np.asarray(gap_elo, dtype=float) / 400.0))


@dataclass(frozen=True)
class RatingSettings:
    """What a league may choose about its ratings."""

    prior_sd: float | None = None
    """Spread of the field before any race [Elo]; None learns it from the field."""
    slot_sd: float = 300.0
    """How far two grid slots may differ in worth, before any race [Elo]."""
    dense_most: int = systems.DENSE_MOST
    """Entries up to which variances are exact; in larger fields they are estimated to about 1 %."""

    def __post_init__(self) -> None:
        for name in ("prior_sd", "slot_sd"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise ConfigError(f"{name} is {value}: give a spread above 0 Elo")


@dataclass(frozen=True)
class Carried:
    """What is known of a field before its first race: the ratings of an earlier season."""

    entries: np.ndarray
    """Entry numbers, one or more, ascending, (entries,)."""
    elo: np.ndarray
    """Their ratings then [Elo], (entries,); all others are expected at the mean of these."""
    sd: np.ndarray
    """How sure these still are [Elo], (entries,)."""
    prior_sd: float
    """Spread of entries that are not among them [Elo]; it is not learned again."""

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
class Ratings:
    """Strengths of a field, all from one table of races."""

    entries: np.ndarray
    """Entry numbers, ascending, (entries,)."""
    elo: np.ndarray
    """Strength [Elo], the anchor's 1000; 400 more are ten times the odds, (entries,)."""
    sd: np.ndarray
    """Standard deviation of the place above or below the average of all others [Elo], (entries,).

    The average counts each entry by the information in its races, so newcomers do not blur it.
    """
    low95: np.ndarray
    """Lower end of the 95 % interval of `elo`, as it stands relative to the anchor, (entries,)."""
    high95: np.ndarray
    """Upper end of it; the anchor's own interval is a point, (entries,)."""
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
    """Spread of the field, learned from it [Elo]."""
    anchor: int | None
    """Entry pinned to 1000; without one the field's mean is."""
    num_races: int
    """Races that counted."""
    num_spreads: int
    """Spreads of the field tried before the likeliest was settled."""
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

    def line(self, at: int, *names: str) -> dict[str, Any]:
        """Return what some of the tables hold of an entry, by its index."""
        return {name: getattr(self, name)[at].item() for name in names}

    def difference(self, one: int, other: int) -> Difference:
        """Return how far one entry is ahead of another, with its own interval."""
        a, b = self.index(one), self.index(other)
        gap = float(self.elo[a] - self.elo[b])
        sd = float(np.sqrt(self.gap_variances(np.array([a]), np.array([b]))[0]))
        return Difference(
            elo=gap,
            sd=sd,
            low95=gap - SIGMAS_95 * sd,
            high95=gap + SIGMAS_95 * sd,
            superiority=float(ndtr(gap / sd)) if sd > 0 else 0.5,
        )

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


def _strengths(rated: Carried | Ratings, entries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return strengths of some entries [natural units], 0 if new, and their places, -1 if new.

    Strengths count from the mean of all that are rated.
    """
    nearest = np.searchsorted(rated.entries, entries).clip(max=len(rated.entries) - 1)
    place = np.where(rated.entries[nearest] == entries, nearest, -1)
    return np.where(place >= 0, (rated.elo[place] - rated.elo.mean()) / ELO, 0.0), place


def fit(
    races: Results | RatingData,
    settings: RatingSettings | None = None,
    *,
    entries: Iterable[int] = (),
    anchor: int | None = None,
    carried: Carried | None = None,
    near: Ratings | None = None,
) -> Ratings:
    """Rate a field from all its races.

    Args:
        races: in any order, delivered once or more often; or counted already.
        settings: the league's choices.
        entries: numbers to rate even if they have not raced yet (where races are not counted yet).
        anchor: the entry that is 1000.
        carried: ratings of an earlier season, which these races change.
        near: ratings by nearly the same races: the search begins there and is short.

    Raises:
        ConfigError: no entry to rate, an anchor that is not in the field, contradicting results.
    """
    data = races if isinstance(races, RatingData) else RatingData.of(races, entries)
    settings = settings or RatingSettings()
    if not len(data.entries):
        raise ConfigError("there are no entries to rate: submit one, or give results")
    if anchor is not None and anchor not in data.entries:
        raise ConfigError(f"anchor {anchor} is not in the field: name one of its entries")
    model = _Model(data, settings, carried, near)
    prior_sd = carried.prior_sd if carried and settings.prior_sd is None else settings.prior_sd
    posterior = model.learned() if prior_sd is None else model.at(prior_sd)
    squares = Squares.of(data.results, posterior.parameters, model.prior(posterior.prior_sd))
    variances = Variances(posterior.system, squares, posterior.weights)
    return _ratings(data, posterior, variances, anchor, model.num_spreads)


def refit(data: RatingData, like: Ratings, carried: Carried | None = None) -> np.ndarray:
    """Return what ratings would be by part of their races [Elo], under the same prior."""
    posterior = _Model(data, RatingSettings(), carried, like).at(like.prior_sd)
    return _elo(data, posterior, like.anchor)


@dataclass(frozen=True)
class _Posterior:
    """The best parameters under one prior."""

    parameters: np.ndarray
    """Strengths and slots [natural units]."""
    system: System
    """The curvature there."""
    prior_sd: float
    """Spread of the strengths [Elo]."""
    weights: np.ndarray
    """What each entry counts in the field's average, (entries,)."""


class _Model:
    """A field's log-posterior; each climb begins where the last one ended."""

    def __init__(
        self,
        data: RatingData,
        settings: RatingSettings,
        carried: Carried | None,
        near: Ratings | None,
    ) -> None:
        self._counts, self._settings = data.counts, settings
        self._mean = np.zeros(data.counts.size)
        self._precisions = np.full(len(data.entries), np.nan)
        if carried is not None:
            self._mean[: len(data.entries)], self._precisions = carried.at(data.entries)
        self._last = self._mean
        self._spread, self._enough = USUAL_SPREAD, ENOUGH_FAR
        if near is not None:  # its parameters and spread are nearly the best
            self._last = near.at(data.entries, data.counts.size)
            self._spread, self._enough = near.prior_sd, ENOUGH
        self.num_spreads = 0

    def prior(self, prior_sd: float) -> np.ndarray:
        """Return the precision of each parameter."""
        precisions = np.full(self._counts.size, (ELO / prior_sd) ** 2)
        known = ~np.isnan(self._precisions)
        precisions[: len(known)][known] = self._precisions[known]
        # Each of two slots has half the variance of their difference.
        precisions[self._counts.num_entries :] = 2.0 * (ELO / self._settings.slot_sd) ** 2
        return precisions

    def at(self, prior_sd: float, enough: float = ENOUGH) -> _Posterior:
        """Climb to the best parameters under a prior, until a step is small enough."""
        prior, at = self.prior(prior_sd), self._last
        self.num_spreads += 1
        seen = slope(self._counts, at)
        value = seen.value - 0.5 * float(prior @ (at - self._mean) ** 2)
        far = 1.0
        for _ in range(100):
            system = systems.system(
                self._counts, seen.weights, prior, dense_most=self._settings.dense_most
            )
            gradient = seen.gradient - prior * (at - self._mean)
            # A step that others follow need not be exact: the next one's error is its square.
            step = system.solve(gradient, within=min(1e-2, max(1e-6, 1e-2 * far)))
            promised = float(gradient @ step)
            far = float(np.abs(step).max())
            if far < enough:
                self._last = at + step
                return _Posterior(self._last, system, prior_sd, self._shares(seen.weights))
            length = min(1.0, 4.0 / far)
            while True:
                tried = at + length * step
                seen = slope(self._counts, tried)
                now = seen.value - 0.5 * float(prior @ (tried - self._mean) ** 2)
                # Rounding hides gains below a billionth; there the full step is right anyway.
                if now >= value + 1e-4 * length * promised - 1e-9 * abs(value) or length < 1e-6:
                    break
                length *= 0.5
            at, value = tried, now
        raise ArithmeticError("the fit of the ratings did not settle in 100 Newton steps")

    def _shares(self, weights: np.ndarray) -> np.ndarray:
        """Return how much each entry counts in the field's average: by what its races tell, sum 1.

        No share is above a half, as each pair counts for both of its entries.
        """
        shares = np.add(*self._counts.by_entry(self._counts.by_pair(weights)))
        total = shares.sum()
        return shares / total if total > 0 else shares

    def learned(self) -> _Posterior:
        """Return the posterior under the spread that the field itself shows.

        The spread is the fixed point of the EM step: from the strengths' squares and posterior
        variances follows the likeliest spread. The prior of the spread itself keeps it from
        collapsing where a few races say little of it.

        Where races say little of the strengths (the front slot decides them all), the EM step is
        tiny everywhere, near the fixed point or not. So the root of its drift is sought, by
        Newton's steps on the logarithm of the variance, kept within a bracket.
        """
        bounds = low, high = tuple(float(2 * np.log(limit)) for limit in SPREAD_LIMITS)
        spread = float(np.clip(2 * np.log(self._spread), low, high))
        enough, last = self._enough, None
        for _ in range(MOST_SPREADS):
            posterior = self.at(float(np.exp(0.5 * spread)), enough)
            drift, bend, towards = self._drift(posterior, spread)
            low, high = (spread, high) if drift > 0 else (low, spread)
            if last is not None and (abs(spread - last[0]) < NEAR or drift * last[1] < 0):
                # Two drifts around a slope are more accurate than what probes estimate of it.
                between = (drift - last[1]) / ((spread - last[0]) or np.inf)
                bend = between if between < 0 else bend
            last = spread, drift
            step = float(np.clip(drift / max(-bend, 1e-12), -FAR, FAR))
            end = high if drift > 0 else low
            if abs(step) >= abs(end - spread):  # beyond the bracket: half the way to its end
                step = end - spread if end in bounds else 0.5 * (end - spread)
            # The next spread's best parameters lie along their slope.
            self._last = self._last + step * towards
            if step == 0.0 and enough == ENOUGH:  # at a limit
                return posterior
            spread += step
            if abs(step) < SETTLED and enough == ENOUGH:
                break
            if abs(step) < NEAR and enough == ENOUGH_FAR:
                enough, (low, high) = ENOUGH, bounds  # signs of a rough drift may be wrong
        return self.at(float(np.exp(0.5 * spread)))

    def _drift(self, posterior: _Posterior, spread: float) -> tuple[float, float, np.ndarray]:
        """Return the EM step, its slope by the logarithm of the variance, and the parameters'."""
        size = self._counts.num_entries
        strengths = posterior.parameters[:size]
        precision = np.exp(-spread) * ELO**2
        right = np.zeros(self._counts.size)
        right[:size] = precision * strengths
        # As the prior loosens, d strengths = H^-1 (precision strengths) du, and their variances
        # change by d H^-1 = H^-1 precision H^-1 du.
        towards = posterior.system.solve(right, within=1e-4)
        variance, twice = posterior.system.mean_variance()
        square = float((strengths**2).mean()) + variance
        rise = 2.0 * float(strengths @ towards[:size]) / size + precision * twice
        likeliest = _likeliest(square * ELO**2, size)
        data = size * square * ELO**2 * np.exp(-likeliest)
        share = data / (data + 2 / (2 * SPREAD_DOUBT) ** 2)
        return likeliest - spread, share * rise / square - 1.0, towards


def _likeliest(square: float, size: int) -> float:
    """Return the likeliest logarithm u of a field's variance, given its strengths' mean square.

    It is where the slope of log Normal(strengths; 0, e^u) + log Normal(u; u0, w^2) is 0,

        size * square * e^-u - size - 2 (u - u0) / w^2 = 0,

    with u0 and w of USUAL_SPREAD and SPREAD_DOUBT (u is twice the logarithm of the spread). With
    n = size w^2 / 2 and x = u - u0 + n that is x + log x = log(n square) + n - u0.
    """
    usual, n = 2 * np.log(USUAL_SPREAD), size * 2 * SPREAD_DOUBT**2
    return float(usual - n + wrightomega(np.log(n * square) + n - usual).real)


def _elo(data: RatingData, posterior: _Posterior, anchor: int | None) -> np.ndarray:
    strengths = posterior.parameters[: len(data.entries)]
    zero = strengths[np.searchsorted(data.entries, anchor)] if anchor is not None else 0.0
    return ANCHOR_ELO + ELO * (strengths - zero)


def _ratings(
    data: RatingData,
    posterior: _Posterior,
    variances: Variances,
    anchor: int | None,
    num_spreads: int,
) -> Ratings:
    """Convert a posterior to Elo, with intervals and flags."""
    entries, races, size = data.entries, data.races, len(data.entries)
    elo = _elo(data, posterior, anchor)
    sd = elo_sd = ELO * np.sqrt(variances.strengths)
    if anchor is not None:  # what is published is the lead over the anchor
        elo_sd = ELO * np.sqrt(variances.against(int(np.searchsorted(entries, anchor))))
    pairs, points = data.counts.points()
    group = data.counts.groups()
    if anchor is not None:
        home = group[np.searchsorted(entries, anchor)]
    else:
        home = np.bincount(group, races).argmax()
    connected = (group == home) & ((races > 0) | (size == 1))
    return Ratings(
        entries=entries,
        elo=elo,
        sd=sd,
        low95=elo - SIGMAS_95 * elo_sd,
        high95=elo + SIGMAS_95 * elo_sd,
        races=races,
        provisional=(sd > PROVISIONAL_SD) | ~connected,
        connected=connected,
        one_sided=(pairs > 0) & ((points == 0) | (points == pairs)),
        slot_advantages=ELO * posterior.parameters[size:],
        slot_sd=ELO * np.sqrt(variances.slots()),
        prior_sd=posterior.prior_sd,
        anchor=anchor,
        num_races=len(data.results),
        num_spreads=num_spreads,
        gap_variances=lambda one, other: ELO**2 * variances.gaps(one, other),
    )
