"""The narrowest phones: no page is wider than the screen, and every column can be reached."""

from __future__ import annotations

import pytest

from tests.browser.looking import NEEDS_CHROMIUM, PATHS
from tests.web.small_league import rated_heat

pytestmark = NEEDS_CHROMIUM
NARROW = {"width": 320, "height": 640}
SPILLED = """() => [...document.querySelectorAll("main *")].filter(
    (one) => one.getBoundingClientRect().right > innerWidth && !one.closest(".scroll, .player, pre")
).map((one) => one.outerHTML.slice(0, 150))"""


@pytest.mark.parametrize("path", [*PATHS, "/heats?driver=3"])
def test_no_page_is_wider_than_320_pixels_and_hidden_columns_can_be_shown(shared_page, store, path):
    page = shared_page
    page.set_viewport_size(NARROW)
    page.goto(path.format(heat=rated_heat(store)))
    fits = "document.documentElement.scrollWidth <= innerWidth"
    assert page.evaluate(fits), page.evaluate(SPILLED)
    late = page.locator("th.late")
    if not late.count():
        return
    assert not late.first.is_visible()
    page.get_by_label("Show all columns").check()
    assert all(one.is_visible() for one in late.all())
    assert page.evaluate(fits), page.evaluate(SPILLED)
