"""A pursuit: cars start spread evenly round the lap, and each drives its own laps."""

import math
from dataclasses import replace

import numpy as np
import pytest

from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.sim import referee
from league.sim.config import ObstacleConfig, RaceRules, SimConfig
from league.sim.records import World, members
from league.track.track import TrackSet
from tests.scenes import RING_LENGTH, Stages, follow_center, go_to, make_straight, start


def pursuit(num_cars: int = 2, *, boxes: int = 0, laps: int = 3, **obstacles) -> SimConfig:
    return SimConfig(
        kind="head_to_head",
        num_cars=num_cars,
        obstacles=ObstacleConfig(count=boxes, **obstacles),
        rules=RaceRules(start="pursuit", laps=laps),
    )


@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("num_cars", range(1, 9))
def test_cars_stand_evenly_round_the_lap_each_at_the_beginning_of_its_own(
    ring, clockwise, num_cars
):
    tracks = ring(clockwise=clockwise)
    sim = pursuit(num_cars) if num_cars > 1 else replace(pursuit(), kind="time_trial", num_cars=1)
    world = start(tracks, sim, [0, 1])
    cars, place = world.cars, tracks.project(world.track, world.cars["x"], world.cars["y"])
    wished = -np.arange(num_cars) * RING_LENGTH / num_cars % RING_LENGTH
    off = (place.s - wished + RING_LENGTH / 2) % RING_LENGTH - RING_LENGTH / 2
    assert np.abs(off).max() < 1e-3
    assert np.abs(place.lateral).max() < 1e-3
    for name in ("distance", "best_distance", "laps", "velocity_x", "velocity_y"):
        assert not cars[name].any()
    assert (cars["zero_s"] == cars["s"]).all()


def moved(tracks, sim, places: list[float], before: World | None = None):
    """Return verdict and world after the cars drove to these distances from the line."""
    before = start(tracks, sim, [1]) if before is None else before
    after = go_to(tracks, before, [(place, 0.2 * car) for car, place in enumerate(places)])
    return Stages(tracks, sim).judge(before, after)


def drive(tracks, sim, path: list[list[float]]):
    """Return all verdicts and the world at the end of a drive through these places."""
    world, verdicts = None, []
    for places in path:
        verdict, world = moved(tracks, sim, places, world)
        verdicts.append(verdict[0].copy())
    assert world is not None
    return np.stack(verdicts), world


def steps(one: tuple[float, float], other: tuple[float, float], number: int) -> list[list[float]]:
    return np.stack([np.linspace(*one, number), np.linspace(*other, number)], axis=1).tolist()


def test_laps_end_where_each_car_began(ring):
    # The second starts 6 m behind the line. After 12.1 m each it is at 6.1 m, the first at 12.1 m.
    verdicts, world = drive(ring(), pursuit(), steps((0.0, 12.1), (-6.0, 6.1), 60))
    assert verdicts["lap"].sum(axis=0).tolist() == [1, 1]
    assert world.cars["laps"][0].tolist() == [1, 1]
    assert world.cars["distance"][0] == pytest.approx([12.1, 12.1], abs=1e-3)
    assert world.cars["last_lap_s"][0, 0] == pytest.approx(world.cars["last_lap_s"][0, 1])


def test_who_has_driven_farther_leads_wherever_it_is_on_the_road(ring):
    tracks, sim = ring(), pursuit()
    # On the road the second stays 5.5 m behind the first, in laps it is 0.5 m ahead.
    verdicts, world = drive(tracks, sim, steps((0.0, 4.0), (-6.0, -1.5), 40))
    assert world.worlds["leader"].tolist() == [1]
    assert world.worlds["lead_changes"].tolist() == [1]
    assert not verdicts["overtook"].any()
    assert referee.running_order(world.cars, True).tolist() == [[1, 0]]
    # The lead changes when it is clear by half a car, 0.162 m, not at every millimetre.
    close = [[4.0 + 0.1 * k, -1.9 + 0.1 * k + 0.05 * (-1) ** k] for k in range(20)]
    verdicts, _ = drive(tracks, sim, steps((0.0, 4.0), (-6.0, -1.9), 40) + close)
    assert verdicts["lead_changed"].sum() == 0


def test_catching_a_car_on_the_road_is_one_pass_and_half_a_lap_apart_is_none(ring):
    tracks, sim = ring(), pursuit(laps=9)
    # The second gains 6 m and passes, then 6 m more (half a lap apart) and 6 m more: it passes
    # again.
    path = steps((0.0, 24.0), (-6.0, 24.0 + 12.5), 400)
    verdicts, world = drive(tracks, sim, path)
    passed = members(verdicts["overtook"], 2)
    assert passed[:, 1, 0].sum() == 2 and passed[:, 0, 1].sum() == 0
    assert world.cars["overtakes"][0].tolist() == [0, 2]
    first = int(np.argmax(passed[:, 1, 0]))
    lead = np.array(path)[first, 1] - np.array(path)[first, 0]
    assert 0.162 < lead < 0.162 + 0.1


def test_who_finishes_passes_nobody_by_it_and_stays_ahead(ring):
    tracks, sim = ring(), pursuit(laps=1)
    # The first finishes its lap; the second, 3 m short of its own, drives on and finishes later.
    path = steps((0.0, 12.1), (-6.0, 3.0), 60) + steps((12.1, 13.0), (3.0, 6.2), 30)
    verdicts, world = drive(tracks, sim, path)
    assert verdicts["finished"].sum(axis=0).tolist() == [1, 1]
    assert not verdicts["overtook"].any()
    assert world.worlds["leader"].tolist() == [0]
    assert referee.running_order(world.cars, True).tolist() == [[0, 1]]


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_three_drivers_finish_their_own_laps_in_the_order_of_their_speed(ring, solver):
    tracks, sim = ring(), pursuit(3, laps=2)
    env = RaceEnv(tracks, EnvConfig(sim=sim, solver=solver))
    env.reset(seed=1)
    speeds = 1.0, 2.0, 1.6
    laps = np.zeros(3)
    for _ in range(700):
        actions = [
            follow_center(seen, speed, 0.27 - 0.27 * car)
            for car, (seen, speed) in enumerate(zip(env.observations, speeds, strict=True))
        ]
        step = env.step(np.stack(actions, axis=1))
        laps += step.verdicts["lap"][0]
        if step.terminated.all() or step.truncated.any():
            break
    cars = env.world.cars[0]
    assert laps.tolist() == [2, 2, 2]
    assert np.argsort(cars["finish_s"]).tolist() == [1, 2, 0]
    # Two laps of 12 m at 1 m/s, on a circle 0.27 m smaller than the centreline.
    slow = 2 * (RING_LENGTH - 2 * math.pi * 0.27)
    assert cars["finish_s"][0] == pytest.approx(slow, abs=0.5)
    # Until it is home, after about 12 s, the second gains 10 m on the first, which began 4 m ahead,
    # and 7 m on the third, 8 m ahead. The third gains 4 m on the first, which began 8 m ahead.
    assert cars["overtakes"].tolist() == [0, 1, 0]
    env.close()


@pytest.mark.parametrize("num_cars", [2, 8])
@pytest.mark.parametrize("places", [True, False])
def test_no_obstacle_stands_on_a_start(ring, num_cars, places):
    tracks = ring()
    sim = pursuit(num_cars, boxes=4, random_places=places)
    world = start(tracks, sim, list(range(200)))
    cars, things = world.cars, world.obstacles
    apart = things["s"][:, :, None] - cars["s"][:, None, :]
    apart = np.abs((apart + RING_LENGTH / 2) % RING_LENGTH - RING_LENGTH / 2)
    assert apart.min() > min(1.0, RING_LENGTH / num_cars / 2) - 1e-3


def test_open_track_has_no_pursuit():
    with pytest.raises(ConfigError, match="straight is an open track, and the cars of a pursuit"):
        RaceEnv(TrackSet(make_straight()), EnvConfig(sim=pursuit()))
