"""Results of races -> strengths on the Elo scale, with how sure they are; see docs/ratings.md."""

from league.matchmaking.ratings.fit import RatingSettings, fit
from league.matchmaking.ratings.results import Finish, Results, Run, places_of
from league.matchmaking.ratings.table import Difference, Ratings, expected_score

__all__ = [
    "Difference",
    "Finish",
    "RatingSettings",
    "Ratings",
    "Results",
    "Run",
    "expected_score",
    "fit",
    "places_of",
]
