"""Small leagues: one with recorded races and HTML in a name, one with heats that wait."""

from __future__ import annotations

import itertools

from league.matchmaking import cups, divisions, loop, seasons
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from tests.matchmaking.season_kit import SHORT, Here, new_league, submitted

ORIGIN = "http://127.0.0.1"
ANCHORS = ("centerline", "racing_line")
TRACKS = ("reinvent_2018", "reinvent_2018")
RULES = Ruleset(solver="planar", laps=1, max_time_s=8.0)
NAME = "<img src=x onerror=name='owned'>"
OWNER = "</td><script>name='owned'</script>"


def _founded(url: str) -> Store:
    """Return a league of three entries, one of them with HTML in its names."""
    store = new_league(url, anchors=ANCHORS, rules=RULES)
    store.submit(NAME, OWNER, scripted="cautious")
    return store


def raced_league(url: str, *, heats: int = 24) -> Store:
    """Return a league in which that many heats were raced."""
    store = _founded(url)
    dispatcher = Dispatcher(store, Here())
    loop.run(store, dispatcher, Matchmaker(store, same_owner=True), heats=heats)
    return store


def queued_league(url: str) -> Store:
    """Return a league with seven rated heats in its queue."""
    store = new_league(url, anchors=ANCHORS)
    for number, name in enumerate(("e0", "e1")):
        submitted(store, name, seed=number, senses="blind")
    pairs = [*itertools.combinations([entry.id for entry in store.entries()], 2)]
    store.plan([heat_spec.mirrored(SHORT.hash, TRACKS, pair) for pair in [*pairs, pairs[0][::-1]]])
    return store


def seasoned_league(url: str) -> Store:
    """Return a league with a season that is over, a cup in it, and a season that is running."""
    store = _founded(url)
    store.submit("blocks", "someone", scripted="blocker")
    worker, season = Dispatcher(store, Here()), Matchmaker(store, same_owner=True)
    seasons.start(store, "Spring", divisions.SeasonSettings(division_size=2))
    loop.run(store, worker, season, heats=16)
    cups.start(store, "May Cup", anchors=True)
    loop.run(store, worker, season, heats=8)
    seasons.end(store)
    seasons.start(store, "Summer", divisions.SeasonSettings(division_size=2))
    loop.run(store, worker, season, heats=6)
    return store


def rated_heat(store: Store) -> int:
    """Return the number of the first heat that counts."""
    return next(one.number for one in store.heats(("done",)) if one.heat.purpose == "rated")


def overtaken_heat(store: Store) -> int:
    """Return the number of the first rated heat with an overtaking in its first race."""
    for record in store.heats(("done",)):
        cars = store.results(record.number)[0].result["order"]
        if record.heat.purpose == "rated" and any(car["overtakes"] for car in cars):
            return record.number
    raise AssertionError("no car was overtaken")


def lapped_heat(store: Store) -> int:
    """Return the number of the first rated heat with a completed lap in its first race."""
    for record in store.heats(("done",)):
        first = store.results(record.number)[0]
        if record.heat.purpose == "rated" and first.result["order"][0]["lap_times_s"]:
            return record.number
    raise AssertionError("no lap was completed")
