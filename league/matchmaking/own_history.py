"""An entry's rating over its heats against the ratings of today: quick in a league of any size."""

from __future__ import annotations

import numpy as np

from league.matchmaking.ratings.fit import SIGMAS_95, expected_score
from league.matchmaking.ratings.pair_counts import ELO
from league.matchmaking.standings import HistoryPoint, Standings


def own_history(rated: Standings, number: int, *, points: int = 20) -> list[HistoryPoint]:
    """Return an entry's rating over its heats, all others rated as they are now.

    It takes milliseconds in a league of any size; `standings.history` fits all ratings for each
    point.
    """
    ratings, races = rated.ratings, rated.races
    rows = np.flatnonzero((races.entries == number).any(axis=1))
    rows = rows[np.argsort(races.heat[rows], kind="stable")]
    entries, places = races.entries[rows], races.places[rows].astype(int)
    known = np.searchsorted(ratings.entries, entries).clip(max=len(ratings.entries) - 1)
    slots = np.broadcast_to(ratings.slot_advantages[: entries.shape[1]], entries.shape)
    mine, met = entries == number, (entries >= 0) & (entries != number)
    own_place = (places * mine).sum(axis=1, keepdims=True)
    own_slot = (slots * mine).sum(axis=1, keepdims=True)
    points_made = (own_place < places) + 0.5 * (own_place == places)
    needed = ratings.elo[known] + slots - own_slot  # a rating at which the two are even
    middle, spread = float(ratings.elo.mean()), ratings.prior_sd
    picked = np.unique(np.linspace(1, len(rows), min(points, len(rows))).round().astype(int))
    moments = []
    for count in picked.tolist():
        counted = met[:count]
        elo, sd = _own_rating(points_made[:count][counted], needed[:count][counted], middle, spread)
        reach = SIGMAS_95 * sd
        moments.append(
            HistoryPoint(int(races.heat[rows[count - 1]]), count, elo, elo - reach, elo + reach)
        )
    now = ratings.index(number)
    ends = float(ratings.elo[now]), float(ratings.low95[now]), float(ratings.high95[now])
    return [*moments[:-1], HistoryPoint(int(races.heat.max()), len(rows), *ends)]


def _own_rating(
    points: np.ndarray, needed: np.ndarray, middle: float, spread: float
) -> tuple[float, float]:
    """Return the likeliest rating, and its standard deviation, given those of all opponents."""
    elo, information = middle, 1.0
    for _ in range(50):
        chance = expected_score(elo - needed)
        gradient = float((points - chance).sum()) / ELO - (elo - middle) / spread**2
        information = float(np.sum(chance * (1 - chance))) / ELO**2 + 1 / spread**2
        step = float(np.clip(gradient / information, -200.0, 200.0))
        elo += step
        if abs(step) < 0.01:
            break
    return elo, information**-0.5
