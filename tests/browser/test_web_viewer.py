"""The web viewer in a real browser: what a visitor sees is judged by its pixels."""

import time
from collections.abc import Callable

import numpy as np

from league import rerun_view
from league.sim.camera.scene import CAR_COLOURS
from league.track import files
from tests.browser import chromium
from tests.browser.looking import NEEDS_CHROMIUM
from tests.recorded import raced

pytestmark = NEEDS_CHROMIUM

WIDTH, HEIGHT = 640, 405
"""Each pixel costs processor time; the layout still shows all that is judged."""
LIMIT_S = 240.0
"""Software rendering on a busy machine takes tens of seconds."""


def share(picture: np.ndarray, colour: tuple[int, int, int], slack: int = 30) -> float:
    """Return the share of pixels near a colour."""
    return float((np.abs(picture.astype(int) - colour) <= slack).all(axis=2).mean())


def regions(picture: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the chase view, the cars' eyes and the charts, by where the layout puts them."""
    height, width = picture.shape[:2]
    split, floor = round(width * 0.695), round(height * 0.69)
    return picture[40:floor, :split], picture[floor + 40 : -60, :split], picture[:, split + 10 :]


def shows_the_race(picture: np.ndarray) -> bool:
    """Whether road, cars, films and charts are all there."""
    colours = files.load("reinvent_2018").colours
    chase, eyes, charts = regions(picture)
    return (
        share(chase, colours.road, 12) > 0.04
        and share(chase, colours.field) > 0.15
        and share(chase, colours.line) > 0.005
        and all(share(chase, colour, 40) > 0.0005 for colour in CAR_COLOURS[:2])
        and share(eyes, colours.dash, 60) > 0.0005
        and share(eyes, colours.road, 25) > 0.05
        and all(share(charts, colour, 40) > 0.001 for colour in CAR_COLOURS[:2])
    )


def wait_for(browser: chromium.Chromium, wished: Callable[[np.ndarray], bool]) -> np.ndarray:
    """Return the first picture that is as wished, or the last one."""
    deadline = time.monotonic() + LIMIT_S
    while True:
        picture = browser.picture()
        if wished(picture) or time.monotonic() > deadline:
            return picture
        time.sleep(1.0)


def test_the_browser_shows_the_race_and_asks_nobody_else(tmp_path):
    path = rerun_view.save(raced(), tmp_path / "race.rrd")
    with (
        rerun_view.serve(path) as server,
        chromium.Chromium(WIDTH, HEIGHT) as browser,
    ):
        browser.open(server.url)
        assert not shows_the_race(browser.picture())
        picture = wait_for(browser, shows_the_race)
        chromium.save(picture, tmp_path / "race.png")
        assert shows_the_race(picture), f"see {tmp_path / 'race.png'}"
        # It plays by itself: the picture changes without a touch.
        later = wait_for(browser, lambda now: share_changed(now, picture) > 0.01)
        assert share_changed(later, picture) > 0.01
        outside = [url for url in browser.requests if not url.startswith(server.origin)]
        assert [url for url in outside if not url.startswith(("data:", "blob:", "about:"))] == []


def share_changed(one: np.ndarray, other: np.ndarray) -> float:
    """Return the share of the chase view's pixels that differ clearly."""
    now, then = regions(one)[0].astype(int), regions(other)[0].astype(int)
    return float((np.abs(now - then).max(axis=2) > 40).mean())
