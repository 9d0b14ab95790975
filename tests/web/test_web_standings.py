"""The standings' page: filters, order, pages, and answers that are kept while nothing happens."""

from __future__ import annotations

import dataclasses
import re
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from starlette.testclient import TestClient

from league.matchmaking import scores, standings
from league.matchmaking.scope import scope
from league.matchmaking.scores import own_history
from league.matchmaking.store import Store
from league.web import answers, reader
from league.web.app import make_app
from league.web.pages import table
from league.web.routes import Page
from league.web.snapshot import take
from tests.matchmaking import leagues
from tests.web.decided_league import ENTRIES, decided_league, raced, until
from tests.web.small_league import ORIGIN


@pytest.fixture
def league(tmp_path) -> Iterator[Store]:
    with decided_league(f"sqlite:///{tmp_path / 'league.db'}", duels=42) as store:
        yield store


@pytest.fixture
def pages(league) -> Iterator[TestClient]:
    with TestClient(make_app(league), base_url=ORIGIN) as client:
        yield client


def rows(client: TestClient, **query: str) -> list[dict]:
    answer = client.get("/api/v1/standings", params=query)
    assert answer.status_code == 200, answer.text
    return answer.json()["rows"]


def test_a_track_has_standings_of_its_own(pages, league):
    by_id = sorted(league.entries(), key=lambda entry: entry.id)
    ring, square = rows(pages, track="ring"), rows(pages, track="square")
    # Who always wins on the one track always loses on the other.
    assert (ring[0]["number"], ring[-1]["number"]) == (by_id[0].number, by_id[-1].number)
    assert (square[0]["number"], square[-1]["number"]) == (by_id[-1].number, by_id[0].number)
    assert [row["rank"] for row in ring] == list(range(1, ENTRIES + 1))
    assert sum(row["races"] for row in ring) == 2 * 42 + 3
    page = pages.get("/standings", params={"track": "square"}).text
    assert "the 42 races on square alone" in page and "all races</a>" in page


def test_races_of_so_many_cars_alone(pages, league):
    document = pages.get("/api/v1/standings", params={"cars": "3"}).json()
    assert document["races"] == 1 and document["car_counts"] == [2, 3]
    three = {entry.number for entry in league.entries()[:3]}
    assert {row["number"] for row in document["rows"]} == three
    assert rows(pages, cars="3", track="square") == []


def test_lines_are_sorted_without_javascript(pages):
    for sort, key in (
        ("wins", lambda row: -row["wins"]),
        ("lap", lambda row: row["clean_laps_s"].get("ring", np.inf)),
        ("owner", lambda row: row["owner"]),
        ("finishes", lambda row: row["unfinished"]),
    ):
        found = [key(row) for row in rows(pages, sort=sort)]
        assert found == sorted(found) and len(set(found)) > 1, sort
    page = pages.get("/standings?sort=wins&kind=policy").text
    assert 'aria-sort="descending"' in page
    assert "/standings?kind=policy&amp;sort=lap" in page
    assert '<input type="hidden" name="sort" value="wins">' in page
    assert pages.get("/standings?sort=luck").status_code == 404


def test_pages_hold_everyone_once(pages, monkeypatch):
    monkeypatch.setattr(reader, "PER_PAGE", 3)
    whole = [row["number"] for number in "123" for row in rows(pages, page=number)]
    assert len(whole) == len(set(whole)) == ENTRIES
    middle = pages.get("/standings?page=2&kind=policy").text
    assert '<a aria-current="page" aria-label="Page 2 of 3">2</a>' in middle
    assert 'href="/standings?kind=policy"' in middle
    assert 'href="/standings?kind=policy&amp;page=3"' in middle
    for page in ("0", "4", "x", "1.0"):
        assert pages.get("/standings", params={"page": page}).status_code == 404


def test_names_are_typed_where_a_list_would_be_long(pages, monkeypatch):
    assert '<select name="owner">' in pages.get("/standings").text
    monkeypatch.setattr(table, "MOST_OPTIONS", 3)
    page = pages.get("/standings?kind=policy").text
    assert '<input name="owner"' in page and '<input name="against"' in page
    assert rows(pages, owner="owner 3")[0]["name"] == "e3"
    document = pages.get("/api/v1/standings", params={"against": "e2"}).json()
    assert document["against"]["name"] == "e2"


def test_everyones_record_is_the_rivals_turned(league):
    rated = standings.of(league)
    for one in rated.rows:
        met = standings.meetings(rated, rated.own_races(one.number))
        for other, record in met.items():
            back = standings.head_to_head(rated, other, one.number)
            assert dataclasses.astuple(back) == pytest.approx(dataclasses.astuple(record.turned))
        assert sum(record.races for record in met.values()) >= one.races


def test_the_history_against_ratings_of_today_ends_as_they_are(league):
    rated = standings.of(league)
    top = rated.rows[0]
    moments = own_history(rated, rated.own_races(top.number), points=5)
    assert (moments[-1].elo, moments[-1].low95) == (top.elo, top.low95)
    assert [moment.races for moment in moments] == sorted({moment.races for moment in moments})
    assert moments[-1].races == top.races
    # More races make the interval narrower.
    widths = [moment.high95 - moment.low95 for moment in moments[:-1]]
    assert widths == sorted(widths, reverse=True)
    # The likeliest rating given the others is nearly that of the whole fit.
    assert moments[-2].elo == pytest.approx(top.elo, abs=150)


def test_a_snapshot_reads_only_what_is_new(league, monkeypatch):
    first = take(league)
    assert take(league, first).rated is first.rated
    raced(league, leagues.duels(league, 5, first=100))
    asked = []
    read = Store.races

    def counted(self, *args, **options):
        asked.append(options.get("since", 0))
        return read(self, *args, **options)

    monkeypatch.setattr(Store, "races", counted)
    second = take(league, first)
    assert asked == [first.races.last]
    whole = standings.of(league)
    assert second.rated is not None
    assert [row.elo for row in second.rated.rows] == pytest.approx(
        [row.elo for row in whole.rows], abs=1e-6
    )
    assert second.races.entries.shape == whole.races.entries.shape
    assert second.trends == pytest.approx(scores.trends(whole, scope(league).carried), abs=1e-3)
    assert second.trends and second.trends != first.trends


def test_only_the_lines_of_a_page_have_marks(pages, monkeypatch):
    monkeypatch.setattr(reader, "PER_PAGE", 3)
    document = pages.get("/api/v1/standings?page=2").json()
    assert list(document["marks"]) == [str(row["number"]) for row in document["rows"]]
    assert len(document["rows"]) == 3
    assert all(mark["trend"] for mark in document["marks"].values())


def test_a_near_copy_is_marked_and_leads_to_the_original(pages, league):
    assert "≈" not in pages.get("/standings").text
    card = {"near_copy_of": "e2"}
    copy = league.submit("copy", "someone", weights=b"nearly", card=card)
    league.submit("other", "someone", weights=b"too", card={"near_copy_of": "gone"})
    for state in ("validating", "placement"):
        league.move({entry.id: state for entry in league.entries()[-2:]})
    with TestClient(make_app(league), base_url=ORIGIN) as pages:
        marks = pages.get("/api/v1/standings").json()["marks"]
        assert marks[str(copy.number)]["copy_of"] == {"number": 2, "name": "e2"}
        assert sum(mark["copy_of"] is not None for mark in marks.values()) == 1
        page = pages.get("/standings").text
    link = '<a href="/drivers/2" title="Its weights are nearly those of e2">'
    assert page.count("nearly a copy of") == 1 and link in page
    assert "≈: weights nearly those of an earlier driver" in page


def test_a_retired_driver_is_marked(pages, league):
    number, badge = rows(pages)[0]["number"], '<span class="badge">retired</span>'
    assert badge not in pages.get("/standings").text
    league.move({league.entries()[number - 1].id: "retired"})
    with TestClient(make_app(league), base_url=ORIGIN) as pages:
        page = pages.get("/standings").text
    (line,) = (line for line in page.splitlines() if badge in line)
    assert f'href="/drivers/{number}"' in line


def test_an_answer_is_kept_until_something_happens(pages, league, monkeypatch):
    made, read = [], Page.read

    def counted(self, *asked):
        made.append(self.path)
        return read(self, *asked)

    monkeypatch.setattr(Page, "read", counted)
    monkeypatch.setattr(answers, "MOST", 8)
    for module in (reader, answers):
        monkeypatch.setattr(module, "FRESH_S", 0.0)
    # However busy the machine is, the next request sees the new races.
    monkeypatch.setattr(reader, "REST", 0.0)
    monkeypatch.setattr(reader, "QUICK_S", 60.0)
    monkeypatch.setattr(answers, "LASTS_S", 0.0)
    monkeypatch.setattr(answers, "STALE_S", 0.0)
    first = pages.get("/standings")
    assert pages.get("/standings").text == first.text
    assert made.count("/standings") == 1
    assert pages.get("/standings?kind=policy").status_code == 200
    assert made.count("/standings") == 2
    raced(league, leagues.duels(league, 1, first=500))
    assert pages.get("/standings").text != first.text
    assert made.count("/standings") == 3
    for _ in range(2):
        pages.get("/live")  # changes with time alone
    assert made.count("/live") == 2
    plain = pages.get("/standings", headers={"accept-encoding": "identity"})
    assert "content-encoding" not in plain.headers
    assert re.search("<h1>Standings</h1>", plain.text)


def test_an_answer_that_was_just_up_to_date_is_given_while_the_next_is_made(
    league, making, monkeypatch
):
    may, _ = making
    for module in (reader, answers):
        monkeypatch.setattr(module, "FRESH_S", 0.0)
    monkeypatch.setattr(reader, "REST", 0.0)
    monkeypatch.setattr(reader, "QUICK_S", 60.0)
    with TestClient(make_app(league), base_url=ORIGIN) as pages:
        first = pages.get("/standings").text
        raced(league, leagues.duels(league, 3, first=500))
        may.clear()
        for _ in range(5):
            assert pages.get("/standings").text == first
        may.set()
        until(lambda: pages.get("/standings").text != first)
        # What is older is made before it is given; of this page no renewal is under way.
        pages.get("/standings?sort=wins")
        monkeypatch.setattr(answers, "STALE_S", 0.0)
        raced(league, leagues.duels(league, 3, first=600))
        second = pages.get("/standings?sort=wins").text
        assert f"{league.heats(limit=1, newest=True)[0].number * 2 - 1} races" in second


def test_a_page_that_many_ask_for_at_once_is_made_once(league, making):
    may, made = making
    may.clear()
    with (
        TestClient(make_app(league), base_url=ORIGIN) as pages,
        ThreadPoolExecutor(6) as visitors,
    ):
        asked = [visitors.submit(pages.get, "/standings") for _ in range(6)]
        until(lambda: made)
        time.sleep(0.1)  # the others arrive
        may.set()
        assert {one.result().status_code for one in asked} == {200}
    assert made == ["/standings"]


def test_a_newcomer_has_a_page_before_the_next_snapshot(pages, league):
    assert pages.get("/standings").status_code == 200
    entry = league.submit("new", "someone", scripted="cautious")
    assert pages.get(f"/drivers/{entry.number}").status_code == 200
    assert pages.get(f"/drivers/{entry.number + 1}").status_code == 404


def test_unknown_values_are_one_sentence_above_the_whole_table(pages):
    known = {
        "track": "ring, square", "cars": "2, 3", "kind": "policy", "owner": "owner 1, owner 2",
        "against": "e1, e2",
    }  # fmt: skip
    for name, found in known.items():
        for value in ("nobody", "<b>", "-1"):
            document = pages.get("/api/v1/standings", params={name: value}).json()
            (sentence,) = document["unknown"]
            assert repr(value) in sentence and found in sentence
            assert len(document["rows"]) == ENTRIES and not document["against"]
            page = pages.get("/standings", params={name: value})
            assert page.status_code == 200 and "<b>" not in page.text
            assert page.text.count('class="refusal"') == 1
    assert pages.get("/api/v1/standings?kind=policy").json()["unknown"] == []
