"""The season's loop: when it ends, and when another process plans at the same time."""

from __future__ import annotations

from league.matchmaking import loop
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from league.matchmaking.workers import News
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


class Slow(Here):
    """An executor that sends all that a worker sends, one message at a time."""

    def __init__(self) -> None:
        super().__init__()
        self._news: list[News] = []

    def wait(self, timeout_s: float) -> list[News]:
        if not self._news and self.jobs:
            self._news = list(self._worker.follow(self.jobs[0]))
        if len(self._news) == 1:
            self.jobs.clear()
        return [self._news.pop(0)] if self._news else []


def test_how_far_heats_have_come_is_shown_at_most_once_a_second(tmp_path, monkeypatch):
    monkeypatch.setattr("league.matchmaking.workers.worker.SHOWN_EVERY_S", 0.0)
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        submitted(store, "ann", senses="blind")
        Matchmaker(store).plan()
        dispatcher, shown = Dispatcher(store, Slow()), []
        monkeypatch.setattr(store, "show", lambda worker, some: shown.append((worker, *some)))
        finished = []
        while not finished:
            finished = dispatcher.step(0.0)
        assert [worker for worker, _ in shown] == [dispatcher.name]  # it was raced within a second
        assert shown[0][1].key == finished[0].running.claim.heat.key
        monkeypatch.setattr("league.matchmaking.loop.SHOWN_EVERY_S", 0.0)
        while len(finished) < 2:
            finished += dispatcher.step(0.0)
        keys = [one.key for _, one in shown[1:]]
        assert len(keys) == 9 and set(keys) == {finished[1].running.claim.heat.key}
