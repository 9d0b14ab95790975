"""Parts of pages that renew themselves in a real browser, and what is changed where it is."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Page, expect

from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from tests.browser.looking import NEEDS_CHROMIUM, opened
from tests.matchmaking.season_kit import followed, new_league, raced

pytestmark = NEEDS_CHROMIUM
HIDDEN = """hidden => {
    Object.defineProperty(document, "hidden", { configurable: true, get: () => hidden });
    document.dispatchEvent(new Event("visibilitychange"));
}"""
"""Says that the page is hidden, or seen: without a window, another page in front does not."""


@pytest.fixture(scope="module")
def store(tmp_path_factory) -> Iterator[Store]:
    url = f"sqlite:///{tmp_path_factory.mktemp('renewal') / 'league.db'}"
    with new_league(url, anchors=("centerline", "racing_line")) as store:
        store.submit("blocks", "someone", scripted="blocker")
        raced(store, 5, same_owner=True)
        yield store


@pytest.fixture
def page(browser, origin, complaints) -> Page:
    """Return a page on which nothing plays by itself."""
    page = opened(browser, origin, complaints, reduced_motion="reduce")
    page.set_default_timeout(20_000)
    page.clock.install()
    return page


def race(page: Page, store: Store) -> None:
    """Race a heat, and wait until the server shows it."""
    raced(store, 1, same_owner=True)
    page.wait_for_timeout(2500)


def later(page: Page) -> None:
    """Let nine seconds pass on a page, and what it asked for arrive."""
    page.clock.run_for(9000)
    page.wait_for_timeout(500)


def test_a_link_that_has_the_focus_keeps_it(page, store, complaints):
    page.goto("/")
    results = page.locator("section", has=page.get_by_role("heading", name="Newest results"))
    count = results.get_by_role("link", name="heats")
    before = count.inner_text()
    results.locator("li a").last.focus()
    race(page, store)
    later(page)
    assert results.locator("li a").last.evaluate("link => link === document.activeElement")
    assert count.inner_text() == before
    page.evaluate("document.activeElement.blur()")
    expect(count).not_to_have_text(before, timeout=20_000)
    assert complaints == []


def test_a_hidden_page_asks_for_nothing_until_it_is_seen(page):
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto("/live")
    page.wait_for_load_state("networkidle")
    page.evaluate(HIDDEN, True)
    asked.clear()
    later(page)
    assert asked == []
    # Far enough ahead that it is not past when the browser hears of it.
    page.clock.pause_at(page.evaluate("Date.now() / 1000") + 30)
    with page.expect_response("**/live"):  # at once: no turn comes now
        page.evaluate(HIDDEN, False)


def test_a_race_that_is_over_stays_until_there_is_a_newer_one(page, store, complaints):
    page.goto("/live")
    screen = page.locator("[data-newest]")
    canvas, slider = screen.locator("canvas"), screen.locator(".scrub input")
    canvas.evaluate("canvas => (canvas.own = true)")
    race(page, store)
    later(page)  # it is not over: it was not begun
    assert canvas.evaluate("canvas => canvas.own")
    screen.locator(".player").focus()
    page.keyboard.press("End")
    expect(canvas).not_to_have_js_property("own", True, timeout=20_000)
    assert slider.input_value() == "0"
    canvas.evaluate("canvas => (canvas.own = true)")
    screen.locator(".player").focus()
    page.keyboard.press("End")
    over = slider.input_value()
    later(page)
    assert canvas.evaluate("canvas => canvas.own") and slider.input_value() == over != "0"
    assert complaints == []


def test_a_heat_is_followed_while_it_runs(browser, origin, store, complaints):
    Matchmaker(store, same_owner=True).plan()
    (claim,) = store.claim("a worker", 1)
    try:
        *sent, report = followed(store, claim)
        page = opened(browser, origin, complaints)
        page.set_default_timeout(20_000)
        page.goto(f"/heats/{claim.number}")
        expect(page.get_by_role("heading", name="Racing now")).to_be_visible()
        expect(page.locator(".player")).to_have_count(0)
        store.show("a worker", [sent[2]])
        canvas, clock = page.locator("canvas"), page.locator(".clock")
        canvas.wait_for()
        canvas.evaluate("canvas => (canvas.own = true)")
        # It plays, and waits for more where the recording ends.
        expect(clock).to_have_text("0:00.20 / 0:00.20 so far")
        start = canvas.screenshot()
        store.show("a worker", [sent[-2]])
        expect(clock).to_have_text("0:00.53 / 0:00.53 so far")
        assert canvas.screenshot() != start
        expect(page.get_by_role("button", name="Pause")).to_be_visible()
        expect(page.get_by_role("heading", name="Classification")).to_have_count(0)
        store.complete("a worker", [report.outcome])
        # Its result comes when the player is at its end; the player stays the same.
        expect(page.get_by_role("heading", name="Classification")).to_be_visible()
        expect(clock).to_have_text("0:00.60 / 0:00.60")
        assert canvas.evaluate("canvas => canvas.own") and complaints == []
    finally:
        store.fail("a worker", claim.heat.key, "", lost=True)


def test_the_result_of_a_heat_waits_until_the_player_has_shown_it(
    browser, origin, store, complaints
):
    Matchmaker(store, same_owner=True).plan()
    (claim,) = store.claim("a worker", 1)
    try:
        *sent, report = followed(store, claim)
        store.show("a worker", [sent[2]])
        page = opened(browser, origin, complaints, reduced_motion="reduce")
        page.set_default_timeout(20_000)
        page.goto(f"/heats/{claim.number}")
        clock = page.locator(".clock")
        expect(clock).to_have_text("0:00.00 / 0:00.20 so far")  # nothing plays by itself
        store.complete("a worker", [report.outcome])
        expect(clock).to_have_text("0:00.00 / 0:00.60")
        page.wait_for_timeout(2000)
        expect(page.get_by_role("heading", name="Classification")).to_have_count(0)
        page.get_by_role("link", name="Show the result now").click()
        expect(page.get_by_role("heading", name="Classification")).to_be_visible()
        assert complaints == []
    finally:
        store.fail("a worker", claim.heat.key, "", lost=True)


def test_the_standings_are_sorted_and_filtered_where_they_are(page, complaints):
    page.goto("/standings")
    names = page.locator("td.name > a")
    page.evaluate("window.stays = true")
    with page.context.expect_page() as tab:
        page.get_by_role("link", name="Driver", exact=True).click(modifiers=["Control"])
    assert tab.value.url.endswith("/standings?sort=name") and page.url.endswith("/standings")
    page.get_by_role("link", name="Driver", exact=True).click()
    expect(page).to_have_url("/standings?sort=name")
    expect(names).to_have_text(["blocks", "centerline", "racing_line"])
    expect(page.get_by_role("status")).to_have_text("Drivers on this page: 3, sorted by name.")
    page.get_by_label("Kind").select_option("scripted")
    expect(names).to_have_text(["blocks"])
    data = page.get_by_role("link", name="This page as JSON").get_attribute("href")
    assert "kind=scripted" in page.url and data.endswith(page.url.partition("?")[2])
    page.go_back()
    expect(names).to_have_text(["blocks", "centerline", "racing_line"])
    expect(page.get_by_label("Kind")).to_have_value("")
    page.go_back()
    expect(page.locator("th[aria-sort]")).to_have_text("Rating")
    assert page.evaluate("window.stays") and complaints == []
    page.route("**/standings?*", lambda route: route.abort())
    page.get_by_role("link", name="Driver", exact=True).click()
    expect(page.get_by_role("alert")).to_have_text("The server did not answer: try again.")
    page.unroute("**/standings?*")
    page.get_by_role("link", name="Driver", exact=True).click()
    expect(page).to_have_url("/standings?sort=name")
    expect(page.locator("#refusal")).to_be_hidden()


@pytest.mark.parametrize("answer", [None, 502])
def test_a_form_keeps_its_input_if_the_server_does_not_answer(page, answer):
    page.goto("/drivers/1/retire")
    page.route("**/retire", lambda route: route.fulfill(status=answer) if answer else route.abort())
    page.get_by_label("Token").fill("league_x")
    page.get_by_label("no way back").check()
    page.get_by_role("button", name="Retire").click()
    said = "The server answered 502." if answer else "The server did not answer: try again."
    expect(page.get_by_role("alert")).to_have_text(said)
    expect(page.get_by_role("button", name="Retire")).to_be_enabled()
    assert page.get_by_label("Token").input_value() == "league_x"
    page.unroute("**/retire")
    page.get_by_role("button", name="Retire").click()
    expect(page.get_by_role("alert")).to_contain_text("This token is not known")
