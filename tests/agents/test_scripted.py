"""Scripted drivers drive: laps, speed, boxes, traffic, memory and batches."""

import subprocess
import sys
from functools import lru_cache
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from league.agents import roster
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.envs.state import FIELDS, INDEX, SIZE
from league.racing_line.racing_line import lap_bound
from league.sim.config import CarConfig, ObstacleConfig, RaceRules, SimConfig
from league.track import files, importer
from league.track.track import Track, TrackSet

SHARED = Path(__file__).resolve().parents[2].parent / "shared" / "tracks"
CAR = CarConfig()


def drive(track: Track, names: list[str], sim: SimConfig, *, num_worlds: int = 1) -> np.ndarray:
    """Race drivers until all have finished or time is up; return the cars."""
    tracks = TrackSet(track)
    drivers = [roster.load(name, tracks, CAR) for name in names]
    env = RaceEnv(tracks, EnvConfig(sim=sim), num_worlds=num_worlds)
    return finish(
        env,
        lambda observations: [one.act(its) for one, its in zip(drivers, observations, strict=True)],
    )


def tour(starts: list[tuple[Track, str]], laps: int) -> np.ndarray:
    """Drive each driver alone on its track, all of them at once; return the cars."""
    tracks = TrackSet(*(track for track, _ in starts))
    drivers = [roster.load(name, TrackSet(track), CAR) for track, name in starts]
    cfg = EnvConfig(sim=SimConfig(rules=RaceRules(laps=laps)))
    env = RaceEnv(tracks, cfg, num_worlds=len(starts))

    def choose(observations):
        actions = np.zeros((len(drivers), 2), np.float32)
        for world in np.flatnonzero(np.isinf(env.world.cars["finish_s"][:, 0])):
            row = {"state": observations[0]["state"][world : world + 1]}
            actions[world] = drivers[world].act(row)[0]
        return [actions]

    return finish(env, choose)


def finish(env: RaceEnv, choose) -> np.ndarray:
    observations = env.reset(seed=3)
    farthest = env.cfg.sim.rules.laps * float(env.tracks.length.max())
    for _ in range(round(15 * (20 + farthest / 0.8))):
        step = env.step(np.stack(choose(observations), axis=1))
        observations = step.observations
        if step.terminated.all():
            break
    assert step.terminated.all(), "a car did not finish"
    return env.world.cars


def alone(track: Track, name: str, laps: int) -> np.ndarray:
    return drive(track, [name], SimConfig(rules=RaceRules(laps=laps)))


def by_world(cars: np.ndarray) -> list[int]:
    """Return the mistakes made in each world."""
    counts = [cars[name] for name in ("off_tracks", "crashes", "immobilised", "reversed")]
    return np.sum(counts, axis=(0, 2)).tolist()


def mistakes(cars: np.ndarray) -> int:
    return sum(by_world(cars))


def clumsy(starts: list[tuple[Track, str]], laps: int) -> list[str]:
    """Return who made a mistake, and on which track."""
    made = zip(starts, by_world(tour(starts, laps)), strict=True)
    return [f"{name} on {track.name}" for (track, name), count in made if count]


@lru_cache(maxsize=1)
def reinvent() -> Track:
    return files.load("reinvent_2018")


def test_racing_line_laps_within_a_tenth_of_the_bound_from_a_standing_start():
    cars = alone(reinvent(), "racing_line", laps=3)
    assert mistakes(cars) == 0
    assert cars["best_lap_s"].item() <= 1.10 * lap_bound(reinvent(), CAR)


def test_racing_line_stays_on_every_shipped_track():
    assert not clumsy([(files.load(name), "racing_line") for name in files.names()], laps=2)


def test_slower_drivers_get_round_hairpins_narrow_roads_and_clockwise_ones():
    names = ("needle_pass", "thread_lane")
    starts = product(map(files.load, names), ("centerline", "cautious", "blocker"))
    assert not clumsy(list(starts), laps=1)


@pytest.mark.skipif(not SHARED.is_dir(), reason="../shared/tracks is not here")
def test_community_tracks_are_driven_round():
    tracks = [importer.read_npy(path) for path in sorted(SHARED.glob("*.npy"))]
    assert len(tracks) == 10
    assert not clumsy(list(product(tracks, ("centerline", "racing_line"))), laps=1)


def test_drivers_have_the_pace_their_names_promise():
    cars = tour([(reinvent(), name) for name in roster.NAMES], laps=2)
    pace = dict(zip(roster.NAMES, cars["best_lap_s"][:, 0].tolist(), strict=True))
    assert pace["racing_line"] < pace["blocker"] < pace["cautious"] < pace["centerline"]


@pytest.mark.parametrize("name", ["cautious", "centerline"])
def test_boxes_are_passed_without_contact(name):
    sim = SimConfig(kind="obstacle_avoidance", rules=RaceRules(laps=1))
    assert mistakes(drive(reinvent(), [name], sim, num_worlds=16)) == 0


def test_racing_line_passes_most_fields_of_boxes():
    sim = SimConfig(
        kind="obstacle_avoidance",
        obstacles=ObstacleConfig(count=4),
        rules=RaceRules(laps=1),
    )
    cars = drive(reinvent(), ["racing_line"], sim, num_worlds=16)
    assert (cars["crashes"] > 0).sum() <= 2


def test_racing_line_overtakes_a_slower_car_without_ramming_it():
    sim = SimConfig(kind="head_to_head", num_cars=2, rules=RaceRules(laps=2))
    first, second = drive(files.load("broad_street"), ["centerline", "racing_line"], sim)[0]
    assert first["crashes"] == second["crashes"] == 0
    assert second["overtakes"] >= 1
    assert second["finish_s"] < first["finish_s"]


@pytest.mark.parametrize(("slow", "fewest"), [("centerline", 11), ("cautious", 4)])
def test_racing_line_overtakes_a_slower_car_and_seldom_rams_it(slow, fewest):
    sim = SimConfig(kind="head_to_head", num_cars=2, rules=RaceRules(laps=2))
    passed = rammed = 0
    for name in files.names():
        first, second = drive(files.load(name), [slow, "racing_line"], sim)[0]
        passed += second["overtakes"] >= 1 and second["finish_s"] < first["finish_s"]
        rammed += second["crashes"]
    assert passed >= fewest
    assert rammed <= 3


def test_six_cars_race_without_a_pile_of_crashes():
    names = ["centerline", "blocker", "cautious", "racing_line", "centerline", "racing_line"]
    sim = SimConfig(kind="head_to_head", num_cars=6, rules=RaceRules(laps=2))
    assert drive(reinvent(), names, sim)["crashes"].sum() <= 2


def states(count: int) -> np.ndarray:
    """Cars of one track in all sorts of places, with others and boxes about."""
    generator = np.random.default_rng(5)
    made = generator.random((count, len(FIELDS)), np.float32) - np.float32(0.5)
    made[:, INDEX["s"]] = generator.random(count) * reinvent().length
    made[:, INDEX["speed_ahead"]] = generator.random(count) * 4
    for field in FIELDS:
        if field.endswith("_gap"):
            made[:, INDEX[field]] *= 6
        if field.endswith("present"):
            made[:, INDEX[field]] = made[:, INDEX[field]] > 0
        if field.endswith("frozen"):
            made[:, INDEX[field]] = 0.0
    return made


@pytest.mark.parametrize("name", roster.NAMES)
def test_a_row_in_a_batch_is_driven_as_alone(name):
    tracks, batch = TrackSet(reinvent()), states(37)
    together = roster.load(name, tracks, CAR)
    actions = [together.act({"state": batch}) for _ in range(2)]
    for row in (0, 7, 36):
        single = roster.load(name, tracks, CAR)
        for action in actions:
            assert np.array_equal(single.act({"state": batch[row : row + 1]})[0], action[row])


@pytest.mark.parametrize("name", roster.NAMES)
@pytest.mark.parametrize("rows", [np.array([1, 3]), np.array([False, True, False, True, False])])
def test_after_a_reset_nothing_of_the_past_remains(name, rows):
    tracks, batch = TrackSet(reinvent()), states(5)
    driver = roster.load(name, tracks, CAR)
    fresh = driver.act({"state": batch})
    driver.act({"state": batch[::-1]})
    driver.reset(None)
    assert np.array_equal(driver.act({"state": batch}), fresh)
    driver.act({"state": batch[::-1]})
    driver.reset(rows)
    again = driver.act({"state": batch})
    assert np.array_equal(again[[1, 3]], fresh[[1, 3]])
    assert not np.array_equal(again[[0, 4]], fresh[[0, 4]])


@pytest.mark.parametrize("name", roster.NAMES)
def test_actions_are_always_in_range(name):
    actions = roster.load(name, TrackSet(reinvent()), CAR).act({"state": states(64)})
    assert actions.shape == (64, 2)
    assert actions.dtype == np.float32
    assert (np.abs(actions) <= 1).all()


def test_the_blocker_moves_in_front_of_the_car_behind():
    state = np.zeros((2, SIZE), np.float32)
    state[:, INDEX["speed_ahead"]] = 2.0
    state[:, INDEX["car_0_present"]] = 1.0
    state[:, INDEX["car_0_gap"]] = -1.0
    state[:, INDEX["car_0_speed"]] = 2.5
    state[:, INDEX["car_0_lateral"]] = [0.25, -0.25]
    blocker = roster.load("blocker", TrackSet(reinvent()), CAR)
    left, right = blocker.act({"state": state})[:, 0].tolist()
    assert left > right


@pytest.mark.parametrize("name", ["racing_line", "cautious", "centerline"])
def test_a_car_that_stands_a_penalty_is_driven_through_as_if_it_were_not_there(name):
    clear, frozen, solid = np.zeros((3, 1, SIZE), np.float32)
    for state in (clear, frozen, solid):
        state[:, INDEX["s"]], state[:, INDEX["speed_ahead"]] = 3.0, 2.0
        state[:, INDEX["left"]] = state[:, INDEX["right"]] = 0.381
    for state in (frozen, solid):
        state[:, INDEX["car_0_present"]], state[:, INDEX["car_0_gap"]] = 1.0, 0.8
    frozen[:, INDEX["car_0_frozen"]] = 1.0
    acts = [
        roster.load(name, TrackSet(reinvent()), CAR).act({"state": state})
        for state in (clear, frozen, solid)
    ]
    assert np.array_equal(acts[0], acts[1])
    assert not np.array_equal(acts[0], acts[2])


def test_a_race_of_scripted_drivers_waits_for_no_heavy_library(tmp_path):
    late = ("torch", "pybullet", "pandas", "cv2", "rerun", "matplotlib", "sqlalchemy")
    program = f"""
import sys
from league.cli import main
main("race centerline racing_line --laps 1 --solver planar --json".split())
assert not {set(late)} & set(sys.modules), {set(late)} & set(sys.modules)
"""
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
