"""Answers that are made again, or kept in part: in which order, and that nothing is missed."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import jinja2
import numpy as np
import pytest
from starlette.testclient import TestClient

from league.errors import LeagueError
from league.matchmaking import scores, standings
from league.matchmaking.ratings.pair_counts import ELO
from league.matchmaking.ratings.table import expected_score
from league.matchmaking.scope import RatingScope
from league.matchmaking.scores import heat_scores, race_scores
from league.matchmaking.store import Store
from league.web import answers, reader, server, snapshot
from league.web.app import make_app
from league.web.pages import heats
from league.web.reader import Reader
from league.web.routes import Page
from tests.matchmaking import leagues
from tests.web.decided_league import decided_league, raced, until
from tests.web.small_league import ORIGIN


@pytest.fixture
def league(tmp_path) -> Iterator[Store]:
    with decided_league(f"sqlite:///{tmp_path / 'league.db'}", duels=42) as store:
        yield store


def test_the_answer_that_most_ask_for_is_made_again_first(league, making, monkeypatch):
    may, made = making
    for module in (answers, reader):
        monkeypatch.setattr(module, "FRESH_S", 0.0)
        monkeypatch.setattr(module, "REST", 0.0)
    monkeypatch.setattr(answers, "STALE_S", 600.0)
    with TestClient(make_app(league), base_url=ORIGIN) as pages:
        for path in ("/feed.atom", "/heats", "/standings"):
            assert pages.get(path).status_code == 200
        raced(league, leagues.duels(league, 1, first=500))
        made.clear()
        may.clear()
        give_up = time.monotonic() + 60
        while not made:  # until the thread that makes answers again is busy
            pages.get("/feed.atom")
            assert time.monotonic() < give_up
        for path in ("/heats", "/standings", "/standings"):
            pages.get(path)
        may.set()
        while len(made) < 3:
            assert time.monotonic() < give_up
            time.sleep(0.01)
    assert made[:3] == ["/feed.atom", "/standings", "/heats"]


def test_scores_of_heats_are_the_sums_of_their_races(league):
    rated = standings.of(league)
    for row in rated.rows:
        by_heat: dict[int, list[float]] = {}
        for one in race_scores(rated.own_races(row.number), rated.tracks):
            points, expected = by_heat.get(one.heat, [0.0, 0.0])
            by_heat[one.heat] = [points + one.points, expected + one.expected]
        heats, points, expected = heat_scores(rated.own_races(row.number))
        assert heats.tolist() == sorted(by_heat)
        sums = np.array([by_heat[heat] for heat in heats.tolist()]).T
        assert points == pytest.approx(sums[0]) and expected == pytest.approx(sums[1])
        assert points.sum() == pytest.approx(
            row.score * rated.ratings.pairs[rated.ratings.index(row.number)]
        )


def test_each_moment_of_a_history_is_the_likeliest_rating_by_the_races_until_then(league):
    rated = standings.of(league)
    for row in rated.rows:
        own = rated.own_races(row.number)
        needed = own.strengths - rated.ratings.slot_advantages[own.slot]
        middle, spread = float(rated.ratings.elo.mean()), rated.ratings.prior_sd
        for moment in scores.own_history(rated, own, points=6)[:-1]:
            met = own.met[: moment.races]
            chance = expected_score(moment.elo - needed[: moment.races][met])
            # The slope of the log-posterior is 0 there, but for a step of a hundredth of an Elo.
            slope = float((own.points[: moment.races][met] - chance).sum()) / ELO
            slope -= (moment.elo - middle) / spread**2
            sd = (moment.high95 - moment.low95) / (2 * 1.959963984540054)
            assert abs(slope) * sd**2 < 0.02


def test_the_most_contested_race_is_found_reading_each_result_once(league, monkeypatch):
    asked, read = [], Store.results

    def noted(self, *heats):
        asked.extend(heats)
        return read(self, *heats)

    monkeypatch.setattr(Store, "results", noted)
    pages = Reader(league)
    first = heats._most_contested(pages)
    known = set(asked)
    asked.clear()
    assert heats._most_contested(pages) == first and not asked
    raced(league, leagues.duels(league, 2, first=500))
    later = heats._most_contested(pages)
    assert len(asked) == 2 and not known & set(asked)
    assert later == heats._most_contested(Reader(league))


def test_a_slow_car_that_is_hit_again_and_again_is_no_fight():
    def contest(heat, passes, crashes):
        cars = [
            {"overtakes": passes, "crashes": 0, "finished": True, "total_s": 15.0},
            {"overtakes": 0, "crashes": crashes, "finished": True, "total_s": 18.0},
        ]
        result = {"order": cars, "lead_changes": passes}
        return heats._contest(SimpleNamespace(result=result, heat=heat, half=0))

    assert max(contest(1, 3, 11), contest(2, 1, 0), contest(3, 1, 1))[2] == 2


def test_who_raced_the_newest_heats_is_read_without_the_heats(league):
    records = league.heats(("done",), limit=5, newest=True)[::-1]
    assert league.newest_done(5) == [(one.worker, one.done_s) for one in records]


def test_a_filter_that_leaves_all_races_rates_nobody_again(league):
    now = Reader(league).snapshot()
    assert len(now.car_counts) > 1 and now.rated_by("", now.car_counts[0]) is not now.rated
    alike = replace(now, rated=now.rated_by("", now.car_counts[0]))
    again = alike.rated_by("", now.car_counts[0])
    assert again is alike.rated
    fresh = standings.table(
        [one for one in now.entries if one.number in alike.rows],
        RatingScope(alike.rated.races, None, None),
        now.settings.ruleset.hash,
        now.settings.ruleset.tracks,
    )
    assert again.ratings.elo == pytest.approx(fresh.ratings.elo, abs=1e-3)


def test_a_warm_server_has_made_what_first_visitors_would_wait_for(store, monkeypatch):
    app = make_app(store)
    app.warm()
    monkeypatch.setattr(reader, "lap_bound", None)  # the bound of a track takes a tenth of a second
    monkeypatch.setattr(jinja2.environment.Environment, "compile", None)
    with TestClient(app, base_url=ORIGIN) as pages:
        for path in ("/tracks", "/time-attack", "/drivers/1", "/heats", "/definitions"):
            answer = pages.get(path)
            assert answer.status_code == 200, answer.text


def test_renewals_wait_for_what_is_not_kept_yet(league, monkeypatch):
    may, began, made, read = threading.Event(), threading.Event(), [], Page.read

    def recorded(self, *asked):
        made.append(self.path)
        if self.path == "/tracks":
            began.set()
            assert may.wait(60)
        return read(self, *asked)

    monkeypatch.setattr(Page, "read", recorded)
    for name, value in {"MOST": 8, "WAITS_S": 600.0, "STALE_S": 600.0}.items():
        monkeypatch.setattr(answers, name, value)
    for module in (answers, reader):
        monkeypatch.setattr(module, "FRESH_S", 0.0)
        monkeypatch.setattr(module, "REST", 0.0)
    with TestClient(make_app(league), base_url=ORIGIN) as pages:
        assert pages.get("/heats").status_code == 200
        raced(league, leagues.duels(league, 1, first=500))
        first = threading.Thread(target=pages.get, args=("/tracks",))
        first.start()
        assert began.wait(60)
        time.sleep(0.1)
        assert pages.get("/heats").status_code == 200  # the older one; a newer one is due
        time.sleep(0.2)
        assert made == ["/heats", "/tracks"]
        may.set()
        first.join()
        give_up = time.monotonic() + 60
        while made[2:] != ["/heats"]:
            assert time.monotonic() < give_up, made
            time.sleep(0.01)


def test_what_is_read_at_once_is_of_one_moment(league):
    with league.at_once():
        before, entry = league.counts(), league.entry("e1").number
        states = league.heat_states(entry)
        raced(league, leagues.duels(league, 1, first=500))
        assert league.counts() == before and league.heat_states(entry) == states
    assert league.counts()["done"] == before["done"] + 1
    assert list(states.values()).count("done") == league.num_done(entry)


def test_new_races_wait_while_first_answers_are_made(league, monkeypatch):
    pages = Reader(league)
    before = pages.snapshot()
    raced(league, leagues.duels(league, 1, first=500))
    pages._is_slow, pages._due_s = True, time.monotonic()
    pages.note(reader.MANY - 1)
    assert pages._crowded_s == float("-inf")
    pages.note(reader.MANY)
    assert time.monotonic() - 60 < pages._crowded_s <= time.monotonic()
    pages._crowded_s = time.monotonic() + 600
    assert pages.snapshot() is before
    time.sleep(2 * reader.CALM_S)
    assert pages.snapshot() is before
    pages._crowded_s = 0.0
    until(lambda: len(pages.snapshot().races.heat) > len(before.races.heat))
    # A crowd that does not end is not waited for any longer.
    pages._crowded_s = time.monotonic() + 600
    monkeypatch.setattr(reader, "PATIENCE_S", 0.1)
    monkeypatch.setattr(reader, "FRESH_S", 0.0)
    raced(league, leagues.duels(league, 1, first=600))
    until(lambda: len(pages.snapshot().races.heat) > len(before.races.heat) + 2)


def test_a_fit_waits_until_the_first_answers_of_a_crowd_are_made(league, monkeypatch):
    monkeypatch.setattr(reader, "FIT_CALM_S", 0.1)
    pages = Reader(league)
    first = pages.snapshot()
    pages._is_slow, pages._took_s, pages._crowded_s = True, 0.0, time.monotonic() + 600
    pages._settle_later(0.0)
    time.sleep(0.5)
    assert pages.snapshot() is first
    pages._crowded_s = 0.0
    until(lambda: pages.snapshot() is not first)


def test_a_fit_that_has_begun_lets_a_crowd_go_first(league, monkeypatch):
    monkeypatch.setattr(reader, "FIT_CALM_S", 0.0)
    pages = Reader(league)
    first = pages.snapshot()
    pages._is_slow, pages._took_s = True, 0.0
    raced(league, leagues.duels(league, 1, first=500))
    steps, scores = [], snapshot.scores.trends

    def crowd_comes(rated, carried, pause):
        pages._crowded_s = time.monotonic() + 600
        steps.append("begun")
        pause()
        steps.append("gone on")
        return scores(rated, carried, pause)

    monkeypatch.setattr(snapshot.scores, "trends", crowd_comes)
    pages._settle_later(0.0)
    until(lambda: steps)
    time.sleep(0.3)
    assert steps == ["begun"] and pages._snapshot is first
    pages._crowded_s = 0.0
    until(lambda: pages._snapshot is not first)
    assert steps == ["begun", "gone on"] and pages._snapshot.settled is None


def test_likely_pages_are_made_while_no_visitor_waits(league, making, monkeypatch):
    may, made = making
    monkeypatch.setattr(answers, "MOST", 100)
    for module in (answers, reader):
        monkeypatch.setattr(module, "FRESH_S", 0.0)
        monkeypatch.setattr(module, "REST", 0.0)
    app, give_up = make_app(league), time.monotonic() + 120
    assert not app.prepare()  # before the first request the server does not know its own address
    with TestClient(app, base_url=ORIGIN) as pages, TestClient(make_app(league)) as fresh:
        assert pages.get("/heats").status_code == 200
        while app.prepare():
            assert time.monotonic() < give_up
        likely = ["/", "/feed.atom", "/heats", "/standings", "/standings?sort=wins"]
        assert {address.partition("?")[0] for address in likely} <= {*made}
        assert not {"/live", "/submit", "/drivers/{number:number}"} & {*made}
        made.clear()
        prepared = {address: pages.get(address).text for address in likely}
        assert not made
        fresh.base_url = ORIGIN
        assert prepared == {address: fresh.get(address).text for address in likely}
        raced(league, leagues.duels(league, 1, first=500))
        made.clear()
        while not app.prepare():  # until nothing is made again
            assert time.monotonic() < give_up
        refused = {"/tracks", "/ghosts", "/time-attack"}  # the league's track does not exist
        assert len({*made} - refused) == 1
        may.clear()
        waiting = threading.Thread(target=pages.get, args=("/drivers/1",))
        waiting.start()
        while "/drivers/{number:number}" not in made:
            assert time.monotonic() < give_up
        assert not app.prepare()
        may.set()
        waiting.join(60)


def test_a_server_prepares_pages_until_it_is_over(monkeypatch):
    done: list[str] = []

    class Prepared:
        def warm(self) -> None:
            done.append("warm")

        def prepare(self) -> bool:
            done.append("page")
            if len(done) == 2:
                raise LeagueError("the database fails now")
            over.set()
            return True

    monkeypatch.setattr(server, "LOOKS_S", 0.01)
    over = threading.Event()
    server.prepare(Prepared(), over)
    assert done == ["warm", "page", "page"]


def test_heats_are_counted_by_one_request_at_a_time(league, monkeypatch):
    pages = Reader(league)
    before = pages.counts()
    raced(league, leagues.duels(league, 1, first=500))
    pages._counts_due_s = 0.0
    with pages._counting:  # by another request
        assert pages.counts() == before
    assert pages.counts() == league.counts() != before
