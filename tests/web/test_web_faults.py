"""The faults of each lap, as a heat's table of laps shows them."""

from __future__ import annotations

import re

import pytest

from league.race_spec import CarResult, Entry, Event, RaceResult, RaceSpec
from league.racing import race
from league.web.pages import heats
from tests.web.small_league import rated_heat

COUNTED = {"off": "off_tracks", "stuck": "immobilised", "backwards": "reversed"}


def result_with(*events: Event) -> RaceResult:
    """Return a race of two laps: car 0 finished it, car 1 is on its second lap at the end."""
    about = {
        "place": 1, "total_s": 20.0, "distance": 36.0, "off_tracks": 0, "crashes": 0,
        "contacts_taken": 0, "immobilised": 0, "reversed": 0, "penalty_s": 0.0, "overtakes": 0,
    }  # fmt: skip
    cars = (
        CarResult(car=1, name="b", finished=False, laps=1, lap_times_s=(15.0,), **about),
        CarResult(car=0, name="a", finished=True, laps=2, lap_times_s=(10.0, 10.0), **about),
    )
    spec = RaceSpec(entries=(Entry(name="a"), Entry(name="b")), laps=2)
    return RaceResult(
        spec=spec, order=cars, steps=300, race_s=20.0, lead_changes=0, events=tuple(events)
    )


def test_a_fault_belongs_to_the_lap_that_its_car_was_on():
    first, second = heats.faults_by_lap(
        result_with(
            Event(time_s=3.0, kind="off_track", car=0, value=2.0),
            Event(time_s=10.0, kind="lap", car=0, value=10.0),
            Event(time_s=12.0, kind="crash", car=0, other=1, value=5.0),
            Event(time_s=13.0, kind="crash", car=0, other=1, value=2.5),
            Event(time_s=14.0, kind="touch", car=0, other=1, value=0.4),
            Event(time_s=15.0, kind="lap", car=1, value=15.0),
            Event(time_s=16.0, kind="contact", car=1),
            Event(time_s=17.0, kind="reversed", car=1, value=2.0),
            Event(time_s=20.0, kind="lap", car=0, value=10.0),
            Event(time_s=20.1, kind="touch", car=0, value=0.4),
        )
    )
    assert [(lap.counts, lap.penalty_s) for lap in first] == [
        ({"off": 1}, 2.0),
        ({"contact": 2, "light contact": 1}, 7.5),
    ]
    assert [(lap.counts, lap.penalty_s) for lap in second] == [({}, 0.0), ({"backwards": 1}, 2.0)]


def test_faults_of_one_step_share_its_penalty():
    (lap, _), _ = heats.faults_by_lap(
        result_with(
            Event(time_s=3.0, kind="off_track", car=0, value=2.0),
            Event(time_s=3.0, kind="reversed", car=0, value=2.0),
            Event(time_s=3.0, kind="forced_off", car=0, other=1, value=4.0),
        )
    )
    assert lap.counts == {"off": 1, "backwards": 1, "pushed off": 1}
    assert lap.penalty_s == 4.0


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_faults_of_all_laps_are_those_of_the_classification(seed):
    entries = tuple(Entry(name=name) for name in ("blocker", "centerline", "racing_line", "racer"))
    spec = RaceSpec(
        entries=entries, kind="head_to_head", laps=2, max_time_s=40.0, solver="planar", seed=seed
    )
    result = race.run(spec, record=False).result
    assert sum(row.penalty_s for row in result.order) > 0
    for row in result.order:
        laps = heats.faults_by_lap(result)[row.car]
        assert sum(lap.penalty_s for lap in laps) == pytest.approx(row.penalty_s, abs=0.01)
        for word, name in COUNTED.items():
            assert sum(lap.counts.get(word, 0) for lap in laps) == getattr(row, name)
        contacts = sum(lap.counts.get(word, 0) for lap in laps for word in ("contact", "obstacle"))
        assert contacts == row.crashes
        assert sum(lap.counts.get("light contact", 0) for lap in laps) == row.touches


def test_a_heats_table_of_laps_shows_them(client, store):
    shown = {
        (record.number, number + 1): sum(lap["penalty_s"] for car in one for lap in car)
        for record in store.heats(("done",))
        for number, _ in enumerate(record.heat.halves)
        for one in [client.get(f"/api/v1/heats/{record.number}?race={number + 1}").json()["faults"]]
    }
    assert rated_heat(store) in {heat for heat, _ in shown}
    (heat, number), cost_s = max(shown.items(), key=lambda item: item[1])
    assert cost_s > 0
    page = client.get(f"/heats/{heat}?race={number}").text
    paid = re.findall(r'class="faults">[^<]+<b>\+([\d.]+) s</b>', page)
    assert sum(map(float, paid)) == pytest.approx(cost_s, abs=0.2)
