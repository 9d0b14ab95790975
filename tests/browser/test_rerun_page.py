"""A race opens in the Rerun viewer from its heat's page: judged by the viewer's pixels."""

from __future__ import annotations

import time

import cv2
import numpy as np

from league.track import files
from tests.browser.looking import NEEDS_CHROMIUM, opened
from tests.web.small_league import rated_heat

pytestmark = NEEDS_CHROMIUM
NEEDS_WEBGL = True
LIMIT_S = 300.0
"""The recording is made first, and software draws it."""


def picture(page) -> np.ndarray:
    encoded = np.frombuffer(page.screenshot(), np.uint8)
    return cv2.imdecode(encoded, cv2.IMREAD_COLOR)[..., ::-1].astype(int)


def share(shown: np.ndarray, colour: tuple[int, int, int]) -> float:
    """Return the share of pixels near a colour."""
    return float((np.abs(shown - colour) <= 14).all(axis=2).mean())


def test_a_heat_opens_in_rerun_from_its_page(browser, origin, complaints, store):
    page = opened(browser, origin, complaints, viewport={"width": 640, "height": 448})
    asked: list[str] = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"/heats/{rated_heat(store)}")
    page.get_by_role("link", name="Open in Rerun").click()
    page.wait_for_url("**/rerun/**")
    colours = files.load("reinvent_2018").colours
    deadline, shown = time.monotonic() + LIMIT_S, picture(page)
    while share(shown, colours.road) < 0.02 or share(shown, colours.field) < 0.05:
        assert time.monotonic() < deadline, "the viewer shows no race"
        page.wait_for_timeout(2000)
        shown = picture(page)
    assert any(url.endswith(".rrd") for url in asked)
    outside = [url for url in asked if not url.startswith((origin, "data:", "blob:"))]
    assert outside == []
    # The viewer looks for newer versions and counts its users elsewhere, which is refused.
    refused = [line for line in complaints if "Content Security Policy" in line]
    assert all("Connecting to 'https://" in line or "load https://" in line for line in refused)
