"""Self-play: who is drawn, who beats whom, what is kept, and that a resumed run is the same run."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import small
import torch
from small_play import CAR, CARD, FREE, RING, SHORT, TRAIN, Constant, blind, learnt, playing, saved

from league.agents import checkpoint
from league.agents.policy import Policy
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig, OpponentPlacement
from league.envs.race_env import RaceEnv
from league.envs.state import INDEX, SIZE
from league.errors import ConfigError, PolicyError
from league.sim.config import SensorConfig, SimConfig
from league.training import run as run_room
from league.training.config import TrainConfig
from league.training.selfplay import SelfPlay, SelfPlayConfig, opponents
from league.training.selfplay.opponents import (
    DRAWN,
    LOST,
    NO_DRIVER,
    WON,
    Lineup,
    MixedDriver,
    Opponent,
    Pacer,
    WinRates,
)
from league.training.selfplay.payoff_matrix import PayoffMatrix
from league.training.selfplay.pool import Pool, spread
from league.training.selfplay.settings import PACER_SHARE, paces


def test_win_rate_begins_at_one_half_and_follows_the_results():
    win_rates = WinRates(window=400)
    assert win_rates["a"] == 0.5
    win_rates.add("a", WON)
    assert win_rates["a"] == pytest.approx(2 / 3)  # (1 + 1) / (2 + 1)
    win_rates.add("a", LOST)
    win_rates.add("a", DRAWN)
    assert win_rates["a"] == pytest.approx(2.5 / 5)
    again = WinRates(window=400)
    again.restore(json.loads(json.dumps(win_rates.state())))
    assert again.state() == win_rates.state() == {"a": "10h"}


def test_only_the_last_meetings_count():
    win_rates = WinRates(window=4)
    for result in (LOST, LOST, LOST, WON, WON, WON, WON):
        win_rates.add("a", result)
    assert win_rates.state() == {"a": "1111"}
    assert win_rates["a"] == pytest.approx(5 / 6)


def test_members_are_drawn_by_the_square_of_the_loss_rate():
    # Losses .5 and .25 squared are .25 and .0625, four to one of .45; the hardest gets .1 more.
    newest, members = opponents.shares([0.5, 0.75], newest=0.35, prioritised=0.45, hardest=0.1)
    assert newest == 0.35
    assert members == pytest.approx([0.36 + 0.1, 0.09])
    assert opponents.shares([], newest=0.35, prioritised=0.45, hardest=0.1) == (
        pytest.approx(0.9),
        [],
    )


def test_a_member_that_always_loses_is_still_met_now_and_then():
    _, members = opponents.shares([1.0, 0.0], newest=0.35, prioritised=0.45, hardest=0.1)
    assert members[0] == pytest.approx(0.45 * 0.0025 / 1.0025)


def lineup() -> Lineup:
    return Lineup(("a", "b"), (Constant(0.0, 1.0), Constant(1.0, -1.0)), (0.25, 0.75), (FREE, FREE))


def test_draws_follow_the_shares_and_the_count_alone():
    seats = [Opponent(1, SensorConfig(), 8000, 5, WinRates(10)) for _ in range(2)]
    assert (seats[0].driver_of_row == NO_DRIVER).all()
    for seat in seats:
        seat.choose_from(lineup(), 77)
    assert np.array_equal(seats[0].driver_of_row, seats[1].driver_of_row)
    assert (seats[0].driver_of_row == 1).mean() == pytest.approx(0.75, abs=0.02)
    before = seats[0].driver_of_row.copy()
    rows = np.arange(0, 8000, 2)
    seats[0].reset(rows)
    assert np.array_equal(seats[0].driver_of_row[1::2], before[1::2])
    assert not np.array_equal(seats[0].driver_of_row[::2], before[::2])
    seats[1].choose_from(lineup(), 78)
    assert not np.array_equal(seats[1].driver_of_row, before)


def test_each_row_is_driven_by_its_own_driver_and_frozen_cars_by_nobody():
    one, two = Policy(blind(1), CAR), Policy(blind(2), CAR)
    seats = MixedDriver("mix", SensorConfig(), [one, two, Constant(0.5, 0.25)])
    seats.driver_of_row = np.array([0, 1, 2, 1, 0, NO_DRIVER])
    draw = np.random.default_rng(0)
    told = {
        "state": np.zeros((6, SIZE), np.float32),
        "motion": draw.normal(size=(6, 5)).astype(np.float32),
    }
    told["state"][4, 9] = 1.0  # frozen
    asked = seats.act(told)
    assert np.array_equal(asked[0], one.act(told)[0])
    assert np.array_equal(asked[[1, 3]], two.act(told)[[1, 3]])
    assert asked[2].tolist() == [0.5, 0.25]
    assert asked[4].tolist() == asked[5].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(("learner", "other", "result"), [(1.0, 0.164, LOST), (0.164, 1.0, WON)])
def test_who_leaves_the_road_has_lost_the_meeting(learner, other, result):
    win_rates = WinRates(400)
    seat = Opponent(1, SensorConfig(), 16, 1, win_rates)
    seat.choose_from(Lineup(("it",), (Constant(other, -0.5),), (1.0,), (FREE,)), 0)
    cfg = EnvConfig(
        sim=SimConfig(kind="head_to_head", num_cars=2),
        mode="training",
        placement=OpponentPlacement(alone=0.5, standing=0.0, rolling=0.0),
    )
    env = RacingVecEnv(RING, cfg, num_worlds=16, opponents={1: seat})
    for _ in range(25):
        env.step(torch.tensor([learner, -0.5]).expand(16, 2).clone())
    # atan(0.164 / 1.91) rad of 0.5236 follow the ring; full lock leaves it.
    told = win_rates.state()["it"]
    assert len(told) >= 3
    assert told.count(result) > 0.7 * len(told)


def paced(low: float, high: float, steps: int = 60) -> tuple[Pacer, np.ndarray]:
    """Return a pacer and how far it came in each of 32 worlds [m]."""
    pacer = Pacer(RING.tracks[0], CAR, seed=1, car_index=1)
    pacer.keep_between((low, high), 7)
    env = RaceEnv(RING, EnvConfig(sim=SimConfig()), num_worlds=32, seed=3)
    told, driven = env.reset(seed=3), np.zeros(32)
    for _ in range(steps):
        taken = env.step(pacer.act(told[0])[:, None])
        assert not taken.verdicts["mistake"].any()
        told, driven = taken.observations, driven + taken.verdicts["advance"][:, 0]
    return pacer, driven


def test_a_pacer_drives_the_line_at_a_share_of_its_pace_that_is_drawn_for_each_row():
    (_, full), (pacer, slow) = paced(1.0, 1.0), paced(0.4, 0.6)
    share = slow / full
    # All start from rest, so the slow ones lose less than their share of the pace.
    assert 0.4 <= share.min() < 0.52 and 0.56 < share.max() <= 0.7
    assert np.array_equal(slow, paced(0.4, 0.6)[1])
    state = np.zeros((32, SIZE), np.float32)
    state[:, INDEX["speed_ahead"]], state[:, INDEX["curvature_0.25m"]] = 1.7, 0.5
    before = pacer.act({"state": state})[:, 1].copy()
    pacer.reset(np.arange(32) < 16)
    after = pacer.act({"state": state})[:, 1]
    assert np.array_equal(before[16:], after[16:]) and not np.array_equal(before[:16], after[:16])


def test_a_pacer_looks_at_nobody():
    state = np.zeros((4, SIZE), np.float32)
    state[:, INDEX["speed_ahead"]] = 2.0
    behind = state.copy()
    behind[:, INDEX["car_0_present"]], behind[:, INDEX["car_0_gap"]] = 1.0, 0.4
    asked = []
    for told in (state, behind):
        pacer = Pacer(RING.tracks[0], CAR, seed=1, car_index=1)
        asked.append(pacer.act({"state": told}))
    assert np.array_equal(*asked)


def members(pool: Pool, updates: list[int]) -> None:
    for number in updates:
        pool.add(blind(), number, forced=False, measured=None)


def test_the_pool_keeps_oldest_newest_and_whoever_is_not_beaten(tmp_path):
    pool = Pool(tmp_path, 4)
    members(pool, [0, 10, 20, 30, 40, 50])
    gone = pool.thin(lambda one: one.updates in (20, 30))
    assert [one.updates for one in gone] == [10, 40]
    assert [one.updates for one in pool.members] == [0, 20, 30, 50]
    # Files go at the next save point: a run that was killed before it needs them.
    assert (tmp_path / "000010.pt").exists()
    pool.sweep()
    assert not (tmp_path / "000010.pt").exists()


def test_ages_stay_spread_in_powers(tmp_path):
    pool = Pool(tmp_path, 48)
    members(pool, list(range(0, 1025, 64)))
    ages = [1024 - one.updates for one in spread(pool.members, 6)]
    assert (ages[0], ages[-1]) == (1024, 0)
    assert ages[1] <= 640 and ages[2] <= 384 and ages[-2] == 64


def test_a_resumed_pool_has_no_members_from_the_future(tmp_path):
    pool = Pool(tmp_path, 8)
    members(pool, [0, 10])
    kept = json.loads(json.dumps(pool.state()))
    members(pool, [20])
    again = Pool(tmp_path, 8)
    again.restore(kept["members"], kept["tried"])
    assert [one.name for one in again.members] == ["parent", "000010"]
    assert sorted(path.name for path in tmp_path.glob("*.pt")) == ["000010.pt", "parent.pt"]
    (tmp_path / "000010.pt").write_bytes((tmp_path / "parent.pt").read_bytes())
    changed = replace(again.members[1], digest="0" * 64)
    with pytest.raises(PolicyError, match="is not the policy it was"):
        again.load(changed)


@pytest.mark.parametrize("num_cars", [2, 3])
def test_resume_equals_a_run_that_was_never_interrupted(tmp_path, num_cars):
    play, learner = learnt(tmp_path / "run", blind(), num_cars=num_cars)
    kept = saved(play, learner, tmp_path)
    learner.update(0.0)
    play.after_update(learner, 0.5)
    again, fresh = playing(tmp_path / "copy", num_cars=num_cars)
    fresh.restore(tmp_path / "state.pt")
    again.restore(kept, fresh)
    fresh.update(0.0)
    again.after_update(fresh, 0.5)
    assert again.state() == play.state()
    there = fresh.weights()
    assert all(np.array_equal(value, there[name]) for name, value in learner.weights().items())


def test_the_best_of_a_run_is_whoever_wins_the_matrix(tmp_path, monkeypatch):
    small_pool = replace(SHORT, candidate_every=2, forced_every=1)
    monkeypatch.setattr(run_room, "SelfPlayConfig", lambda **given: replace(small_pool, **given))
    cfg = small.cfg(updates=4, train=small.train(kind="head_to_head", num_cars=2), self_play=True)

    def learnt(folder, champion) -> tuple:
        monkeypatch.setattr(PayoffMatrix, "champion", champion)
        run = small.run(folder, cfg)
        outcome = run.learn()
        assert json.loads((folder / "win_matrix.json").read_text())["champion"] == champion
        return outcome, checkpoint.load(folder / "best.pt")

    outcome, best = learnt(tmp_path / "early", "000002")
    assert best.card.results["updates"] == 2 and best.card.steps == 2 * small.SAMPLES
    assert small.equal(tmp_path / "early" / "best.pt", tmp_path / "early" / "pool" / "000002.pt")
    assert not small.equal(tmp_path / "early" / "best.pt", tmp_path / "early" / "last.pt")
    assert outcome.evaluation is not None
    assert best.card.results.items() >= outcome.evaluation.summary.items()
    _, best = learnt(tmp_path / "late", "final")
    assert best.card.results["updates"] == 4
    assert small.equal(tmp_path / "late" / "best.pt", tmp_path / "late" / "last.pt")


def test_a_parent_with_other_sensors_is_refused(tmp_path):
    cfg = replace(TRAIN, sensors=TrainConfig().sensors)
    with pytest.raises(ConfigError, match="needs other sensors than the learner"):
        SelfPlay(tmp_path, RING, cfg, CARD, parent=blind())


def test_schedules_run_through_once_for_the_warm_up_and_once_for_the_rest():
    cfg = SelfPlayConfig(warm_up=0.2)
    told = [cfg.part_done(done) for done in (0.0, 0.1, 0.2, 0.6, 1.0)]
    assert told == pytest.approx([0.0, 0.5, 0.0, 0.5, 1.0])
    assert cfg.meeting(0.1).alone == pytest.approx(1.0 - OpponentPlacement().standing)
    assert cfg.meeting(0.2) == OpponentPlacement()


def test_slow_cars_become_faster_while_they_are_beaten():
    cfg = SelfPlayConfig(warm_up=0.2)
    assert cfg.quicker(0.0, 0.9, 0.1, 0.15) == 0.0  # they wait for the warm-up
    # Of .8 of the run .1 and .2 are a half and a quarter of the way, twice as fast as time.
    assert cfg.quicker(0.0, 0.5, 0.1, 0.3) == pytest.approx(0.25)
    assert cfg.quicker(0.25, 0.9, 0.3, 0.5) == pytest.approx(0.75)
    assert cfg.quicker(0.75, 0.49, 0.5, 0.9) == 0.75
    assert cfg.quicker(0.75, 0.5, 0.5, 0.9) == 1.0
    # Given more time, a run that was through goes on at half of it, and nobody slows down.
    assert cfg.quicker(0.75, 0.9, 1.0, 0.5) == 0.75
    assert paces(0.0) == pytest.approx((0.4, 0.6))
    assert paces(0.5) == pytest.approx((0.475, 0.7))
    assert paces(1.0) == pytest.approx((0.55, 0.8))


@pytest.mark.parametrize("handicap", [True, False])
def test_who_is_slow_decides_how_slow_they_are(tmp_path, handicap):
    play, learner = playing(tmp_path, blind(1), cfg=replace(SHORT, handicap=handicap, warm_up=0.0))
    play.begin(learner)
    for result, name in ((WON, "newest"), (WON, "parent"), (LOST, "pacer")):
        for _ in range(8):
            play.win_rates.add(name, result)
    # Of those who are slow: the parent at .9 and pacers at .1, or pacers alone.
    assert play._beaten() == pytest.approx(0.5 if handicap else 0.1)
    learner.update(0.0)
    play.after_update(learner, 0.25)
    assert play.state()["quickness"] == (0.5 if handicap else 0.0)
    limits = play.drivers()[1].lineup.speed_limits
    half = tuple(4.0 * pace for pace in paces(0.5))
    assert limits[1] == pytest.approx(half if handicap else (4.0, 4.0))


@pytest.mark.parametrize("parent", [None, 1])
def test_whoever_is_missing_leaves_its_share_to_the_others(tmp_path, parent):
    play, learner = playing(tmp_path, parent and blind(parent))
    play.begin(learner)
    field = play.drivers()[1].lineup
    assert sum(field.shares) == pytest.approx(1.0)
    told = dict(zip(field.names, field.shares, strict=True))
    cfg = SHORT
    if parent is None:
        assert set(told) == {"newest", "centerline", "pacer"}
        assert told["newest"] == pytest.approx(1.0 - cfg.scripted)
    else:
        assert told["newest"] == pytest.approx(cfg.newest)
        assert told["parent"] == pytest.approx(cfg.prioritised + cfg.hardest)
    assert told["pacer"] == pytest.approx(told["centerline"] * PACER_SHARE / (1 - PACER_SHARE))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"warm_up": 1.0}, "below 1"),
        ({"races": 3}, "even number"),
    ],
)
def test_settings_that_make_no_sense_are_refused(wrong, said):
    with pytest.raises(ConfigError, match=said):
        SelfPlayConfig(**wrong)
