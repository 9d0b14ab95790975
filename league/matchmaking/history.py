"""How an entry's rating came about: exactly, season by season, or quickly in large leagues."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.errors import StoreError, brief
from league.matchmaking import standings
from league.matchmaking.ratings import Carried, RatingData, refit
from league.matchmaking.ratings.pair_counts import ELO, changes
from league.matchmaking.ratings.table import SIGMAS_95, expected_score
from league.matchmaking.scope import scope
from league.matchmaking.standings import OwnRaces, Standings
from league.matchmaking.store import LeagueEntry, Store

TREND_HEATS = 50
"""So many of a season's newest heats, at most half of them, make the trend of a rating."""


@dataclass(frozen=True)
class HistoryPoint:
    """An entry's rating at some time."""

    heat: int
    """Number of the last heat counted."""
    races: int
    """Races of the entry up to then, those of earlier seasons under the same rules included."""
    elo: float
    """Strength [Elo]."""
    low95: float
    """Lower end of the 95 % interval [Elo]."""
    high95: float
    """Upper end of the 95 % interval [Elo]."""
    season: int = 0
    """Number of the season; 0 in a league without seasons."""


def history(store: Store, entry: LeagueEntry, *, points: int = 20) -> list[HistoryPoint]:
    """Return an entry's rating as it was after evenly many of its heats, and last as it is now.

    Each is fitted to the races of its season up to then, so later corrections of results count.
    Seasons under other rules than the present ones are left out: their ratings are no comparison.
    """
    ruleset = store.settings.ruleset.hash
    races, entries = store.races(ruleset), store.entries()
    mine = np.unique(races.heat[(races.entries == entry.number).any(axis=1)])
    if not len(mine):
        raise StoreError(
            f"{brief(entry.name)} has not raced for its rating yet: let the league run first"
        )
    picked = np.unique(np.linspace(0, len(mine) - 1, min(points, len(mine))).round().astype(int))
    seasons = [one for one in store.seasons() if one.ruleset == ruleset] or [None]
    moments: list[HistoryPoint] = []
    raced = 0
    for season in seasons:
        within = scope(store, ruleset, season, races)
        # Others may have raced since its last heat, and their races move its rating too.
        heats = {*mine[picked[:-1]].tolist(), int(within.races.heat.max(initial=0))}
        own = np.array(sorted(heats - {0}), dtype=np.int64)
        for heat in own[season.has(own)] if season else own:
            before = standings.results_of(within.races, before=heat + 1)
            found = standings.rated(before, entries, carried=within.carried)
            if found is None or entry.number not in found[1].entries:
                continue
            fitted = found[1]
            at = fitted.index(entry.number)
            moments.append(
                HistoryPoint(
                    heat=int(heat),
                    races=raced + int(fitted.races[at]),
                    **fitted.line(at, "elo", "low95", "high95"),
                    season=season.number if season else 0,
                )
            )
        raced = moments[-1].races if moments else 0
    return moments


def trends(rated: Standings, carried: Carried | None) -> dict[int, float]:
    """Return by how much the season's newest heats changed each rating [Elo], by entry number.

    `carried` is what was known before the season.
    """
    heats = np.sort(rated.races.heat)  # np.unique takes ten times as long
    heats = heats[changes(heats)]
    newest = heats[len(heats) - min(TREND_HEATS, len(heats) // 2) :]
    if not len(newest):
        return {}
    earlier = standings.results_of(rated.races, before=int(newest[0]))
    data = RatingData.of(earlier, rated.ratings.entries)
    changed = rated.ratings.elo - refit(data, rated.ratings, carried)
    raced = data.races > 0
    return dict(zip(data.entries[raced].tolist(), changed[raced].tolist(), strict=True))


def own_history(rated: Standings, own: OwnRaces, *, points: int = 20) -> list[HistoryPoint]:
    """Return an entry's rating over its heats, all others rated as they are now.

    It takes milliseconds in a league of any size; `history` fits all ratings for each point.
    """
    ratings = rated.ratings
    needed = own.strengths - ratings.slot_advantages[own.slot]  # a rating at which the two are even
    middle, spread = float(ratings.elo.mean()), ratings.prior_sd
    heats = own.races.heat
    picked = np.unique(np.linspace(1, len(heats), min(points, len(heats))).round().astype(int))
    counted = np.arange(len(heats)) < picked[:, None]  # (moments, races)
    met = counted[:, :, None] & own.met
    elos, sds = _own_ratings(own.points, needed, met, middle, spread)
    moments = [
        HistoryPoint(int(heats[count - 1]), count, elo, elo - SIGMAS_95 * sd, elo + SIGMAS_95 * sd)
        for count, elo, sd in zip(picked.tolist(), elos.tolist(), sds.tolist(), strict=True)
    ]
    now = ratings.line(ratings.index(own.number), "elo", "low95", "high95")
    return [*moments[:-1], HistoryPoint(int(rated.races.heat.max()), len(heats), **now)]


def _own_ratings(
    points: np.ndarray, needed: np.ndarray, met: np.ndarray, middle: float, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the likeliest ratings, and their standard deviations, given those of all opponents.

    Against each car there are the points made and the rating `needed` to be even with it, (races,
    cars); `met` tells whether it counts at a moment, (moments, races, cars).
    """
    at, moments = met.any(axis=0), len(met)
    counts, points, needed = met[:, at].astype(float), points[at], needed[at]  # (moments, cars met)
    elo, information = np.full(moments, middle), np.ones(moments)
    moving = np.ones(moments, bool)
    for _ in range(50):
        chance = np.asarray(expected_score(elo[:, None] - needed))
        gradient = (counts * (points - chance)).sum(axis=1) / ELO - (elo - middle) / spread**2
        curved = (counts * (chance * (1 - chance))).sum(axis=1) / ELO**2 + 1 / spread**2
        information = np.where(moving, curved, information)
        step = np.where(moving, np.clip(gradient / curved, -200.0, 200.0), 0.0)
        elo = elo + step
        moving &= np.abs(step) >= 0.01
        if not moving.any():
            break
    return elo, information**-0.5
