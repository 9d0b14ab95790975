"""Sequential test of whether B is better than A, over heats.

The generalised sequential probability ratio test over heats (Wald 1945; Van den Bergh 2019). A
heat's score is the mean over its races, so its five outcomes (two races, ties) keep together what
belongs together: the worth of a grid slot cancels, and a track that suits one car counts once.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.optimize import brentq

from league.errors import ConfigError
from league.matchmaking.ratings.table import SIGMAS_95, expected_score

Decision = Literal["better", "not better", "undecided"]

LEAST_HEATS = 4  # no answer before so many heats
OUTCOMES = np.linspace(0.0, 1.0, 5)  # scores that a heat of two races can have
_UNSEEN = 1e-3
"""Heats credited to each outcome, so that one not yet seen is unlikely and not impossible."""


@dataclass(frozen=True)
class SequentialSettings:
    """What is asked, and how sure the answer must be."""

    elo0: float = 0.0  # B is "not better" if it leads by this or less [Elo]
    elo1: float = 30.0
    """B is "better" if it leads by this or more [Elo]; 30 while developing, 10 for finals."""
    alpha: float = 0.05  # chance to say "better" though the lead is only elo0
    beta: float = 0.05  # chance to say "not better" though the lead is elo1
    slot_gap: float = 0.0
    """What the front of two slots is worth over the other, as the league's ratings say [Elo].

    A heat swaps the slots, but a gap between them still pulls its mean score towards a half.
    """

    def __post_init__(self) -> None:
        if not self.elo0 < self.elo1:
            raise ConfigError(
                f"elo0 is {self.elo0} and elo1 {self.elo1}: elo1 must be the larger one"
            )
        if not (0 < self.alpha < 0.5 and 0 < self.beta < 0.5):
            raise ConfigError(
                f"alpha is {self.alpha} and beta {self.beta}: give both between 0 and 0.5"
            )

    @property
    def bounds(self) -> tuple[float, float]:
        """Log-likelihood ratios that end the test: not better, better."""
        return math.log(self.beta / (1 - self.alpha)), math.log((1 - self.beta) / self.alpha)


@dataclass(frozen=True)
class Comparison:
    """Where a sequential test stands."""

    decision: Decision  # the answer, if there is one already
    llr: float  # log-likelihood ratio of elo1 against elo0
    lower: float  # at or below it the answer is "not better"
    upper: float  # at or above it the answer is "better"
    heats: int  # heats counted
    score: float  # mean score of B, in [0, 1]
    elo: float  # B's lead [Elo]; infinite while every race has the same winner
    low95: float
    """Lower end of its 95 % interval [Elo], as if the number of heats had been fixed before."""
    high95: float  # upper end of it [Elo]


def compare(scores: np.ndarray, settings: SequentialSettings | None = None) -> Comparison:
    """Judge B's mean scores against A in heats, in [0, 1], (heats,), in the order of their plan.

    A score that no heat of two races can have is a ConfigError.
    """
    settings = settings or SequentialSettings()
    counts = (np.abs(scores - OUTCOMES[:, None]) < 1e-6).sum(axis=1).astype(float)
    if counts.sum() != len(scores):
        raise ConfigError(
            "scores of heats of 2 races must be multiples of 1/4 in [0, 1]: give the mean over a "
            "heat's races, a tie as 0.5"
        )
    llr = ratio(counts, settings)
    lower, upper = settings.bounds
    decision: Decision = "undecided"
    if len(scores) >= LEAST_HEATS:
        decision = "better" if llr >= upper else "not better" if llr <= lower else "undecided"
    score, low, high = _interval(counts)
    return Comparison(
        decision=decision,
        llr=llr,
        lower=lower,
        upper=upper,
        heats=len(scores),
        score=score,
        elo=elo_of(score, settings.slot_gap),
        low95=elo_of(low, settings.slot_gap),
        high95=elo_of(high, settings.slot_gap),
    )


def ratio(counts: np.ndarray, settings: SequentialSettings) -> float:
    """Return the log-likelihood ratio of elo1 against elo0.

    Of all distributions over the outcomes with the mean score that elo0 (elo1) gives, the one
    most likely to have made these counts stands for elo0 (elo1).
    """
    if not counts.sum():
        return 0.0
    seen = counts + _UNSEEN
    values = np.linspace(0.0, 1.0, len(counts))
    means = (heat_score(elo, settings.slot_gap) for elo in (settings.elo0, settings.elo1))
    under = [_log_tilts(seen, values, mean) for mean in means]
    return float(seen @ (under[1] - under[0]))


def heat_score(elo: float, slot_gap: float) -> float:
    """Return the mean score of a lead [Elo] over a heat with slots swapped half way."""
    sides = expected_score(np.array([elo + slot_gap, elo - slot_gap]))
    return float(np.mean(sides))


def elo_of(score: float, slot_gap: float = 0.0) -> float:
    """Return the lead [Elo] that gives this mean score over a heat."""
    if not 0.0 < score < 1.0:
        return math.copysign(math.inf, score - 0.5)
    pull = 10.0 ** (slot_gap / 400.0)
    # Half the sum of o p / (1 + o p) and o / (o + p) for odds o and pull p is a quadratic in o.
    half = 0.5 * (pull + 1.0 / pull) * (1.0 - 2.0 * score)
    odds = (-half + math.sqrt(half**2 + 4.0 * score * (1.0 - score))) / (2.0 * (1.0 - score))
    return 400.0 * math.log10(odds)


def _log_tilts(seen: np.ndarray, values: np.ndarray, mean: float) -> np.ndarray:
    """Return log(q / p) of the likeliest distribution q with a mean, p being what was seen.

    q = p / (1 + tilt (value - mean)), where the tilt makes the mean right (Owen's empirical
    likelihood); it lies between the poles of the outermost outcomes.
    """
    share, apart = seen / seen.sum(), values - mean
    edge = 1e-12
    low, high = -1.0 / apart.max() * (1 - edge), -1.0 / apart.min() * (1 - edge)
    root = brentq(lambda t: float((share * apart / (1 + t * apart)).sum()), low, high, xtol=1e-14)
    tilt = float(np.asarray(root))
    return -np.log1p(tilt * apart)


def _interval(counts: np.ndarray) -> tuple[float, float, float]:
    """Return the mean score and its 95 % interval from the scatter of the heats."""
    heats = counts.sum()
    if heats == 0:
        return 0.5, 0.0, 1.0
    score = float(counts @ OUTCOMES / heats)
    # One imagined heat, half won and half lost, keeps few or equal heats from looking certain.
    padded = counts.copy()
    padded[[0, -1]] += 0.5
    middle = float(padded @ OUTCOMES / padded.sum())
    spread = float(padded @ (OUTCOMES - middle) ** 2 / padded.sum())
    half = SIGMAS_95 * math.sqrt(spread / padded.sum())
    return score, max(0.0, min(score, middle - half)), min(1.0, max(score, middle + half))
