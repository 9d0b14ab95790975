"""Boxes and bot cars: where they stand and how they drive."""

import itertools

import numpy as np
import pytest

from league.sim.config import ObstacleConfig, SimConfig
from league.track.track import TrackSet
from tests.scenes import Stages, assert_same, make_ring, make_straight, start


def placed(sim, tracks=None, num_worlds=1):
    tracks = tracks or TrackSet(make_ring())
    return tracks, start(tracks, sim, list(range(num_worlds)))


def avoiding(**settings) -> SimConfig:
    return SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(**settings))


def drive(tracks, sim, world, steps):
    """Return the obstacles at first and after each step, (steps + 1, num_worlds, count)."""
    stages, seen = Stages(tracks, sim), [world.obstacles]
    for _ in range(steps):
        _, world = stages.aim(world)
        seen.append(world.obstacles)
    return np.stack(seen)


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize("clockwise", [False, True])
def test_fixed_obstacles_are_evenly_spaced_with_lanes_from_the_inner_one(num_worlds, clockwise):
    # The first 2 m from the start, the last 1 m before it: 2, 5, 8, 11 on a lap of 12 m.
    tracks = TrackSet(make_ring(clockwise=clockwise))
    _, world = placed(avoiding(count=4, random_places=False), tracks, num_worlds)
    assert world.obstacles["s"][-1].tolist() == pytest.approx([2, 5, 8, 11], abs=1e-4)
    inner = -0.2 if clockwise else 0.2
    lateral = world.obstacles["lateral"][-1].tolist()
    assert lateral == pytest.approx([inner, -inner, inner, -inner], abs=1e-3)


def test_obstacles_stand_at_the_places_that_are_given():
    _, world = placed(avoiding(count=2, places=((0.25, 1.0), (0.5, -0.5))))
    assert world.obstacles["s"][0].tolist() == pytest.approx([3.0, 6.0], abs=1e-4)
    assert world.obstacles["lateral"][0].tolist() == pytest.approx([0.2, -0.1], abs=1e-3)


def test_box_stands_on_its_place_along_the_track():
    _, world = placed(avoiding(count=1, places=((0.25, 1.0),)))
    box = world.obstacles[0, 0]
    # A quarter round the ring of radius 1.91 m: heading +y, the lane 0.2 m nearer to the middle.
    assert box["x"] == pytest.approx(1.9099 - 0.2, abs=1e-3)
    assert box["y"] == pytest.approx(1.9099, abs=1e-3)
    assert box["yaw"] == pytest.approx(np.pi / 2, abs=1e-3)
    assert (box["half_length"], box["half_width"]) == pytest.approx((0.2, 0.15))


@pytest.mark.parametrize("count", [1, 2, 4])
def test_random_obstacles_keep_their_distance_from_each_other_and_the_start(count):
    # Up to four have room for 2 m each on 12 m.
    _, world = placed(avoiding(count=count), num_worlds=500)
    s = world.obstacles["s"]
    assert s.min() >= min(2.0, 12 / (count + 1)) - 1e-4
    assert s.max() <= 11.0001
    if count > 1:
        assert (s[:, 1:] - s[:, :-1]).min() >= 2.0 - 1e-4
    assert len(np.unique(s[:, 0])) > 400
    assert 0.4 < (world.obstacles["lateral"] > 0).mean() < 0.6


def test_crowd_of_obstacles_still_stands_apart():
    _, world = placed(avoiding(count=32), num_worlds=20)
    assert np.diff(world.obstacles["s"], axis=1).min() > 0.3


def test_races_without_obstacles_have_none():
    _, world = placed(SimConfig(), num_worlds=3)
    assert world.obstacles.shape == (3, 0)


def test_boxes_never_move():
    tracks, world = placed(avoiding(count=3))
    for seen in drive(tracks, avoiding(count=3), world, 3):
        assert_same(seen, world.obstacles)


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_bots_drive_at_their_speed_along_their_lane(num_worlds):
    sim = avoiding(count=2, kind="bot", speed=0.75, lane_change=False)
    tracks, world = placed(sim, num_worlds=num_worlds)
    first, *_, last = drive(tracks, sim, world, 30)
    assert np.allclose(last["s"] - first["s"], 1.5, atol=1e-4, rtol=0)
    assert np.allclose(last["lateral"], first["lateral"], atol=1e-5, rtol=0)
    place = tracks.project(world.track, last["x"], last["y"])
    assert np.allclose(place.lateral, last["lateral"], atol=1e-3, rtol=0)
    # Inner lane: shorter by the ring's radius less the lane, 1.71 or 2.11 to 1.91 m.
    speed = np.hypot(last["velocity_x"], last["velocity_y"])
    wanted = 0.75 * (1.9099 - last["lateral"]) / 1.9099
    assert np.allclose(speed, wanted, atol=2e-3, rtol=0)


@pytest.mark.parametrize("speed", [0.0, 0.2, 0.5, 2.0])
def test_bots_change_lanes_now_and_then_without_a_jump(speed):
    sim = avoiding(count=3, kind="bot", speed=speed)
    tracks, world = placed(sim, num_worlds=3)
    lateral = drive(tracks, sim, world, 300)["lateral"]  # 20 s
    # Across 0.4 m on 1 m: the steepest part of the cubic climbs 0.6 m for each metre.
    assert abs(np.diff(lateral, axis=0)).max() <= 0.6 * speed / 15 + 1e-4
    sides = np.sign(lateral)
    changes = (sides[1:] != sides[:-1]).sum(axis=0)
    if speed >= 0.5:  # every 3 to 5 s
        assert 3 <= changes.min() <= changes.max() <= 6
    assert abs(lateral).max() == pytest.approx(0.2, abs=2e-3)


def test_velocity_of_a_bot_leads_to_where_it_arrives():
    sim = avoiding(count=3, kind="bot")
    tracks, world = placed(sim)
    for _ in range(60):
        moving, world = Stages(tracks, sim).aim(world)
        now, arrived = moving.obstacles, world.obstacles
        assert np.allclose(now["x"] + now["velocity_x"] / 15, arrived["x"], atol=1e-5, rtol=0)
        assert np.allclose(now["y"] + now["velocity_y"] / 15, arrived["y"], atol=1e-5, rtol=0)
        assert now["velocity_x"].any()


def test_stopped_bot_stands_for_exactly_two_seconds():
    sim = avoiding(count=1, kind="bot")
    tracks, world = placed(sim)
    world.obstacles["stopped_s"] = 2.0
    s = drive(tracks, sim, world, 32)["s"][:, 0, 0]
    moved = [bool(after > before) for before, after in itertools.pairwise(s)]
    assert moved == [False] * 30 + [True] * 2


def test_bots_drive_past_the_start_line_and_on():
    sim = avoiding(count=1, kind="bot", speed=2.0, places=((0.95, 0.5),))
    tracks, world = placed(sim)
    last = drive(tracks, sim, world, 15)[-1]
    assert last["s"].item() == pytest.approx(13.4, abs=1e-3)
    place = tracks.project(world.track, last["x"], last["y"])
    assert place.s.item() == pytest.approx(1.4, abs=1e-2)


def test_obstacles_of_an_open_track_stand_on_it():
    _, world = placed(avoiding(count=6), TrackSet(make_straight()), num_worlds=20)
    assert world.obstacles["x"].min() > 0.5
    assert world.obstacles["x"].max() <= 9.0001
