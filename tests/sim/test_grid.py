"""Where cars are put: the starting grid, restarts in training, what is drawn for each car."""

from dataclasses import replace

import pytest
import torch
from scenes import assert_same, make_ring, make_straight, put_cars

from league.sim import grid
from league.sim.config import CarConfig, ObstacleConfig, SimConfig, Spread
from league.sim.world import row
from league.track.course import TrackSet


def field(num_cars: int, **settings) -> SimConfig:
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    return SimConfig(kind=kind, num_cars=num_cars, **settings)


def started(tracks, sim, num_worlds=1, seeds=None):
    seeds = torch.arange(num_worlds) if seeds is None else seeds
    return grid.start(tracks, sim, seeds, torch.zeros(len(seeds), dtype=torch.int64))


@pytest.mark.parametrize("num_worlds", [1, 3])
@pytest.mark.parametrize("clockwise", [False, True])
@pytest.mark.parametrize("num_cars", range(2, 9))
def test_grid_is_staggered_by_075_m_with_odd_cars_on_the_inner_lane(
    ring, num_worlds, clockwise, num_cars
):
    tracks, sim = ring(clockwise=clockwise), field(num_cars)
    world = started(tracks, sim, num_worlds)
    place = tracks.locate(world.track, world.motion.x, world.motion.y)
    inner = -0.2 if clockwise else 0.2
    for car in range(num_cars):
        assert float(world.standing.distance[-1, car]) == pytest.approx(-0.75 * car)
        assert float(place.s[-1, car]) == pytest.approx((12 - 0.75 * car) % 12, abs=1e-3)
        side = inner if car % 2 else -inner
        assert float(place.lateral[-1, car]) == pytest.approx(side, abs=1e-3)
    along = torch.cos(world.motion.yaw) * place.cos + torch.sin(world.motion.yaw) * place.sin
    assert float(along.min()) == pytest.approx(1.0, abs=1e-5)
    # The first is ahead of all, the last of none.
    assert world.standing.ahead.sum(dim=2)[0].tolist() == list(range(num_cars - 1, -1, -1))


def test_car_alone_starts_on_the_start_line_in_the_middle(ring):
    world = started(ring(), field(1))
    assert world.standing.distance.tolist() == world.standing.lateral.tolist() == [[0.0]]
    assert world.motion.x.item() == world.motion.y.item() == 0.0
    assert world.motion.yaw.item() == pytest.approx(0.0, abs=1e-6)


def test_grid_of_an_open_track_stands_on_the_track():
    world = started(TrackSet(make_straight()), field(4))
    assert world.motion.x[0].tolist() == pytest.approx([2.45, 1.7, 0.95, 0.2], abs=1e-5)


def test_without_a_spread_every_car_is_as_set(ring):
    cars = started(ring(), field(3), num_worlds=3).cars
    settings = CarConfig()
    assert bool((cars.grip == settings.grip).all())
    assert bool((cars.mass == settings.mass).all())
    assert not bool(cars.steering_offset.any() | cars.camera_up.any() | cars.camera_pitch.any())


def test_spread_is_drawn_within_its_range_and_differs_between_cars_and_worlds(ring):
    spread = Spread(grip=0.2, mass=0.1, latency_s=0.02, steering_offset=0.03, camera_angle=0.05)
    cars = started(ring(), field(4, spread=spread), num_worlds=500).cars
    for told, low, high in (
        (cars.grip, 0.56, 0.84),
        (cars.mass, 7.38, 9.02),
        (cars.latency_s, 0.0, 0.02),
        (cars.steering_offset, -0.03, 0.03),
        (cars.camera_pitch, -0.05, 0.05),
    ):
        assert low <= float(told.min()) < low + 0.01 * (high - low)
        assert high - 0.01 * (high - low) < float(told.max()) <= high
        assert len(told.unique()) > 1900
    assert not bool(cars.camera_up.any())


def test_world_of_a_seed_is_the_same_alone_and_in_a_batch(ring):
    sim = SimConfig(kind="obstacle_avoidance", spread=Spread(grip=0.2))
    together = started(ring(), sim, seeds=torch.tensor([5, 6, 7]))
    assert_same(row(together, 1), started(ring(), sim, seeds=torch.tensor([6])))


@pytest.mark.parametrize("num_worlds", [1, 3])
def test_restart_finds_a_free_stretch_and_leaves_the_others_alone(ring, num_worlds):
    tracks, sim = ring(), field(4)
    world = put_cars(
        tracks, sim, [(1.0, 0.1), (4.0, 0.1), (7.0, 0.1), (10.0, 0.1)], num_worlds=num_worlds
    )
    who = torch.zeros_like(world.standing.ghost)
    who[0, 2] = True
    for step in range(1, 30):
        after = grid.restart(tracks, sim, replace(world, step=world.step + step), who)
        s = after.standing.s[0]
        for other in (0, 1, 3):
            gap = abs(float(s[2] - s[other]))
            assert min(gap, 12 - gap) >= 0.8
        assert float(after.standing.distance[0, 2]) == 0.0
        assert float(after.standing.zero_s[0, 2]) == float(s[2])
        others = ~who
        for name in ("x", "y", "yaw", "velocity_x"):
            mine, old = getattr(after.motion, name), getattr(world.motion, name)
            assert torch.equal(mine[others], old[others])
        assert float(after.motion.velocity_x[0, 2]) == 0.0


def test_cars_that_restart_together_keep_clear_of_each_other(ring):
    tracks, sim = ring(), field(6)
    world = started(tracks, sim, num_worlds=300)
    world = grid.restart(tracks, sim, world, torch.ones_like(world.standing.ghost))
    gap = (world.standing.s.unsqueeze(2) - world.standing.s.unsqueeze(1)).abs()
    gap = torch.minimum(gap, 12 - gap) + 100 * torch.eye(6)
    # Six cars on 12 m: not all of eight draws find 0.8 m, but nobody starts inside another.
    assert float(gap.min()) > 0.2
    assert float((gap.amin(dim=(1, 2)) >= 0.8).float().mean()) > 0.7


def test_restart_tells_anew_who_is_ahead_on_the_road(ring):
    tracks, sim = ring(), field(2)
    world = started(tracks, sim, num_worlds=50)
    world = grid.restart(tracks, sim, world, torch.ones_like(world.standing.ghost))
    gap = torch.remainder(world.standing.s[:, 0] - world.standing.s[:, 1] + 6, 12) - 6
    assert torch.equal(world.standing.ahead[:, 0, 1], gap > 0)
    assert torch.equal(world.standing.ahead[:, 1, 0], gap < 0)


def test_each_episode_of_a_car_alone_has_obstacles_of_its_own(ring):
    tracks, sim = ring(), SimConfig(kind="obstacle_avoidance", obstacles=ObstacleConfig(count=3))
    world = started(tracks, sim, num_worlds=2)
    world = replace(world, step=world.step + 100)
    who = torch.tensor([[True], [False]])
    after = grid.restart(tracks, sim, world, who)
    assert not torch.equal(after.obstacles.s[0], world.obstacles.s[0])
    assert torch.equal(after.obstacles.s[1], world.obstacles.s[1])
    gap = (after.standing.s[0] - after.obstacles.s[0]).abs()
    assert float(torch.minimum(gap, 12 - gap).min()) >= 0.8


def test_fixed_obstacles_stay_in_place_from_episode_to_episode(ring):
    things = ObstacleConfig(count=3, random_places=False)
    tracks, sim = ring(), SimConfig(kind="obstacle_avoidance", obstacles=things)
    world = replace(started(tracks, sim), step=torch.tensor([50]))
    after = grid.restart(tracks, sim, world, torch.tensor([[True]]))
    assert_same(after.obstacles, world.obstacles)


def test_restart_of_one_world_does_not_depend_on_its_batch():
    tracks, sim = TrackSet(make_ring()), field(3, spread=Spread(grip=0.3))
    together = started(tracks, sim, seeds=torch.tensor([5, 6, 7]))
    who = torch.tensor([[True, True, False], [True, False, True], [False, False, False]])
    alone = started(tracks, sim, seeds=torch.tensor([6]))
    assert_same(
        row(grid.restart(tracks, sim, together, who), 1), grid.restart(tracks, sim, alone, who[1:2])
    )
