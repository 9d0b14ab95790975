"""Pictures of every page of a league, wide and on a phone, in light and in dark mode.

    python -m tests.browser.pages LEAGUE FOLDER      (`make pages`)

Ends with 1 if a script fails or a page needs sideways scrolling.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from playwright.sync_api import Browser, sync_playwright

from league.matchmaking import standings
from league.matchmaking.store import Store
from tests.browser import chromium

SIZES = {"wide": {"width": 1280, "height": 900}, "phone": {"width": 390, "height": 844}}
SCHEMES = ("light", "dark")


def addresses(store: Store) -> dict[str, str]:
    """Return the pages to look at, by the names of their pictures."""
    best, second = (row.number for row in standings.of(store).rows[:2])
    rated = [one.number for one in store.heats(("done",)) if one.heat.purpose == "rated"]
    return {
        "home": "/",
        "standings": "/standings",
        "against": f"/standings?against={best}",
        "driver": f"/drivers/{best}",
        "retire": f"/drivers/{best}/retire",
        "matchup": f"/matchups/{best}/{second}",
        "heats": "/heats",
        "heat": f"/heats/{rated[-1]}#t=6",
        "tracks": "/tracks",
        "boards": "/time-attack",
        "seasons": "/seasons",
        **{f"season_{one.number}": f"/seasons/{one.number}" for one in store.seasons()},
        **{f"cup_{one.number}": f"/cups/{one.number}" for one in store.cups()},
        "definitions": "/definitions",
        "ghosts": "/ghosts#t=2",
        "live": "/live",
        "submit": "/submit",
        "error": "/drivers/999999",
    }


@contextmanager
def served(league: str) -> Iterator[str]:
    """Serve a league's pages; yield their address."""
    command = [sys.executable, "-m", "league.cli", "serve", "--league", league, "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            yield re.search(r"http://127\.0\.0\.1:\d+", process.stdout.readline()).group()
        finally:
            process.send_signal(2)


def photograph(browser: Browser, origin: str, pages: dict[str, str], folder: Path) -> list[str]:
    """Write the pictures; return what is wrong with the pages, a line each."""
    faults: list[str] = []
    for size, viewport in SIZES.items():
        for scheme in SCHEMES:
            context = browser.new_context(
                base_url=origin, viewport=viewport, color_scheme=scheme, reduced_motion="reduce"
            )
            page = context.new_page()
            page.on("pageerror", lambda error: faults.append(str(error)))
            for name, address in pages.items():
                page.goto(address)
                page.wait_for_timeout(300)
                for picture in page.locator("img[loading=lazy]").all():
                    picture.scroll_into_view_if_needed()
                page.wait_for_load_state("networkidle")
                page.evaluate("scrollTo(0, 0)")
                if not page.evaluate("document.documentElement.scrollWidth <= innerWidth"):
                    faults.append(f"{name} ({size}, {scheme}) needs sideways scrolling")
                page.screenshot(path=folder / f"{name}_{size}_{scheme}.png", full_page=True)
            context.close()
    return faults


def main(league: str, folder: Path) -> int:
    """Write the pictures of a league's pages."""
    folder.mkdir(parents=True, exist_ok=True)
    with Store(league) as store:
        pages = addresses(store)
    with served(league) as origin, sync_playwright() as playwright:
        browser = playwright.chromium.launch(
            executable_path=chromium.program(), args=["--no-sandbox"]
        )
        faults = photograph(browser, origin, pages, folder)
        browser.close()
    print(f"{len(pages) * len(SIZES) * len(SCHEMES)} pictures: {folder}")
    for fault in faults:
        print(fault)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], Path(sys.argv[2])))
