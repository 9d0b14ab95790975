"""Heats' pages: positions, laps compared, what proves a result, the file that plays alone."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from league.replay import format
from league.web import charts
from tests.web.small_league import NAME, lapped_heat, rated_heat


def chart_values(line, chart) -> list[float]:
    """Return the y of a line's points in the unit of its axis, read off the picture."""
    ticks = [(tick.at, float(tick.label)) for tick in chart.y_ticks]
    (low, low_label), (high, high_label) = ticks[0], ticks[-1]
    per = (high_label - low_label) / (high - low)
    points = [float(part.split()[1]) for part in re.split("[ML]", line.path) if part]
    return [low_label + (y - low) * per for y in points]


def recorded(store, number: int):
    return format.decode(store.blobs.get(store.results(number)[0].replay))


def test_positions_after_each_lap_are_by_time():
    order = [
        {"car": 1, "lap_times_s": (5.0, 4.0, 4.0)},
        {"car": 0, "lap_times_s": (4.0, 6.0, 6.0)},
        {"car": 2, "lap_times_s": (6.0,)},
    ]
    chart = charts.position_chart(order, ["a", "b", "c"])
    # After lap 1: 4, 5 and 6 s. After lap 2: 10 and 9 s; c never got there.
    values = [chart_values(line, chart) for line in chart.lines]
    assert values[0] == pytest.approx([1, 1, 2, 2], abs=0.02)
    assert values[1] == pytest.approx([2, 2, 1, 1], abs=0.02)
    assert values[2] == pytest.approx([3, 3], abs=0.02)


def test_laps_compared_are_each_cars_best_or_the_same_lap(store):
    replay = recorded(store, lapped_heat(store))
    best = charts.compared_laps(replay, None)
    finishers = {row.car + 1 for row in replay.result.order if row.lap_times_s}
    assert best.laps == dict.fromkeys(sorted(finishers), 1)
    assert charts.compared_laps(replay, 2) is None  # the races of this league have one lap


def test_speed_and_lost_time_along_the_lap_agree_with_the_recording(store):
    replay = recorded(store, lapped_heat(store))
    compared = charts.compared_laps(replay, None)
    row = min(replay.result.order, key=lambda row: min(row.lap_times_s, default=np.inf))
    speeds = chart_values(
        next(line for line in compared.speed.lines if line.kind == f"car-{row.car + 1}"),
        compared.speed,
    )
    columns = replay.columns
    last = int(np.flatnonzero(columns.laps[:, row.car] > 0)[0])
    expected = np.hypot(columns.velocity_x, columns.velocity_y)[: last + 1, row.car]
    assert speeds == pytest.approx(expected, abs=0.05)
    assert compared.fastest == row.car + 1


def test_the_heat_page_has_a_table_for_every_chart_and_links_to_laps(client, store):
    number = lapped_heat(store)
    page = client.get(f"/heats/{number}").text
    for heading in ("Classification", "Laps", "Position, lap by lap", "Laps compared"):
        assert f">{heading}</h2>" in page
    assert f'href="/heats/{number}?race=1&amp;lap=1#laps" aria' not in page
    assert "Lap 1" in client.get(f"/heats/{number}?lap=1").text
    assert client.get(f"/heats/{number}?lap=2").status_code == 404
    assert client.get(f"/api/v1/heats/{number}").json()["spec"]["laps"] == 1


def test_an_audit_that_agrees_verifies_a_heat(tmp_path):
    from starlette.testclient import TestClient

    from league.matchmaking import gauntlet, loop
    from league.matchmaking.loop import Dispatcher
    from league.matchmaking.pairing.matchmaker import Matchmaker
    from league.web.app import make_app
    from tests.matchmaking.season_kit import Here, new_league
    from tests.web.small_league import ORIGIN

    anchors = ("centerline", "racing_line")
    with new_league(f"sqlite:///{tmp_path / 'league.db'}", anchors=anchors) as store:
        loop.run(store, Dispatcher(store, Here()), Matchmaker(store, same_owner=True), heats=3)
        number = rated_heat(store)
        with TestClient(make_app(store), base_url=ORIGIN) as client:
            before = client.get(f"/api/v1/heats/{number}").json()
            assert before["intact"] and before["audits"] == []
            assert "Not audited yet" in client.get(f"/heats/{number}").text
            audits = gauntlet.pick_audit(store, 1.0, np.random.default_rng(0))
            gauntlet.audit(store, Here(), audits)
            (audit,) = client.get(f"/api/v1/heats/{number}").json()["audits"]
            assert audit["state"] == "done"
            assert "Verified" in client.get(f"/heats/{number}").text


def test_a_race_as_one_file_carries_everything_and_asks_for_nothing(client, store):
    number = rated_heat(store)
    answer = client.get(f"/heats/{number}/races/1/file")
    assert answer.headers["content-disposition"].endswith(f'"heat_{number}_race_1.html"')
    text = answer.text
    assert "/static/" not in text and "http:" not in text.replace("http-equiv", "")
    inline = re.search(r'<script type="application/json"[^>]*>(.*?)</script>', text, re.S).group(1)
    assert json.loads(inline) == client.get(f"/api/v1/heats/{number}/races/1/replay").json()
    assert NAME not in text.replace(inline, "") or "&lt;img" in text
    assert "<img" not in text


@pytest.mark.parametrize("path", ["races/0/file", "races/3/file"])
def test_a_file_of_a_race_that_is_not_there_is_404(client, store, path):
    assert client.get(f"/heats/{rated_heat(store)}/{path}").status_code == 404
