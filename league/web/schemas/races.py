"""Heats, races, seasons and cups in the answers of /api/v1."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict

from league.matchmaking.safety import Safety
from league.matchmaking.scores import BestLap
from league.matchmaking.seasons import Trophy
from league.matchmaking.standings import Row
from league.matchmaking.store import Cup, HeatState, Season
from league.race_spec import CarResult
from league.sim.config import RaceKind
from league.web.charts import ComparedLaps
from league.web.pages.heats import LapFaults


class Answer(BaseModel):
    """An object that has the fields that are listed, and no others."""

    model_config = ConfigDict(extra="forbid", use_attribute_docstrings=True)


class Page(Answer):
    """A page of a long list."""

    page: int
    """Number of the page, from 1."""
    pages: int
    """How many there are."""
    pager: list[tuple[str, str]]
    """Numbers and addresses of pages; this one's address is empty."""


class Rules(Answer):
    """The present rules in short."""

    hash: str
    """SHA-256 of the whole ruleset."""
    tracks: list[str]
    laps: int
    cars: int
    """Cars of a race."""
    kind: RaceKind
    solver: str


class Grid(Answer):
    """A race of a heat, before it is raced."""

    track: str
    grid: list[str]
    """Names of the drivers, the front slot first."""


class HeatLine(Answer):
    """A heat without its results."""

    number: int
    key: str
    """SHA-256 of what is raced."""
    purpose: str
    state: HeatState
    races: list[Grid]
    seeds: list[int] | None
    """Of each race; null until the heat is over."""
    worker: str | None
    """Who has it, or had it last."""
    attempts: int
    traceback: str
    """Of the last failure."""
    audits: str
    """Key of the heat that this one runs again; empty for others."""
    claimed_s: float | None
    """When its worker took it [s since 1970]."""
    done_s: float | None
    """When its results came [s since 1970]."""


class OwnRace(Answer):
    """How a driver did in a race of a heat."""

    race: int
    """Number of the race within the heat, from 1."""
    place: int
    finished: bool


class ListedHeat(HeatLine):
    """A heat of a list."""

    winners: list[str]
    """Name of the winner of each race that was raced."""
    own: list[OwnRace] | None = None
    """Of the driver that was asked for; missing if none was."""


class ScoredHeat(ListedHeat):
    """A heat, and what a driver made in it."""

    points: float
    """Opponents the driver came in ahead of, ties half, in all races of the heat."""
    expected: float
    """Points that the ratings promise it."""


class Classification(Answer):
    """The result of a race."""

    order: list[CarResult]
    """Cars by place."""
    steps: int
    """Control steps raced."""
    race_s: float
    """Race time [s]."""
    lead_changes: int
    faults: int = 0
    """Cars that were taken out of the race because their driver failed."""
    trace: str = ""
    """Hash of the states of all steps."""


class CarName(Answer):
    """Who drives a car."""

    number: int
    """Of the car, from 1, the front slot first."""
    entry: int
    """Number of the driver."""
    name: str


class RaceSummary(Answer):
    """A heat and one of its races."""

    heat: HeatLine
    race: int
    """Number of the race within the heat, from 1."""
    track: str
    cars: list[CarName]
    result: Classification | None
    places: list[int]
    """Of each car, in grid order."""
    recording: str | None
    """SHA-256 of the recording."""
    shown: bool
    """Whether there is something to play: the recording, or the race as far as it has come."""
    map: None = None


class RaceEvent(Answer):
    """What happened in a race."""

    time_s: float
    kind: str
    car: int
    """From 1."""
    text: str


class Audit(Answer):
    """A heat that runs another one again."""

    number: int
    state: HeatState
    worker: str | None
    done_s: float | None
    """[s since 1970]."""


class Progress(Answer):
    """How far a heat that is raced has come; its races are driven side by side."""

    worker: str
    since_s: float
    """Unix time [s]."""
    elapsed_s: float
    """[s]."""
    usual_s: float | None
    """Median of the newest heats [s]; null before the first."""
    races: int
    """Races of the heat."""


class HeatAnswer(RaceSummary):
    """A heat and all about one of its races."""

    progress: Progress | None
    """Null unless it is being raced."""
    queue: int
    """Heats that wait, while this one is not over."""
    seed: int | None
    ruleset: str
    """SHA-256 of the rules."""
    best_lap_s: float | None
    positions: None = None
    gaps: None = None
    laps: int
    """Most laps that a car completed."""
    faults: list[list[LapFaults]]
    """Of each car, in grid order, on each of its laps."""
    lap_rows: int
    """Most laps that a car began."""
    lap: int | None
    """The lap that is compared; null for each car's best one."""
    compared: ComparedLaps | None
    events: list[RaceEvent]
    hash: str | None
    """SHA-256 of places and result."""
    intact: bool
    """Whether the stored result still has that hash."""
    worker: str | None
    machine: str | None
    """Class of the machine that raced it; empty if all give the same bits."""
    disputed: bool
    """Whether workers found different results."""
    rejected: int
    """Results that a third worker did not find."""
    audits: list[Audit]
    spec: dict[str, Any] | None
    """The race's settings but its drivers, see docs/league.md: lengths in metres, times in s."""
    physics: str | None
    """Version of the physics."""
    league_version: str | None


class DrawnTrack(Answer):
    """A track as the player draws it."""

    title: str
    closed: bool
    left: list[int]
    """Border as x0, y0, x1, y1, ... [cm]."""
    right: list[int]


class DrawnCar(Answer):
    """A car as the player draws it."""

    number: int
    """From 1."""
    name: str
    x: list[int]
    """[cm], differenced twice along the frames."""
    y: list[int]
    """[cm], differenced twice."""
    yaw: list[int]
    """[0.01 rad], differenced once."""
    distance: list[int]
    """Along the track [cm], differenced twice."""
    gap: list[int]
    """Time since the leader was there [0.01 s], differenced once."""
    lap_frames: list[int]
    """Frames in which a lap was completed."""
    stops: list[list[int]]
    """First frame, and the one behind the last, of each penalty."""


class PlayedRace(Answer):
    """What the player draws."""

    step_hz: float
    """Frames in a second."""
    duration_s: float
    laps: int
    track: DrawnTrack
    obstacles: list[int]
    """Middles as x0, y0, ... [cm]."""
    cars: list[DrawnCar]
    events: list[RaceEvent]
    over: bool
    """False while it is being raced: ask again for more of it."""


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
