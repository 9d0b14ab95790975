"""The league's pages in a real browser: races play, keys work, names do no harm."""

from __future__ import annotations

import re
from collections.abc import Iterator

import pytest
from playwright.sync_api import expect

from league.matchmaking import loop
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing.heat_spec import mirrored
from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from tests.browser.looking import (
    NEEDS_CHROMIUM,
    PATHS,
    PHONE,
    assert_a_heat_plays_from_disk,
    export,
    opened,
)
from tests.browser.pages import served
from tests.matchmaking.season_kit import Here
from tests.web.small_league import NAME, lapped_heat, overtaken_heat, raced_league, rated_heat

pytestmark = NEEDS_CHROMIUM


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Iterator[Store]:
    """Return a league of this module's own, in which its tests race."""
    with raced_league(f"sqlite:///{tmp_path_factory.mktemp('pages') / 'league.db'}") as store:
        yield store


@pytest.fixture(scope="module")
def origin(store) -> Iterator[str]:
    """Return the address of a server as users start it: a process, which races elsewhere."""
    with served(store.url) as address:
        yield address


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


def test_captions_are_announced_unless_a_race_begins_again_and_again(browser, origin, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/live")  # where a race plays once
    caption = page.locator(".caption")
    expect(caption).to_have_attribute("aria-live", "polite")
    page.goto("/")
    expect(caption).to_have_attribute("aria-live", "off")
    page.get_by_role("button", name="Pause").click()
    page.get_by_role("button", name="Play").click()
    expect(caption).to_have_attribute("aria-live", "polite")  # the visitor started it


def focused_slider(page):
    """Return the slider of a race that plays, after a keyboard has given it the focus."""
    page.get_by_role("button", name="Pause").focus()
    page.keyboard.press("Tab")
    slider = page.locator(".scrub input")
    expect(slider).to_be_focused()
    return slider


def test_a_race_that_plays_leaves_a_screen_reader_where_it_is(browser, origin, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/")
    order, clock = page.locator(".order tbody"), page.locator(".clock")
    row = order.locator("tr").first.element_handle()
    assert page.locator(".player output, .player [role=status]").count() == 0
    before = clock.inner_text()
    expect(order).not_to_have_text(order.text_content())
    assert clock.inner_text() != before
    # Rows that were replaced would lose the reader's place.
    assert row.evaluate("row => row.isConnected")
    # It says each new value of a slider that has the focus: many in a second, if they were shown.
    slider = focused_slider(page)
    focused = slider.input_value(), slider.get_attribute("aria-valuetext")
    page.wait_for_timeout(700)
    assert (slider.input_value(), slider.get_attribute("aria-valuetext")) == focused
    page.keyboard.press("ArrowRight")
    assert float(slider.input_value()) > float(focused[0]) + 1
    sought = slider.input_value()
    expect(slider).not_to_have_value(sought, timeout=20_000)
    found = float(slider.input_value())
    assert found > float(sought) + 4.9 or found < 0.5  # the race may have begun again by then
    assert complaints == []


def test_a_slider_with_the_focus_goes_back_where_a_short_race_begins_again(
    browser, origin, complaints
):
    page = opened(browser, origin, complaints)
    page.goto("/")
    slider = focused_slider(page)
    for key in ("Home", *["ArrowRight"] * 4):
        page.keyboard.press(key)
    sought = slider.input_value()  # less than five seconds from either end
    expect(slider).not_to_have_value(sought, timeout=20_000)
    assert float(slider.input_value()) < 0.5
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


def test_an_overtake_and_a_link_lead_to_their_moment(browser, origin, complaints, store):
    page = opened(browser, origin, complaints)
    page.goto(f"/heats/{overtaken_heat(store)}#t=2.5")
    slider = page.locator(".scrub input")
    slider.wait_for()
    assert slider.input_value() == "2.5"
    overtake = page.locator(".events .overtake a").last
    at_s = float(overtake.get_attribute("data-time"))
    overtake.click()
    page.wait_for_timeout(100)
    moment = float(re.search(r"#t=([\d.]+)", page.url).group(1))
    assert moment == pytest.approx(max(at_s - 1, 0), abs=0.06) != 2.5
    assert float(slider.input_value()) == pytest.approx(moment, abs=0.03)
    page.get_by_role("button", name="Link to this moment").click()
    assert page.url.endswith(f"#t={moment:.1f}")


def test_keys_are_left_to_what_has_the_focus(browser, origin, complaints, store):
    page = opened(browser, origin, complaints)
    page.goto(f"/heats/{rated_heat(store)}")
    slider, play = page.locator(".scrub input"), page.get_by_role("button", name="Play")
    slider.wait_for()
    page.keyboard.press("ArrowRight")
    assert slider.input_value() == "1"
    for other in (".events", ".events a >> nth=0", ".scroll[tabindex]", "nav a >> nth=0"):
        page.locator(other).focus()
        for key in ("End", "Home", "ArrowRight", "ArrowLeft", "Space"):
            page.keyboard.press(key)
        assert slider.input_value() == "1" and play.is_visible()
    page.locator(".events").evaluate("list => (list.style.maxHeight = '3rem')")
    page.locator(".events").focus()
    page.keyboard.press("End")
    expect(page.locator(".events")).not_to_have_js_property("scrollTop", 0)
    page.locator(".player").focus()
    page.keyboard.press("End")
    assert float(slider.input_value()) > 2
    page.keyboard.press("Home")
    page.keyboard.press("Shift+N")  # as the page writes it
    assert float(slider.input_value()) > 0
    assert complaints == []


def test_what_the_link_says_can_be_read_while_the_race_plays(browser, origin, store):
    page = opened(browser, origin, [])
    page.goto(f"/heats/{rated_heat(store)}")
    caption = page.locator(".caption")
    page.get_by_role("button", name="Play").click()
    page.get_by_role("button", name="Link to this moment").click()
    page.wait_for_timeout(700)  # the panel is written six times a second
    assert "leads to this moment" in caption.inner_text()
    expect(caption).not_to_contain_text("leads to this moment", timeout=20_000)


@pytest.mark.parametrize("path", PATHS)
def test_names_with_html_do_nothing_and_phones_need_no_sideways_scroll(
    browser, origin, complaints, store, path
):
    page = opened(browser, origin, complaints, viewport=PHONE, color_scheme="dark")
    page.goto(path.format(heat=rated_heat(store)))
    page.wait_for_timeout(300)
    assert page.evaluate("window.name") == ""
    assert page.locator("img:not(.strip img)").count() == 0
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
    for _ in range(20):
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
    page = opened(browser, origin, complaints, reduced_motion="reduce")
    for path in PATHS:
        page.goto(path.format(heat=rated_heat(store)))
        unnamed = page.evaluate(
            """[...document.querySelectorAll("button, select, input, a[href], section")].filter(
                (one) => !(one.textContent.trim() || one.ariaLabel || one.labels?.length)
            ).map((one) => one.outerHTML.slice(0, 80))"""
        )
        assert unnamed == [], path


def test_an_exported_heat_plays_from_disk(browser, complaints, store, tmp_path):
    export(store, tmp_path / "season")
    page = assert_a_heat_plays_from_disk(browser, tmp_path / "season", complaints)
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
    points = rival.locator("a[href^='/matchups/']").nth(1)
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
    laps = page.locator("section", has_text="Best clean laps")
    lap = laps.locator("tbody td.number").first.inner_text()
    laps.locator("tbody a").last.click()
    page.locator("canvas").wait_for()
    assert lap in page.locator("section", has_text="Penalties included").inner_text()
    assert complaints == []


def test_the_live_page_shows_what_was_raced_since_it_was_opened(browser, origin, store, complaints):
    page = opened(browser, origin, complaints, reduced_motion="reduce")
    page.goto("/live")
    done = page.locator(".figures div", has_text="Done in all").locator("dd")
    before = int(done.inner_text())
    loop.run(store, Dispatcher(store, Here()), Matchmaker(store, same_owner=True), heats=1)
    expect(done).to_have_text(str(before + 1), timeout=20_000)
    assert complaints == []


def test_home_names_a_heat_as_soon_as_it_races(browser, origin, store, complaints):
    page = opened(browser, origin, complaints, reduced_motion="reduce")
    page.goto("/")
    now = page.locator("section", has=page.get_by_role("heading", name="Racing now"))
    expect(now).to_contain_text("No heat races at this moment")
    (claim,) = store.claim("a worker", 1)
    try:
        link = now.locator(f"a[href='/heats/{claim.number}']")
        expect(link).to_be_visible(timeout=20_000)
        link.click()
        expect(page.get_by_role("status")).to_contain_text("a worker races it now")
    finally:
        store.fail("a worker", claim.heat.key, "", lost=True)
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


def test_a_heat_is_followed_until_it_plays(browser, origin, store, complaints):
    rules, ids = store.settings.ruleset, [entry.id for entry in store.entries()[:2]]
    store.plan([mirrored(rules.hash, rules.tracks * 2, tuple(ids), draw=77)])
    number = store.heats(("planned",))[-1].number
    page = opened(browser, origin, complaints)
    page.goto(f"/heats/{number}")
    expect(page.get_by_role("status")).to_contain_text("It waits in a queue")
    page.evaluate("window.stays = true")
    loop.run(store, Dispatcher(store, Here()), None, heats=store.counts()["planned"])
    page.locator("canvas").wait_for(timeout=60_000)
    expect(page.get_by_role("button", name="Pause")).to_be_visible()
    now = page.locator("svg[data-time-from] .now")
    expect(now).not_to_have_attribute("x1", now.get_attribute("x1"))  # it follows the race
    assert page.evaluate("window.stays")
    assert complaints == []


def test_the_live_page_goes_on_to_the_newest_race(browser, origin, store, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/live")
    screen = page.locator("[data-newest]")
    screen.locator("canvas").wait_for()
    before = int(screen.get_attribute("data-newest"))
    loop.run(store, Dispatcher(store, Here()), Matchmaker(store, same_owner=True), heats=1)
    page.locator(".player").focus()
    expect(page.get_by_role("button", name="Pause")).to_be_visible()  # it plays by itself
    page.keyboard.press("End")
    expect(screen).not_to_have_attribute("data-newest", str(before), timeout=60_000)
    screen.locator("canvas").wait_for()
    assert complaints == []


def test_ghosts_are_chosen_without_javascript_and_play_with_it(browser, origin, complaints, store):
    plain = opened(browser, origin, complaints, java_script_enabled=False)
    plain.goto(f"/heats/{lapped_heat(store)}")
    plain.locator("a[href^='/ghosts?one=']").first.click()
    first = plain.get_by_role("heading", level=1).inner_text()
    plain.get_by_label("Laps of heat").fill(str(lapped_heat(store)))
    plain.get_by_role("button", name="Show").click()
    plain.get_by_role("link", name="as the second").last.click()
    assert (
        plain.get_by_role("heading", level=1).inner_text().split(" – ")[0]
        == (first.split(" – ")[0])
    )
    page = opened(browser, origin, complaints)
    page.goto(plain.url)
    canvas = page.locator("canvas")
    canvas.wait_for()
    shown = canvas.screenshot()
    page.wait_for_timeout(700)
    assert canvas.screenshot() != shown
    assert page.locator(".order tbody tr").count() == 2
    assert complaints == []


def test_the_standings_are_filtered_and_sorted_without_javascript(browser, origin, complaints):
    page = opened(browser, origin, complaints, java_script_enabled=False)
    page.goto("/standings")
    page.get_by_label("Kind").select_option("anchor")
    page.get_by_role("button", name="Show").click()
    page.get_by_role("link", name="Wins", exact=True).click()
    assert page.locator("th[aria-sort]").inner_text().lower() == "wins"
    wins = page.locator("tbody tr td:nth-child(7)").all_inner_texts()
    assert len(wins) == 2 and sorted(map(int, wins), reverse=True) == list(map(int, wins))
    assert page.get_by_label("Kind").input_value() == "anchor"
    assert complaints == []


def test_what_a_driver_saw_leads_to_the_moment(browser, origin, complaints):
    page = opened(browser, origin, complaints)
    page.goto("/drivers/2")
    strip = page.locator(".strip")
    strip.scroll_into_view_if_needed()
    expect(strip.locator("img")).to_have_js_property("naturalWidth", 960, timeout=60_000)
    address = strip.locator("a").nth(3).get_attribute("href")
    strip.locator("a").nth(3).click()
    page.locator("canvas").wait_for()
    moment = float(address.split("#t=")[1])
    assert float(page.locator(".scrub input").input_value()) == pytest.approx(moment, abs=0.03)
    assert complaints == []
