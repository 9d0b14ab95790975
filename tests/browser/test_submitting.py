"""A driver is entered through the form, validated and rated while its owner watches."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, expect

from league.agents import checkpoint
from league.cli import main
from league.matchmaking import loop, submission
from league.matchmaking.loop import Dispatcher
from league.matchmaking.pairing.matchmaker import Matchmaker
from league.matchmaking.store import Store
from tests.agents.trained import make_checkpoint
from tests.browser.looking import NEEDS_CHROMIUM, opened
from tests.matchmaking.season_kit import Here, new_league
from tests.web.serving import serving

expect.set_options(timeout=60_000)  # a busy machine is no fault
pytestmark = NEEDS_CHROMIUM


@pytest.fixture
def store(tmp_path) -> Iterator[Store]:
    url = f"sqlite:///{tmp_path / 'league.db'}"
    with new_league(url, anchors=("centerline", "racing_line")) as store:
        yield store


@pytest.fixture
def packed(tmp_path) -> str:
    """Return the path of what `league pack` writes."""
    checkpoint.save(tmp_path / "mine.pt", make_checkpoint("blind", name="mine"))
    path = str(tmp_path / "mine.safetensors")
    assert main(["pack", str(tmp_path / "mine.pt"), "--out", path]) == 0
    return path


def fill(page: Page, token: str, name: str, path: str) -> None:
    page.get_by_label("Token").fill(token)
    page.get_by_label("Name").fill(name)
    page.get_by_label("File").set_input_files(path)
    page.get_by_role("button", name="Submit").click()


def test_a_driver_is_entered_validated_and_rated_before_its_owners_eyes(
    browser: Browser, store, packed, complaints
):
    secret, _ = store.tokens.create("ann", ("submit",))
    with serving(store) as origin:
        page = opened(browser, origin, complaints)
        page.goto("/standings")
        page.get_by_role("link", name="Submit").click()
        fill(page, "league_wrong", "Ann's car", packed)
        expect(page.get_by_role("alert")).to_contain_text("This token is not known")
        complaints.clear()  # the browser logs each answer of 401
        assert page.get_by_label("Name").input_value() == "Ann's car"
        assert page.get_by_label("File").evaluate("field => field.files.length") == 1
        page.get_by_label("Token").fill(secret)
        page.get_by_role("button", name="Submit").click()
        expect(page).to_have_url(re.compile(r"/drivers/3$"))
        panel = page.get_by_label("First races")
        expect(panel.get_by_role("status")).to_contain_text("not planned yet")
        loop.run(store, Dispatcher(store, Here()), Matchmaker(store), heats=2)
        expect(panel.locator("tbody tr").first).to_contain_text("done")
        loop.run(store, Dispatcher(store, Here()), Matchmaker(store), heats=24)
        assert store.entry("Ann's car").state in ("placement", "provisional")
        expect(panel).to_have_count(0)  # its first races are over
        expect(page.get_by_text("Rating, 95 %")).to_be_visible()
        page.goto("/standings")
        assert page.get_by_role("link", name="Ann's car", exact=True).is_visible()
        page.context.close()
    assert complaints == []


def test_the_form_keeps_its_input_and_enters_a_driver_without_javascript(
    browser: Browser, store, packed, complaints
):
    secret, _ = store.tokens.create("ann", ("submit",))
    with serving(store) as origin:
        page = opened(browser, origin, complaints, java_script_enabled=False)
        page.goto("/submit")
        fill(page, "league_wrong", "Ann's car", packed)
        assert "This token is not known" in page.get_by_role("alert").inner_text()
        assert page.get_by_label("Name").input_value() == "Ann's car"
        assert page.get_by_label("Token").input_value() == ""
        fill(page, secret, "Ann's car", packed)
        expect(page).to_have_url(re.compile(r"/drivers/3$"))
        expect(page.get_by_label("First races")).to_be_visible()
        page.context.close()
    assert store.entry("Ann's car").owner == "ann"


def test_a_form_on_another_site_cannot_submit(browser: Browser, store, packed, complaints):
    secret, _ = store.tokens.create("ann", ("submit",))
    with serving(store) as origin:
        page = browser.new_context().new_page()
        page.set_content(
            f'<form method="post" action="{origin}/submit" enctype="multipart/form-data">'
            f'<input name="token" value="{secret}"><input name="name" value="x">'
            '<input type="file" name="file"><button>Go</button></form>'
        )
        page.locator("[type=file]").set_input_files(packed)
        page.get_by_role("button", name="Go").click()
        assert "was not sent from this page" in page.get_by_role("alert").inner_text()
        page.context.close()
    assert len(store.entries()) == 2


@pytest.mark.parametrize("scripts", [True, False])
def test_an_owner_retires_a_driver_and_a_refused_form_keeps_its_input(
    browser: Browser, store, packed, complaints, scripts
):
    secret, token = store.tokens.create("ann", ("submit",))
    submission.accept(store, Path(packed).read_bytes(), "Ann's car", token.owner)
    with serving(store) as origin:
        page = opened(browser, origin, complaints, java_script_enabled=scripts)
        page.goto("/drivers/3")
        page.get_by_role("link", name="retire it").click()
        page.get_by_label("Token").fill("league_wrong")
        page.get_by_label("Reason").fill("a better one is coming")
        page.get_by_role("button", name="Retire").click()
        expect(page.locator("input:invalid")).to_have_attribute("name", "sure")
        page.get_by_label("there is no way back").check()
        page.get_by_role("button", name="Retire").click()
        expect(page.get_by_role("alert")).to_contain_text("This token is not known")
        assert page.get_by_label("Reason").input_value() == "a better one is coming"
        assert page.get_by_label("Token").input_value() == ("league_wrong" if scripts else "")
        assert page.get_by_label("no way back").is_checked() == scripts
        complaints.clear()  # the browser logs each answer of 401
        page.get_by_label("Token").fill(secret)
        page.get_by_label("no way back").check()
        page.get_by_role("button", name="Retire").click()
        expect(page.get_by_role("heading", level=1)).to_have_text("Ann's car is retired")
        expect(page.get_by_role("status")).to_contain_text("a better one is coming")
        page.context.close()
    entry = store.entry("Ann's car")
    assert (entry.state, entry.reason) == ("retired", "a better one is coming")
    assert complaints == []
