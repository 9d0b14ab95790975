"""Strengths on the Elo scale and their uncertainty from results of races; see docs/ratings.md."""

from league.matchmaking.ratings.fit import RatingSettings, fit, refit, updated
from league.matchmaking.ratings.pair_counts import RatingData, Results
from league.matchmaking.ratings.table import Carried, Difference, Ratings, expected_score

__all__ = [
    "Carried", "Difference", "RatingData", "RatingSettings", "Ratings", "Results",
    "expected_score", "fit", "refit", "updated",
]  # fmt: skip
