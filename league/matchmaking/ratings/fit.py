"""The fit: maximum a posteriori Bradley-Terry by damped Newton steps, its prior learned."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from league.errors import ConfigError
from league.matchmaking.ratings import intervals, pair_counts, systems
from league.matchmaking.ratings.field import Field
from league.matchmaking.ratings.pair_counts import ELO, Evidence
from league.matchmaking.ratings.results import Results
from league.matchmaking.ratings.systems import Maker, Squares, System
from league.matchmaking.ratings.table import SIGMAS_95, Ratings

ANCHOR_ELO = 1000.0
"""Where the anchor is pinned."""

USUAL_SPREAD = 300.0
"""DynamicsRandomization of a field of drivers before anything is known of it [Elo]."""
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


@dataclass(frozen=True)
class RatingSettings:
    """What a league may choose about its ratings."""

    prior_sd: float | None = None
    """DynamicsRandomization of the field before any race [Elo]; None learns it from the field."""
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
    return rate(Field.of(results, entries), settings, anchor=anchor)


def rate(
    field: Field, settings: RatingSettings | None = None, *, anchor: int | None = None
) -> Ratings:
    """Rate a field whose races are counted already.

    Args:
        field: the races.
        settings: the league's choices.
        anchor: the entry that is 1000.

    Raises:
        ConfigError: nobody to rate, or an anchor that is not in the field.
    """
    settings = settings or RatingSettings()
    if not len(field.entries):
        raise ConfigError("there are no entries to rate: submit one, or give results")
    if anchor is not None and anchor not in field.entries:
        raise ConfigError(f"anchor {anchor} is not in the field: name one of its entries")
    model = _Model(field.evidence, settings)
    posterior = model.learned() if settings.prior_sd is None else model.at(settings.prior_sd)
    prior = model.prior(posterior.prior_sd)
    squares = systems.squares(field.results, field.evidence, posterior.parameters, prior)
    return _table(field, posterior, squares, settings, anchor)


@dataclass(frozen=True)
class _Posterior:
    """The best parameters under one prior."""

    parameters: np.ndarray
    """Strengths and slots [natural units]."""
    system: System
    """The curvature there."""
    prior_sd: float
    """DynamicsRandomization of the strengths [Elo]."""
    weights: np.ndarray
    """What each entry counts in the field's average, (entries,)."""
    num_spreads: int
    """Spreads tried up to this one."""


class _Model:
    """A field's log-posterior; it remembers where the last climb ended, to begin there again."""

    def __init__(self, evidence: Evidence, settings: RatingSettings) -> None:
        self._evidence, self._settings = evidence, settings
        self._make: Maker = systems.maker(evidence, dense_most=settings.dense_most)
        self._last = np.zeros(evidence.size)
        self._num_spreads = 0

    def prior(self, prior_sd: float) -> np.ndarray:
        """Return the precision of each parameter."""
        precisions = np.full(self._evidence.size, (ELO / prior_sd) ** 2)
        # Each of two slots has half the variance of their difference.
        precisions[self._evidence.num_entries :] = 2.0 * (ELO / self._settings.slot_sd) ** 2
        return precisions

    def at(self, prior_sd: float, enough: float = ENOUGH) -> _Posterior:
        """Climb to the best parameters under a prior, until a step is small enough."""
        prior, at = self.prior(prior_sd), self._last
        self._num_spreads += 1
        seen = pair_counts.slope(self._evidence, at)
        value = seen.value - 0.5 * float(prior @ at**2)
        far = 1.0
        for _ in range(100):
            system = self._make(seen.weights, prior)
            gradient = seen.gradient - prior * at
            # A step that is followed by others need not be exact: the next one's error is its
            # square anyway.
            step = system.solve(gradient, within=min(1e-2, max(1e-6, 1e-2 * far)))
            promised = float(gradient @ step)
            far = float(np.abs(step).max())
            if far < enough:
                self._last = at + step
                counts = intervals.field_weights(self._evidence, seen.weights)
                return _Posterior(self._last, system, prior_sd, counts, self._num_spreads)
            length = min(1.0, 4.0 / far)
            while True:
                tried = at + length * step
                seen = pair_counts.slope(self._evidence, tried)
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
        variances follows the likeliest spread. What is known of fields in general keeps it from
        collapsing where a few races tell nothing of it.

        Where races tell little of the strengths (the front slot decides them all), the EM step is
        tiny everywhere, near the fixed point or not: it moves by what the races tell of it. So
        the root of its drift is sought, by Newton's steps on the logarithm of the variance.
        """
        limits = self._settings.least_prior_sd, self._settings.most_prior_sd
        bounds = low, high = tuple(float(2 * np.log(limit)) for limit in limits)
        spread = float(np.clip(2 * np.log(USUAL_SPREAD), low, high))
        enough, last = ENOUGH_FAR, None
        for _ in range(MOST_SPREADS):
            posterior = self.at(float(np.exp(0.5 * spread)), enough)
            drift, bend, towards = self._drift(posterior, spread)
            low, high = (spread, high) if drift > 0 else (low, spread)
            if last is not None and (abs(spread - last[0]) < NEAR or drift * last[1] < 0):
                # What probes say of a slope is rough; what two drifts around it say is not.
                between = (drift - last[1]) / ((spread - last[0]) or np.inf)
                bend = between if between < 0 else bend
            last = spread, drift
            step = float(np.clip(drift / max(-bend, 1e-12), -FAR, FAR))
            end = high if drift > 0 else low
            if abs(step) >= abs(end - spread):  # beyond what was tried before: half the way there
                step = end - spread if end in bounds else 0.5 * (end - spread)
            moved = spread + step
            # The next spread's best parameters lie along their slope.
            self._last = self._last + (moved - spread) * towards
            if moved == spread and enough == ENOUGH:  # at a limit
                return posterior
            spread, near = moved, abs(moved - spread)
            if near < SETTLED and enough == ENOUGH:
                break
            if near < NEAR and enough == ENOUGH_FAR:
                enough, (low, high) = ENOUGH, bounds  # signs of a rough drift may be wrong
        return self.at(float(np.exp(0.5 * spread)))

    def _drift(self, posterior: _Posterior, spread: float) -> tuple[float, float, np.ndarray]:
        """Return the EM step, its slope by the logarithm of the variance, and the parameters'."""
        size = self._evidence.num_entries
        strengths = posterior.parameters[:size]
        precision = np.exp(-spread) * ELO**2
        held = np.zeros(self._evidence.size)
        held[:size] = precision * strengths
        # The prior lets go of the strengths: d strengths = H^-1 (precision strengths) du,
        # and of their variances: d H^-1 = H^-1 precision H^-1 du.
        towards = posterior.system.solve(held, within=1e-4)
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
    field: Field,
    posterior: _Posterior,
    squares: Squares,
    settings: RatingSettings,
    anchor: int | None,
) -> Ratings:
    """Put a posterior into Elo, with intervals and flags."""
    names, races, size = field.entries, field.races, len(field.entries)
    strengths, slots = posterior.parameters[:size], posterior.parameters[size:]
    zero = strengths[np.searchsorted(names, anchor)] if anchor is not None else 0.0
    elo = ANCHOR_ELO + ELO * (strengths - zero)
    system = posterior.system
    variances = intervals.variances(system, squares, posterior.weights)
    sd = ELO * np.sqrt(variances.strengths)
    pairs, points = pair_counts.points_of(field.evidence)
    group = pair_counts.groups(field.evidence)
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
        num_races=len(field.results),
        num_spreads=posterior.num_spreads,
        gap_variances=gap_variances,
    )
