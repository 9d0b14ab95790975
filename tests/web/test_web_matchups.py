"""Records of two drivers against each other, on the pages and in the JSON."""

from __future__ import annotations

import dataclasses

import pytest

from league.matchmaking import standings
from league.matchmaking.scores import race_scores
from tests.web.small_league import NAME


def test_selecting_a_driver_shows_everyones_record_against_it(client, store):
    rated = standings.of(store)
    document = client.get("/api/v1/standings?against=3").json()
    assert document["against"]["number"] == 3
    for row in rated.rows:
        if row.number == 3:
            continue
        record = standings.head_to_head(rated, row.number, 3)
        shown = document["records"].get(str(row.number))
        assert (shown and shown["races"]) == (record.races or None)
        if shown:
            assert shown["wins"] == record.wins
            # The server fits from the ratings before, the command line from nothing.
            assert shown["expected"] == pytest.approx(record.expected)
            assert f'href="/matchups/{row.number}/3"' in client.get("/standings?against=3").text


def test_the_matchup_page_has_the_record_of_the_command_line(client, store):
    rated = standings.of(store)
    document = client.get("/api/v1/matchups/2/3").json()
    record = standings.head_to_head(rated, 2, 3)
    gap = rated.ratings.difference(2, 3)
    assert document["record"]["races"] == record.races > 0
    assert document["difference"]["superiority"] == pytest.approx(gap.superiority)
    assert sum(line["races"] for line in document["tracks"]) == record.races
    assert sum(line["points"] for line in document["tracks"]) == record.points
    assert sum(line["expected"] for line in document["tracks"]) == pytest.approx(record.expected)


def test_the_matchup_page_lists_each_race_with_its_result(client, store):
    document = client.get("/api/v1/matchups/2/3").json()
    rated = [line for line in document["heats"] if line["purpose"] == "rated"]
    now = standings.of(store)
    scores = race_scores(now.own_races(2), now.tracks, 3)
    assert len(rated) == len(scores) > 0
    for score in scores:
        line = next(one for one in rated if (one["heat"], one["race"]) == (score.heat, score.race))
        won = {1.0: "racing_line", 0.5: None, 0.0: NAME}[score.points]
        assert line["ahead"] == won
        assert line["expected"] == pytest.approx(score.expected)


def test_earlier_heats_are_on_pages_of_their_own(client, monkeypatch):
    monkeypatch.setattr("league.web.pages.driver.HEATS_MET", 1)
    first = client.get("/api/v1/matchups/2/3").json()
    assert f"before={first['older']}" in client.get("/matchups/2/3").text
    second = client.get(f"/api/v1/matchups/2/3?before={first['older']}").json()
    assert first["heats"][0]["heat"] == first["older"] > second["heats"][0]["heat"]


def test_drivers_that_are_not_rated_have_a_matchup_page(tmp_path):
    from starlette.testclient import TestClient

    from league.web.app import make_app
    from tests.web.small_league import ORIGIN, new_league

    with (
        new_league(f"sqlite:///{tmp_path / 'league.db'}", anchors=("centerline",)) as store,
        TestClient(make_app(store), base_url=ORIGIN) as client,
    ):
        store.submit("new", "someone", scripted="cautious")
        page = client.get("/matchups/1/2").text
        assert "Not both of them are rated yet" in page and "no races" in page


def test_no_probability_is_certain(client, store):
    gap = standings.of(store).ratings.difference(2, 3)
    for superiority, words in (
        (1.0, "more than 99.9 %"),
        (0.0, "less than 0.1 %"),
        (0.5, "50.0 %"),
    ):
        assert dataclasses.replace(gap, superiority=superiority).sureness == words
    page = client.get("/matchups/2/3").text
    assert f"of {gap.sureness}" in page and "100.0 %" not in page
    assert "Only rated races count for the numbers of this page; the list has all races" in page
