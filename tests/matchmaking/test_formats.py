"""A league's format decides how the cars of its heats line up."""

from __future__ import annotations

from dataclasses import replace

import pytest

from league.matchmaking import loop, standings
from league.matchmaking.loop import Dispatcher, heat_driver
from league.matchmaking.pairing.heat_spec import Half, Ruleset
from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import HeatOutcome, HeatRecord, RaceOutcome, Store
from league.matchmaking.workers.worker import HeatJob, HeatReport, RaceWorker
from league.replay import format as replay_format
from tests.matchmaking.season_kit import SHORT, Here, new_league, submitted

TRACKS = ("reinvent_2018", "peanut", "comet", "anvil")


class Known(Here):
    """Workers that decide races by the entries' names: e2 beats e1, but its laps are slower."""

    def __init__(self, store: Store) -> None:
        super().__init__()
        self.skill = {entry.id: sum(map(ord, entry.name)) for entry in store.entries()}

    def wait(self, timeout_s: float) -> list[HeatReport]:
        if not self.jobs:
            return []
        job = self.jobs.pop(0)
        races = tuple(
            self.outcome(half, seed) for half, seed in zip(job.halves, job.seeds, strict=True)
        )
        return [HeatReport(job.key, HeatOutcome(job.key, races), "", 0.1, 60.0)]

    def outcome(self, half: Half, seed: int) -> RaceOutcome:
        skills = [self.skill[id] for id in half.grid]
        places = tuple(1 + sum(other > skill for other in skills) for skill in skills)
        order = [
            {"car": car, "finished": True, "lap_times_s": [lap_s(skill, half.track), 99.0]}
            for car, skill in enumerate(skills)
        ]
        return RaceOutcome(places, {"seed": seed, "order": order})


def lap_s(skill: int, track: str) -> float:
    """The better the slower, but on the first track the faster."""
    return 1000.0 / skill if track == TRACKS[0] else skill / 100


def raced(tmp_path, rules: Ruleset, heats: int = 60) -> Store:
    store = new_league(f"sqlite:///{tmp_path / 'league.db'}", rules=rules)
    for number in range(3):
        submitted(store, f"e{number}", seed=number, senses="blind")
    loop.run(store, Dispatcher(store, Known(store)), Matchmaker(store), heats=heats)
    Matchmaker(store).plan()
    return store


def rated(store: Store, *states) -> list[HeatRecord]:
    return [record for record in store.heats(states or None) if record.heat.purpose == "rated"]


@pytest.mark.parametrize("format", ["standing", "pursuit"])
def test_without_an_order_of_its_own_a_format_swaps_the_grid_in_the_second_race(tmp_path, format):
    with raced(tmp_path, replace(SHORT, format=format), heats=10) as store:
        heats = rated(store)
        assert heats
        for record in heats:
            one, other = record.heat.halves
            assert one.grid == other.grid[::-1]


def test_in_a_reverse_grid_the_best_rated_starts_last_in_both_races(tmp_path):
    with raced(tmp_path, replace(SHORT, format="reverse", cars=3)) as store:
        elo = {row.id: row.elo for row in standings.of(store).rows}
        newest = rated(store, "planned")
        assert newest
        for record in newest:
            one, other = record.heat.halves
            assert one.grid == other.grid and len(one.grid) == 3
            assert list(one.grid) == sorted(one.grid, key=lambda id: elo[id])


def test_both_races_of_a_reverse_grid_are_rated_however_they_end(tmp_path):
    class Even(Known):
        def outcome(self, half: Half, seed: int) -> RaceOutcome:
            known = super().outcome(half, seed)
            places = (1, 2) if seed % 2 and len(set(half.grid)) == 2 else known.places
            return RaceOutcome(places, known.result)

    with new_league(
        f"sqlite:///{tmp_path / 'league.db'}", rules=replace(SHORT, format="reverse")
    ) as store:
        for number in range(3):
            submitted(store, f"e{number}", seed=number, senses="blind")
        loop.run(store, Dispatcher(store, Even(store)), Matchmaker(store), heats=30)
        table = standings.of(store)
        assert table.num_races == 2 * len(rated(store, "done"))


def test_qualifying_puts_the_best_lap_on_the_track_first_and_who_has_none_last(tmp_path):
    with raced(tmp_path, replace(SHORT, format="qualifying", tracks=TRACKS)) as store:
        skill = Known(store).skill
        newest = rated(store, "planned")
        assert {half.track for record in newest for half in record.heat.halves} == set(TRACKS)
        for record in newest:
            for half in record.heat.halves:
                assert list(half.grid) == sorted(
                    half.grid, key=lambda id: lap_s(skill[id], half.track)
                )
        # Before anyone has a lap, grids are as they were drawn, and the same in both races.
        first, second = rated(store)[0].heat.halves
        assert first.grid == second.grid
        # A newcomer has no lap, so it starts last.
        late = submitted(store, "a", seed=9, senses="blind")  # would have the fastest laps
        known = Known(store)
        loop.run(store, Dispatcher(store, known), Matchmaker(store), heats=80)
        heats = [record for record in rated(store) if late.id in record.heat.entries]
        assert heats and all(half.grid[-1] == late.id for half in heats[0].heat.halves)


@pytest.mark.parametrize("format", ["reverse", "pursuit"])
def test_workers_race_by_the_format_and_obstacles_of_the_ruleset(tmp_path, format):
    rules = replace(SHORT, format=format, obstacles=3, obstacle_kind="bot")
    with new_league(f"sqlite:///{tmp_path / 'league.db'}", rules=rules) as store:
        entry = submitted(store, "bob", senses="blind")
        halves = (Half("reinvent_2018", (entry.id, entry.id)),)
        field = {entry.id: heat_driver(store, entry)}
        report = RaceWorker().race(HeatJob("0" * 64, 1, halves, (3,), rules, field))
    assert report.outcome is not None, report.traceback
    recording = report.outcome.races[0].replay
    assert recording is not None
    replay = replay_format.decode(recording)
    assert replay.spec.format == format
    assert replay.columns.num_obstacles == 3
    gap = abs(replay.columns.distance[0, 0] - replay.columns.distance[0, 1])
    assert gap == pytest.approx(0.0 if format == "pursuit" else 0.75, abs=1e-3)


def test_a_format_makes_another_ruleset_and_none_that_of_before():
    assert (
        len(
            {
                replace(SHORT, format=name).hash
                for name in ("standing", "reverse", "qualifying", "pursuit")
            }
        )
        == 4
    )
    stored = {"tracks": ["reinvent_2018"], "laps": 3, "physics": "4"}
    assert Ruleset.of(stored).format == "standing"
    assert Ruleset.of(stored).hash == Ruleset.of({**stored, "format": "standing"}).hash
