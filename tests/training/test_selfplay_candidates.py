"""Candidates for the pool: who enters, and what is kept of those who do not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from small_play import SHORT, blind, learnt, playing, saved

from league.training.selfplay import duels
from league.training.selfplay.duels import Score

NEVER = replace(SHORT, admission=1.01, forced_every=3)


def told(folder: Path) -> dict:
    return json.loads((folder / "pool" / "pool.json").read_text())


def test_who_was_refused_is_told_with_its_win_rates(tmp_path):
    play, learner = playing(tmp_path, blind(), cfg=NEVER)
    play.begin(learner)
    assert "/selfplay/candidate_smallest" not in play.log()
    for updates in (1, 2, 3, 4):
        learner.update(0.0)
        assert play.after_update(learner, 0.5) == (updates == 3)
        last = told(tmp_path)["candidates"][-1]
        assert last["smallest"] == min(last["win_rates"].values())
        assert play.log()["/selfplay/candidate_smallest"] == last["smallest"]
        assert play.log()["/selfplay/candidate_mean"] == last["mean"]
    found = told(tmp_path)
    assert [one["name"] for one in found["members"]] == ["parent", "000003"]
    tried = found["candidates"]
    assert [one["updates"] for one in tried] == [1, 2, 3, 4]
    assert [one["entered"] for one in tried] == [False, False, True, False]
    assert [one["forced"] for one in tried] == [False, False, True, False]
    assert [sorted(one["win_rates"]) for one in tried[:3]] == [["parent"]] * 3
    assert sorted(tried[3]["win_rates"]) == ["000003", "parent"]
    assert found["members"][1]["measured"] == tried[2]["smallest"]


def test_who_wins_enters_unforced_and_so_does_who_has_no_rival(tmp_path):
    play, learner = playing(tmp_path, cfg=replace(SHORT, admission=0.0))
    play.begin(learner)
    for _ in range(2):
        learner.update(0.0)
        assert play.after_update(learner, 0.5)
    first, second = told(tmp_path)["candidates"]
    assert first["win_rates"] == {} and first["smallest"] is None and first["mean"] is None
    assert set(second["win_rates"]) == {"000001"}
    assert not first["forced"] and not second["forced"]


@pytest.mark.parametrize(("behind", "enters"), [(-1.0, True), (-3.0, False)])
def test_who_wins_on_aggregate_enters_where_the_slot_decides_each_race(
    tmp_path, monkeypatch, behind, enters
):
    play, learner = playing(tmp_path, blind(), cfg=replace(SHORT, forced_every=100))
    play.begin(learner)
    found = Score(races=2, wins=1.0, leads_m=(2.0, behind))
    monkeypatch.setattr(duels, "meet", lambda *given, **_: {pair: (found,) for pair in given[3]})
    learner.update(0.0)
    assert play.after_update(learner, 0.5) == enters
    (last,) = told(tmp_path)["candidates"]
    assert (last["entered"], last["forced"]) == (enters, False)
    assert last["win_rates"] == {"parent": float(enters)}


def test_a_resumed_run_still_knows_all_candidates(tmp_path):
    play, learner = learnt(tmp_path / "run", blind(), cfg=NEVER)
    kept = saved(play, learner, tmp_path)
    again, fresh = playing(tmp_path / "copy", cfg=NEVER)
    fresh.restore(tmp_path / "state.pt")
    again.restore(kept, fresh)
    assert again.pool.candidates == play.pool.candidates and again.log() == play.log()
    fresh.update(0.0)
    again.after_update(fresh, 0.5)
    assert [one["updates"] for one in told(tmp_path / "copy")["candidates"]] == [1, 2]


def test_a_run_that_kept_no_candidates_goes_on(tmp_path):
    play, learner = playing(tmp_path, blind())
    play.begin(learner)
    learner.save(tmp_path / "state.pt", {})
    old = {name: value for name, value in play.state().items() if name != "tried"}
    again, fresh = playing(tmp_path)
    fresh.restore(tmp_path / "state.pt")
    again.restore(old, fresh)
    assert again.pool.candidates == [] and again.pool.members == play.pool.members
