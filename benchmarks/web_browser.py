"""What a browser needs for a league's pages: until something is seen, and for a frame of a race."""

import statistics
from collections.abc import Mapping

from benchmarks.report import figure, note

PAINTS = 5
"""Times that each page is opened, each in a browser that has seen nothing before."""
PLAYED_S = 5.0
"""How long a race is played [s]."""
GOAL_PAINT_S, GOAL_FRAMES = 1.0, 60.0
PAINTED = """new Promise((done) => new PerformanceObserver((seen) => {
  const first = seen.getEntriesByName("first-contentful-paint")[0];
  if (first) done(first.startTime / 1000);
}).observe({ type: "paint", buffered: true }))"""
"""Returns when something was seen first [s], from the moment that the page was asked for."""
PLAYED = """async (seconds) => {
  const player = document.querySelector("[data-replay]").player;
  const draw = player.draw.bind(player);
  let script = 0;
  const starts = [];
  player.draw = () => {
    starts.push(performance.now());
    draw();
    script += performance.now() - starts.at(-1);
  };
  if (!player.playing) player.toggle();
  await new Promise((done) => setTimeout(done, 1000 * seconds));
  const [drawn, took] = [starts.length, starts.at(-1) - starts[0]];
  return { cars: player.race.cars.length, drawn, script, took };
}"""
"""Plays a race: how many frames were drawn, the time in the script and from the first to the last
[ms]."""
EMPTY = """async (seconds) => {
  const starts = [];
  const next = (now) => { starts.push(now); requestAnimationFrame(next); };
  requestAnimationFrame(next);
  await new Promise((done) => setTimeout(done, 1000 * seconds));
  return { drawn: starts.length, took: starts.at(-1) - starts[0] };
}"""
"""Draws nothing: how many frames the browser asks for, and from the first to the last [ms]."""
FLAGS = ("--no-sandbox",)
"""Without a graphics card Chromium draws the pages in software. The tests' flags for WebGL, which
no page but the Rerun viewer's needs, made it draw a sixth as many frames."""


def measure(origin: str, pages: Mapping[str, str], race: str) -> None:
    """Print the figures of a headless Chromium, if there is one.

    Args:
        origin: where the league is served.
        pages: addresses of pages by what they are called.
        race: address of the page of a race of eight cars.
    """
    try:
        from playwright.sync_api import sync_playwright

        from tests.browser import chromium
    except ImportError:
        note("First paint and the player: not measured, playwright is not installed.")
        return
    if chromium.program() is None:
        note("First paint and the player: not measured, Chromium is not installed.")
        return
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium.program(), args=list(FLAGS))
        for name, address in pages.items():
            _paint(browser, name, origin + address)
        _play(browser, origin + race)
        browser.close()


def _paint(browser, name: str, address: str) -> None:
    seen, worked = [], []
    for _ in range(PAINTS):
        page = browser.new_page(viewport={"width": 1280, "height": 900})
        clock = _Clock(page)
        page.goto(address)
        page.wait_for_load_state()
        seen.append(page.evaluate(PAINTED))
        worked.append(clock.worked_s())
        page.close()
    figure(f"{name}: first paint, wall time", statistics.median(seen), "s", GOAL_PAINT_S, most=True)
    figure(f"{name}: the page's thread until it is loaded, processor time",
           1e3 * statistics.median(worked), "ms")  # fmt: skip


def _play(browser, address: str) -> None:
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    empty = page.evaluate(EMPTY, PLAYED_S)
    asked = 1e3 * (empty["drawn"] - 1) / empty["took"]
    figure("an empty page: frames that the browser asks for, wall time", asked, "frames/s")
    page.goto(address)
    page.wait_for_selector("[data-replay].ready")
    clock = _Clock(page)
    before_s = clock.worked_s()
    played = page.evaluate(PLAYED, PLAYED_S)
    worked_s = clock.worked_s() - before_s
    assert played["cars"] == 8 and played["drawn"] > 1, played
    frames = played["drawn"]
    figure("the player with eight cars, wall time", 1e3 * (frames - 1) / played["took"], "frames/s",
           GOAL_FRAMES)  # fmt: skip
    figure("a frame of it: in the script that draws it", played["script"] / frames, "ms",
           1e3 / GOAL_FRAMES, most=True)  # fmt: skip
    figure("a frame of it: the page's thread, processor time", 1e3 * worked_s / frames, "ms",
           1e3 / GOAL_FRAMES, most=True)  # fmt: skip
    page.close()


class _Clock:
    """The processor time of a page's main thread."""

    def __init__(self, page) -> None:
        self._session = page.context.new_cdp_session(page)
        self._session.send("Performance.enable", {"timeDomain": "threadTicks"})

    def worked_s(self) -> float:
        """Return how long its tasks have worked since the page began [s]."""
        metrics = self._session.send("Performance.getMetrics")["metrics"]
        return next(one["value"] for one in metrics if one["name"] == "TaskDuration")
