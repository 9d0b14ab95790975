"""A small league that is served, and a browser."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from playwright.sync_api import Browser, Page, sync_playwright

from tests.browser import chromium
from tests.browser.looking import opened
from tests.matchmaking.season_kit import Store
from tests.web.serving import serving
from tests.web.small_league import raced_league


@pytest.fixture(scope="session")
def store(tmp_path_factory) -> Iterator[Store]:
    """Return a league that is only read: raced once for all modules."""
    with raced_league(f"sqlite:///{tmp_path_factory.mktemp('league') / 'league.db'}") as store:
        yield store


@pytest.fixture(scope="module")
def origin(store) -> Iterator[str]:
    """Return the pages' address. A thread serves them: a process would load the league again."""
    with serving(store) as address:
        yield address


@pytest.fixture
def browser(running_browser) -> Iterator[Browser]:
    """Return the browser; a page that goes on playing must not slow down the next test."""
    before = running_browser.contexts
    yield running_browser
    for context in running_browser.contexts:
        if context not in before:
            context.close()


@pytest.fixture(scope="module")
def running_browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    flags = chromium.DRAWING if getattr(request.module, "NEEDS_WEBGL", False) else chromium.FLAT
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium.program(), args=list(flags))
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def shared_page(running_browser, origin) -> Iterator[Page]:
    """Return a page for one address after the other: a page of its own is a process for each."""
    page = opened(running_browser, origin, [])
    yield page
    page.context.close()


@pytest.fixture
def complaints() -> list[str]:
    """Return what pages wrote to the console, refusals by the security policy included."""
    return []
