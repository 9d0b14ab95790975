"""What the numbers mean: one short text for each, which the tables link to."""

from __future__ import annotations

from league.matchmaking import divisions, history, safety
from league.matchmaking.scope import SEASON_SD
from league.web.pages.tracks import MEDALS
from league.web.reader import Document, Reader


def document(reader: Reader) -> Document:
    """Return the definitions, with the numbers in them."""
    season = next(iter(reader.store.seasons()[::-1]), None)
    settings = divisions.SeasonSettings.of(season) if season else divisions.SeasonSettings()
    return {
        "settings": settings,
        "safety_margin": divisions.SAFETY_MARGIN,
        "safety_races": safety.RACES,
        "safety_half": safety.HALF,
        "safety_best": safety.BEST,
        "safety_corners": safety.ENOUGH_CORNERS,
        "season_sd": SEASON_SD,
        "trend_heats": history.TREND_HEATS,
        "medals": MEDALS,
    }
