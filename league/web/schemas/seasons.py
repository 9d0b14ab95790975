"""Seasons and cups in the answers of /api/v1."""

from __future__ import annotations

from league.matchmaking.safety import Safety
from league.matchmaking.scores import BestLap
from league.matchmaking.seasons import Trophy
from league.matchmaking.standings import Row
from league.matchmaking.store import Cup, HeatState, Season
from league.web.schemas.races import Answer, ListedHeat, Page


class SeasonLine(Answer):
    """A season without its table."""

    season: Season
    entries: int
    races: int
    trophies: list[Trophy]


class ListedSeason(SeasonLine):
    """A season of the list."""

    won: int
    """Trophies of the season; `trophies` has the first of them."""


class Leader(Answer):
    """One of the first in the standings."""

    number: int
    name: str
    elo: float
    races: int


class Winner(Answer):
    """An entry of a cup."""

    entry: int
    name: str


class CupLine(Answer):
    """A cup of the list."""

    cup: Cup
    winner: Winner | None


class SeasonsAnswer(Answer):
    """All seasons and cups."""

    seasons: list[ListedSeason]
    running: Season | None
    leaders: list[Leader]
    cups: list[CupLine]


class SeasonAnswer(SeasonLine, Page):
    """A season."""

    rows: list[Row]
    """The page of the final standings."""
    divisions: dict[int, int]
    """Of the entries on the page, by number."""
    safety: dict[int, Safety]
    """Of the entries on the page, by number."""
    laps: dict[str, list[BestLap]]
    """Of the entries on the page, by track."""
    divided: bool
    """Whether the season had divisions."""
    leaders: list[Leader] | None = None
    """Of a running season; missing of others."""
    newest: list[ListedHeat] | None = None
    """Of a running season; missing of others."""


class CupRun(Answer):
    """How an entrant did in a heat."""

    entry: int
    name: str
    seed: int
    """Place after qualifying, from 1; 0 before."""
    places: list[int]
    """In each race."""
    lap_s: float | None
    """Best lap in qualifying [s]."""
    distance: float
    """Driven in qualifying [m]."""
    advances: bool


class CupHeat(Answer):
    """A heat of a cup, the best first once it is over."""

    number: int | None
    """Null before it is planned."""
    state: HeatState | None
    track: str | None
    runs: list[CupRun]


class FedHeat(CupHeat):
    """A knock-out heat."""

    feeds: list[int | None]
    """Numbers of the heats that its drivers come from."""


class Qualifying(Answer):
    """A page of the qualifying."""

    name: str
    heats: list[CupHeat]


class Round(Answer):
    """A round of the knock-out."""

    name: str
    heats: list[FedHeat]


class LargeRound(Answer):
    """A round that has pages of its own."""

    name: str
    heats: int
    address: str


class CupAnswer(Page):
    """A cup as far as it has come."""

    cup: Cup
    entrants: int
    qualifying: Qualifying | None
    rounds: list[Round]
    round: int | None
    """The one that was asked for."""
    large: list[LargeRound]
    """Rounds that have pages of their own."""
    order: list[Winner]
    """All entrants by how far they came; empty before the end."""
