"""Every page as axe-core judges it: nothing serious, wide and on a phone, light and dark."""

from __future__ import annotations

import pytest

from tests.browser.axe import faults, open_still, serious_faults
from tests.browser.looking import NEEDS_CHROMIUM, PATHS, opened
from tests.web.small_league import rated_heat

pytestmark = NEEDS_CHROMIUM


@pytest.mark.parametrize("path", [*PATHS, "/submit", "/drivers/3/retire", "/drivers/99"])
def test_axe_finds_nothing_serious(shared_page, store, path):
    open_still(shared_page, path.format(heat=rated_heat(store)))
    shared_page.wait_for_load_state("networkidle")
    assert serious_faults(shared_page) == {}


def test_axe_would_find_a_missing_label_and_a_pale_text(browser, origin):
    page = opened(browser, origin, [])
    page.goto("/standings")
    page.evaluate(
        """() => {
            document.querySelector("label").replaceWith(document.querySelector("select"));
            document.querySelector(".lead").style.color = "#ddd";
        }"""
    )
    found = " ".join(faults(page))
    assert "select-name" in found and "color-contrast" in found
