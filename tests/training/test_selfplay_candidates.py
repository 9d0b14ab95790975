"""Candidates for the pool: who enters, and what is kept of those who do not."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from small_play import CAR, RING, SHORT, blind, learnt, playing, saved

from league.agents.policy import Policy
from league.errors import PolicyError
from league.training.selfplay import matches

NEVER = replace(SHORT, admission=1.01, forced_every=3)


def pool_of(folder: Path) -> dict:
    return json.loads((folder / "pool" / "pool.json").read_text())


def test_who_was_refused_is_listed_with_its_win_rates(tmp_path):
    play, learner = playing(tmp_path, blind(), cfg=NEVER)
    play.begin(learner)
    assert "/selfplay/candidate_smallest" not in play.log()
    for updates in (1, 2, 3, 4):
        learner.update(0.0)
        assert play.after_update(learner, 0.5) == (updates == 3)
        last = pool_of(tmp_path)["candidates"][-1]
        assert last["smallest"] == min(last["win_rates"].values())
        assert play.log()["/selfplay/candidate_smallest"] == last["smallest"]
        assert play.log()["/selfplay/candidate_mean"] == last["mean"]
    found = pool_of(tmp_path)
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
    first, second = pool_of(tmp_path)["candidates"]
    assert first["win_rates"] == {} and first["smallest"] is None and first["mean"] is None
    assert set(second["win_rates"]) == {"000001"}
    assert not first["forced"] and not second["forced"]


def test_candidates_are_measured_by_mirrored_races(tmp_path):
    cfg = replace(SHORT, races=4, forced_every=1)
    play, _ = learnt(tmp_path, blind(2), cfg=cfg)
    drivers = [Policy(play.snapshot(name)[1], CAR) for name in ("000001", "parent")]
    again = matches.race_pairs(RING, CAR, drivers, [(0, 1)], cfg.match, races=4, seed=1)
    (tried,) = pool_of(tmp_path)["candidates"]
    assert tried["win_rates"] == {"parent": again[0, 1][0].win_rate}


def test_a_candidate_whose_races_were_broken_off_races_again(tmp_path):
    play, learner = playing(tmp_path, blind(), cfg=replace(SHORT, forced_every=1))
    play.begin(learner)
    learner.update(0.0)
    (tmp_path / "pool" / "parent.pt").rename(tmp_path / "away.pt")
    with pytest.raises(PolicyError, match=r"parent\.pt"):
        play.after_update(learner, 0.5)
    (tmp_path / "away.pt").rename(tmp_path / "pool" / "parent.pt")
    assert play.after_update(learner, 0.5)
    assert [one["updates"] for one in pool_of(tmp_path)["candidates"]] == [1]


def test_turns_are_counted_in_candidates_however_rare_save_points_are(tmp_path):
    play, learner = playing(tmp_path, blind(), cfg=replace(NEVER, forced_every=2), save_every=2)
    play.begin(learner)
    for _ in range(8):
        learner.update(0.0)
        play.after_update(learner, 0.5)
    tried = pool_of(tmp_path)["candidates"]
    assert [(one["updates"], one["forced"]) for one in tried] == [
        *((2, False), (4, True), (6, False), (8, True))
    ]


def test_a_resumed_run_still_knows_all_candidates(tmp_path):
    play, learner = learnt(tmp_path / "run", blind(), cfg=NEVER)
    kept = saved(play, learner, tmp_path)
    again, fresh = playing(tmp_path / "copy", cfg=NEVER)
    fresh.restore(tmp_path / "state.pt")
    again.restore(kept, fresh)
    assert again.pool.candidates == play.pool.candidates and again.log() == play.log()
    fresh.update(0.0)
    again.after_update(fresh, 0.5)
    assert [one["updates"] for one in pool_of(tmp_path / "copy")["candidates"]] == [1, 2]
