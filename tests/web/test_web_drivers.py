"""Drivers' pages: best laps with medals, neighbours, surprises, family."""

from __future__ import annotations

import pytest

from league.matchmaking import standings
from league.matchmaking.scores import HistoryPoint, race_scores
from league.matchmaking.store import LeagueEntry
from league.web import charts, snapshot
from league.web.pages import driver
from league.web.pages.laps import medal, medal_times


@pytest.mark.parametrize(
    ("lap_s", "name"),
    [
        *((10.0, "platinum"), (10.3, "platinum"), (10.31, "gold"), (11.0, "gold")),
        *((12.0, "silver"), (13.5, "bronze"), (13.51, "")),
    ],
)
def test_medals_are_shares_of_the_lap_bound(lap_s, name):
    assert medal(lap_s, 10.0) == name
    assert medal_times(10.0) == pytest.approx(
        {"platinum": 10.3, "gold": 11.0, "silver": 12.0, "bronze": 13.5}
    )


def test_no_medal_where_the_bound_is_unknown():
    assert medal(1.0, None) == "" and medal_times(None) == {}


def test_clean_laps_are_those_of_the_standings_and_lead_to_their_race(client, store):
    for row in standings.of(store).rows:
        laps = client.get(f"/api/v1/drivers/{row.number}").json()["laps"]
        assert {lap["track"]: lap["lap_s"] for lap in laps} == pytest.approx(row.clean_laps_s)
        for lap in laps:
            race = client.get(f"/api/v1/heats/{lap['heat']}?race={lap['race']}").json()
            mine = next(car["number"] for car in race["cars"] if car["entry"] == row.number)
            order = race["result"]["order"]
            times_s = next(car["lap_times_s"] for car in order if car["car"] == mine - 1)
            assert min(times_s) == pytest.approx(lap["lap_s"], abs=6e-4)
            assert lap["over_bound"] > 1


def test_neighbours_are_those_in_the_standings(client, store, monkeypatch):
    monkeypatch.setattr("league.web.pages.driver.NEIGHBOURS", 1)
    rows = standings.of(store).rows
    against = client.get(f"/api/v1/drivers/{rows[0].number}").json()["against"]
    assert [other["number"] for other, _ in against] == [rows[0].number, rows[1].number]
    assert against[0][1] is None
    against = client.get(f"/api/v1/drivers/{rows[2].number}").json()["against"]
    assert [other["number"] for other, _ in against] == [rows[1].number, rows[2].number]


def test_surprises_are_the_heats_farthest_from_what_was_expected(client, store):
    number = 3
    document = client.get(f"/api/v1/drivers/{number}").json()
    surplus, rated = {}, standings.of(store)
    for score in race_scores(rated.own_races(number), rated.tracks):
        surplus[score.heat] = surplus.get(score.heat, 0) + score.points - score.expected
    best, worst = document["best"], document["worst"]
    assert [heat["points"] - heat["expected"] for heat in best] == pytest.approx(
        [value for value in sorted(surplus.values(), reverse=True)[:5] if value > 0]
    )
    assert [heat["points"] - heat["expected"] for heat in worst] == pytest.approx(
        [value for value in sorted(surplus.values())[:5] if value < 0]
    )
    assert best or worst


def entry(number: int, digest: str, *parents: str) -> LeagueEntry:
    card = {"digest": digest, "parents": list(parents)}
    name = f"entry {number}"
    return LeagueEntry(number, digest * 64, name, "ann", "policy", False, "ranked", "", card, 0.0)


def test_a_family_has_all_its_generations():
    league = [entry(1, "a"), entry(2, "b", "a", "x"), entry(3, "c", "b")]
    (parent,) = driver.ancestors(snapshot.by_digest(league), league[2])
    assert (parent.number, parent.name) == (2, "entry 2")
    assert [(one.number, one.digest) for one in parent.parents] == [(1, "a"), (None, "x")]
    children = snapshot.by_parent([*league, entry(4, "d", "")])
    assert {digest: [one.number for one in own] for digest, own in children.items()} == {
        "a": [2],
        "x": [2],
        "b": [3],
    }


def test_a_card_that_names_its_own_descendant_ends():
    league = [entry(1, "a", "b", "a"), entry(2, "b", "a")]
    (parent,) = driver.ancestors(snapshot.by_digest(league), league[0])
    assert (parent.number, parent.parents) == (2, [])


def test_many_parents_of_many_parents_are_cut():
    names = [f"{number:x}" for number in range(200)]
    league = [entry(number + 1, name, *names) for number, name in enumerate(names)]

    def count(parents) -> int:
        return sum(1 + count(one.parents) for one in parents)

    assert count(driver.ancestors(snapshot.by_digest(league), league[0])) <= driver.MOST_ANCESTORS


def test_the_rating_of_an_anchor_has_one_number_at_its_axis():
    points = [HistoryPoint(n, n, 1000.0, 1000.0, 1000.0 + 1e-12) for n in range(1, 4)]
    chart = charts.rating_history(points)
    (tick,) = chart.y_ticks
    assert tick.label == "1000"
    assert tick.at == pytest.approx((chart.top + chart.bottom) / 2)
    assert chart.lines[0].path.split()[1].startswith(f"{tick.at:.2f}")
