"""Pages of seasons, cups, boards and definitions, and the marks they leave on other pages."""

from __future__ import annotations

import re
from collections.abc import Iterator
from urllib.parse import urlsplit

import pytest
from markupsafe import escape
from starlette.testclient import TestClient

from league.cli import main
from league.matchmaking import standings
from league.matchmaking.store import Store
from league.web import site
from league.web.app import make_app
from league.web.reader import Reader
from tests.web.linked_numbers import without_heats
from tests.web.small_league import NAME, ORIGIN, RULES, new_league, seasoned_league


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Iterator[Store]:
    with seasoned_league(f"sqlite:///{tmp_path_factory.mktemp('seasons') / 'league.db'}") as store:
        yield store


@pytest.fixture(scope="module")
def client(store) -> Iterator[TestClient]:
    with TestClient(make_app(store), base_url=ORIGIN) as client:
        yield client


def test_the_hall_of_fame_has_the_season_its_trophies_and_the_cup(client, store):
    page = client.get("/seasons").text
    assert "Summer is running" in page and "Spring" in page and "May Cup" in page
    document = client.get("/api/v1/seasons").json()
    assert document["running"]["name"] == "Summer"
    spring = document["seasons"][1]
    assert spring["season"]["hash"] == store.seasons()[0].hash
    titles = [one["title"] for one in spring["trophies"]]
    assert titles[:2] == ["Champion", "Second"]
    assert {one["name"] for one in spring["trophies"]} <= {NAME, "blocks"}  # anchors win none


def test_a_warm_server_has_read_the_trophies_that_drivers_pages_list(store, monkeypatch):
    app, made, keep = make_app(store), [], Reader.keep
    app.warm()
    monkeypatch.setattr(
        Reader, "keep", lambda self, key, new: made.append(key) or keep(self, key, new)
    )
    with TestClient(app, base_url=ORIGIN) as pages:
        assert pages.get("/drivers/1").status_code == 200
    assert made and not [key for key in made if key[0] == "frozen"]


def test_a_season_shows_its_standings_as_they_were_frozen(client, store):
    frozen = store.frozen(store.seasons()[0])
    page = client.get("/seasons/1").text
    assert store.seasons()[0].hash in page
    names = re.findall(r'<td class="name"><a href="/drivers/(\d+)">', page)
    assert [int(one) for one in names] == [row["number"] for row in frozen["standings"]["entries"]]
    assert client.get("/seasons/9").status_code == 404


def test_numbers_of_a_season_lead_to_its_heats(client, store):
    spring, summer = store.seasons()
    row = client.get("/api/v1/seasons/1").json()["rows"][0]
    page, address = client.get("/seasons/1").text, f"/heats?driver={row['number']}&season=1"
    for count in (row["races"], row["wins"]):
        assert f'<a href="{address.replace("&", "&amp;")}">{count}</a>' in page
    document = client.get(f"/api/v1{address}").json()
    rated = [one for one in document["heats"] if one["purpose"] == "rated"]
    assert sum(len(one["own"]) for one in rated) == row["races"]
    assert document["season"]["name"] == "Spring" and "Spring" in client.get(address).text
    whole = [client.get(f"/api/v1/heats?season={number}").json() for number in (1, 2)]
    assert min(one["number"] for one in whole[1]["heats"]) > spring.until == summer.after
    assert sum(one["count"] for one in whole) == client.get("/api/v1/heats").json()["count"]
    for wrong in ("3", "x", "-1"):
        assert client.get(f"/heats?season={wrong}").status_code == 404


@pytest.mark.parametrize("path", ["/seasons/1", "/cups/1", "/standings", "/matchups/2/3"])
def test_each_number_of_a_season_leads_to_the_heats_it_comes_from(client, path):
    assert without_heats(client.get(path).text) == []


def test_trophies_lead_to_what_they_are_and_to_the_heats_they_were_won_in(client):
    (spring,) = [one for one in client.get("/api/v1/seasons").json()["seasons"] if one["trophies"]]
    assert any(one["heat"] for one in spring["trophies"])
    for one in spring["trophies"]:
        heats = f"/{one['heat']}" if one["heat"] else f"?driver={one['number']}&amp;season=1"
        link = f'<a href="/heats{heats}">{one["value"]}</a>'
        for path in ("/seasons", "/seasons/1", f"/drivers/{one['number']}"):
            page = client.get(path).text
            assert link in page and 'href="/definitions#trophies"' in page, path


def test_ratings_of_leaders_lead_to_their_heats(client):
    for path in ("/seasons", "/seasons/2"):
        page = client.get(path).text
        for row in client.get(f"/api/v1{path}").json()["leaders"]:
            for number, about, name in (
                (round(row["elo"]), "rating", "Elo"),
                (row["races"], "races", "races"),
            ):
                heats = f'<a href="/heats?driver={row["number"]}">{number}</a>'
                assert f'{heats} <a href="/definitions#{about}">{name}</a>' in page


def test_sums_of_places_in_a_cup_lead_to_their_heats_and_their_meaning(client):
    page, document = client.get("/cups/1").text, client.get("/api/v1/cups/1").json()
    assert '<a href="/definitions#cup">sums of places</a>' in page
    heats = [heat for one in document["rounds"] for heat in one["heats"] if heat["number"]]
    assert heats
    for heat in heats:
        for run in heat["runs"]:
            link = f'<a href="/heats/{heat["number"]}'
            places = " + ".join(
                f'{link}?race={race}">{place}</a>' for race, place in enumerate(run["places"], 1)
            )
            total = f'{link}">{sum(run["places"])}</a>'
            assert f'{places}</td><td class="sum">{total}</td>' in page


def test_the_running_season_shows_who_leads_and_its_newest_heats(client, store):
    document, page = client.get("/api/v1/seasons/2").json(), client.get("/seasons/2").text
    assert document["leaders"] == client.get("/api/v1/seasons").json()["leaders"] != []
    for row in document["leaders"]:
        assert f'<a href="/drivers/{row["number"]}">{escape(row["name"])}</a>' in page
    first = store.seasons()[1].after
    done = [one.number for one in store.heats(("done",)) if one.number > first][::-1]
    assert [one["number"] for one in document["newest"]] == done[:20]
    assert all(f'href="/heats/{number}"' in page for number in done[:20])
    assert "Newest heats" in page or "No heat of this season is done yet" in page
    assert "leaders" not in client.get("/api/v1/seasons/1").json()


def test_a_cup_shows_its_bracket_with_links_to_its_heats(client, store):
    page, document = client.get("/cups/1").text, client.get("/api/v1/cups/1").json()
    (final,) = document["rounds"][-1]["heats"]
    assert f'href="/heats/{final["number"]}"' in page
    assert final["runs"][0]["name"] == document["order"][0]["name"]
    assert len(document["qualifying"]["heats"]) == 4
    assert store.heat(final["number"]).heat.purpose == "cup"
    assert client.get("/cups/2").status_code == 404


def test_standings_and_drivers_show_division_safety_and_trend(client):
    document = client.get("/api/v1/standings").json()
    assert document["season"]["name"] == "Summer"
    marks = document["marks"]
    assert {marks[number]["division"] for number in ("3", "4")} == {1}
    assert marks["1"]["division"] is None  # an anchor
    assert marks["3"]["safety"]["corners"] > 0
    page = client.get("/standings").text
    for link in ("division", "safety", "trend", "rating", "rank"):
        assert f'href="/definitions#{link}"' in page
    page = client.get("/drivers/3").text
    assert "Spring ended" in page and "Trophies" in page


def test_a_matchup_counts_each_season_and_all_of_them(client, store):
    document = client.get("/api/v1/matchups/2/3").json()
    summer, spring = document["records"]
    assert [one["season"]["name"] for one in (summer, spring)] == ["Summer", "Spring"]
    assert summer["present"] and not spring["present"]
    assert summer["races"] == document["record"]["races"]
    assert summer["expected"] == pytest.approx(document["record"]["expected"])
    for name in ("heats", "races", "wins", "ties", "points", "expected"):
        assert document["whole"][name] == pytest.approx(summer[name] + spring[name])
    (past,) = [one for one in store.seasons() if one.ended_s is not None]
    rated = standings.of(store, past.ruleset, past)
    assert spring["races"] == standings.head_to_head(rated, 2, 3).races > 0
    assert spring["expected"] == pytest.approx(standings.head_to_head(rated, 2, 3).expected)
    # Each count leads to the heats it is of.
    assert 'href="/matchups/2/3?season=1#races">' in client.get("/matchups/2/3").text
    listed = client.get("/api/v1/matchups/2/3?season=1").json()["heats"]
    rated_heats = {line["heat"] for line in listed if line["purpose"] == "rated"}
    assert len(rated_heats) == spring["heats"] and max(rated_heats) <= past.until
    assert client.get("/matchups/2/3?season=9").status_code == 404


def test_boards_have_clean_laps_by_kind(client, store):
    document = client.get("/api/v1/time-attack").json()
    assert [one["kind"] for one in document["kinds"]] == ["head_to_head", "time_trial"]
    alone = client.get("/api/v1/time-attack?races=time_trial").json()
    (board,) = alone["boards"]
    for lap in board["laps"]:
        row = store.results(lap["heat"])[lap["race"] - 1].result["order"][0]
        assert min(row["lap_times_s"]) == pytest.approx(lap["lap_s"], abs=0.001)
        assert row["off_tracks"] == row["crashes"] == 0
    assert board["laps"]
    assert client.get("/time-attack?races=golf").status_code == 404


def test_each_link_to_a_definition_leads_to_one(client):
    known = set(re.findall(r'<dt id="([\w-]+)"', client.get("/definitions").text))
    for path in ("/standings", "/seasons", "/seasons/1", "/cups/1", "/time-attack", "/drivers/3"):
        links = re.findall(r'href="/definitions#([\w-]+)"', client.get(path).text)
        assert set(links) <= known


@pytest.mark.parametrize("path", ["/seasons", "/seasons/1", "/time-attack", "/cups/1"])
def test_names_are_escaped(client, path):
    page = client.get(path).text
    assert "<img src=x" not in page and "<script>name=" not in page


def test_files_of_a_site_include_the_seasons(store, tmp_path):
    site.export(store, tmp_path / "site", heats=2)
    names = {str(path.relative_to(tmp_path / "site")) for path in tmp_path.rglob("*.html")}
    assert {"seasons.html", "seasons/1.html", "cups/1.html", "definitions.html"} <= names
    assert {"time-attack.html", "time-attack-races-time_trial.html"} <= names


def test_a_season_that_is_over_is_exported_as_it_ended(store, tmp_path):
    folder, (past, running) = tmp_path / "spring", store.seasons()
    command = ["site", str(folder), "--season", "1", "--heats", "3", "--league", store.url]
    assert main(command) == 0
    pages = {str(path.relative_to(folder)): path.read_text() for path in folder.rglob("*.html")}
    assert not any("Summer" in page for page in pages.values())
    frozen = store.frozen(store.seasons()[0])["standings"]["entries"]
    rows = re.findall(r'<td class="name"><a href="drivers/(\d+)', pages["standings.html"])
    assert rows == [str(row["number"]) for row in frozen]
    assert f">{frozen[0]['elo']:.0f} " in pages["standings.html"]
    assert "Spring</a>, which is over" in pages["standings.html"]
    heats = {int(name[6:-5]) for name in pages if re.fullmatch(r"heats/\d+\.html", name)}
    assert len(heats) == 3 and max(heats) <= past.until < running.after + 1
    assert {"index.html", "tracks.html", "cups/1.html", "seasons/1.html"} <= set(pages)
    for name, page in pages.items():
        for link in re.findall(r'(?:href|src)="([^"]*)"', page):
            path = urlsplit(link).path
            assert not link.startswith(("/", "http")), link
            assert not path or ((folder / name).parent / path).is_file(), f"{name}: {link}"


def test_only_a_season_that_is_over_is_exported(store, tmp_path, capsys):
    for number in ("0", "2", "9"):
        command = ["site", str(tmp_path / "no"), "--season", number, "--league", store.url]
        assert main(command) == 2
        assert f"no season {number} that is over: give 1" in capsys.readouterr().err


def test_files_of_a_site_without_heats_have_none(store, tmp_path):
    written = site.export(store, tmp_path / "site", heats=0)
    assert written.heats == 0
    assert not (tmp_path / "site" / "heats").exists()


def test_a_league_without_seasons_says_so(tmp_path):
    with new_league(f"sqlite:///{tmp_path / 'league.db'}", rules=RULES) as store:
        client = TestClient(make_app(store), base_url=ORIGIN)
        assert "This league has no seasons yet" in client.get("/seasons").text
        assert client.get("/time-attack").status_code == 200
        assert "Division" not in client.get("/standings").text


def test_a_matchup_says_which_races_count(client):
    page = client.get("/matchups/3/4").text
    season = '<a href="/seasons/2">Summer</a>'
    assert f"Only rated races of {season} count" in page and "the races of all seasons" in page
