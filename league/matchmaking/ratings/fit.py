"""Maximum a posteriori Bradley-Terry ratings by damped Newton steps, their prior learned.

`fit` starts from the races alone, `updated` adds a few races to a fit.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import aslinearoperator, cg
from scipy.special import wrightomega

from league.matchmaking.ratings import pair_counts
from league.matchmaking.ratings.pair_counts import (
    ELO,
    EMPTY,
    PairCounts,
    RatingData,
    Results,
    Squares,
)
from league.matchmaking.ratings.systems import Blocks, Dense, Sparse, Variances
from league.matchmaking.ratings.table import SIGMAS_95, Carried, Posterior, Ratings

ANCHOR_ELO = 1000.0  # where the anchor is pinned
SPREAD_LIMITS = 20.0, 400.0  # a learned spread is at least, and at most, this [Elo]
USUAL_SPREAD = 300.0  # spread of a field of drivers before any race [Elo]
SPREAD_DOUBT = np.log(3.0)
"""Standard deviation of the logarithm of a field's spread: it is known to a factor of three."""
ENOUGH = 1e-6
"""A Newton step this small [natural units] is the last one: it leaves an error of its square."""
ENOUGH_FAR = 1e-3  # the same while the spread of the field is still far from settled
MOST_SPREADS = 40  # spreads that are tried at most
FAR = 2.0  # the logarithm of a field's variance is moved by this at most in one step
NEAR = 0.1  # after a step of that logarithm this small the next spread is as good as settled
SETTLED = 1e-5  # a step of that logarithm this small is the last one
ENOUGH_LATER = 1e-4
"""A step this small [natural units] is the last one where races are added to a fit."""
MOST_STEPS = 20  # steps then at most; each is at most of one natural unit


@dataclass(frozen=True)
class RatingSettings:
    """What a league may choose about its ratings."""

    prior_sd: float | None = None
    """Spread of the field before any race [Elo]; None learns it from the field."""
    slot_sd: float = 300.0  # how far two grid slots may differ in worth, before any race [Elo]
    dense_most: int = 1500
    """Entries that met others up to which variances are exact; of more they are right to 1 %, for
    the cube of these would be too slow."""


def fit(
    races: Results | RatingData,
    settings: RatingSettings | None = None,
    *,
    entries: Iterable[int] = (),
    anchor: int | None = None,
    carried: Carried | None = None,
    near: Ratings | None = None,
    pause: Callable[[], None] = lambda: None,
) -> Ratings:
    """Rate a field from all its races.

    Args:
        races: in any order; or counted already.
        settings: the league's choices.
        entries: numbers to rate even if they have not raced yet (where races are not counted yet).
        anchor: the entry that is 1000, one of the field.
        carried: ratings of an earlier season, which these races change.
        near: ratings by nearly the same races: the search begins there and is short.
        pause: called between steps, so that a thread with more urgent work can have its turn.
    """
    data = races if isinstance(races, RatingData) else RatingData.of(races, entries)
    settings = settings or RatingSettings()
    model = _Model(data, settings, carried, near, pause)
    prior_sd = carried.prior_sd if carried and settings.prior_sd is None else settings.prior_sd
    posterior = model.learned() if prior_sd is None else model.at(prior_sd)
    pause()
    squares = Squares.of(data.results, posterior.parameters, model.prior(posterior.prior_sd))
    pause()
    variances = Variances(posterior.system, squares, posterior.weights)
    pause()
    return _ratings(data, posterior, variances, anchor, model.num_spreads)


def refit(
    data: RatingData,
    like: Ratings,
    carried: Carried | None = None,
    pause: Callable[[], None] = lambda: None,
) -> np.ndarray:
    """Return what ratings would be by part of their races [Elo], under the same prior."""
    posterior = _Model(data, RatingSettings(), carried, like, pause).at(like.prior_sd)
    return _elo(data, posterior, like.anchor)


class _Model:
    """A field's log-posterior; each climb begins where the last one ended."""

    def __init__(
        self,
        data: RatingData,
        settings: RatingSettings,
        carried: Carried | None,
        near: Ratings | None,
        pause: Callable[[], None] = lambda: None,
    ) -> None:
        self._counts, self._settings, self._pause = data.counts, settings, pause
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

    def at(self, prior_sd: float, enough: float = ENOUGH) -> Posterior:
        """Climb to the best parameters under a prior, until a step is small enough."""
        prior, at = self.prior(prior_sd), self._last
        form = Dense if len(self._counts.met) <= self._settings.dense_most else Sparse
        self.num_spreads += 1
        seen = pair_counts.slope(self._counts, at)
        value = seen.value - 0.5 * float(prior @ (at - self._mean) ** 2)
        far = 1.0
        for _ in range(100):
            self._pause()
            system = form(Blocks(self._counts, seen.weights, prior))
            gradient = seen.gradient - prior * (at - self._mean)
            # A step that others follow need not be exact: the next one's error is its square.
            step = system.solve(gradient, within=min(1e-2, max(1e-6, 1e-2 * far)))
            promised = float(gradient @ step)
            far = float(np.abs(step).max())
            if far < enough:
                self._last = at + step
                return Posterior(self._last, system, prior_sd, self._shares(seen.weights))
            length = min(1.0, 4.0 / far)
            while True:
                tried = at + length * step
                seen = pair_counts.slope(self._counts, tried)
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

    def learned(self) -> Posterior:
        """Return the posterior under the spread that the field itself shows.

        The spread is the fixed point of the EM step: from the strengths' squares and posterior
        variances follows the likeliest spread. The prior of the spread itself keeps it from
        collapsing where a few races say little of it.

        Where races say little of the strengths (the front slot decides them all), the EM step is
        tiny everywhere, near the fixed point or not. So the root of its drift is sought, by
        Newton's steps on the logarithm of the variance, kept within a bracket.
        """
        if not len(self._counts.met):
            return self.at(USUAL_SPREAD)
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

    def _drift(self, posterior: Posterior, spread: float) -> tuple[float, float, np.ndarray]:
        """Return the EM step, its slope by the logarithm of the variance, and the parameters'.

        Entries that met no other tell nothing of the spread, so they are left out of its means.
        """
        met = self._counts.met
        size, strengths = len(met), posterior.parameters[met]
        precision = np.exp(-spread) * ELO**2
        right = np.zeros(self._counts.size)
        right[met] = precision * strengths
        # As the prior loosens, d strengths = H^-1 (precision strengths) du, and their variances
        # change by d H^-1 = H^-1 precision H^-1 du.
        towards = posterior.system.solve(right, within=1e-4)
        variance, twice = posterior.system.mean_variance()
        square = float((strengths**2).mean()) + variance
        rise = 2.0 * float(strengths @ towards[met]) / size + precision * twice
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


def _elo(data: RatingData, posterior: Posterior, anchor: int | None) -> np.ndarray:
    strengths = posterior.parameters[: len(data.entries)]
    zero = strengths[np.searchsorted(data.entries, anchor)] if anchor is not None else 0.0
    return ANCHOR_ELO + ELO * (strengths - zero)


def _ratings(
    data: RatingData,
    posterior: Posterior,
    variances: Variances,
    anchor: int | None,
    num_spreads: int,
) -> Ratings:
    """Convert a posterior to Elo, with intervals and flags."""
    entries, races, size = data.entries, data.races, len(data.entries)
    elo = _elo(data, posterior, anchor)
    sd = elo_sd = ELO * np.sqrt(variances.strengths)
    pairs, points = data.counts.points()
    group = pair_counts.groups(data.counts.one, data.counts.other, size)
    home = np.bincount(group, races).argmax()
    if anchor is not None:  # what is published is the lead over the anchor
        at = int(np.searchsorted(entries, anchor))
        home, elo_sd = group[at], ELO * np.sqrt(variances.against(at))
    connected = (group == home) & ((races > 0) | (size == 1))
    return Ratings(
        entries=entries,
        elo=elo,
        sd=sd,
        low95=elo - SIGMAS_95 * elo_sd,
        high95=elo + SIGMAS_95 * elo_sd,
        races=races,
        pairs=pairs,
        points=points,
        connected=connected,
        slot_advantages=ELO * posterior.parameters[size:],
        slot_sd=ELO * np.sqrt(variances.slots()),
        prior_sd=posterior.prior_sd,
        anchor=anchor,
        num_races=len(data.results),
        num_spreads=num_spreads,
        posterior=posterior,
        gap_variance=lambda one, other: ELO**2 * variances.gap(one, other),
    )


def updated(fitted: Ratings, later: Results) -> Ratings | None:
    """Return ratings by more races than they were fitted to; None where they need a fit.

    It takes a hundredth of the time of a fit. Around the best parameters of the races that were
    fitted, the log-posterior is taken for the parabola that it nearly is; what later races say is
    exact. So the error is of the third order in how far strengths have moved since: far below
    their standard deviation as long as few races are new. The spread of the field is not learned
    again, and intervals shrink by what the later races tell of each entry, as if its opponents'
    strengths were known.

    Args:
        fitted: what `fit` returned.
        later: races that it did not know.
    """
    slots = len(fitted.slot_advantages)
    place = np.searchsorted(fitted.entries, later.entries).clip(max=len(fitted.entries) - 1)
    raced = later.entries != EMPTY
    known = (fitted.entries[place] == later.entries) | ~raced
    if not known.all() or later.entries.shape[1] > slots:
        return None
    room = ((0, 0), (0, slots - later.entries.shape[1]))
    entries = np.pad(np.where(raced, place, EMPTY), room, constant_values=EMPTY)
    results = Results(later.heats, entries, np.pad(later.places, room))
    counts = pair_counts.count(results, len(fitted.entries))
    parameters, weights = _climbed(fitted, counts)
    return _rated(fitted, results, counts, parameters, weights)


def _climbed(fitted: Ratings, counts: PairCounts) -> tuple[np.ndarray, np.ndarray]:
    """Return the best parameters, and the curvature of each cell there."""
    posterior = fitted.posterior
    at, system = posterior.parameters, posterior.system
    for _ in range(MOST_STEPS):
        seen = pair_counts.slope(counts, at)
        later = Sparse(Blocks(counts, seen.weights, np.zeros(counts.size)))
        step, _ = cg(
            aslinearoperator(system) + aslinearoperator(later),
            seen.gradient - system.matvec(at - posterior.parameters),
            rtol=1e-5,
            maxiter=1000,
            M=sparse.diags_array(1.0 / (system.diagonal + later.diagonal)),
        )
        far = float(np.abs(step).max())
        at = at + min(1.0, 1.0 / max(far, ENOUGH_LATER)) * step
        if far < ENOUGH_LATER:
            break
    return at, pair_counts.slope(counts, at).weights


def _rated(
    fitted: Ratings,
    results: Results,
    counts: PairCounts,
    parameters: np.ndarray,
    weights: np.ndarray,
) -> Ratings:
    """Return the table with what has changed by some races: all of them by index."""
    size = counts.num_entries
    moved = ELO * (parameters - fitted.posterior.parameters)
    zero = moved[fitted.index(fitted.anchor)] if fitted.anchor is not None else 0.0
    elo = fitted.elo + moved[:size] - zero
    information = np.add(*counts.by_entry(counts.by_pair(weights))) / ELO**2
    sd = fitted.sd / np.sqrt(1.0 + fitted.sd**2 * information)
    interval_sd = (fitted.high95 - fitted.low95) / (2 * SIGMAS_95)
    reach = SIGMAS_95 * interval_sd / np.sqrt(1.0 + interval_sd**2 * information)
    connected = fitted.connected.copy()
    raced = results.entries != EMPTY
    at_home = (connected[results.entries] & raced).any(axis=1)
    connected[results.entries[at_home][raced[at_home]]] = True
    more, points = counts.points()
    return replace(
        fitted,
        elo=elo,
        sd=sd,
        low95=elo - reach,
        high95=elo + reach,
        races=fitted.races + np.bincount(results.entries[raced], minlength=size),
        pairs=fitted.pairs + more,
        points=fitted.points + points,
        connected=connected,
        slot_advantages=ELO * parameters[size:],
        num_races=fitted.num_races + len(results),
    )
