"""The pages by their addresses: template, data, and what may be asked for."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from starlette.convertors import IntegerConvertor, register_url_convertor
from starlette.requests import Request

from league.web.pages import driver, heats, laps, seasons, table
from league.web.reader import PER_PAGE, Document, Reader
from league.web.schemas import pages as schemas
from league.web.schemas import races


class _Number(IntegerConvertor):
    """Numbers in addresses: no longer than any that a league has."""

    regex = "[0-9]{1,15}"


register_url_convertor("number", _Number())
LISTED = 10
"""Pages of each long list that visitors are likely to turn to."""


@dataclass(frozen=True)
class Page:
    """One page; its data alone is at /api/v1 and the same path."""

    path: str
    """As Starlette writes routes."""
    summary: str
    """What it shows, in a few words."""
    document: Callable[..., Document]
    """Returns its data, from a Reader and the parameters of path and query by their names."""
    template: str = ""
    """File of the page; empty for data without a page."""
    file: str = ""
    """Name under which browsers save the page instead of showing it; may hold path parameters."""
    media_type: str = "text/html"
    """Of the page."""
    query: Mapping[str, str] = field(default_factory=dict)
    """Parameters after the question mark, all of them text, each with its meaning."""
    shared: bool = False
    """Whether it is the same for everyone who asks and may be a few seconds old, so that an answer
    is kept."""
    fleeting: bool = False
    """Whether it changes with time alone."""
    answer: type[races.Answer] | None = None
    """What its data is, where it is to be had as JSON."""

    @property
    def has_api(self) -> bool:
        """Whether its data is to be had as JSON."""
        return self.answer is not None

    @property
    def api_path(self) -> str:
        """Address of its data."""
        return f"/api/v1{self.path.rstrip('/') or '/home'}"

    def read(self, reader: Reader, request: Request) -> Document:
        """Return the data that a request asks for."""
        asked: dict[str, Any] = {name: request.query_params.get(name, "") for name in self.query}
        return self.document(reader, **request.path_params, **asked)


PAGES = (
    Page("/", "The most contested recent race and the top of the standings", heats.home,
         "home.html", shared=True,
         answer=schemas.HomeAnswer),
    Page("/standings", "The standings", table.document, "standings.html",
         shared=True,
         query={"owner": "Only entries of this owner", "kind": "Only anchor, policy or scripted",
          "track": "Only races on this track",
          "cars": "Only races of so many cars",
          "against": "Number or name of a driver: everyone's record against it",
          "sort": "races, wins, finishes, lap, name or owner; by default the rating",
          "page": "Number of the page, from 1"},
         answer=schemas.StandingsAnswer),
    Page("/drivers/{number:number}", "A driver: rating, history, records, heats, card",
         driver.document, "driver.html", shared=True,
         answer=schemas.DriverAnswer),
    Page("/matchups/{one:number}/{other:number}",
         "Two drivers: their heats, expected and actual score",
         driver.matchup, "matchup.html", shared=True,
         query={"before": "Number of a heat: only earlier ones are listed",
          "season": "Number of a season: only its heats are listed"},
         answer=schemas.MatchupAnswer),
    Page("/heats", "The heats that are done, the newest first", heats.heats, "heats.html",
         shared=True,
         query={"driver": "Number of a driver: only its heats, and how it did in each race",
          "season": "Number of a season: only its heats",
          "page": "Number of the page, from 1"},
         answer=schemas.HeatsAnswer),
    Page("/feed.atom", "The newest heats as a feed", heats.feed, "feed.xml", shared=True,
         media_type="application/atom+xml"),
    Page("/heats/{number:number}", "A heat, and one of its races", heats.heat, "heat.html",
         shared=True,
         query={"race": "Number of the race within the heat, from 1",
          "lap": "Number of the lap to compare, from 1; empty for each car's best one"},
         answer=races.HeatAnswer),
    Page("/heats/{number:number}/races/{race:number}/replay", "What the player draws of a race",
         heats.replay, shared=True,
         answer=races.PlayedRace),
    Page("/heats/{number:number}/races/{race:number}/file",
         "A file that plays a race without a server",
         heats.one_file, "one_file.html", file="heat_{number}_race_{race}.html"),
    Page("/tracks", "The tracks, and the best clean laps on each", laps.tracks, "tracks.html",
         shared=True,
         answer=schemas.TracksAnswer),
    Page("/ghosts", "Any two laps on a track against each other", laps.ghosts, "ghosts.html",
         shared=True,
         query={"track": "Name of the track",
          "one": "A lap as heat.race.car.lap, or the number of a driver: its best clean lap",
          "other": "The same, for the second lap",
          "heat": "Number of a heat of which all laps are offered"},
         answer=schemas.GhostsAnswer),
    Page("/ghosts/replay", "What the player draws of two laps", laps.ghosts_replay, shared=True,
         query={"one": "A lap as heat.race.car.lap", "other": "The second lap"},
         answer=races.PlayedRace),
    Page("/time-attack", "The fastest clean laps on each track, for each kind of race",
         laps.boards, "boards.html", shared=True,
         query={"races": "Kind of race: head_to_head, time_trial or obstacle_avoidance"},
         answer=schemas.BoardsAnswer),
    Page("/seasons", "Past seasons with their trophies, and cups", seasons.document, "seasons.html",
         shared=True, answer=races.SeasonsAnswer),
    Page("/seasons/{number:number}", "A season's final standings and trophies", seasons.season,
         "season.html", query={"page": "Number of the page of the final standings, from 1"},
         answer=races.SeasonAnswer),
    Page("/cups/{number:number}", "A cup: qualifying and bracket", seasons.cup, "cup.html",
         query={"round": "Number of a round with many heats, from 1, instead of the last rounds",
          "page": "Number of the page of the qualifying, or of that round, from 1"},
         answer=races.CupAnswer),
    Page("/definitions", "What the numbers mean", table.definitions, "definitions.html",
         answer=schemas.DefinitionsAnswer),
    Page("/live", "Running heats, queue, workers, heats per minute", heats.live, "live.html",
         shared=True, fleeting=True,
         answer=schemas.LiveAnswer),
)  # fmt: skip
"""All pages, and data without a page."""


def likely(reader: Reader) -> Iterator[str]:
    """Yield the addresses of pages that visitors are likely to ask for: the lists, as they are."""
    for one in PAGES:
        if one.template and one.shared and not one.fleeting and "{" not in one.path:
            yield one.path
    lengths = {table.PATH: len(reader.snapshot().rows), "/heats": reader.counts().get("done", 0)}
    for path, lines in lengths.items():
        last = min(LISTED, math.ceil(lines / PER_PAGE))
        yield from (f"{path}?page={page}" for page in range(2, last + 1))
    yield from (f"{table.PATH}?sort={name}" for name in filter(None, table.ORDERS))
