"""Strengths on the Elo scale and their uncertainty from results of races; see docs/ratings.md."""

from league.matchmaking.ratings.fit import (
    Carried,
    Difference,
    Ratings,
    RatingSettings,
    expected_score,
    fit,
    refit,
)
from league.matchmaking.ratings.pair_counts import RatingData, Results

__all__ = [
    "Carried",
    "Difference",
    "RatingData",
    "RatingSettings",
    "Ratings",
    "Results",
    "expected_score",
    "fit",
    "refit",
]
