"""Results of races -> strengths on the Elo scale, with how sure they are; see docs/ratings.md."""

from league.matchmaking.ratings.field import Field
from league.matchmaking.ratings.fit import RatingSettings, fit, rate
from league.matchmaking.ratings.results import Finish, Results, Run, places_of
from league.matchmaking.ratings.table import Difference, Ratings, expected_score

__all__ = [
    "Difference",
    "Field",
    "Finish",
    "RatingSettings",
    "Ratings",
    "Results",
    "Run",
    "expected_score",
    "fit",
    "places_of",
    "rate",
]
