"""Seasons and cups of many drivers: their pages stay small, and everyone is on one of them."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from benchmarks import frozen
from league.web import reader
from league.web.app import make_app
from tests.matchmaking import leagues
from tests.web.small_league import ORIGIN

ENTRIES, ENTRANTS = 650, 600
LARGEST = 200_000
"""Bytes of a page."""


@pytest.fixture(scope="module")
def client(tmp_path_factory) -> Iterator[TestClient]:
    url = f"sqlite:///{tmp_path_factory.mktemp('large') / 'league.db'}"
    with leagues.founded(url, entries=4) as store:
        frozen.freeze(store, ENTRIES, ENTRANTS)
        with TestClient(make_app(store), base_url=ORIGIN) as pages:
            yield pages


def test_no_page_of_a_large_season_or_cup_is_large(client):
    for path in ("/seasons", "/seasons/1", "/seasons/1?page=3", "/cups/1", "/cups/1?page=2",
                 "/cups/1?round=1", "/cups/1?round=3"):  # fmt: skip
        for address in (path, f"/api/v1{path}"):
            answer = client.get(address)
            assert answer.status_code == 200
            assert len(answer.content) < LARGEST, (address, len(answer.content))


def test_the_list_of_seasons_leaves_the_tables_to_their_own_pages(client):
    (large,) = client.get("/api/v1/seasons").json()["seasons"]
    assert large["entries"] == ENTRIES and large["won"] == frozen.DIVISIONS
    assert (
        len(large["trophies"]) < frozen.DIVISIONS and "rows" not in large and "safety" not in large
    )
    assert f"All {frozen.DIVISIONS} trophies" in client.get("/seasons").text


def test_each_driver_of_a_season_is_on_one_of_its_pages(client):
    found = []
    for page in range(1, 8):
        document = client.get(f"/api/v1/seasons/1?page={page}").json()
        assert (document["page"], document["pages"], document["entries"]) == (page, 7, ENTRIES)
        numbers = [one["number"] for one in document["rows"]]
        for name in ("safety", "divisions"):
            assert sorted(map(int, document[name])) == sorted(numbers)
        found += numbers
    assert found == list(range(1, ENTRIES + 1))
    page = client.get("/seasons/1?page=2").text
    assert f"{ENTRIES} entries" in page and 'href="/seasons/1?page=3"' in page
    for wrong in ("0", "8", "x"):
        assert client.get(f"/seasons/1?page={wrong}").status_code == 404


def test_each_heat_of_a_large_cup_is_on_one_page(client):
    document = client.get("/api/v1/cups/1").json()
    assert [len(one["heats"]) for one in document["rounds"]] == [16, 8, 4, 2, 1]
    assert [one["heats"] for one in document["large"]] == [128, 64, 32]
    page = client.get("/cups/1").text
    for one in document["large"]:
        assert f'href="{one["address"]}">{one["name"]}</a>' in page
    found = set()
    for number, one in enumerate(document["large"], 1):
        pages = client.get(f"/api/v1{one['address']}").json()["pages"]
        for at in range(1, pages + 1):
            shown = client.get(f"/api/v1{one['address']}&page={at}").json()
            assert (shown["round"], shown["qualifying"]) == (number, None)
            (stage,) = shown["rounds"]
            found |= {heat["number"] for heat in stage["heats"]}
    found |= {heat["number"] for stage in document["rounds"] for heat in stage["heats"]}
    assert found == set(range(ENTRANTS + 1, ENTRANTS + 256))
    assert client.get("/cups/1?round=4").status_code == 404
    assert client.get("/cups/1?round=1&page=4").status_code == 404


def test_each_qualifier_of_a_large_cup_is_on_one_page(client):
    found = []
    for page in range(1, 2 + (ENTRANTS - 1) // reader.PER_PAGE):
        qualifying = client.get(f"/api/v1/cups/1?page={page}").json()["qualifying"]
        found += [heat["runs"][0]["entry"] for heat in qualifying["heats"]]
    assert found == list(range(1, ENTRANTS + 1))
