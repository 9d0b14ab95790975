"""What ratings are made of: the races of a season, and the ratings of the season before."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from league.matchmaking.ratings import Carried
from league.matchmaking.store import Races, Season, Store

SEASON_SD = 100.0
"""How far strengths may move from one season to the next, besides what was not known [Elo]: drivers
are retrained, and a rating is a comparison with a field that changes, too."""


@dataclass(frozen=True)
class RatingScope:
    """What ratings are made of: a season's races, and what was known before them."""

    races: Races
    """Rated races."""
    season: Season | None
    """None in a league without seasons: all its races count."""
    carried: Carried | None
    """Ratings of the season before, if it had the same rules."""


def scope(
    store: Store,
    ruleset: str | None = None,
    season: Season | None = None,
    races: Races | None = None,
) -> RatingScope:
    """Return what the ratings of a season are made of.

    Args:
        store: the league.
        ruleset: hash; by default the present one.
        season: by default the last one under this ruleset.
        races: all rated races under the ruleset, if they have been read already.
    """
    ruleset = ruleset or store.settings.ruleset.hash
    own = [one for one in store.seasons() if one.ruleset == ruleset]
    races = store.races(ruleset) if races is None else races
    season = season or (own[-1] if own else None)
    if season is None:
        return RatingScope(races, None, None)
    before = next((one for one in own if one.number == season.number - 1), None)
    own = season.has(races.heat)
    counted = races if own.all() else races.where(own)
    return RatingScope(counted, season, _carried(store, before))


def _carried(store: Store, season: Season | None) -> Carried | None:
    """Return a season's ratings as they are known at the start of the next one.

    Whoever was less sure than a newcomer is stays as sure as that.
    """
    document = store.season_document(season.number) if season else None
    if document is None:
        return None
    frozen = document["standings"]
    rows = sorted(frozen["entries"], key=lambda row: row["number"])
    sd = np.array([row["sd"] for row in rows])
    return Carried(
        entries=np.array([row["number"] for row in rows]),
        elo=np.array([row["elo"] for row in rows]),
        sd=np.minimum(np.hypot(sd, SEASON_SD), np.maximum(sd, frozen["prior_sd"])),
        prior_sd=frozen["prior_sd"],
    )
