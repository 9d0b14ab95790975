"""The league's pages in a real browser: races play, keys work, names do no harm."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, expect, sync_playwright

from league.matchmaking import loop
from league.matchmaking.pairing.matchmaker import Season
from league.matchmaking.workers.dispatcher import Dispatcher
from tests.browser import chromium
from tests.matchmaking.season_kit import Here, Store
from tests.web.small_league import NAME, raced_league, rated_heat

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(
        chromium.program() is None,
        reason="needs Chromium: install it, or set CHROMIUM to its path",
    ),
]
PHONE = {"width": 390, "height": 800}
PATHS = (
    "/", "/standings", "/standings?against=3", "/drivers/1", "/drivers/3", "/matchups/3/1",
    "/heats", "/heats/{heat}", "/tracks", "/live",
)  # fmt: skip


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Iterator[Store]:
    with raced_league(f"sqlite:///{tmp_path_factory.mktemp('league') / 'league.db'}") as store:
        yield store


@pytest.fixture(scope="module")
def origin(store) -> Iterator[str]:
    command = [sys.executable, "-m", "league.cli", "serve", "--league", store.url, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield re.search(r"http://127\.0\.0\.1:\d+", process.stdout.readline()).group()
        finally:
            process.send_signal(2)


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium.program(), args=["--no-sandbox"]
        )
        yield browser
        browser.close()


@pytest.fixture
def complaints() -> list[str]:
    """Return what pages wrote to the console, refusals by the security policy included."""
    return []


def opened(browser: Browser, origin: str, complaints: list[str], **options) -> Page:
    page = browser.new_context(base_url=origin, **options).new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    return page


def test_home_plays_and_pixels_change(browser, origin, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/")
    canvas = page.locator("canvas")
    canvas.wait_for()
    first = canvas.screenshot()
    page.wait_for_timeout(700)
    assert canvas.screenshot() != first
    assert float(page.locator(".scrub input").input_value()) > 0.3
    page.get_by_role("button", name="Pause").click()
    still = canvas.screenshot()
    page.wait_for_timeout(300)
    assert canvas.screenshot() == still
    assert complaints == []


def test_home_stands_still_where_motion_is_not_wanted(browser, origin, complaints):
    page = opened(browser, origin, complaints, reduced_motion="reduce")
    page.goto("/")
    page.get_by_role("button", name="Play").wait_for()
    page.wait_for_timeout(300)
    assert page.locator(".scrub input").input_value() == "0"


def test_a_heat_is_scrubbed_by_keyboard(browser, origin, complaints, store):
    page = opened(browser, origin, complaints)
    page.goto(f"/heats/{rated_heat(store)}")
    canvas, slider = page.locator("canvas"), page.locator(".scrub input")
    canvas.wait_for()
    start = canvas.screenshot()
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowLeft")
    assert slider.input_value() == "1"
    assert canvas.screenshot() != start
    page.keyboard.press("Home")
    page.keyboard.press(".")
    assert float(slider.input_value()) == pytest.approx(1 / 15, abs=0.03)
    page.keyboard.press("2")
    assert page.get_by_label("Follow").input_value() == "2"
    page.keyboard.press(" ")
    page.wait_for_timeout(400)
    page.keyboard.press(" ")
    assert float(slider.input_value()) > 0.2
    page.keyboard.press("End")
    assert page.locator(".order tbody tr").count() == 2
    assert complaints == []


def test_an_event_and_a_link_lead_to_their_moment(browser, origin, complaints, store):
    page = opened(browser, origin, complaints)
    page.goto(f"/heats/{rated_heat(store)}#t=2.5")
    slider = page.locator(".scrub input")
    slider.wait_for()
    assert slider.input_value() == "2.5"
    page.locator(".events a").last.click()
    page.wait_for_timeout(100)
    moment = float(re.search(r"#t=([\d.]+)", page.url).group(1))
    assert float(slider.input_value()) == pytest.approx(moment, abs=0.03)
    page.get_by_role("button", name="Link to this moment").click()
    assert page.url.endswith(f"#t={moment:.1f}")


@pytest.mark.parametrize("path", PATHS)
def test_names_with_html_do_nothing_and_phones_need_no_sideways_scroll(
    browser, origin, complaints, store, path
):
    page = opened(browser, origin, complaints, viewport=PHONE, color_scheme="dark")
    page.goto(path.format(heat=rated_heat(store)))
    page.wait_for_timeout(300)
    assert page.evaluate("window.name") == ""
    assert page.locator("img").count() == 0
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert complaints == []


def test_keys_lead_to_events_and_charts_follow(browser, origin, complaints, store):
    page = opened(browser, origin, complaints)
    page.goto(f"/heats/{rated_heat(store)}")
    slider = page.locator(".scrub input")
    slider.wait_for()
    page.keyboard.press("End")
    page.keyboard.press("p")
    before = float(slider.input_value())
    page.keyboard.press("p")
    assert 0 <= float(slider.input_value()) < before
    page.keyboard.press("n")
    assert float(slider.input_value()) == pytest.approx(before, abs=0.03)
    chart = page.locator("svg[data-time-from]")
    now = float(chart.locator(".now").get_attribute("x1"))
    box = chart.bounding_box()
    chart.click(position={"x": 0.3 * box["width"], "y": 0.5 * box["height"]})
    assert (
        float(chart.locator(".now").get_attribute("x1")) == pytest.approx(0.3 * 520, abs=4) != now
    )
    assert page.locator(".events [aria-current=step]").count() == 1
    assert complaints == []


def test_the_downloaded_file_plays_without_a_server(browser, origin, complaints, store, tmp_path):
    page = opened(browser, origin, complaints)
    page.goto(f"/heats/{rated_heat(store)}")
    with page.expect_download() as download:
        page.get_by_role("link", name="Download as one HTML file").click()
    path = tmp_path / download.value.suggested_filename
    download.value.save_as(path)
    alone = browser.new_context(offline=True).new_page()
    alone.on("console", lambda message: complaints.append(message.text))
    alone.on("pageerror", lambda error: complaints.append(str(error)))
    alone.goto(path.as_uri())
    canvas = alone.locator("canvas")
    canvas.wait_for()
    first = canvas.screenshot()
    alone.keyboard.press(" ")
    alone.wait_for_timeout(700)
    assert canvas.screenshot() != first
    assert alone.evaluate("window.name") == ""
    assert complaints == []


def test_a_driver_is_reached_by_keyboard_alone(browser, origin, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/standings")
    page.keyboard.press("Tab")
    assert page.evaluate("document.activeElement.textContent") == "To the content"
    page.keyboard.press("Enter")
    for _ in range(8):
        page.keyboard.press("Tab")
        if page.evaluate("document.activeElement.matches('td.name a')"):
            break
    assert page.evaluate("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    name = page.evaluate("document.activeElement.textContent")
    page.keyboard.press("Enter")
    page.wait_for_url("**/drivers/*")
    assert page.get_by_role("heading", level=1).inner_text() == name
    assert complaints == []


def test_every_scrolling_table_and_control_has_a_name(browser, origin, complaints, store):
    page = opened(browser, origin, complaints)
    for path in PATHS:
        page.goto(path.format(heat=rated_heat(store)))
        unnamed = page.evaluate(
            """[...document.querySelectorAll("button, select, input, a[href], section")].filter(
                (one) => !(one.textContent.trim() || one.ariaLabel || one.labels?.length)
            ).map((one) => one.outerHTML.slice(0, 80))"""
        )
        assert unnamed == [], path


def test_an_exported_heat_plays_from_disk(browser, complaints, store, tmp_path):
    command = [sys.executable, "-m", "league.cli", "site", str(tmp_path / "season")]
    subprocess.run([*command, "--heats", "1", "--league", store.url], check=True)
    page = browser.new_context(offline=True).new_page()
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto((tmp_path / "season" / "index.html").as_uri())
    page.get_by_role("link", name="Heats", exact=True).click()
    page.locator("td.number a").first.click()
    canvas = page.locator("canvas")
    canvas.wait_for()
    first = canvas.screenshot()
    page.keyboard.press("End")
    assert canvas.screenshot() != first
    page.get_by_role("link", name="Standings").click()
    assert page.get_by_role("heading", level=1).inner_text() == "Standings"
    assert complaints == []


def test_a_driver_chosen_in_the_standings_leads_to_its_meetings(browser, origin, complaints):
    page = opened(browser, origin, complaints, java_script_enabled=False)
    page.goto("/standings")
    page.get_by_label("Record against").select_option(label=NAME)
    page.get_by_role("button", name="Show").click()
    assert page.locator("tr.chosen td.name").inner_text() == NAME
    rival = page.locator("tr", has_text="racing_line")
    points = rival.locator("a[href^='/matchups/']")
    won = points.inner_text()
    points.click()
    assert page.get_by_role("heading", level=1).inner_text() == f"racing_line – {NAME}"
    assert page.locator(".figures div", has_text="Points").locator("dd").inner_text() == won
    page.locator("tbody a").first.click()
    assert "Heat" in page.locator(".lead").inner_text()
    assert complaints == []


def test_a_drivers_best_lap_leads_to_the_race_it_was_driven_in(browser, origin, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/drivers/2")
    laps = page.locator("section", has_text="Best laps")
    lap = laps.locator("tbody td.number").first.inner_text()
    laps.locator("tbody a").last.click()
    page.locator("canvas").wait_for()
    assert lap in page.locator("section", has_text="Penalties included").inner_text()
    assert complaints == []


def test_the_live_page_shows_what_was_raced_since_it_was_opened(browser, origin, store, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/live")
    done = page.locator(".figures div", has_text="Done in all").locator("dd")
    before = int(done.inner_text())
    loop.run(store, Dispatcher(store, Here()), Season(store, same_owner=True), heats=1)
    expect(done).to_have_text(str(before + 1), timeout=20_000)
    assert complaints == []


def test_everything_but_the_player_works_without_javascript(browser, origin, complaints, store):
    page = opened(browser, origin, complaints, java_script_enabled=False)
    page.goto("/standings")
    page.get_by_label("Kind").select_option("anchor")
    page.get_by_role("button", name="Show").click()
    assert page.locator("tbody tr").count() == 2
    page.get_by_role("link", name="racing_line", exact=True).click()
    assert page.get_by_role("heading", level=1).inner_text() == "racing_line"
    page.goto(f"/heats/{rated_heat(store)}")
    assert page.get_by_text("Classification").is_visible()
    assert page.locator(".player svg").is_visible()
    assert complaints == []
