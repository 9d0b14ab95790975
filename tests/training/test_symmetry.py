from __future__ import annotations

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from league.envs.actions import ContinuousActions, DiscreteActions, grid
from league.envs.config import EnvConfig
from league.envs.observations import MOTION_FIELDS
from league.envs.race_env import RaceEnv
from league.envs.sensor_suite import SensorSuite
from league.envs.state import FIELDS, INDEX
from league.sim.config import CameraConfig, LidarConfig, ObstacleConfig, SensorConfig, SimConfig
from league.sim.records import World
from league.track.track import Track, TrackSet
from league.training.ppo import symmetry
from tests.scenes import Stages, make_square, taken

LIDARS = {
    "ranges": LidarConfig(beams=16, noise=0.0),
    "sectors": LidarConfig(beams=16, noise=0.0, form="sectors", sectors=4),
    "discretised": LidarConfig(beams=16, noise=0.0, form="discretised", sectors=4, bins=5),
}


def seen(form: str = "ranges", *, colour: bool = False, eyes: str = "stereo") -> SensorConfig:
    camera = CameraConfig(width=64, height=48, colour=colour, eyes=eyes)  # pyright: ignore
    return SensorConfig(camera=camera, lidar=LIDARS[form])


def drawn(kind: str) -> tuple[SimConfig, World]:
    """Return worlds in the middle of driving."""
    sim = SimConfig(
        kind=kind,  # pyright: ignore
        num_cars=3 if kind == "head_to_head" else 1,
        obstacles=ObstacleConfig(count=0 if kind == "time_trial" else 5),
    )
    env = RaceEnv(TrackSet(make_square()), EnvConfig(sim=sim), num_worlds=4, seed=5)
    draw = np.random.default_rng(3)
    for _ in range(25):
        actions = draw.uniform(-1.0, 1.0, (4, sim.num_cars, 2))
        env.step(actions * [0.7, 0.3] - [0.0, 0.4])
    return sim, env.world


def in_a_mirror(world: World) -> World:
    """Return the worlds with y swapped for -y; the tracks are swapped elsewhere."""
    world = world.copy()
    for name in ("y", "yaw", "velocity_y", "lateral"):
        world.cars[name] *= -1
        world.obstacles[name] *= -1
    for name in ("yaw_rate", "roll", "steering", "action_steering"):
        world.cars[name] *= -1
    return world


def shown(track: Track, cfg: EnvConfig, world: World) -> list[TensorDict]:
    """Return what each car observes in these worlds."""
    tracks = TrackSet(track)
    sensing = SensorSuite(tracks, cfg)
    sensing.observe(world)
    groups = sensing.groups(world, Stages(tracks, cfg.sim).motions(world))
    return [TensorDict(one, [world.num_worlds]) for one in taken(groups)]


def observed_twice(kind: str, sensors: SensorConfig) -> list[tuple[TensorDict, TensorDict]]:
    """Return what each car observes, and what it observes in the mirrored world."""
    sim, world = drawn(kind)
    cfg, track = EnvConfig(sim=sim, sensors=(sensors,)), make_square()
    here = shown(track, cfg, world)
    return list(zip(here, shown(track.mirrored(), cfg, in_a_mirror(world)), strict=True))


@pytest.mark.parametrize("kind", ["time_trial", "obstacle_avoidance", "head_to_head"])
@pytest.mark.parametrize("form", LIDARS)
def test_numbers_observed_in_a_mirrored_world_are_the_mirror_image(kind, form):
    sensors = seen(form)
    for here, there in observed_twice(kind, sensors):
        found = symmetry.observations(here, sensors)
        for group in ("lidar", "motion", "state"):
            assert torch.allclose(found[group], there[group], atol=2e-4), group
        # The cars do not stand where left and right are the same.
        assert not torch.allclose(here["state"], there["state"], atol=0.01)


@pytest.mark.parametrize("kind", ["time_trial", "obstacle_avoidance", "head_to_head"])
@pytest.mark.parametrize(
    "sensors", [seen(), seen(colour=True), seen(eyes="mono")], ids=["gray", "colour", "mono"]
)
def test_pictures_in_a_mirrored_world_are_the_mirror_image(kind, sensors):
    for here, there in observed_twice(kind, sensors):
        found = symmetry.observations(here, sensors)["stereo"]
        # The grain of the floor and the light on walls have no mirror image; lines and cars have.
        assert differing(found, there["stereo"]) < 0.002
        assert differing(found, there["stereo"]) < 0.1 * differing(here["stereo"], there["stereo"])


def differing(one: torch.Tensor, other: torch.Tensor) -> float:
    """Return the share of pixels that differ by more than a tenth of white."""
    apart = (one.to(torch.float32) - other.to(torch.float32)).abs()
    return float((apart > 25).to(torch.float32).mean())


def test_swapping_the_eyes_is_needed():
    sensors = seen()
    for here, there in observed_twice("obstacle_avoidance", sensors):
        found = symmetry.observations(here, sensors)["stereo"]
        eyes_left = found.flip(1)
        assert differing(eyes_left, there["stereo"]) > 10 * differing(found, there["stereo"])


@pytest.mark.parametrize("form", LIDARS)
def test_a_mirror_in_a_mirror_shows_the_original(form):
    sensors = seen(form, colour=True)
    for here, _ in observed_twice("head_to_head", sensors):
        again = symmetry.observations(symmetry.observations(here, sensors), sensors)
        for group in here.keys():  # noqa: SIM118
            assert torch.equal(again[group], here[group]), group


def test_motion_keeps_its_speeds_and_turns_its_steering():
    assert MOTION_FIELDS == ("speed", "yaw_rate", "steering", "last_steering", "last_speed")
    motion = torch.tensor([[0.5, 0.25, -0.125, 0.75, -1.0]])
    assert symmetry.numbers(motion, MOTION_FIELDS).tolist() == [[0.5, -0.25, 0.125, -0.75, -1.0]]


def test_state_swaps_the_borders():
    truth = torch.zeros(1, len(INDEX))
    truth[0, INDEX["left"]], truth[0, INDEX["right"]] = 0.3, 0.5
    truth[0, INDEX["car_0_gap"]], truth[0, INDEX["car_0_lateral"]] = 2.0, 0.25
    found = symmetry.numbers(truth, FIELDS)[0]
    assert float(found[INDEX["left"]]) == 0.5
    assert float(found[INDEX["right"]]) == pytest.approx(0.3)
    assert float(found[INDEX["car_0_gap"]]) == 2.0
    assert float(found[INDEX["car_0_lateral"]]) == -0.25


def test_a_picture_is_flipped_and_its_eyes_swapped():
    pictures = torch.tensor([[[[1, 2, 3]], [[4, 5, 6]]]], dtype=torch.uint8)  # (1, 2, 1, 3)
    assert symmetry.stereo(pictures, 2).tolist() == [[[[6, 5, 4]], [[3, 2, 1]]]]
    # One eye in colour: the colours stay where they are.
    assert symmetry.stereo(pictures, 1).tolist() == [[[[3, 2, 1]], [[6, 5, 4]]]]


def test_only_cars_with_a_mirror_image_learn_from_it():
    both, one = seen(), seen(eyes="left")
    assert symmetry.applies(both, ContinuousActions())
    assert not symmetry.applies(one, ContinuousActions())
    assert not symmetry.applies(both, ContinuousActions(steering_low=-20.0, steering_high=30.0))
    assert symmetry.applies(both, grid(3, 30.0, 2, 2.0))
    assert not symmetry.applies(both, DiscreteActions(((30.0, 1.0), (0.0, 1.0))))


def test_a_choice_that_stands_there_twice_has_an_image_each_time():
    left, ahead, right = (30.0, 1.0), (0.0, 1.0), (-30.0, 1.0)
    space = DiscreteActions((left, ahead, ahead, right))
    scores = torch.tensor([[1.0, 2.0, 3.0, 4.0]])
    assert space.is_mirrored
    assert space.mirror(scores).tolist() == [[4.0, 2.0, 3.0, 1.0]]
    assert not DiscreteActions((left, left, ahead, right)).is_mirrored


def test_every_decision_is_learnt_from_both_ways_round():
    parts = 4
    mirroring = symmetry.Symmetry(SensorConfig(), ContinuousActions(), parts)
    turned = torch.zeros(2, parts, dtype=torch.bool)
    mirroring.restart()
    for epoch in range(2):
        for part in range(parts):
            batch = Batch()
            mirroring.augment_batch(batch, 1)  # pyright: ignore
            turned[epoch, part] = float(batch.actions[0, 0]) < 0
    assert torch.equal(turned[0], ~turned[1])
    assert int(turned[0].sum()) == 2


def test_a_mirrored_decision_was_as_likely_as_the_one_it_was():
    batch = Batch()
    mirroring = symmetry.Symmetry(SensorConfig(), ContinuousActions(), 1)
    mirroring.augment_batch(batch, 1)  # pyright: ignore
    before = Batch()
    mirroring.augment_batch(batch, 1)  # pyright: ignore
    mean, deviation = batch.old_distribution_params
    assert mean.tolist() == [[-0.25, 0.5]]
    assert torch.equal(deviation, before.old_distribution_params[1])
    now = torch.distributions.Normal(mean, deviation).log_prob(batch.actions).sum()
    then = torch.distributions.Normal(*before.old_distribution_params).log_prob(before.actions)
    assert float(now) == float(then.sum())


class Batch:
    """What rsl-rl hands over, as far as mirroring touches it."""

    def __init__(self) -> None:
        motion = torch.tensor([[0.5, 0.25, -0.125, 0.75, -1.0]])
        self.observations = TensorDict({"motion": motion}, [1])
        self.actions = torch.tensor([[0.5, 0.25]])
        self.old_distribution_params = (torch.tensor([[0.25, 0.5]]), torch.tensor([[0.3, 0.3]]))
