"""A large league between two fits: new races are added to the last one, and settled later."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np
import pytest
from starlette.testclient import TestClient

from league.matchmaking import standings
from league.matchmaking.store import Store
from league.web import reader, snapshot
from league.web.app import make_app
from league.web.reader import Reader
from tests.matchmaking import leagues
from tests.web.decided_league import decided_league, raced, until
from tests.web.small_league import ORIGIN

FIELDS = ("number", "races", "wins", "score", "unfinished", "best_laps_s", "connected", "one_sided")


@pytest.fixture
def league(tmp_path) -> Iterator[Store]:
    with decided_league(f"sqlite:///{tmp_path / 'league.db'}", duels=60) as store:
        yield store


def table(of: snapshot.Snapshot) -> np.ndarray:
    ratings = of.rated.ratings
    return np.stack([ratings.elo, ratings.sd, ratings.low95, ratings.high95, ratings.listed_by])


def test_new_races_are_all_in_the_standings_between_two_fits(league):
    before = snapshot.take(league)
    before.prepare()
    raced(league, leagues.duels(league, 2, first=500))
    later, whole = snapshot.updated(league, before), snapshot.take(league)
    later.prepare()
    assert later.settled is before and whole.settled is None
    rows = {row.number: row for row in later.rated.rows}
    for row in whole.rated.rows:
        for name in FIELDS:
            assert getattr(rows[row.number], name) == getattr(row, name), name
    assert later.rated.num_races == whole.rated.num_races == before.rated.num_races + 4
    for name in ("clean_laps", "car_counts", "owners", "kinds", "by_number"):
        assert getattr(later, name) == getattr(whole, name), name
    one, other = (sorted(of.counted.entries.tolist()) for of in (later, whole))
    assert one == other
    assert later.safety.by_entry == whole.safety.by_entry
    # What is left to settle is less than what the races changed, and both are below an Elo or two.
    assert table(later) == pytest.approx(table(whole), abs=0.5)
    assert np.abs(table(before) - table(whole)).max() > 1.0


def test_lines_between_two_fits_are_whole(league):
    before = snapshot.take(league)
    raced(league, leagues.duels(league, 2, first=500))
    later = snapshot.updated(league, before)
    for rank, row in enumerate(later.rated.rows, 1):
        at = later.rated.ratings.index(row.number)
        assert row.rank == rank and set(vars(row)) == {field.name for field in fields(row)}
        expected = later.rated.ratings.line(at, *standings.RATING_FIELDS)
        assert {name: getattr(row, name) for name in expected} == expected


def test_how_often_races_were_added_changes_nothing(league):
    before = often = snapshot.take(league)
    for number in range(3):
        raced(league, leagues.duels(league, 1, first=500 + number))
        often = snapshot.updated(league, often)
    once = snapshot.updated(league, before)
    assert table(often).tolist() == table(once).tolist()
    assert often.rated.rows == once.rated.rows and often.clean_laps == once.clean_laps
    settled, whole = snapshot.take(league, often), snapshot.take(league)
    # A fit that begins at earlier ratings ends where it would anyway.
    assert table(settled) == pytest.approx(table(whole), abs=1e-3)
    assert [row.number for row in settled.rated.rows] == [row.number for row in whole.rated.rows]
    assert settled.trends == pytest.approx(whole.trends, abs=1e-3)


def test_what_pages_look_up_is_not_computed_again_where_nothing_was_raced(league):
    before = snapshot.take(league)
    before.prepare()
    looked_up = {name: id(value) for name, value in vars(before).items() if name != "revision"}
    league.plan(leagues.duels(league, 1, first=500))
    later = snapshot.updated(league, before)
    assert later.revision > before.revision
    assert {name: id(vars(later)[name]) for name in looked_up} == looked_up


def test_what_is_more_than_new_races_needs_a_whole_snapshot(league):
    before = snapshot.take(league)
    assert snapshot.updated(league, before).rated is before.rated
    entry = league.submit("new", "someone", scripted="cautious")
    assert snapshot.updated(league, before) is None
    after = snapshot.take(league, before)
    assert after.entries == tuple(league.entries()) and entry in after.entries
    league.move({after.entries[0].id: "retired"}, reason="old")
    assert snapshot.updated(league, after) is None
    assert snapshot.take(league, after).entries == tuple(league.entries())


def test_a_large_league_shows_new_results_at_once_and_settles_them(league, monkeypatch):
    monkeypatch.setattr(reader, "QUICK_S", 0.0)  # as if a fit took long
    monkeypatch.setattr(reader, "FRESH_S", 0.0)
    monkeypatch.setattr(reader, "REST", 0.0)
    pages = Reader(league)
    first = pages.snapshot()
    monkeypatch.setattr(Reader, "_settle_later", lambda self, rest: None)
    raced(league, leagues.duels(league, 1, first=500))
    until(lambda: pages.snapshot().settled is first)
    assert pages.snapshot().rated.num_races == first.rated.num_races + 2
    monkeypatch.undo()
    monkeypatch.setattr(reader, "FRESH_S", 0.0)
    until(lambda: pages.snapshot().settled is None)
    assert table(pages.snapshot()) == pytest.approx(table(snapshot.take(league)), abs=1e-3)


def test_the_page_of_a_large_league_has_new_results_a_moment_later(league, monkeypatch):
    monkeypatch.setattr(reader, "QUICK_S", 0.0)
    monkeypatch.setattr(reader, "FRESH_S", 0.0)
    monkeypatch.setattr(reader, "REST", 0.0)
    with TestClient(make_app(league), base_url=ORIGIN) as pages:
        before = pages.get("/api/v1/standings").json()["races"]
        for number in range(1, 4):
            raced(league, leagues.duels(league, 1, first=500 + number))
            now = before + 2 * number
            until(lambda now=now: pages.get("/api/v1/standings").json()["races"] == now)
