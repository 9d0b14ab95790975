"""Seasons, cups and the hall of fame in a real browser, from one page to the next."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from league.matchmaking.store import Store
from tests.browser.axe import open_still, serious_faults
from tests.browser.looking import (
    NEEDS_CHROMIUM,
    PHONE,
    assert_a_heat_plays_from_disk,
    export,
    opened,
)
from tests.web.small_league import seasoned_league

pytestmark = NEEDS_CHROMIUM
PATHS = ("/seasons", "/seasons/1", "/seasons/2", "/cups/1", "/time-attack", "/definitions")


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Iterator[Store]:
    with seasoned_league(f"sqlite:///{tmp_path_factory.mktemp('seasons') / 'league.db'}") as store:
        yield store


def rows(page: Page) -> list[str]:
    return page.locator("td.name > a").all_inner_texts()


def test_a_trophy_leads_from_the_hall_of_fame_to_its_driver_and_back(browser, origin, complaints):
    page = opened(browser, origin, complaints, java_script_enabled=False)
    page.goto("/")
    page.get_by_role("link", name="Seasons").click()
    expect(page.locator(".lead")).to_contain_text("Summer is running")
    spring = page.locator("section", has=page.get_by_role("link", name="Spring", exact=True))
    trophy = spring.locator(".trophies li", has_text="Champion")
    driver = trophy.locator("a[href^='/drivers/']")
    champion = driver.inner_text()
    driver.click()
    assert page.get_by_role("heading", level=1).inner_text() == champion
    won = page.locator(".trophies li", has_text="Champion")
    won.get_by_role("link", name="Spring").click()
    assert page.get_by_role("heading", level=1).inner_text() == "Spring"
    links = page.locator(".trophies li", has_text="Champion").locator("a")
    assert links.first.inner_text() == champion
    links.last.click()
    assert page.get_by_role("heading", level=1).inner_text() == f"Heats of {champion} in Spring"
    assert complaints == []


def test_a_heat_of_an_exported_season_plays_from_disk(browser, complaints, store, tmp_path):
    export(store, tmp_path / "spring", "--season", "1")
    assert_a_heat_plays_from_disk(browser, tmp_path / "spring", complaints)
    assert complaints == []


def test_a_season_that_is_over_keeps_its_table_and_a_running_one_leads_to_the_standings(
    browser, origin, complaints, store
):
    frozen = store.frozen(store.seasons()[0])["standings"]["entries"]
    page = opened(browser, origin, complaints, java_script_enabled=False)
    page.goto("/seasons")
    page.get_by_role("link", name="final standings").click()
    assert rows(page) == [row["name"] for row in frozen]
    assert page.locator("code").last.inner_text() == store.seasons()[0].hash
    page.goto("/seasons/2")
    page.get_by_role("link", name="its standings").click()
    assert "Summer" in page.locator(".lead").inner_text()
    divisions = page.locator("tbody tr td:nth-child(2)").all_inner_texts()
    assert sorted(divisions) == ["", "", "1", "1"]
    assert complaints == []


def test_a_bracket_says_who_goes_through_and_leads_to_the_race(browser, origin, complaints, store):
    cup = store.frozen(store.cups()[0])
    page = opened(browser, origin, complaints)
    page.goto("/seasons")
    page.get_by_role("link", name="May Cup").click()
    bracket = page.get_by_label("Rounds of the bracket")
    names = [text.split()[0] for text in bracket.locator("h3").all_inner_texts()]
    assert names == ["Final", "Winner"]
    assert bracket.locator(".champion").inner_text() == cup["order"][0]["name"]
    final = bracket.locator("table", has_text="Heat")
    assert rows(page)[:4] == [one["name"] for one in cup["order"]]
    through = final.locator("tr.through")
    assert through.count() == 1 and "wins the cup" in through.text_content()
    places = cup["stages"][-1]["heats"][0]["runs"][0]["places"]
    assert through.locator("td").last.inner_text() == str(sum(places))
    final.get_by_role("link", name="Heat").click()
    page.locator("canvas").wait_for()
    assert page.locator(".order tbody tr").count() == 4
    assert complaints == []


def test_rounds_are_columns_with_lines_and_on_a_phone_one_below_the_other(browser, origin):
    line = """one => {
        const drawn = getComputedStyle(one, "::before");
        return drawn.content !== "none" && drawn.borderTopWidth === "1px";
    }"""
    for options, is_wide in (({}, True), ({"viewport": PHONE}, False)):
        page = opened(browser, origin, [], **options)
        page.goto("/cups/1")
        final, winner = (page.locator(".round").nth(at).bounding_box() for at in (0, 1))
        assert (winner["x"] > final["x"] + final["width"]) == is_wide
        assert (winner["y"] > final["y"] + final["height"]) == (not is_wide)
        assert page.locator(".round").nth(1).locator("li").evaluate(line) == is_wide
        assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.parametrize("path", PATHS)
def test_axe_finds_nothing_serious(shared_page, path):
    open_still(shared_page, path)
    assert serious_faults(shared_page) == {}
    assert shared_page.evaluate("window.name") == ""  # a driver's name holds HTML
