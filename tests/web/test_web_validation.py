"""What pages say of a driver that enters: its validation, and how one is entered."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import pytest
from starlette.testclient import TestClient

from league.matchmaking import loop
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from league.web import site
from league.web.app import make_app
from league.web.security import Access
from tests.matchmaking.season_kit import Here, new_league
from tests.web.serving import FREE
from tests.web.small_league import RULES

HOST = "league.example.org"
ATOM = "{http://www.w3.org/2005/Atom}"


@pytest.fixture(scope="module")
def validated(tmp_path_factory) -> Iterator[Store]:
    """Return a league with a third entry that was validated, and has raced no other yet."""
    url = f"sqlite:///{tmp_path_factory.mktemp('league') / 'league.db'}"
    with new_league(url, anchors=("centerline", "racing_line"), rules=RULES) as store:
        store.submit("Ann's car", "ann", scripted="cautious")
        while sum(one.heat.purpose == "validation" for one in store.heats(("done",))) < 2:
            loop.run(store, Dispatcher(store, Here()), Matchmaker(store), heats=1)
        yield store


@pytest.fixture(scope="module")
def pages(validated) -> Iterator[TestClient]:
    app = make_app(validated, access=Access(hosts=(HOST,), limits=FREE))
    with TestClient(app, base_url=f"https://{HOST}") as client:
        yield client


def alone(store: Store) -> int:
    """Return the number of the heat that the newcomer raced against itself."""
    return next(
        one.number for one in store.heats(("done",)) if len(set(one.heat.halves[0].grid)) == 1
    )


@pytest.mark.parametrize("path", ["/", "/heats", "/live", "/drivers/3"])
def test_lists_say_whose_validation_a_race_against_itself_was(pages, validated, path):
    page = pages.get(path).text
    assert "validation of Ann&#39;s car" in page
    assert "Ann&#39;s car – Ann&#39;s car" not in page
    assert not re.search(r"validation of Ann&#39;s car</a> <span class=\"dim clamp\">\w", page)


def test_the_feed_says_whose_validation_a_heat_was(pages, validated):
    feed = ET.fromstring(pages.get("/feed.atom").content)
    titles = {
        int(entry.find(f"{ATOM}link").get("href").rpartition("/")[2]): entry.findtext(
            f"{ATOM}title"
        )
        for entry in feed.findall(f"{ATOM}entry")
    }
    assert titles.pop(alone(validated)) == "validation of Ann's car"
    other = next(title for title in titles.values() if "Ann's car – " in title)
    assert re.fullmatch(r"Ann's car – \w+ \(validation\): won by .+", other)


def test_a_new_drivers_heats_are_listed_once(pages, validated):
    page = pages.get("/drivers/3").text
    numbers = re.findall(r'<td class="number"><a href="/heats/(\d+)">', page)
    assert "First races" in page and str(alone(validated)) in numbers
    assert len(numbers) == len(set(numbers))


def test_home_says_how_visitors_of_a_served_league_enter_a_driver(pages):
    page = pages.get("/").text
    page = page[page.index("Enter a driver") :]
    assert f"--to https://{HOST}/</code>" in page and 'href="/submit"' in page
    assert "--owner" not in page and "league run" not in page


def test_exported_pages_say_how_a_league_of_ones_own_is_raced(validated, tmp_path):
    site.export(validated, tmp_path / "season", heats=3)
    home = (tmp_path / "season" / "index.html").read_text(encoding="utf-8")
    assert "--owner you\nleague run</code>" in home and "--to" not in home
    driver = (tmp_path / "season" / "drivers" / "3.html").read_text(encoding="utf-8")
    assert "Recent heats" in driver and "validation of Ann&#39;s car" in driver
