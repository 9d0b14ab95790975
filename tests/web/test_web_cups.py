"""The bracket of a cup: which heats stand side by side, and what is to come."""

from __future__ import annotations

import re
from itertools import pairwise

from starlette.testclient import TestClient

from league.matchmaking import cups
from league.web.app import make_app
from tests.matchmaking import leagues
from tests.matchmaking.cup_races import race_on
from tests.web.small_league import ORIGIN


def test_two_neighbours_of_a_round_meet_in_the_heat_between_them(tmp_path):
    with leagues.rated(f"sqlite:///{tmp_path / 'league.db'}", entries=18) as store:
        cups.start(store, "Cup")
        race_on(store)
        with TestClient(make_app(store), base_url=ORIGIN) as client:
            rounds = client.get("/api/v1/cups/1").json()["rounds"]
    assert [len(one["heats"]) for one in rounds] == [4, 2, 1]
    for before, after in pairwise(rounds):
        for index, heat in enumerate(after["heats"]):
            fed = before["heats"][2 * index : 2 * index + 2]
            assert heat["feeds"] == [one["number"] for one in fed]
            through = {run["entry"] for one in fed for run in one["runs"] if run["advances"]}
            assert {run["entry"] for run in heat["runs"]} == through


def test_a_cup_that_is_raced_shows_the_rounds_to_come(tmp_path):
    with leagues.rated(f"sqlite:///{tmp_path / 'league.db'}", entries=18) as store:
        cups.start(store, "Cup")
        with TestClient(make_app(store), base_url=ORIGIN) as client:
            assert "Bracket" not in client.get("/cups/1").text  # the qualifying decides it
            race_on(store, most=18)
            cups.advance(store)
            race_on(store, most=1)
            page, document = client.get("/cups/1").text, client.get("/api/v1/cups/1").json()
    names = [one["name"] for one in document["rounds"]]
    assert names == ["Quarter-finals", "Semi-finals", "Final"]
    quarter, semi, final = (one["heats"] for one in document["rounds"])
    assert [bool(run["advances"]) for run in quarter[0]["runs"]] == [True, True, False, False]
    assert [heat["state"] for heat in quarter] == ["done", "planned", "planned", "planned"]
    assert semi[0]["feeds"] == [quarter[0]["number"], quarter[1]["number"]]
    assert final[0]["feeds"] == [None, None] and final[0]["runs"] == []
    fed = " and ".join(str(heat["number"]) for heat in quarter[2:])
    assert f"The first two of heats {fed}" in page and "to be raced for" in page
    assert len(re.findall("advances to the semi-finals", page)) == 2
