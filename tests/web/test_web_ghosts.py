"""Ghosts: two laps of any races against each other."""

from __future__ import annotations

import re

import numpy as np
import pytest
from starlette.testclient import TestClient

from league.matchmaking import standings
from league.matchmaking.scores import clean_laps
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.web import charts, replay_data
from league.web.app import make_app
from league.web.pages import heats
from league.web.reader import NotFoundError
from tests.web.small_league import NAME, ORIGIN, RULES, lapped_heat, new_league

TRACK = "reinvent_2018"


def best_laps(store):
    rated = standings.of(store)
    return clean_laps(rated.races, rated.tracks)[TRACK]


def summed(column: list[int], order: int) -> np.ndarray:
    values = np.array(column)
    for _ in range(order):
        values = np.cumsum(values)
    return values / 100


def test_without_a_choice_the_two_fastest_drivers_meet(client, store):
    first, second = best_laps(store)[:2]
    document = client.get("/api/v1/ghosts").json()
    assert [lap["entry"] for lap in document["pair"]] == [first.number, second.number]
    assert [lap["lap_s"] for lap in document["pair"]] == pytest.approx(
        [first.lap_s, second.lap_s], abs=5e-4
    )
    assert [(one["heat"], one["race"]) for one in document["pair"]] == [
        (first.heat, first.race),
        (second.heat, second.race),
    ]


def test_the_gap_over_the_line_is_the_difference_of_the_lap_times(client):
    pair = client.get("/api/v1/ghosts").json()["pair"]
    query = {"one": pair[0]["id"], "other": pair[1]["id"]}
    race = client.get("/api/v1/ghosts/replay", params=query).json()
    gap = summed(race["cars"][1]["gap"], 1)[-1]
    assert gap == pytest.approx(pair[1]["lap_s"] - pair[0]["lap_s"], abs=0.04)
    # The other way round it is the same lap that leads.
    turned = client.get(
        "/api/v1/ghosts/replay", params={"one": query["other"], "other": query["one"]}
    ).json()
    assert summed(turned["cars"][0]["gap"], 1)[-1] == pytest.approx(gap, abs=0.011)
    ends = [event for event in race["events"] if event["kind"] == "finish"]
    assert [end["time_s"] for end in ends] == pytest.approx(
        [one["lap_s"] for one in pair], abs=0.03
    )


def test_a_later_lap_begins_at_the_line_and_the_first_with_the_signal():
    entries = (Entry(name="racing_line"), Entry(name="cautious"))
    replay = race.run(RaceSpec(entries=entries, laps=2, solver="planar", seed=3)).replay
    car = 1  # the second on the grid
    laps = [charts.lap_of(replay, car, number) for number in (1, 2)]
    drawn = replay_data.ghosts_data(laps, replay.track)["cars"]
    first, second = (summed(one["distance"], 2) for one in drawn)
    assert first[0] < -0.05  # the grid is behind the line
    assert abs(second[0]) < 0.02
    x, y = (summed(drawn[1][name], 2)[0] for name in "xy")
    start = (replay.track.left[0] + replay.track.right[0]) / 2
    assert np.hypot(x - start[0], y - start[1]) < replay.track.width / 2 + 0.05
    times_s = next(row for row in replay.result.order if row.car == car).lap_times_s
    for one, lap_s in zip(drawn, times_s, strict=False):
        assert one["lap_frames"][0] / replay_data.STEP_HZ == pytest.approx(lap_s, abs=0.08)


def test_a_chosen_lap_meets_the_fastest_one_and_stays_chosen(client, store):
    heat = lapped_heat(store)
    result = store.results(heat)[0].result["order"][0]
    one = f"{heat}.1.{result['car'] + 1}.1"
    document = client.get("/api/v1/ghosts", params={"one": one, "heat": str(heat)}).json()
    assert document["pair"][0]["id"] == one
    assert document["pair"][0]["lap_s"] == result["lap_times_s"][0]
    assert document["pair"][1]["entry"] != document["pair"][0]["entry"]
    listed = {(lap["race"], lap["car"], lap["lap"]) for lap in document["heat_laps"]}
    results = store.results(heat)
    assert listed == {
        (one.half + 1, row["car"] + 1, lap + 1)
        for one in results
        for row in one.result["order"]
        for lap in range(len(row["lap_times_s"]))
    }
    page = client.get("/ghosts", params={"one": one, "heat": str(heat)}).text
    assert f'<option value="{one}" selected>' in page
    # Every lap of the heat can be made the first or the second one without JavaScript.
    for lap in document["heat_laps"]:
        assert f"/ghosts?one={lap['id']}&amp;other={document['pair'][1]['id']}" in page


def test_a_driver_stands_for_its_best_lap(client, store):
    fastest, slower = best_laps(store)[:2]
    asked = client.get("/api/v1/ghosts", params={"track": TRACK, "one": str(slower.number)}).json()
    assert [lap["entry"] for lap in asked["pair"]] == [slower.number, fastest.number]


def test_heats_tracks_and_drivers_lead_to_ghosts(client, store):
    heat = lapped_heat(store)
    links = re.findall(r'/ghosts\?one=(\d+\.1\.\d\.1)"', client.get(f"/heats/{heat}").text)
    assert links and all(client.get(f"/ghosts?one={link}").status_code == 200 for link in links)
    assert f"/ghosts?track={TRACK}" in client.get("/tracks").text
    driver = best_laps(store)[1].number
    assert f"/ghosts?track={TRACK}&amp;one={driver}" in client.get(f"/drivers/{driver}").text


@pytest.mark.parametrize(
    "query",
    [
        "track=nowhere",
        "one=99",
        "one=999.1.1.1",
        "one=1.9.1.1",
        "one={heat}.1.9.1",
        "one={heat}.1.0.1",
        "one={heat}.1.1.99",
        "heat=x",
        "heat=999",
    ],
)
def test_laps_that_are_not_there_are_404(client, store, query):
    answer = client.get(f"/ghosts?{query.format(heat=lapped_heat(store))}")
    assert answer.status_code == 404
    assert "<h1>Not Found</h1>" in answer.text


def test_the_player_gets_only_laps_of_one_track(client, store):
    heat = lapped_heat(store)
    assert client.get(f"/api/v1/ghosts/replay?one={heat}.1.1.1").status_code == 404
    assert client.get("/api/v1/ghosts/replay?one=3&other=4").status_code == 404


def test_names_in_ghosts_are_text(client):
    page = client.get("/ghosts").text
    assert NAME not in page and "&lt;img src=x" in page


def test_laps_that_were_not_recorded_are_passed_over(store, client, monkeypatch):
    first, *others = client.get("/api/v1/ghosts").json()["options"]
    recording = heats.recording

    def forgetful(reader, heat, race):
        best = best_laps(store)[0]
        if (heat, race) == (best.heat, best.race):
            raise NotFoundError("This race was not recorded.")
        return recording(reader, heat, race)

    monkeypatch.setattr(heats, "recording", forgetful)
    pair = client.get("/api/v1/ghosts").json()["pair"]
    assert first["entry"] not in [lap["entry"] for lap in pair]
    assert len(pair) in (0, 2) and len(others) >= 1


def test_a_league_without_laps_says_so(tmp_path):
    with (
        new_league(f"sqlite:///{tmp_path / 'league.db'}", anchors=(), rules=RULES) as store,
        TestClient(make_app(store), base_url=ORIGIN) as client,
    ):
        assert "no two drivers" in client.get("/ghosts").text
