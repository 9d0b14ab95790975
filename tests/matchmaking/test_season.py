"""The season: newcomers are validated, rounds are planned, and crashes change nothing."""

from __future__ import annotations

import shutil
import sqlite3

import numpy as np
import pytest

from league.cli import main
from league.errors import StoreError
from league.matchmaking import loop, scores, standings
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing import matchmaker
from league.matchmaking.pairing.matchmaker import ROUND, Matchmaker
from league.matchmaking.store import RATED, HeatOutcome, RaceOutcome, Store
from league.matchmaking.workers.worker import HeatJob, HeatReport
from tests.matchmaking import leagues
from tests.matchmaking.season_kit import Here, new_league, submitted


class Coin(Here):
    """Workers that toss a coin by the race's seed instead of racing."""

    def wait(self, timeout_s: float) -> list[HeatReport]:
        if not self.jobs:
            return []
        job = self.jobs.pop(self.pick())
        return [HeatReport(job.key, tossed(job), "", 0.1, 60.0)]

    def pick(self) -> int:
        return 0


class Late(Coin):
    """The same, but the newest job is through first."""

    def pick(self) -> int:
        return -1


def tossed(job: HeatJob) -> HeatOutcome:
    races = []
    for half, seed in zip(job.halves, job.seeds, strict=True):
        first = seed % 2
        places = (1, 2) if first else (2, 1)
        races.append(RaceOutcome(places[: len(half.grid)], {"seed": seed}))
    return HeatOutcome(job.key, tuple(races))


@pytest.fixture
def url(tmp_path) -> str:
    return f"sqlite:///{tmp_path / 'league.db'}"


def grown(url: str, entries: int = 3) -> Store:
    store = new_league(url)
    for number in range(entries):
        submitted(store, f"e{number}", seed=number, senses="blind")
    return store


def states(store: Store) -> dict[str, str]:
    return {entry.name: entry.state for entry in store.entries()}


def test_anchors_need_no_validation_and_the_first_is_1000(url):
    with new_league(url, anchors=("centerline", "cautious")) as store:
        assert states(store) == {"centerline": "placement", "cautious": "placement"}
        assert standings.of(store).row(1).elo == pytest.approx(1000.0)


def test_a_newcomer_races_itself_and_an_anchor_before_it_is_paired(url):
    with grown(url, 1) as store:
        planner = Matchmaker(store)
        assert planner.plan() == 2  # none else to pair
        own, anchor = (record.heat for record in store.heats())
        assert own.purpose == anchor.purpose == "validation"
        ids = {entry.name: entry.id for entry in store.entries()}
        assert own.halves[0].grid == (ids["e0"],) * 2
        assert set(anchor.halves[0].grid) == {ids["e0"], ids["centerline"]}
        assert planner.plan() == 0 and states(store)["e0"] == "validating"
        loop.run(store, Dispatcher(store, Coin()), None, heats=2)
        assert planner.plan() == 8 and states(store)["e0"] == "placement"
        assert all(r.heat.purpose == "rated" for r in store.heats(("planned",)))


def test_a_new_leagues_first_entries_do_not_wait_behind_races_of_its_anchors(url):
    with new_league(url, anchors=("centerline", "cautious")) as store:
        submitted(store, "e0", senses="blind")
        planner = Matchmaker(store)
        assert [planner.plan(), planner.plan()] == [2, 0]
        assert all(record.heat.purpose == "validation" for record in store.heats())
        loop.run(store, Dispatcher(store, Coin()), None, heats=2)
        assert planner.plan() == 8  # now that all three are known, everybody meets everybody
        me = store.entry("e0").id
        assert any(me in record.heat.entries for record in store.heats(("planned",)))


def test_anchors_go_on_racing_when_a_newcomer_cannot_be_validated(url):
    with new_league(url, anchors=("centerline", "cautious")) as store:
        submitted(store, "e0", senses="blind")
        planner = Matchmaker(store)
        planner.plan()
        while claims := store.claim("w", 9):
            for claim in claims:
                store.fail("w", claim.heat.key, "the dog ate it")
        assert planner.plan() == 8 and states(store)["e0"] == "validating"


def test_an_entry_that_is_not_rated_yet_says_what_it_waits_for(url):
    def reason() -> str:
        return matchmaker.entries_with_reasons(store)[-1].reason

    with grown(url, 1) as store:
        planner = Matchmaker(store)
        assert "not planned yet: `league run`" in reason()
        planner.plan()
        assert "waits for its validation heats (1, 2): `league run`" in reason()
        while claims := store.claim("w", 1):
            store.fail("w", claims[0].heat.key, "Traceback\nOSError: the dog ate it")
        assert planner.plan() == 0 and states(store)["e0"] == "validating"
        assert "heat 1 was given up (OSError: the dog ate it)" in reason()
        assert "`league retry 1`" in reason()
        assert [store.retry(record.heat.key) for record in store.heats(("error",))] == [1, 2]
        loop.run(store, Dispatcher(store, Coin()), None, heats=2)
        assert "are done: `league run` rates it" in reason()
        planner.plan()
        assert states(store)["e0"] == "placement" and reason() == ""


def test_two_rounds_are_in_the_queue_and_the_next_waits_for_the_older_one(url):
    with new_league(url, anchors=("centerline", "cautious", "blocker")) as store:
        planner = Matchmaker(store)
        assert [planner.plan() for _ in range(3)] == [8, 8, 0]
        dispatcher = Dispatcher(store, Coin())
        loop.run(store, dispatcher, None, heats=7)
        assert planner.plan() == 0
        loop.run(store, dispatcher, None, heats=1)
        assert planner.plan() == 8 and planner.plan() == 0
        assert sorted({record.heat.draw // ROUND for record in store.heats()}) == [1, 2, 3]


def test_the_same_heats_are_planned_for_any_number_of_workers(url, monkeypatch, capsys):
    new_league(url, anchors=("centerline", "cautious")).close()
    path = url.removeprefix("sqlite:///")
    planned = []
    for workers in (1, 5):
        copy = f"{path}.{workers}"
        shutil.copy(path, copy)  # the same secret, so the same seeds
        monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{copy}")
        assert main(["run", "--heats", "1", "--workers", str(workers), "--plain"]) == 0
        with Store(f"sqlite:///{copy}") as store:
            planned.append([record.heat.key for record in store.heats()])
    fewer = min(map(len, planned))
    assert fewer >= 8 and planned[0][:fewer] == planned[1][:fewer]


def test_a_heat_is_two_races_with_the_grid_swapped(url):
    with new_league(url, anchors=("centerline", "cautious")) as store:
        Matchmaker(store).plan()
        for record in store.heats():
            one, other = record.heat.halves
            assert one.grid == other.grid[::-1] and len(set(one.grid)) == 2


def test_entries_of_one_owner_meet_only_if_the_league_allows_it(url):
    with new_league(url, anchors=()) as store:
        for name in ("e0", "e1"):
            submitted(store, name, seed=ord(name[1]), owner="ann", senses="blind")
        dispatcher = Dispatcher(store, Coin())
        tally = loop.run(store, dispatcher, Matchmaker(store), heats=50)
        assert tally.idle and tally.heats == 2  # each raced itself, there is no anchor
        tally = loop.run(store, dispatcher, Matchmaker(store, same_owner=True), heats=10)
        assert tally.heats == 10 and not tally.idle


def fingerprint(store: Store) -> list[tuple]:
    rows = [(row.number, row.elo, row.sd, row.races, row.state) for row in standings.of(store).rows]
    return sorted(rows)


def test_a_season_ends_the_same_whoever_was_faster_and_however_often_it_was_restarted(url):
    grown(url).close()
    path = url.removeprefix("sqlite:///")
    shutil.copy(path, f"{path}.copy")  # the same secret, so the same seeds
    with Store(url) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=60)
        plain = fingerprint(store), [record.heat.key for record in store.heats()]
    with Store(f"{url}.copy") as store:
        for _ in range(12):  # a new matchmaker each time, workers that finish the other way round
            loop.run(store, Dispatcher(store, Late(5)), Matchmaker(store), heats=5)
        keys = [record.heat.key for record in store.heats()]
        assert keys == plain[1] and fingerprint(store) == plain[0]


def test_entries_climb_from_placement_to_ranked_as_they_become_sure(url):
    with grown(url, 2) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=24)
        assert set(states(store).values()) <= set(RATED)
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=70)
        assert set(states(store).values()) == {"ranked"}
        table = standings.of(store)
        assert all(row.sd < 50 and not row.provisional for row in table.rows)
        assert all(row.low95 < row.elo < row.high95 for row in table.rows if not row.anchor)


class Fickle(Coin):
    """Workers that end races another way each time."""

    count = 0

    def wait(self, timeout_s: float) -> list[HeatReport]:
        reports = super().wait(timeout_s)
        self.count += 1
        return [
            HeatReport(r.key, HeatOutcome(r.key, tuple(RaceOutcome(one.places, {"n": self.count})
                                               for one in r.outcome.races)))
            for r in reports if r.outcome
        ]  # fmt: skip


def test_an_entry_whose_validation_is_disputed_is_refused(url):
    with grown(url, 1) as store:
        planner = Matchmaker(store)
        planner.plan()
        (first, *_) = store.heats()
        for claim in store.claim("w", 1):
            store.complete("w", [HeatOutcome(claim.heat.key, (RaceOutcome((1, 2), {"n": 1}),))])
            store.complete("w", [HeatOutcome(claim.heat.key, (RaceOutcome((1, 2), {"n": 2}),))])
        assert store.heat(first.number).state == "quarantined"
        loop.run(store, Dispatcher(store, Coin()), None, heats=1)
        planner.plan()
        entry = store.entry("e0")
        assert entry.state == "refused" and "deterministic" in entry.reason


def test_an_entry_refused_for_a_dispute_comes_back_when_a_third_worker_settles_it(url):
    with grown(url, 1) as store:
        planner = Matchmaker(store)
        planner.plan()
        (claim,) = store.claim("w", 1)
        rightly = HeatOutcome(claim.heat.key, (RaceOutcome((1, 2), {"n": 1}),))
        store.complete("w", [rightly])
        store.complete("v", [HeatOutcome(claim.heat.key, (RaceOutcome((1, 2), {"n": 2}),))])
        planner.plan()  # refuses it, and cancels its other validation heat
        assert states(store)["e0"] == "refused" and store.counts()["cancelled"] == 1
        assert store.retry(claim.heat.key) == claim.number
        assert states(store)["e0"] == "validating"
        (again,) = store.claim("x", 1)
        assert store.complete("x", [HeatOutcome(again.heat.key, rightly.races)]).accepted
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=4)
        assert states(store)["e0"] in RATED


def test_after_its_first_round_a_league_is_connected_to_the_pinned_anchor(url):
    anchors = ("centerline", "racing_line", "cautious", "blocker")
    with new_league(url, anchors=anchors) as store:
        for number in range(5):
            submitted(store, f"e{number}", seed=number, owner="garage", senses="blind")
        # Five entries validate in ten heats; eight rated ones are the fewest that connect nine.
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store, same_owner=True), heats=18)
        table = standings.of(store)
        assert len(table.rows) == 9 and table.num_races == 16
        assert all(row.connected and row.provisional for row in table.rows)
        assert min(row.sd for row in table.rows) > 50  # not one is sure yet
        for row in table.rows:  # what is printed is relative to the first anchor, which is 1000
            assert (row.high95 - row.low95 > 196) == (row.name != "centerline")


class Drivers(Coin):
    """Workers that report laps: the front car drives one in 11 s, the other none."""

    def wait(self, timeout_s: float) -> list[HeatReport]:
        order = [
            {"car": 0, "finished": True, "lap_times_s": (11.5, 11.0)},
            {"car": 1, "finished": False, "lap_times_s": ()},
        ]
        return [
            HeatReport(r.key, HeatOutcome(r.key, tuple(RaceOutcome((1, 2), {"order": order})
                                               for _ in r.outcome.races)))
            for r in super().wait(timeout_s) if r.outcome
        ]  # fmt: skip


def test_standings_tell_races_not_finished_and_best_laps_of_accepted_results(url):
    with grown(url, 2) as store:
        loop.run(store, Dispatcher(store, Drivers()), Matchmaker(store), heats=16)
        table = standings.of(store)
        track = store.settings.ruleset.tracks[0]
        for row in table.rows:  # each heat is a race in front and one behind
            assert row.unfinished == pytest.approx(0.5) and row.best_laps_s == {track: 11.0}
        heat = next(r for r in store.heats(("done",)) if r.heat.purpose == "rated")
        quick = {"order": [{"car": 0, "finished": True, "lap_times_s": [1.0]}]}
        lie = tuple(RaceOutcome((1, 2), quick) for _ in heat.heat.halves)
        store.complete("liar", [HeatOutcome(heat.heat.key, lie)])
        assert all(row.best_laps_s == {track: 11.0} for row in standings.of(store).rows)
        assert standings.of(store).num_races == table.num_races - 2
    with new_league(f"{url}.new") as store:
        (row,) = standings.of(store).rows
        assert row.unfinished is None and row.best_laps_s == {}


def test_a_retired_entry_is_paired_no_more_and_keeps_its_results(url):
    with grown(url, 2) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=40)
        gone = store.entry("e0")
        races = standings.of(store).row(gone.number).races
        store.move({gone.id: "retired"})
        since = store.heats()[-1].number
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=30)
        later = store.heats(("done",), since=since)
        assert later and not any(gone.id in record.heat.entries for record in later)
        assert standings.of(store).row(gone.number).races >= races > 0


def test_head_to_head_records_add_up(url):
    with grown(url) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=60)
        table = standings.of(store)
        for one in table.rows:
            others = [other.number for other in table.rows if other is not one]
            met = [standings.head_to_head(table, one.number, other) for other in others]
            assert sum(record.races for record in met) == one.races
            points = sum(record.points for record in met)
            assert points / one.races == pytest.approx(one.score)
        forth, back = (standings.head_to_head(table, *pair) for pair in ((1, 2), (2, 1)))
        assert forth.wins == back.races - back.wins - back.ties
        assert forth.expected + back.expected == pytest.approx(forth.races)
        assert forth.residual == pytest.approx(-back.residual)


def test_the_last_moment_of_a_history_is_the_present(url):
    with grown(url) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=40)
        table = standings.of(store)
        last = store.races().entries[-1]
        assert any(row.number not in last for row in table.rows)  # others raced after its last
        for row in table.rows:
            moments = scores.history(store, store.entry(row.name), points=5)
            # Both races of a heat are one moment.
            assert len(moments) == min(5, row.races // 2) and moments[-1].races == row.races
            assert [m.heat for m in moments] == sorted({m.heat for m in moments})
            # Widths need not fall from the first moment on: the prior is learnt from little there.
            widths = [moment.high95 - moment.low95 for moment in moments]
            assert min(widths) > 0 or row.anchor
            assert widths[-1] == pytest.approx(row.high95 - row.low95)


def test_standings_do_not_depend_on_the_order_of_the_rows_in_the_database(url):
    with grown(url, 6) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=40)
        before = standings.of(store)
        with sqlite3.connect(url.removeprefix("sqlite:///")) as database:
            rows = database.execute("SELECT * FROM races").fetchall()
            database.execute("DELETE FROM races")
            for number, place in enumerate(np.random.default_rng(0).permutation(len(rows)), 1):
                row = (number, *rows[place][1:])
                database.execute(f"INSERT INTO races VALUES ({','.join('?' * len(row))})", row)
        assert store.races().heat.tolist() != sorted(store.races().heat)
        after = standings.of(store)
    assert after.num_races == before.num_races > 40
    for one, other in zip(before.rows, after.rows, strict=True):
        for name, value in vars(one).items():
            same = getattr(other, name)
            assert same == (pytest.approx(value, abs=1e-6) if isinstance(value, float) else value)


def test_ranks_that_an_entry_may_have_leave_out_those_that_are_surely_apart(url):
    with grown(url, 4) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=30)
        rows = standings.of(store).rows
    for row in rows:
        above = sum(other.elo - 1.96 * other.sd > row.elo + 1.96 * row.sd for other in rows)
        below = sum(other.elo + 1.96 * other.sd < row.elo - 1.96 * row.sd for other in rows)
        assert row.best_rank == min(row.rank, 1 + above)
        assert row.worst_rank == max(row.rank, len(rows) - below)


def test_standings_of_nobody_say_what_to_do(url):
    with new_league(url, anchors=()) as store, pytest.raises(StoreError, match="league submit"):
        standings.of(store)


def test_ratings_are_kept_apart_by_the_rules(url):
    from dataclasses import replace

    with grown(url) as store:
        loop.run(store, Dispatcher(store, Coin()), Matchmaker(store), heats=40)
        leagues.set_ruleset(store, replace(store.settings.ruleset, laps=2))
        assert standings.of(store).num_races == 0
        loop.run(
            store, Dispatcher(store, Coin()), Matchmaker(store), heats=24
        )  # old ones are in the queue
        assert 0 < standings.of(store).num_races <= 48
        assert np.isfinite([row.sd for row in standings.of(store).rows]).all()
