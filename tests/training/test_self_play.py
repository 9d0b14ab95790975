"""Learning to race on the true state: a curriculum of rivals, and a policy that learns from it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from league.agents import roster
from league.envs.rewards import PRESETS
from league.sim.config import CameraConfig, SensorConfig
from league.track.track import TrackSet
from league.training.config import PpoConfig, TrainConfig
from league.training.ppo import self_play
from league.training.ppo.self_play import Curriculum, Racer, RacingLearner, make_racing
from tests.scenes import make_ring
from tests.training.learners import settings

RING = TrackSet(make_ring())
SMALL = replace(
    settings(),
    kind="head_to_head",
    num_cars=2,
    num_worlds=4,
    sensors=SensorConfig(camera=CameraConfig(width=24, height=18)),
    teacher=0.5,
    reward=PRESETS["race"],
)


@pytest.fixture
def small(monkeypatch) -> TrainConfig:
    monkeypatch.setattr("league.training.config._RACING_ROWS", 8)
    on_truth = TrainConfig.on_truth

    def smaller(self):
        return replace(on_truth(self), ppo=PpoConfig(rollout=8, epochs=1, mini_batches=2))

    monkeypatch.setattr(TrainConfig, "on_truth", smaller)
    return SMALL


ROWS = 1000


def logged(attacks: float, passed: float, clean: float) -> dict[str, float]:
    return {"/race/attacks": attacks, "/race/passed": passed, "/race/clean": clean}


def run(made: Curriculum, shares: np.ndarray, clean: float) -> dict[str, float]:
    """Add updates with 50 attacks each; return the last log."""
    log: dict[str, float] = {}
    for share in shares.tolist():
        log = made.add(logged(0.05, 0.05 * max(clean, 0.9), 0.05 * clean), share)
    return log


def test_rivals_become_faster_while_attacks_succeed_and_slower_while_they_fail():
    made = Curriculum(ROWS, {})
    run(made, np.array([0.0, 0.02]), 0.9)
    assert made.pace == self_play.FIRST_PACE  # the cars still learn to drive
    run(made, np.array([0.05, 0.1]), 0.9)
    assert made.pace == pytest.approx(self_play.FIRST_PACE + (0.1 - 0.02) * self_play.PACE_STEP)
    log = run(made, np.linspace(0.1, 0.6, 40), 0.1)
    assert made.pace == self_play.LEAST_PACE == log["/race/pace"]
    assert log["/race/clean"] < self_play.ENOUGH - self_play.SLACK


def test_rivals_stay_as_fast_between_the_two_thresholds():
    made = Curriculum(ROWS, {})
    log = run(made, np.linspace(0.05, 0.2, 20), self_play.ENOUGH - 0.02)
    assert made.pace == self_play.FIRST_PACE
    assert log["/race/passed"] == pytest.approx(0.9)


def test_the_pace_sets_the_top_speeds_of_rivals_and_the_budget_the_price_of_hits(small):
    made = make_racing(RING, replace(small, sensors=SensorConfig(truth=True)))
    assert isinstance(made, Racer)
    worlds = made.env.race_env
    made.curriculum.pace = 0.9
    made.curriculum.prepare(worlds, 0.0)
    how = worlds.cfg.scenarios
    assert how is not None and how.fastest_rival == 0.9
    assert how.slowest_rival == pytest.approx(0.9 - self_play.RANGE)
    assert worlds.cfg.reward == PRESETS["race"]
    made.curriculum.prepare(worlds, 0.9)
    last, first = worlds.cfg.reward, PRESETS["race"]
    dear = {name: 6.0 * getattr(first, name) for name in ("crash", "closing")}
    assert last == replace(first, **dear)
    # Hitting a car to pass it does not pay in the end.
    assert last.crash + last.overtake < 0.0


def test_light_contacts_become_dearer_for_a_policy_with_its_own_sensors(small):
    made = make_racing(RING, small)
    assert isinstance(made, RacingLearner)
    first = PRESETS["race"]
    for learner, dear in ((made, 6.0), (made.teacher, 2.0)):
        assert isinstance(learner, Racer | RacingLearner)
        learner.curriculum.prepare(learner.env.race_env, 0.9)
        weights = learner.env.race_env.cfg.reward
        assert weights.touch == dear * first.touch
        assert weights.crash == 6.0 * first.crash


def test_a_curriculum_is_resumed():
    made, other = Curriculum(ROWS, {}), Curriculum(ROWS, {})
    run(made, np.linspace(0.05, 0.1, 9), 0.8)
    other.restore(made.state())
    assert other.state() == made.state()
    assert run(other, np.array([0.2]), 0.3) == run(made, np.array([0.2]), 0.3)


def test_all_cars_learn_from_the_true_state(small):
    made = make_racing(RING, replace(small, sensors=SensorConfig(truth=True)))
    assert isinstance(made, Racer)
    # A scripted driver has one of the eight cars.
    assert made.env.learners == (0, 1) and made.env.num_envs == 8 - 1
    before = made.weights()
    log = made.update(0.0).log
    assert {"/race/pace", "/race/clean", "/race/near"} <= log.keys()
    after = made.weights()
    assert any(not np.array_equal(before[name], after[name]) for name in before)


@pytest.mark.parametrize("truth", [True, False], ids=["first stage", "second stage"])
def test_scripted_drivers_have_the_last_car_of_some_worlds(small, monkeypatch, truth):
    monkeypatch.setattr("league.training.config._RACING_ROWS", 24)
    sensors = SensorConfig(truth=True) if truth else small.sensors
    made = make_racing(RING, replace(small, sensors=sensors, num_cars=3, num_worlds=8))
    worlds = made.env.race_env
    seen = {name: group.copy() for name, group in worlds.observations[2].items()}
    # They have no rows: nothing that they do is learnt or logged.
    assert made.env.num_envs == 24 - 5
    pairs = zip(made.env.row_worlds.tolist(), made.env.row_cars.tolist(), strict=True)
    assert list(pairs) == [(w, c) for w in range(8) for c in range(3) if c < 2 or w >= 5]
    steering = torch.arange(19.0) / 20.0
    made.env.step(torch.stack([steering, torch.zeros(19)], dim=1))
    names = ["racing_line"] * 2 + ["centerline", "cautious", "blocker"]
    for world, name in enumerate(names):
        expected = roster.load(name, RING, self_play.CAR).act(seen)[world]
        assert worlds.last_action[world, 2] == pytest.approx(expected, abs=1e-6), name
    driven = worlds.last_action[made.env.row_worlds, made.env.row_cars, 0]
    assert driven == pytest.approx(steering.numpy(), abs=1e-6)
    assert made.update(0.6).samples == 19 * made.cfg.ppo.rollout


def test_a_camera_driver_learns_from_the_racer_and_against_itself(small):
    made = make_racing(RING, small)
    assert isinstance(made, RacingLearner)
    assert made.env.learners == (0, 1)
    own = made.weights()
    made.update(0.0)
    assert not made.has_learnt
    assert all(np.array_equal(own[name], value) for name, value in made.weights().items())
    assert isinstance(made.teacher, Racer)
    made.teacher.curriculum.pace = 0.8
    made.update(0.5)
    assert made.has_learnt and made.at_save_point
    made.update(0.6)
    # Its rivals follow its own success, and for it contacts are cheap at first.
    worlds = made.env.race_env
    assert worlds.cfg.scenarios is not None
    assert worlds.cfg.scenarios.fastest_rival == self_play.FIRST_PACE
    assert worlds.cfg.reward.closing > 2.5 * PRESETS["race"].closing
    # Without a clean attack they become slower, from the restart of the rows on.
    made.update(0.6)
    assert made.at_save_point
    assert worlds.cfg.scenarios.fastest_rival == self_play.LEAST_PACE


def test_all_cars_learn_where_there_are_several_tracks(small):
    tracks = TrackSet(RING.tracks[0], RING.tracks[0].reversed())
    both = make_racing(tracks, replace(small, num_cars=3))
    assert both.env.num_envs == 12
    assert np.isfinite(both.update(0.6).reward)  # scripted drivers would refuse two tracks


@pytest.mark.parametrize("truth", [True, False], ids=["first stage", "second stage"])
def test_cars_learn_to_race_among_obstacles(small, truth):
    sensors = SensorConfig(truth=True) if truth else small.sensors
    made = make_racing(RING, replace(small, sensors=sensors, num_cars=3, obstacles=4))
    worlds = made.env.race_env.world
    assert (worlds.num_cars, worlds.num_obstacles) == (3, 4)
    assert np.isfinite(made.update(0.6).reward)
