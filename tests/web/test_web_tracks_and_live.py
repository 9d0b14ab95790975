"""The tracks with their records and speeds, and what happens now."""

from __future__ import annotations

import time

import numpy as np
import pytest
from markupsafe import escape
from starlette.testclient import TestClient

from league import times
from league.matchmaking import standings
from league.matchmaking.pairing.heat_spec import mirrored
from league.racing_line.racing_line import lap_bound
from league.replay import format
from league.sim.config import CarConfig
from league.track import files
from league.web import charts
from league.web.app import make_app
from tests.matchmaking.season_kit import SHORT, followed
from tests.web.small_league import ORIGIN, RULES, lapped_heat, new_league, queued_league


def test_records_are_the_clean_laps_of_the_standings(client, store):
    (track,) = client.get("/api/v1/tracks").json()["tracks"]
    best = {
        row.number: row.clean_laps_s[track["name"]]
        for row in standings.of(store).rows
        if track["name"] in row.clean_laps_s
    }
    assert {record["entry"]: record["lap_s"] for record in track["records"]} == best
    laps = [record["lap_s"] for record in track["records"]]
    assert laps == sorted(laps) and laps
    assert f'href="/heats/{track["records"][0]["heat"]}?race=' in client.get("/tracks").text


def test_medals_are_by_the_lap_bound_of_the_track(client):
    (track,) = client.get("/api/v1/tracks").json()["tracks"]
    bound_s = lap_bound(files.load(track["name"]), CarConfig())
    assert track["medals"]["silver"] == pytest.approx(1.2 * bound_s)
    for record in track["records"]:
        assert (record["medal"] == "") == (record["lap_s"] > 1.35 * bound_s)


def test_a_speed_map_has_the_whole_lap_and_its_slowest_and_fastest_part(store):
    number = lapped_heat(store)
    replay = format.decode(store.blobs.get(store.results(number)[0].replay))
    lap = charts.lap_of(replay, replay.result.order[0].car, 1)
    shown = charts.speed_map(lap)
    assert sum(line.path.count("M") for line in shown.lines) == len(lap.points) - 1
    middle = (lap.speed[1:] + lap.speed[:-1]) / 2
    assert (shown.low, shown.high) == (middle.min(), middle.max())
    slowest, fastest = (shown.lines[at].path.count("M") for at in (0, -1))
    width = (shown.high - shown.low) / len(shown.lines)
    assert slowest == np.count_nonzero(middle < shown.low + width)
    assert fastest == np.count_nonzero(middle >= shown.high - width)


def test_a_lap_begins_at_the_start_line_and_ends_there(store):
    replay = format.decode(store.blobs.get(store.results(lapped_heat(store))[0].replay))
    car = replay.result.order[0]
    lap = charts.lap_of(replay, car.car, 1)
    assert lap.place[-1] == pytest.approx(replay.track.length, abs=0.4)
    assert lap.time_s[-1] == pytest.approx(car.lap_times_s[0], abs=1 / replay.step_hz)


def test_a_running_heat_its_worker_and_the_queue_are_live(client, store):
    before = client.get("/api/v1/live").json()
    (claim,) = store.claim("a worker", 1)
    try:
        now = client.get("/api/v1/live").json()
        assert [heat["number"] for heat in now["running"]] == [claim.number]
        assert now["counts"]["planned"] == before["counts"]["planned"] - 1
        worker = next(one for one in now["workers"] if one["name"] == "a worker")
        assert (worker["racing"], worker["done"]) == (1, 0)
        page, since_s = client.get("/live").text, now["running"][0]["claimed_s"]
        assert "1 heat is racing" in page
        assert claim.claimed_s == since_s and 0 <= time.time() - since_s < 600
        assert f'<td class="number dim">{times.time_of_day(since_s)}</td>' in page
    finally:
        store.fail("a worker", claim.heat.key, "", lost=True)


def test_a_heat_that_is_raced_tells_how_far_it_has_come(store, monkeypatch):
    client = TestClient(make_app(store), base_url=ORIGIN)
    took_s = sorted(one.done_s - one.claimed_s for one in store.heats(("done",))[-20:])
    assert client.get(f"/api/v1/heats/{store.heats()[0].number}").json()["progress"] is None
    (claim,) = store.claim("a worker", 1)
    try:
        page, path = f"/heats/{claim.number}", f"/api/v1/heats/{claim.number}"
        monkeypatch.setattr("league.web.reader.time.time", lambda: claim.claimed_s + 12.0)
        monkeypatch.setattr("league.web.answers.MOST", 8)
        monkeypatch.setattr("league.web.answers.FRESH_S", 0.0)
        progress = client.get(path).json()["progress"]
        assert progress["worker"] == "a worker" and progress["races"] == len(claim.heat.halves)
        assert progress["elapsed_s"] == pytest.approx(12.0)
        assert progress["usual_s"] == pytest.approx((took_s[9] + took_s[10]) / 2)
        assert client.get("/api/v1/live").json()["progress"][str(claim.number)] == progress
        text = client.get(page).text
        since = f"On a worker since {times.time_of_day(claim.claimed_s)} UTC: 12 s <progress "
        assert since in " ".join(text.split()) and "<progress " in client.get("/live").text
        assert f'<noscript><p class="note"><a href="{page}?race=1">Look again' in text
        # It is not kept, although nothing happens in the league meanwhile.
        monkeypatch.setattr("league.web.answers.STALE_S", 0.0)
        monkeypatch.setattr("league.web.reader.time.time", lambda: claim.claimed_s + 15.0)
        assert client.get(path).json()["progress"]["elapsed_s"] == pytest.approx(15.0)
    finally:
        store.fail("a worker", claim.heat.key, "", lost=True)


def test_a_heat_can_be_followed_while_it_runs(tmp_path):
    with queued_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        client = TestClient(make_app(store), base_url=ORIGIN)
        (claim,) = store.claim("a worker", 1)
        page, data = f"/heats/{claim.number}?race=2", f"/api/v1/heats/{claim.number}?race=2"
        player = f"/api/v1/heats/{claim.number}/races/2/replay"
        assert client.get(player).status_code == 404
        assert "data-replay" not in client.get(page).text
        assert client.get(data).json()["shown"] is False
        *sent, report = followed(store, claim)
        for progress in sent[3], sent[-2]:
            store.show("a worker", [progress])
            client = TestClient(make_app(store), base_url=ORIGIN)
            seen = client.get(player)
            steps = 1 + sent.index(progress)
            assert seen.json()["over"] is False and seen.json()["laps"] == SHORT.laps
            assert seen.json()["duration_s"] == pytest.approx(
                steps / seen.json()["step_hz"], abs=1e-3
            )
            assert {len(car["x"]) for car in seen.json()["cars"]} == {steps + 1}
            # One car leads, but has not won.
            assert {event["kind"] for event in seen.json()["events"]} == {"start"}
            document, html = client.get(data), client.get(page).text
            assert document.json()["shown"] and document.json()["spec"] is None
            assert f'data-replay="{player}"' in html and "Show the result now" in html
            assert f'data-newest="{claim.number}"' in client.get("/live").text
            # Seeds are a secret until a heat is over.
            texts = seen.text, document.text, html
            assert not any(str(seed) in text for seed in store.seeds(claim.heat) for text in texts)
        store.complete("a worker", [report.outcome])
        client = TestClient(make_app(store), base_url=ORIGIN)
        seen = client.get(player).json()
        assert "winner" in {event["kind"] for event in seen["events"]}
        assert seen["over"] is True and {len(car["x"]) for car in seen["cars"]} == {len(sent) + 1}
        assert client.get(data).json()["shown"] and "Show the result" not in client.get(page).text


def test_home_names_the_heats_that_race_and_has_the_newest_results(client, store):
    assert "No heat races at this moment" in client.get("/").text
    (claim,) = store.claim("a worker", 1)
    try:
        document, page = client.get("/api/v1/home").json(), client.get("/").text
        (running,) = document["running"]
        names = {entry.id: entry.name for entry in store.entries()}
        grid = [names[id] for id in claim.heat.halves[0].grid]
        assert (running["number"], running["races"][0]["grid"]) == (claim.number, grid)
        assert f'href="/heats/{claim.number}">{escape(" – ".join(grid))}</a>' in page
        since = f"a worker, since {times.time_of_day(claim.claimed_s)} UTC"
        assert "1 heat races" in page and since in page
    finally:
        store.fail("a worker", claim.heat.key, "", lost=True)
    done = sorted(store.heats(("done",)), key=lambda one: (-(one.done_s or 0.0), -one.number))
    assert [one["number"] for one in document["newest"]] == [one.number for one in done[:6]]


def test_a_duel_is_shown_with_its_score(client, store):
    document, page = client.get("/api/v1/home").json(), client.get("/").text
    duels = [heat for heat in document["newest"] if len(heat["winners"]) == 2]
    assert duels
    for heat in duels:
        first = heat["winners"].count(heat["races"][0]["grid"][0])
        link = page[page.index(f'class="duel" href="/heats/{heat["number"]}"') :]
        assert f"<b>{first} – {2 - first}</b>" in link[: link.index("</a>")]


def test_the_pace_is_of_the_last_five_minutes(client, store, monkeypatch):
    done = [heat.done_s for heat in store.heats(("done",))]
    monkeypatch.setattr("league.web.pages.heats.time.time", lambda: max(done) + 1.0)
    recent = sum(max(done) + 1.0 - one < 300 for one in done)
    assert client.get("/api/v1/live").json()["per_minute"] == pytest.approx(recent / 5)
    monkeypatch.setattr("league.web.pages.heats.time.time", lambda: max(done) + 301.0)
    later = client.get("/api/v1/live").json()
    assert later["per_minute"] == 0 and later["wait_minutes"] is None


def test_a_heat_that_waits_says_so_and_is_asked_for_again(tmp_path):
    anchors = ("centerline", "racing_line")
    with new_league(f"sqlite:///{tmp_path / 'league.db'}", anchors=anchors, rules=RULES) as store:
        ids = tuple(entry.id for entry in store.entries())
        store.plan([mirrored(RULES.hash, RULES.tracks * 2, ids)])
        with TestClient(make_app(store), base_url=ORIGIN) as client:
            page = client.get("/heats/1").text
            assert "waits in a" in page and "of 1 heat," in page
            assert 'data-live="heat"' in page and "/static/live.js" in page
            store.claim("worker 7")
            assert "worker 7 races it now" in client.get("/heats/1").text
