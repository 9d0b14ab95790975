"""Seasons: begun, ended, and frozen as a document of standings and trophies."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from league.errors import StoreError
from league.matchmaking import divisions, documents, safety, standings
from league.matchmaking.divisions import SeasonSettings
from league.matchmaking.safety import Safety
from league.matchmaking.scores import BestLap, clean_laps
from league.matchmaking.standings import Standings
from league.matchmaking.store import Season, Store


def start(store: Store, name: str = "", settings: SeasonSettings | None = None) -> Season:
    """Begin a season, the first one with all races so far; see Store.start_season."""
    return store.start_season(name, asdict(settings or SeasonSettings()))


def end(store: Store) -> Season:
    """End the season: cancel its waiting heats, and freeze its standings and trophies.

    After a kill at any moment, called again, it goes on. A league that never began a season ends
    its first one. While heats are still being raced, without a rated entry, or if the season is
    over already, that is a StoreError.
    """
    known = store.seasons()
    if known and known[-1].ended_s is not None:
        raise StoreError(
            f"the season {known[-1].name!r} has ended already: begin the next one with "
            "`league season start`"
        )
    standings.of(store, known[-1].ruleset if known else None)  # refuses a season without a rating
    season = known[-1] if known else start(store)
    racing = store.close_season(season.number)
    if racing:
        raise StoreError(
            f"the season {season.name!r} takes no more heats, and {racing} of its heats are still "
            "being raced: end it again when they are over"
        )
    season = store.seasons()[-1]
    return store.freeze(season, freeze(store, season))


def freeze(store: Store, season: Season) -> dict[str, Any]:
    """Return a closed season as plain data: settings, standings, clean laps and trophies."""
    rated = standings.of(store, season.ruleset, season)
    now = divisions.assigned(store.division_moves(season.number))
    safe = safety.of(store, season.ruleset)
    laps = clean_laps(rated.races, rated.tracks)
    return {
        "season": {
            name: documents.plain(getattr(season, name))
            for name in ("number", "name", "ruleset", "settings", "after", "until", "started_s")
        },
        "standings": documents.standings_document(rated),
        "laps": documents.plain(laps),
        "safety": {str(number): asdict(one) for number, one in sorted(safe.items())},
        "divisions": {str(number): division for number, division in sorted(now.items())},
        "trophies": [asdict(one) for one in trophies(store, rated, now, safe, laps)],
    }


@dataclass(frozen=True)
class Trophy:
    """What a driver won in a season."""

    title: str
    number: int
    name: str
    owner: str
    value: str
    """What it was won with."""
    heat: int = 0
    """Number of the heat it was won in; 0 for the whole season."""


PLACES = ("Champion", "Second", "Third")


def trophies(
    store: Store,
    rated: Standings,
    division_of: Mapping[int, int],
    safe: Mapping[int, Safety],
    laps: Mapping[str, Sequence[BestLap]],
) -> list[Trophy]:
    """Return a season's trophies: by standings, divisions and safety (by number), and clean laps.

    The league's own anchors win none.
    """
    own = {row.number: row for row in rated.rows if not row.anchor and row.races}
    won: list[Trophy] = []

    def award(title: str, number: int, value: str, heat: int = 0) -> None:
        won.append(Trophy(title, number, own[number].name, own[number].owner, value, heat))

    for title, row in zip(PLACES, own.values(), strict=False):
        award(title, row.number, f"{row.elo:.0f} Elo, {row.races} races")
    for division in range(2, max(division_of.values(), default=0) + 1):
        best = next((number for number in own if division_of.get(number) == division), None)
        if best is not None:
            award(f"Winner of division {division}", best, f"{own[best].elo:.0f} Elo")
    known = [number for number in own if number in safe and safe[number].known]
    if known:
        safest = max(known, key=lambda number: (safe[number].rating, own[number].listed_by))
        value = f"{safe[safest].rating:.2f}, {safe[safest].incidents:.1f} points per 100 corners"
        award("Safest driver", safest, value)
    for track, fastest in laps.items():
        lap = next((lap for lap in fastest if lap.number in own), None)
        if lap is not None:
            award(f"Fastest clean lap, {track}", lap.number, f"{lap.lap_s:.3f} s", lap.heat)
    return won + _cup_winners(store, rated)


def _cup_winners(store: Store, rated: Standings) -> list[Trophy]:
    won: list[Trophy] = []
    entries = {entry.number: entry for entry in store.entries()}
    for cup in store.cups():
        document = store.frozen(cup)
        if document is None or rated.season is None or cup.season != rated.season.number:
            continue
        best, final = document["order"][0], document["stages"][-1]["heats"][0]["number"]
        entry, title = entries[best["entry"]], f"Winner of {cup.name}"
        if not entry.anchor:
            won.append(Trophy(title, entry.number, entry.name, entry.owner, "the final", final))
    return won
