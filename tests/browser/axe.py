"""What axe-core says of a page, and the looks that pages are judged in."""

from __future__ import annotations

from importlib import resources

from playwright.sync_api import Page

from tests.browser.looking import NARROW, PHONE

AXE = resources.files("axe_playwright_python").joinpath("axe.min.js")
SERIOUS = {"serious", "critical"}
LOOKS = {
    "wide_light": {"color_scheme": "light"},
    "phone_dark": {"color_scheme": "dark", "viewport": PHONE},
    "narrow_light": {"color_scheme": "light", "viewport": NARROW},
}


def faults(page: Page) -> list[str]:
    """Return what axe-core finds serious or worse on a page, a line each."""
    # Evaluated by the debugger, which the page's own policy does not bind.
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run(document, { resultTypes: ['violations'] })")
    return [
        f"{rule['id']}: {node['html'][:120]} ({node['failureSummary'][:200]})"
        for rule in found["violations"]
        if rule["impact"] in SERIOUS
        for node in rule["nodes"]
    ]
