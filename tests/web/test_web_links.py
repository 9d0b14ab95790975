"""Numbers lead to what they mean, and to the heats they come from."""

from __future__ import annotations

import re

import pytest

from league.web import reader
from tests.web.linked_numbers import without_heats
from tests.web.small_league import NAME, OWNER, rated_heat

ABOUT = {
    "/": {"Rank": "rank", "Rating": "rating", "95 % interval": "interval", "Races": "races"},
    "/drivers/3": {
        "Rank": "rank", "Rating": "rating", "Races": "races", "Wins": "races", "Finishes": "races",
        "Safety": "safety", "Expected": "expected", "Points": "points", "Met": "races",
        "Rating, 95 %": "interval", "per 100 corners": "incidents",
    },
    "/matchups/3/1": {
        "Rating difference, 95 %": "difference", "Races": "races", "Points": "points",
        "Expected": "expected", "Won – tied – lost": "points",
    },
    "/live": {
        "Racing": "racing", "In the queue": "queue", "Heats per minute": "pace",
        "Done in all": "heat",
    },
    "/tracks": {"Lap": "clean-lap", "Medal": "medals"},
    "/heats/{heat}": {"Off": "mistakes", "Crashes": "mistakes", "Passed": "passed"},
    "/standings?against=3": {
        "Met": "races", "Points": "points", "Expected": "expected", "Rating": "rating",
    },
}  # fmt: skip
HEADS = {
    "Rating": "rating", "Races": "races", "Wins": "races", "Finishes": "races",
    "Clean lap": "clean-lap",
}  # fmt: skip


@pytest.mark.parametrize("path", ABOUT)
def test_each_number_links_to_its_definition(client, store, path):
    page = client.get(path.format(heat=rated_heat(store))).text
    known = set(re.findall(r'<dt id="([\w-]+)"', client.get("/definitions").text))
    for label, about in ABOUT[path].items():
        assert f'<a href="/definitions#{about}">{label}</a>' in page, label
        assert about in known


@pytest.mark.parametrize("sort", ["", "races", "wins", "finishes", "lap", "name"])
def test_heads_of_the_standings_have_definitions_whatever_they_are_sorted_by(client, sort):
    page = client.get("/standings", params={"sort": sort} if sort else {}).text
    heads = re.findall(r"<th .*?</th>", page)
    for label, about in HEADS.items():
        (head,) = (one for one in heads if f">{label}</a>" in one)
        assert f'href="/definitions#{about}"' in head
    sorted_by = next(one for one in heads if "aria-sort" in one)
    assert "title=" not in sorted_by


def test_counts_of_races_lead_to_the_heats_of_the_driver(client, store):
    page = client.get("/standings").text
    for row in client.get("/api/v1/standings").json()["rows"]:
        shares = [f"{100 * (1 - row['unfinished']):.0f} %"] if row["races"] else []
        for count in (row["races"], row["wins"], *shares):
            assert f'<a href="/heats?driver={row["number"]}">{count}</a>' in page
    driver, standing = client.get("/drivers/3").text, client.get("/api/v1/drivers/3").json()
    for number in (standing["standing"]["races"], standing["standing"]["wins"]):
        assert f'<dd><a href="/heats?driver=3">{number}</a></dd>' in driver
    heats = store.heats(("done",), entries=[3])
    assert f'<a href="/heats?driver=3">All {len(heats)} heats</a>' in driver


def test_a_clean_lap_in_the_standings_leads_to_the_lap(client):
    track, rows = "reinvent_2018", client.get("/api/v1/standings").json()["rows"]
    row = next(one for one in rows if track in one["clean_laps_s"])
    address = f"/ghosts?track={track}&one={row['number']}"
    assert f'href="{address.replace("&", "&amp;")}"' in client.get("/standings").text
    shown = client.get(f"/api/v1{address}").json()["pair"][0]
    assert shown["entry"] == row["number"]
    assert shown["lap_s"] == pytest.approx(row["clean_laps_s"][track], abs=0.001)


def test_a_clean_lap_in_races_of_so_many_cars_leads_to_its_race(client, store):
    document, page = client.get("/api/v1/standings?cars=2").json(), client.get("/standings?cars=2")
    assert "/ghosts?" not in page.text  # it may not be the driver's fastest one
    rows = [row for row in document["rows"] if row["clean_laps_s"]]
    assert [str(row["number"]) for row in rows] == [*document["laps"]] != []
    for row in rows:
        lap = document["laps"][str(row["number"])]
        assert lap["lap_s"] == row["clean_laps_s"]["reinvent_2018"]
        assert f'<a href="/heats/{lap["heat"]}?race={lap["race"]}">' in page.text
        race = client.get(f"/api/v1/heats/{lap['heat']}?race={lap['race']}").json()
        (car,) = (one["number"] for one in race["cars"] if one["entry"] == row["number"])
        own = next(one for one in race["result"]["order"] if one["car"] == car - 1)
        assert min(own["lap_times_s"]) == pytest.approx(lap["lap_s"], abs=0.001)
    assert client.get("/api/v1/standings").json()["laps"] == {}


@pytest.mark.parametrize(
    "path",
    ["/", "/standings", "/standings?cars=2", "/standings?against=3", "/drivers/3", "/matchups/3/1",
     "/live"],
)  # fmt: skip
def test_each_number_leads_to_the_heats_it_comes_from(client, path):
    assert without_heats(client.get(path).text) == []


@pytest.mark.parametrize("path", ["/", "/standings"])
def test_ratings_intervals_and_trends_lead_to_the_heats_of_the_driver(client, path):
    page, document = client.get(path).text, client.get("/api/v1/standings").json()
    assert document["rows"]
    for row in document["rows"]:
        link = f'<a href="/heats\\?driver={row["number"]}">'
        half = f"{(row['high95'] - row['low95']) / 2:.0f}"
        assert re.search(rf"{link}{row['elo']:.0f} <span[^>]*>±{half}</span></a>", page)
        trend = document["marks"][str(row["number"])]["trend"]
        if path != "/" and trend is not None:
            shown = f"{trend:+.0f}" if round(trend) else "0"
            assert re.search(rf"{link}\s*<span[^>]*>{re.escape(shown)}</span>", page)


def test_figures_of_what_races_now_lead_to_the_lists_on_the_page(client, store, monkeypatch):
    last_s = max(heat.done_s for heat in store.heats(("done",)))
    monkeypatch.setattr("league.web.pages.heats.time.time", lambda: last_s + 1.0)
    page = client.get("/live").text
    assert '<a href="/definitions#wait">Queue lasts</a>' in page
    for part in ("racing", "queue", "done"):
        assert f'<dd><a href="#{part}">' in page and f'id="{part}"' in page
    done = client.get("/api/v1/heats").json()["count"]
    assert f'<dd><a href="/heats">{done}</a></dd>' in page
    assert without_heats(page) == []


def test_heats_of_a_driver_show_its_place_in_each_race(client, store):
    document = client.get("/api/v1/heats?driver=3").json()
    mine = [one.number for one in store.heats(("done",), entries=[3])]
    assert [one["number"] for one in document["heats"]] == mine[::-1]
    rated = [one for one in document["heats"] if one["purpose"] == "rated"]
    races = [race for heat in rated for race in heat["own"]]
    standing = client.get("/api/v1/drivers/3").json()["standing"]
    assert len(races) == standing["races"] == document["races"]
    assert sum(race["place"] == 1 for race in races) == standing["wins"]
    unfinished = sum(not race["finished"] for race in races)
    assert unfinished / len(races) == pytest.approx(standing["unfinished"])
    page = client.get("/heats?driver=3").text
    assert f'href="/heats/{rated[0]["number"]}?race=2"' in page and ">DNF<" in page
    assert document["driver"]["name"] == NAME and OWNER not in page


def test_heats_come_in_pages(client, store, monkeypatch):
    monkeypatch.setattr(reader, "PER_PAGE", 5)
    done = [one.number for one in store.heats(("done",))][::-1]
    pages, found = -(-len(done) // 5), []
    for page in range(1, pages + 1):
        document = client.get(f"/api/v1/heats?page={page}").json()
        assert (document["count"], document["pages"]) == (len(done), pages)
        found += [one["number"] for one in document["heats"]]
    assert found == done
    assert 'href="/heats?driver=3&amp;page=2"' in client.get("/heats?driver=3").text
    for wrong in ("page=0", f"page={pages + 1}", "driver=99", "driver=x", "driver=-1"):
        assert client.get(f"/heats?{wrong}").status_code == 404


def test_the_feed_has_the_newest_heats_whatever_a_page_holds(client, store, monkeypatch):
    monkeypatch.setattr(reader, "PER_PAGE", 1)
    assert f"heats/{rated_heat(store)}" in client.get("/feed.atom").text
