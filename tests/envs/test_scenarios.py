"""Scenarios: cars begin together where they can meet, and a scenario is over for all of them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from league.envs import scenarios
from league.envs.config import EnvConfig, Scenarios
from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.sim.config import ObstacleConfig, SensorConfig, SimConfig
from league.track.track import TrackSet
from tests.scenes import make_ring, stand

RING = TrackSet(make_ring())
ROLLING = Scenarios(alone=0.0, standing=0.0, abreast=0.0)
FULL = SimConfig().car.max_speed


def make(
    how: Scenarios, num_worlds: int = 64, num_cars: int = 2, tracks: TrackSet = RING, **settings
) -> RaceEnv:
    sim = SimConfig(kind="head_to_head", num_cars=num_cars, **settings)
    cfg = EnvConfig(sim=sim, mode="training", scenarios=how, episode_s=18.0)
    return RaceEnv(tracks, cfg, num_worlds=num_worlds, seed=3)


def gaps(env: RaceEnv) -> np.ndarray:
    """Return how far each other car lies ahead of car 0 [m]."""
    s = env.world.cars["s"]
    return env.tracks.signed_gap(env.world.track, s, s[:, :1])[:, 1:]


def drive(env: RaceEnv, steering: float = 0.0, speed: float = 0.0) -> np.ndarray:
    return np.tile(np.array([steering, speed], np.float32), (env.num_worlds, env.num_cars, 1))


@pytest.mark.parametrize("num_cars", [2, 3, 5])
@pytest.mark.parametrize("kind", ["alone", "standing", "abreast", None])
def test_all_begin_on_the_road_and_touch_no_car(kind, num_cars):
    shares = {name: float(name == kind) for name in ("alone", "standing", "abreast")}
    # A roadblock 0.45 m ahead can be hit within the first decision.
    env = make(Scenarios(**shares, roadblock=0.0), num_worlds=200, num_cars=num_cars)
    # 0.7 of the half width of 0.4 m.
    assert abs(env.world.cars["lateral"]).max() <= 0.281
    step = env.step(drive(env))
    assert not step.verdicts["mistake"].any() and not step.verdicts["to_blame"].any()


def test_roadblocks_come_in_queues():
    how = replace(ROLLING, roadblock=0.5, limited=0.0, slowest_rival=0.95, fastest_rival=1.0)
    top = make(how, num_worlds=600, num_cars=4).world.cars["top_speed"] / FULL
    slow = np.where(top < 0.9, top, np.nan)
    queues = slow[np.isfinite(slow).sum(axis=1) == 3]
    # Half the worlds have one group of four, the others two pairs.
    assert len(queues) / 600 == pytest.approx(0.25, abs=0.05)
    assert (np.nanmax(queues, axis=1) / np.nanmin(queues, axis=1)).max() < 1.15 / 0.85


def test_queues_begin_up_to_four_metres_ahead():
    ahead = np.abs(gaps(make(replace(ROLLING, roadblock=1.0, attack=1.0), num_worlds=400)))
    assert ahead.min() < 0.5 and 3.9 < ahead.max() <= 4.01


def test_a_car_that_begins_behind_a_slow_one_can_still_stop():
    env = make(replace(ROLLING, roadblock=1.0, attack=1.0), num_worlds=400)
    for _ in range(12):  # 0.8 s: enough to reach the car ahead
        step = env.step(drive(env, speed=-1.0))
        assert not (step.verdicts["crashed"] & ~step.began).any()


def test_the_learner_is_the_attacker_as_often_as_it_is_asked():
    how = replace(ROLLING, attack=1.0)
    shares = [
        (make(replace(how, learner=learner), 600, 4)._encounters["attacker"] == 0).mean()
        for learner in (0.0, 0.6, 1.0)
    ]
    # One in four of the others falls to car 0 by chance.
    assert shares == pytest.approx([0.25, 0.7, 1.0], abs=0.06)


def test_a_learner_that_attacks_meets_each_other_car_as_often():
    met = make(replace(ROLLING, learner=1.0, attack=1.0), 600, 4)._encounters["target"]
    assert np.bincount(met) / 600 == pytest.approx([0, 1 / 3, 1 / 3, 1 / 3], abs=0.06)


def test_a_scenario_lasts_until_the_attacker_has_lost_all_cars():
    env = make(replace(ROLLING, attack=1.0, lost=2.0), num_worlds=64, num_cars=3)
    together = np.flatnonzero(np.abs(gaps(env)).max(axis=1) < 1.9)
    env._encounters["length"] = 1000
    cars, meeting = env.world.cars, env._encounters

    for world in together[:2]:
        attacker, target = int(meeting["attacker"][world]), int(meeting["target"][world])
        third = 3 - attacker - target
        stand(RING, cars[world, attacker], 6.0)
        stand(RING, cars[world, target], 3.0)
        stand(RING, cars[world, third], 7.0 if world == together[0] else 9.0)
    began = env.step(drive(env, speed=-1.0)).began.all(axis=1)
    assert not began[together[0]] and began[together[1]]


def test_alone_means_as_far_apart_as_the_lap_allows():
    env = make(replace(ROLLING, alone=1.0), num_cars=3)
    assert np.abs(np.abs(gaps(env)) - 4.0).max() < 1e-3  # a third of 12 m
    assert not env.step(drive(env)).attack.any()


def test_rolling_cars_drive_one_behind_the_other():
    env = make(replace(ROLLING, roadblock=0.0), num_worlds=400)
    gap = np.abs(gaps(env))
    assert 0.44 < gap.min() < 0.55 and 1.7 < gap.max() < 1.81
    frame, cars = RING.at(env.world.track, env.world.cars["s"]), env.world.cars
    along = cars["velocity_x"] * frame.cos + cars["velocity_y"] * frame.sin
    assert along.min() > 0.3
    assert (along <= cars["top_speed"] + 1e-4).all()


def test_cars_on_a_grid_creep_and_the_first_stands_on_either_side():
    cars = (env := make(replace(ROLLING, standing=1.0))).world.cars
    speed = np.hypot(cars["velocity_x"], cars["velocity_y"])
    assert speed.min() < 0.05 and 0.45 < speed.max() <= 0.5
    assert set(np.rint(np.abs(gaps(env)) * 1000).ravel().tolist()) == {750}
    left = cars["lateral"] > 0.0
    assert (left[:, 0] != left[:, 1]).all()
    ahead = np.where(gaps(env)[:, 0] < 0.0, left[:, 0], left[:, 1])
    assert 0.35 < ahead.mean() < 0.65


def test_the_fastest_car_mostly_begins_last_and_the_others_have_their_share_of_its_speed():
    how = replace(ROLLING, limited=0.0, roadblock=0.0, slowest_rival=0.6, fastest_rival=0.7)
    env = make(how, num_worlds=600)
    top = env.world.cars["top_speed"]
    fast = top.max(axis=1)
    assert (fast == FULL).all()
    share = top.min(axis=1) / fast
    assert 0.6 <= share.min() < 0.61 and 0.69 < share.max() <= 0.7
    behind = np.where(top[:, 0] == FULL, gaps(env)[:, 0], -gaps(env)[:, 0]) > 0
    assert behind.mean() == pytest.approx(0.75 + 0.25 / 2, abs=0.05)


def test_a_car_obeys_its_top_speed():
    env = make(replace(ROLLING, limited=0.0, fastest_rival=0.6, roadblock=0.0), num_worlds=32)
    top = env.world.cars["top_speed"].copy()
    for _ in range(3):
        env.step(drive(env, speed=1.0))
    assert (env.world.cars["target_speed"] <= top + 1e-6).all()
    assert (env.world.cars["target_speed"][top < FULL] == top[top < FULL]).all()


def test_some_cars_stand_as_ghosts_for_a_penalty_and_go_on():
    env = make(replace(ROLLING, penalised=0.4), num_worlds=400, num_cars=3)
    cars, now = env.world.cars, env._encounters
    stands = cars["penalty_s"] > 0.0
    attackers = np.take_along_axis(stands, now["attacker"][:, None], axis=1)
    assert not attackers.any()
    assert stands.mean() == pytest.approx(0.4 * 2 / 3, abs=0.04)
    assert (cars["ghost"] == stands).all()
    assert (np.hypot(cars["velocity_x"], cars["velocity_y"])[stands] == 0.0).all()
    longest = env.cfg.sim.rules.off_track_penalty_s
    assert longest - 0.3 < cars["penalty_s"].max() <= longest
    # Half of them stand next to the road, where the ring has its borders.
    off_road = abs(cars["lateral"]) > 0.39
    assert off_road[stands].mean() == pytest.approx(0.5, abs=0.1) and not off_road[~stands].any()
    # A car that stands is no rival to pass.
    targets = np.take_along_axis(stands, now["target"][:, None], axis=1)[:, 0]
    assert targets.any() and not now["attack"][targets].any()
    left, placed = cars["penalty_s"].copy(), off_road & stands
    ended = np.zeros(400, bool)
    for _ in range(3):
        ended |= env.step(drive(env)).began.any(axis=1)
    still = stands & (left > 0.25) & ~ended[:, None]
    assert still.any() and env.world.cars["ghost"][still].all()
    over = placed & (left < 0.15) & ~ended[:, None]
    assert over.any() and (abs(env.world.cars["lateral"][over]) < 0.25).all()
    assert not env.world.cars["ghost"][over].all()


def test_a_car_remembers_nothing_from_before_its_release():
    sim = SimConfig(kind="head_to_head", num_cars=2)
    how = replace(ROLLING, penalised=1.0)
    cfg = EnvConfig(
        sim=sim, sensors=(SensorConfig(history=2),), mode="training", scenarios=how, episode_s=18.0
    )
    env = RaceEnv(RING, cfg, num_worlds=100, seed=3)
    released = 0
    for _ in range(20):
        step = env.step(np.full((100, 2, 2), 0.5, np.float32))
        fresh = step.verdicts["released"] & ~step.began
        for car in range(2):
            rows = np.flatnonzero(fresh[:, car])
            memory = env.observations[car]["history"][rows].reshape(-1, 2, 5)
            assert (memory == env.observations[car]["motion"][rows][:, None]).all()
            released += len(rows)
    assert released > 5


def test_who_leaves_the_road_ends_the_episodes_of_all():
    env = make(ROLLING, num_worlds=32)
    actions = drive(env, speed=0.0)
    actions[:, 0, 0] = 1.0  # off to the left
    ended = np.zeros(32, np.bool_)
    for _ in range(40):
        step = env.step(actions)
        assert (step.began[:, 0] == step.began[:, 1]).all()
        off = step.verdicts["off_track"]
        assert step.began[off.any(axis=1)].all()
        assert (step.terminated[off]).all()
        assert not (step.terminated & step.truncated).any()
        ended |= off[:, 0] & step.truncated[:, 1]
    assert ended.mean() > 0.9


def test_a_contact_of_cars_ends_nothing():
    env = make(replace(ROLLING, limited=0.0, roadblock=1.0), num_worlds=32)
    touched = 0
    for _ in range(12):
        step = env.step(drive(env, speed=1.0, steering=0.28))
        hit = step.verdicts["crashed"].any(axis=1) & ~step.verdicts["off_track"].any(axis=1)
        touched += int(hit.sum())
        lost = step.verdicts["mistake"] & ~step.verdicts["crashed"]
        assert not step.began[hit & ~lost.any(axis=1)].any()
    assert touched


def attack(env: RaceEnv, ahead_m: float, *, hit: bool = False, off: bool = False) -> np.ndarray:
    """Put the attacker of each world ahead or behind, end the scenario, and return its result."""
    worlds, cars, meeting = env.world.worlds, env.world.cars, env._encounters
    meeting["length"] = meeting["steps"] + 1
    meeting["dirty"] = hit
    row = np.arange(env.num_worlds)
    target = cars[row, meeting["target"]]
    for name in ("x", "y", "yaw", "velocity_x", "velocity_y", "s", "lateral"):
        cars[name][row, meeting["attacker"]] = target[name]
    moved = RING.at(worlds["track"], target["s"] + np.float32(ahead_m))
    attacker = row, meeting["attacker"]
    cars["x"][attacker], cars["y"][attacker] = moved.x, moved.y
    cars["s"][attacker] = moved.s
    cars["yaw"][attacker] = np.arctan2(moved.sin, moved.cos)
    if off:
        # The target leaves the road by itself.
        frame, loser = RING.at(worlds["track"], target["s"]), (row, meeting["target"])
        cars["x"][loser] = frame.x + np.float32(0.8) * frame.sin
        cars["y"][loser] = frame.y - np.float32(0.8) * frame.cos
    first = meeting["attacker"].copy()
    return env.step(drive(env, speed=-1.0)).attack[row, first]


def test_attacks_are_judged_when_the_scenario_ends():
    how = replace(ROLLING, attack=1.0, roadblock=0.0)

    def results(*args, **given) -> set[int]:
        return set(attack(make(how, num_worlds=8), *args, **given).tolist())

    assert results(1.0) == {scenarios.CLEAN}
    assert results(1.0, hit=True) == {scenarios.PASSED}
    assert results(-1.0) == {scenarios.FAILED}
    assert results(-1.0, off=True) == {scenarios.NO_ATTACK}


def test_near_is_what_is_within_one_and_a_half_metres():
    env = make(replace(ROLLING, alone=1.0))
    assert not env.step(drive(env)).near.any()
    env = make(replace(ROLLING, abreast=1.0))
    assert env.step(drive(env)).near.all()


def test_many_cars_meet_in_pairs_or_all_together():
    env = make(ROLLING, num_worlds=200, num_cars=4)
    s = env.world.cars["s"]
    near = np.abs(RING.signed_gap(env.world.track, s[:, :, None], s[:, None, :])) < 2.2
    partners = near.sum(axis=(1, 2)) - 4
    assert (partners == 4).mean() == pytest.approx(0.5, abs=0.12)  # two pairs


def test_among_obstacles_cars_begin_clear_of_them():
    env = make(ROLLING, num_worlds=50, obstacles=ObstacleConfig(count=3))
    away = np.abs(
        RING.signed_gap(
            env.world.track,
            env.world.obstacles["s"][:, None, :],
            env.world.cars["s"][:, :, None],
        )
    )
    assert np.median(away.min(axis=(1, 2))) > 0.5


def test_the_same_seed_gives_the_same_scenarios_in_any_batch():
    many, one = make(ROLLING, num_worlds=5), make(ROLLING, num_worlds=1)
    seeds = np.arange(5)
    many.reset(seeds=seeds)
    one.reset(seeds=seeds[3:4])
    for _ in range(30):
        many.step(drive(many, 0.2, 0.5))
        one.step(drive(one, 0.2, 0.5))
    assert many.world.cars[3].tobytes() == one.world.cars[0].tobytes()


@pytest.mark.parametrize(
    "wrong",
    [
        {"alone": 0.6, "standing": 0.6},
        {"slowest_rival": 0.8, "fastest_rival": 0.7},
        {"lost": 0.1},
    ],
)
def test_scenarios_that_contradict_themselves_are_refused(wrong):
    with pytest.raises(ConfigError):
        Scenarios(**wrong)


def test_scenarios_are_for_training_of_several_cars():
    with pytest.raises(ConfigError, match="scenarios are set in mode 'race'"):
        EnvConfig(sim=SimConfig(kind="head_to_head", num_cars=2), scenarios=Scenarios())
    with pytest.raises(ConfigError, match="with 1 cars"):
        EnvConfig(mode="training", scenarios=Scenarios())
