"""The fit: maximum a posteriori Bradley-Terry by damped Newton steps, its prior learned."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from league.errors import ConfigError
from league.matchmaking.ratings import evidence as ev
from league.matchmaking.ratings import intervals, systems
from league.matchmaking.ratings.evidence import ELO, Evidence
from league.matchmaking.ratings.results import NOBODY, Results
from league.matchmaking.ratings.systems import Maker, Squares, System
from league.matchmaking.ratings.table import SIGMAS_95, Ratings

ANCHOR_ELO = 1000.0
"""Where the anchor is pinned."""

USUAL_SPREAD = 300.0
"""Spread of a field of drivers before anything is known of it [Elo]."""
SPREAD_DOUBT = np.log(3.0)
"""Standard deviation of the logarithm of a field's spread: it is known to a factor of three."""

ENOUGH = 1e-6
"""A Newton step this small [natural units] is the last one: it leaves an error of its square."""


@dataclass(frozen=True)
class RatingSettings:
    """What a league may choose about its ratings."""

    prior_sd: float | None = None
    """Spread of the field before any race [Elo]; None learns it from the field."""
    least_prior_sd: float = 20.0
    """A learned spread is at least this [Elo]."""
    most_prior_sd: float = 400.0
    """A learned spread is at most this [Elo]."""
    slot_sd: float = 300.0
    """How far two grid slots may differ in worth, before any race [Elo]."""
    provisional_sd: float = 50.0
    """Ratings less sure than this are marked provisional [Elo]."""
    dense_most: int = systems.DENSE_MOST
    """Entries up to which variances are exact; in larger fields they are estimated to about 1 %."""

    def __post_init__(self) -> None:
        """Check that the spreads are possible."""
        if not 0 < self.least_prior_sd <= self.most_prior_sd:
            raise ConfigError(
                f"the prior's limits are {self.least_prior_sd} to {self.most_prior_sd} Elo: "
                "give two spreads above 0, the smaller one first"
            )
        for name in ("prior_sd", "slot_sd", "provisional_sd"):
            given = getattr(self, name)
            if given is not None and not 0 < given < np.inf:
                raise ConfigError(f"{name} is {given}: give a spread above 0 Elo")


def fit(
    results: Results,
    settings: RatingSettings | None = None,
    *,
    entries: Iterable[int] = (),
    anchor: int | None = None,
) -> Ratings:
    """Rate a field from all its races.

    Args:
        results: the races, in any order, delivered once or more often.
        settings: the league's choices.
        entries: numbers to rate even if they have not raced yet.
        anchor: the entry that is 1000.

    Raises:
        ConfigError: nobody to rate, an anchor that is not in the field, contradicting results.
    """
    settings = settings or RatingSettings()
    results = results.distinct()
    names, results, races = _numbered(results, entries)
    if not len(names):
        raise ConfigError("there are no entries to rate: submit one, or give results")
    if anchor is not None and anchor not in names:
        raise ConfigError(f"anchor {anchor} is not in the field: name one of its entries")
    evidence = ev.evidence_of(results, len(names))
    model = _Model(evidence, settings)
    posterior = model.learned() if settings.prior_sd is None else model.at(settings.prior_sd)
    prior = model.prior(posterior.prior_sd)
    squares = systems.squares(results, evidence, posterior.parameters, prior)
    return _table(names, races, results, evidence, posterior, squares, settings, anchor)


def _numbered(results: Results, extra: Iterable[int]) -> tuple[np.ndarray, Results, np.ndarray]:
    """Return the entries' numbers, the results by index into them, and the races of each."""
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
    return names, Results(results.heats, index[results.entries], results.places), counts[names]


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
    """A field's log-posterior; it remembers where the last climb ended, to begin there again."""

    def __init__(self, evidence: Evidence, settings: RatingSettings) -> None:
        self._evidence, self._settings = evidence, settings
        self._make: Maker = systems.maker(evidence, dense_most=settings.dense_most)
        self._last = np.zeros(evidence.size)

    def prior(self, prior_sd: float) -> np.ndarray:
        """Return the precision of each parameter."""
        precisions = np.full(self._evidence.size, (ELO / prior_sd) ** 2)
        # Each of two slots has half the variance of their difference.
        precisions[self._evidence.num_entries :] = 2.0 * (ELO / self._settings.slot_sd) ** 2
        return precisions

    def at(self, prior_sd: float) -> _Posterior:
        """Climb to the best parameters under a prior."""
        prior, at = self.prior(prior_sd), self._last
        seen = ev.slope(self._evidence, at)
        value = seen.value - 0.5 * float(prior @ at**2)
        for _ in range(100):
            system = self._make(seen.weights, prior)
            gradient = seen.gradient - prior * at
            step = system.solve(gradient, within=1e-5)
            promised = float(gradient @ step)
            far = float(np.abs(step).max())
            if far < ENOUGH:
                self._last = at + step
                counts = intervals.field_weights(self._evidence, seen.weights)
                return _Posterior(self._last, system, prior_sd, counts)
            length = min(1.0, 4.0 / far)
            while True:
                tried = at + length * step
                seen = ev.slope(self._evidence, tried)
                now = seen.value - 0.5 * float(prior @ tried**2)
                # Rounding hides gains below a billionth; there the full step is right anyway.
                if now >= value + 1e-4 * length * promised - 1e-9 * abs(value) or length < 1e-6:
                    break
                length *= 0.5
            at, value = tried, now
        raise ArithmeticError("the fit of the ratings did not settle in 100 Newton steps")

    def learned(self) -> _Posterior:
        """Return the posterior under the spread that the field itself shows.

        The spread is the fixed point of the EM step: from the strengths' squares and posterior
        variances follows the likeliest spread, found by secants on its logarithm. What is known
        of fields in general keeps it from collapsing where a few races tell nothing of it.
        """
        least, most = self._settings.least_prior_sd, self._settings.most_prior_sd
        bounds = 2 * np.log(least), 2 * np.log(most)
        spread, last = 2 * np.log(min(max(USUAL_SPREAD, least), most)), None
        for _ in range(60):
            posterior = self.at(float(np.exp(0.5 * spread)))
            strengths = posterior.parameters[: self._evidence.num_entries]
            square = float((strengths**2).mean()) + posterior.system.mean_variance()
            drift = _likeliest(square * ELO**2, len(strengths)) - spread
            if abs(drift) < 1e-9:
                return posterior
            step = drift
            if last is not None and drift != last[1]:
                secant = -drift * (spread - last[0]) / (drift - last[1])
                # A secant that points back, or far beyond, is of a curve too bent: the EM step.
                if 0 < secant / drift < 100:
                    step = secant
            last = (spread, drift)
            moved = float(np.clip(spread + step, *bounds))
            if abs(moved - spread) < 1e-9:
                return posterior
            spread = moved
        return posterior


def _likeliest(square: float, size: int) -> float:
    """Return the likeliest logarithm u of a field's variance, given its strengths' mean square.

    It is where the slope of log Normal(strengths; 0, e^u) + log Normal(u; u0, w^2) is 0,

        size * square * e^-u - size - 2 (u - u0) / w^2 = 0,

    with u0 and w of USUAL_SPREAD and SPREAD_DOUBT (u is twice the logarithm of the spread).
    """
    usual, doubt = 2 * np.log(USUAL_SPREAD), 2 * SPREAD_DOUBT
    # Left of the root of a convex falling curve, from where Newton's steps cannot overshoot.
    u = min(float(np.log(square)), float(usual))
    for _ in range(50):
        pull = size * square * np.exp(-u)
        slope = pull - size - 2 * (u - usual) / doubt**2
        step = float(slope / (pull + 2 / doubt**2))
        u += step
        if abs(step) < 1e-12:
            break
    return u


def _table(
    names: np.ndarray,
    races: np.ndarray,
    results: Results,
    evidence: Evidence,
    posterior: _Posterior,
    squares: Squares,
    settings: RatingSettings,
    anchor: int | None,
) -> Ratings:
    """Put a posterior into Elo, with intervals and flags."""
    size = len(names)
    strengths, slots = posterior.parameters[:size], posterior.parameters[size:]
    zero = strengths[np.searchsorted(names, anchor)] if anchor is not None else 0.0
    elo = ANCHOR_ELO + ELO * (strengths - zero)
    system = posterior.system
    variances = intervals.variances(system, squares, posterior.weights)
    sd = ELO * np.sqrt(variances.strengths)
    pairs, points = ev.points_of(evidence)
    group = ev.groups(evidence)
    if anchor is not None:
        home = group[np.searchsorted(names, anchor)]
    else:
        home = np.bincount(group, races).argmax()
    connected = (group == home) & ((races > 0) | (size == 1))

    def gap_variances(one: np.ndarray, other: np.ndarray) -> np.ndarray:
        return ELO**2 * intervals.gap_variances(system, squares, variances.ratio, one, other)

    return Ratings(
        entries=names,
        elo=elo,
        sd=sd,
        low95=elo - SIGMAS_95 * sd,
        high95=elo + SIGMAS_95 * sd,
        races=races,
        provisional=(sd > settings.provisional_sd) | ~connected,
        connected=connected,
        one_sided=(pairs > 0) & ((points == 0) | (points == pairs)),
        slot_advantages=ELO * slots,
        slot_sd=ELO * np.sqrt(intervals.slot_variances(system, squares)),
        prior_sd=posterior.prior_sd,
        anchor=anchor,
        num_races=len(results),
        gap_variances=gap_variances,
    )
