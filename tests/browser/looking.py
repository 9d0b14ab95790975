"""What the browser tests share: pages to look at, and how one is opened."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from playwright.sync_api import Browser, Page, ViewportSize

from league.cli import main
from league.matchmaking.store import Store
from tests.browser import chromium

NEEDS_CHROMIUM = [
    pytest.mark.browser,
    pytest.mark.skipif(
        chromium.program() is None,
        reason="needs Chromium: install it, or set CHROMIUM to its path",
    ),
]
PATIENCE_MS = 180_000
"""On a busy machine the first answer takes long."""
PHONE: ViewportSize = {"width": 390, "height": 800}
NARROW: ViewportSize = {"width": 360, "height": 740}
PATHS = (
    "/", "/standings", "/standings?against=3", "/drivers/1", "/drivers/3", "/matchups/3/1",
    "/heats", "/heats/{heat}", "/tracks", "/ghosts", "/live",
)  # fmt: skip


def opened(browser: Browser, origin: str | None, complaints: list[str], **options: object) -> Page:
    """Return a page, which writes what it complains about into a list."""
    page = browser.new_context(base_url=origin, **options).new_page()
    page.set_default_timeout(PATIENCE_MS)
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    return page


def export(store: Store, folder: Path, *options: str) -> None:
    """Write a league's pages with one heat into a folder, as `league site` does."""
    command = ["site", str(folder), "--heats", "1", "--league", store.url, *options]
    # The browser's event loop runs in the test's own thread, which leaves no room for another.
    with ThreadPoolExecutor(1) as thread:
        assert thread.submit(main, command).result() == 0


def assert_a_heat_plays_from_disk(browser: Browser, folder: Path, complaints: list[str]) -> Page:
    """Play the first heat of an exported season without a network; return its page."""
    page = opened(browser, None, complaints, offline=True)
    page.goto((folder / "index.html").as_uri())
    page.get_by_role("link", name="Heats", exact=True).click()
    page.locator("td.number a").first.click()
    canvas = page.locator("canvas")
    canvas.wait_for()
    first = canvas.screenshot()
    page.keyboard.press("End")
    assert canvas.screenshot() != first
    return page
