"""The season's loop: when it ends, and when another process plans at the same time."""

from __future__ import annotations

from league.matchmaking import loop
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from tests.matchmaking.season_kit import Here, new_league, submitted


class Overtaken(Matchmaker):
    """A matchmaker that finds nothing to plan at first, and then that another has planned it."""

    def __init__(self, store: Store) -> None:
        super().__init__(store)
        self._other, self._calls = Matchmaker(store), 0

    def plan(self) -> int:
        self._calls += 1
        if self._calls == 1:
            return 0
        if self._calls == 2:
            assert self._other.plan()
        return super().plan()


def test_a_run_goes_on_when_another_process_has_just_planned(tmp_path):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        for number in range(2):
            submitted(store, f"e{number}", seed=number, senses="blind")
        tally = loop.run(store, Dispatcher(store, Here()), Overtaken(store), heats=12)
        assert tally.heats == 12 and not tally.idle


def test_a_run_without_anything_to_race_ends(tmp_path):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        tally = loop.run(store, Dispatcher(store, Here()), Matchmaker(store), heats=12)
        assert tally.idle and tally.heats == 0
