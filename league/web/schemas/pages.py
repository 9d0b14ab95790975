"""The answers of /api/v1, page by page, for the OpenAPI document.

The pages return plain data; tests/web/test_web_schema.py checks real answers against these types.
"""

from __future__ import annotations

from league.matchmaking.divisions import SeasonSettings
from league.matchmaking.ratings.table import Difference
from league.matchmaking.scores import BestLap, HistoryPoint
from league.matchmaking.standings import HeadToHead, Row
from league.matchmaking.store import EntryState, HeatState, LeagueEntry, Season
from league.sim.config import RaceKind
from league.web.charts import ComparedLaps, SpeedMap
from league.web.pages.driver import Ancestor
from league.web.pages.table import Marks
from league.web.schemas.races import (
    Answer,
    HeatLine,
    ListedHeat,
    Page,
    Progress,
    RaceSummary,
    Rules,
    ScoredHeat,
)


class HomeAnswer(Answer):
    """The first page."""

    rules: Rules
    counts: dict[str, int]
    """Heats in each state."""
    races: int
    """Rated races."""
    featured: RaceSummary | None
    """The most contested race among the newest."""
    scale: list[float] | None
    """Ratings at the ends of the bars [Elo]."""
    rows: list[Row]
    """The top of the standings."""
    entries: int
    running: list[HeatLine]
    newest: list[ListedHeat]


class StandingsAnswer(Page):
    """A page of the standings."""

    rules: Rules
    unknown: list[str]
    """A sentence for each value that was asked for and is not known: it filters nothing."""
    races: int
    """Rated races that count."""
    rejected: bool
    """Whether one number a driver does not explain the results."""
    p_value: float | None
    """Chance of results this far from the ratings if these are right."""
    scale: list[float] | None
    """Ratings at the ends of the bars [Elo]."""
    rows: list[Row]
    """The page's lines."""
    season: Season | None
    marks: dict[int, Marks]
    """By entry number."""
    laps: dict[int, BestLap]
    """Where clean laps of races of so many cars were driven, by entry number; only with `cars`."""
    entries: int
    """Lines on all pages."""
    sort: str
    sorts: dict[str, str]
    """Address of each order; empty for this one."""
    against: Row | None
    records: dict[int, HeadToHead]
    """Of each entry against that one, by entry number."""
    drivers: list[tuple[str, int]]
    """Names and numbers; none where there are too many to choose from."""
    owners: list[str]
    kinds: list[str]
    car_counts: list[int]
    owner: str
    kind: str
    track: str
    cars: str


class LapLine(Answer):
    """A lap, and where it was driven."""

    lap_s: float
    """Lap time, penalties included [s]."""
    medal: str
    """platinum, gold, silver or bronze; empty for none."""
    heat: int
    race: int
    """Number of the race within the heat, from 1."""


class DriverLap(LapLine):
    """A driver's best lap on a track."""

    track: str
    place: int
    """Among the best laps of all drivers, from 1."""
    over_bound: float | None
    """Lap time over that of the fastest possible lap."""


class NamedLap(LapLine):
    """A driver's lap."""

    entry: int
    name: str


class BoardLap(NamedLap):
    """A line of a time-attack board."""

    owner: str
    behind_s: float
    """Behind the first [s]."""
    rank: int | None
    """In the standings."""


class WonTrophy(Answer):
    """A trophy, and the season it was won in."""

    title: str
    number: int
    """Of the entry."""
    name: str
    owner: str
    value: str
    """What it was won with."""
    heat: int
    """In which it was won; 0 for a whole season."""
    season: int
    """Number of the season."""
    of: str
    """Name of the season."""


class Joining(Answer):
    """How far a new entry is."""

    waits_for: str
    """A sentence; empty if for nothing but races."""
    heats: list[ListedHeat]


class Camera(Answer):
    """A race that a driver's film strip shows."""

    heat: int
    race: int
    car: int
    """From 1."""
    track: str
    moments_s: list[float]
    """That the film strip shows [s since the start]."""


class EntryName(Answer):
    """An entry."""

    number: int
    name: str


class DriverAnswer(Answer):
    """A driver."""

    entry: LeagueEntry
    standing: Row | None
    marks: Marks | None
    trophies: list[WonTrophy]
    history: list[HistoryPoint]
    fitted: bool
    """Whether each moment of the history is a fit of its own."""
    chart: None = None
    against: list[tuple[Row, HeadToHead | None]]
    """The entries around it in the standings, and its record against each."""
    best: list[ScoredHeat]
    worst: list[ScoredHeat]
    laps: list[DriverLap]
    heats: list[ListedHeat]
    num_heats: int
    """Heats that are done."""
    waiting: int
    """Heats that wait or are being raced."""
    joining: Joining | None
    """How far a new entry is."""
    camera: Camera | None
    card: dict[str, str]
    """What its card says, in the words of the page."""
    ancestors: list[Ancestor]
    children: list[EntryName]


class TrackPoints(Answer):
    """What was made, and expected, on a track."""

    track: str
    races: int
    points: float
    expected: float


class Meeting(Answer):
    """A race in which two drivers met."""

    heat: int
    race: int
    purpose: str
    state: HeatState
    track: str
    done_s: float | None
    """[s since 1970]."""
    front: str
    """Name of the one that started in front."""
    expected: float | None
    """Points that the ratings promise the one."""
    ahead: str | None
    """Name of the one that came in ahead."""
    margin_s: float | None


class MetRecord(Answer):
    """How often two drivers met in rated races, and what the first made of it."""

    heats: int
    races: int
    wins: int
    ties: int
    points: float
    expected: float
    """Points that the ratings promised it, of each season its own."""


class SeasonRecord(MetRecord):
    """The same of one season."""

    season: Season | None
    """Null for races in no season."""
    present: bool
    """Whether it is the season of the standings."""


class MatchupAnswer(Answer):
    """Two drivers; points and expected ones are those of the first."""

    one: LeagueEntry
    other: LeagueEntry
    standings: tuple[Row | None, Row | None]
    difference: Difference | None
    season: Season | None
    record: HeadToHead | None
    chart: None = None
    tracks: list[TrackPoints]
    heats: list[Meeting]
    records: list[SeasonRecord]
    """The newest season first."""
    whole: MetRecord
    """Of all seasons."""
    chosen: Season | None
    """The season that the listed heats are of; null for all."""
    waiting: int
    older: int | None
    """Pass this as `before` to see earlier heats."""


class HeatsAnswer(Page):
    """A page of the heats that are done."""

    heats: list[ListedHeat]
    counts: dict[str, int]
    """Heats in each state."""
    count: int
    """Heats on all pages."""
    driver: LeagueEntry | None
    season: Season | None
    """The one that was asked for; null for all."""
    races: int
    """Rated races of the driver."""


class TrackAnswer(Answer):
    """A track and its records."""

    name: str
    title: str
    length: float
    """[m]."""
    width: float
    """[m]."""
    direction: str
    min_radius: float | None
    """[m]; null for a straight."""
    points: int
    """Of its centreline."""
    map: None = None
    speeds: SpeedMap | None
    """Along the fastest lap."""
    bound_s: float | None
    """Time of the fastest possible lap [s]."""
    medals: dict[str, float]
    """Lap time that each asks for [s]."""
    records: list[NamedLap]


class TracksAnswer(Answer):
    """The tracks of the present rules."""

    tracks: list[TrackAnswer]


class GhostLap(Answer):
    """A lap that can be chosen."""

    id: str
    """heat.race.car.lap"""
    heat: int
    race: int
    car: int
    """From 1."""
    lap: int
    """From 1."""
    entry: int
    name: str
    lap_s: float
    medal: str


class GhostOption(Answer):
    """A driver's best lap."""

    entry: int
    name: str
    lap_s: float


class GhostsAnswer(Answer):
    """Two laps against each other."""

    tracks: list[str]
    track: str
    pair: list[GhostLap]
    """Two laps, or none."""
    laps: list[str]
    """Their labels."""
    map: None = None
    compared: ComparedLaps | None
    options: list[GhostOption]
    """Fastest laps on the track."""
    heat: str
    heat_laps: list[GhostLap]


class Kind(Answer):
    """A kind of race."""

    kind: RaceKind
    title: str


class Board(Answer):
    """The fastest clean laps on a track."""

    track: str
    title: str
    bound_s: float | None
    """Time of the fastest possible lap [s]."""
    laps: list[BoardLap]


class BoardsAnswer(Answer):
    """The boards of a kind of race."""

    kind: RaceKind
    kinds: list[Kind]
    boards: list[Board]


class DefinitionsAnswer(Answer):
    """The numbers in the definitions."""

    settings: SeasonSettings
    safety_margin: float
    safety_races: int
    safety_half: float
    """Incident points for each 100 corners."""
    safety_best: float
    safety_corners: float
    season_sd: float
    """[Elo]."""
    trend_heats: int
    medals: dict[str, float]
    """Largest lap time of each over the fastest possible one's."""
    window_s: float
    """Time over which heats per minute are counted [s]."""


class WorkerLine(Answer):
    """A worker that raced lately, or does."""

    name: str
    racing: int
    done: int
    """In the last `window_s`."""
    last_s: float | None
    """When its last result came [s since 1970]."""


class JoiningEntry(EntryName):
    """An entry that is being validated."""

    state: EntryState


class LiveAnswer(Answer):
    """What goes on now."""

    newest: RaceSummary | None
    counts: dict[str, int]
    """Heats in each state."""
    per_minute: float
    wait_minutes: float | None
    running: list[HeatLine]
    progress: dict[int, Progress]
    """Of the running heats, by number."""
    queue: list[HeatLine]
    workers: list[WorkerLine]
    finished: list[ListedHeat]
    troubled: list[HeatLine]
    """Given up, or in quarantine."""
    joining: list[JoiningEntry]
    window_s: float
    """Time over which heats are counted [s]."""
