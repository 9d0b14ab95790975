"""What axe-core says of a page, and the looks that pages are judged in."""

from __future__ import annotations

from importlib import resources
from typing import Literal

from playwright.sync_api import Page, ViewportSize

from tests.browser.looking import NARROW, PHONE

AXE = resources.files("axe_playwright_python").joinpath("axe.min.js")
SERIOUS = {"serious", "critical"}
LOOKS: dict[str, tuple[ViewportSize, Literal["light", "dark"]]] = {
    "wide, light": ({"width": 1280, "height": 720}, "light"),
    "phone, dark": (PHONE, "dark"),
    "narrow, light": (NARROW, "light"),
}


def faults(page: Page) -> list[str]:
    """Return what axe-core finds serious or worse on a page, a line each."""
    # Evaluated by the debugger, which the page's own policy does not bind.
    if page.evaluate("typeof axe") == "undefined":
        page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
    return [
        f"{rule['id']}: {node['html'][:120]} ({node['failureSummary'][:200]})"
        for rule in found["violations"]
        if rule["impact"] in SERIOUS
        for node in rule["nodes"]
    ]


def open_still(page: Page, path: str) -> None:
    """Open an address as a new visitor with a wide screen who wants no motion."""
    size, scheme = LOOKS["wide, light"]
    page.set_viewport_size(size)
    page.emulate_media(color_scheme=scheme, reduced_motion="reduce")
    page.goto(path)


def serious_faults(page: Page) -> dict[str, list[str]]:
    """Return these faults of a page in each look, which it takes one after the other."""
    found: dict[str, list[str]] = {}
    for name, (size, scheme) in LOOKS.items():
        page.set_viewport_size(size)
        page.emulate_media(color_scheme=scheme)
        if wrong := faults(page):
            found[name] = wrong
    return found
