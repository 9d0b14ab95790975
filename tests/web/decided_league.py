"""A league with races that are decided by the names of its entries, without driving."""

from __future__ import annotations

import time
from collections.abc import Callable

from league.matchmaking.pairing.heat_spec import Half, Heat
from league.matchmaking.store import HeatOutcome, RaceOutcome, Store
from tests.matchmaking import leagues

ENTRIES = 7


def outcome(half: Half) -> RaceOutcome:
    """Return a race in which smaller names win on the ring, larger ones on the square."""
    order = sorted(half.grid, reverse=half.track == "square")
    places = tuple(order.index(entry) + 1 for entry in half.grid)
    laps = [[10.0 + place, 9.0 + place] for place in places]
    order = [
        {"car": car, "finished": place != 2, "lap_times_s": laps[car], "distance": 0.0}
        for car, place in enumerate(places)
    ]
    return RaceOutcome(places, {"order": order})


def raced(league: Store, heats: list[Heat]) -> None:
    league.plan(heats)
    for claim in league.claim("w", len(heats)):
        races = tuple(outcome(half) for half in claim.heat.halves)
        league.complete("w", [HeatOutcome(claim.heat.key, races)])


def decided_league(url: str, *, duels: int) -> Store:
    """Return a league of seven entries after so many duels and one race of three."""
    store = leagues.founded(url, entries=ENTRIES)
    trio = tuple(entry.id for entry in store.entries()[:3])
    raced(store, [*leagues.duels(store, duels), Heat(leagues.RULES.hash, (Half("ring", trio),))])
    return store


def until(is_so: Callable[[], object]) -> None:
    """Wait until something is so, which another thread brings about."""
    give_up = time.monotonic() + 60
    while not is_so():
        assert time.monotonic() < give_up
        time.sleep(0.01)
