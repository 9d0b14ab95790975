"""The fast pictures against the second opinion: the compiled painter and a ray for every pixel."""

import cv2
import numpy as np
import pytest

from league.sim.camera.renderer import Renderer
from league.sim.config import CameraConfig, VisualRandomization
from tests.sim.looking import random_scenes, room, settings, world
from tests.sim.raycast import RayRenderer

EDGE = 12
"""A pixel is away from edges if the values in the 3 x 3 pixels round it, in the ray's picture,
spread by less than this, in every channel."""


def both(now, tracks, looks=None, **camera) -> tuple[np.ndarray, np.ndarray]:
    parts = (tracks, settings(now.num_cars), CameraConfig(**camera), looks)
    painted = Renderer(*parts).render(now, 0)
    cast = RayRenderer(*parts).render(now, 0)
    return painted, cast


def away_from_edges(cast: np.ndarray) -> np.ndarray:
    square = np.ones((3, 3), np.uint8)
    flat = cast.reshape(-1, *cast.shape[-2:])
    spread = [cv2.dilate(image, square) - cv2.erode(image, square) for image in flat]
    return (np.stack(spread) < EDGE).reshape(cast.shape)


@pytest.mark.parametrize(
    ("size", "colour"), [((160, 120), False), ((64, 48), False), ((64, 48), True)]
)
def test_painted_and_cast_pictures_agree_on_random_scenes(size, colour):
    tracks = room(half=3.0)
    now = random_scenes(tracks, 24, seed=1)
    painted, cast = both(now, tracks, width=size[0], height=size[1], colour=colour)
    away = away_from_edges(cast)
    off = np.abs(painted.astype(int) - cast)
    assert away.mean() > 0.5
    assert off[away].mean() < 0.5  # the goal is 2
    each = [off[k][away[k]].mean() for k in range(len(off))]
    assert max(each) < 2
    assert off.mean() < 5  # edges and all


@pytest.mark.parametrize("side", [-0.22, 0.22])
@pytest.mark.parametrize("ahead", [-0.1, 0.05, 0.15, 0.25, 0.4])
@pytest.mark.parametrize("colour", [False, True])
def test_a_car_alongside_partly_behind_the_camera_is_cut_right(ahead, side, colour):
    tracks = room(half=3.0)
    now = world(tracks, [(0, 0, 0.3), (ahead, side, 0.5)], steering=0.4)
    painted, cast = both(now, tracks, colour=colour)
    away = away_from_edges(cast)
    assert np.abs(painted.astype(int) - cast)[away].mean() < 0.5


@pytest.mark.parametrize("turn", [0.0, 0.7, 1.4, 2.2])
def test_a_wall_at_arms_length_is_cut_right(turn):
    tracks = room(half=3.0)
    now = world(tracks, [(2.75, 0.5, turn)])
    painted, cast = both(now, tracks)
    away = away_from_edges(cast)
    assert np.abs(painted.astype(int) - cast)[away].mean() < 0.5


def test_cars_at_every_distance_and_heading_agree():
    tracks = room()
    cars = [[(0, 0, 0), (0.35 + 0.2 * k, 0.03 * k - 0.2, 0.55 * k)] for k in range(16)]
    now = world(tracks, cars, steering=-0.3)
    for size in ((160, 120), (64, 48)):
        painted, cast = both(now, tracks, width=size[0], height=size[1])
        off = np.abs(painted.astype(int) - cast)
        assert off[away_from_edges(cast)].mean() < 0.3
        seen = (
            np.abs(
                cast.astype(int)
                - both(world(tracks, [(0, 0, 0)]), tracks, width=size[0], height=size[1])[1]
            )
            > 8
        )
        assert seen.reshape(16, -1).sum(axis=1).min() > 8


def test_things_in_a_row_hide_one_another_alike():
    tracks = room()
    boxes = [(1.0, 0.1, 0.4, 0.15, 0.2), (1.5, -0.2, 1.0, 0.4, 0.05), (2.1, 0.3, 0.1, 0.1, 0.5)]
    cars = [(0, 0, 0), (0.7, -0.25, 1.5), (1.4, 0.35, -0.4), (1.9, -0.35, 2.0)]
    now = world(tracks, cars, boxes)
    painted, cast = both(now, tracks, width=320, height=240)
    away = away_from_edges(cast)
    assert np.abs(painted.astype(int) - cast)[away].mean() < 0.3


@pytest.mark.parametrize("colour", [False, True])
def test_pictures_of_cars_that_lean_pitch_and_rise_agree(colour):
    tracks = room(half=3.0)
    now = random_scenes(tracks, 24, seed=3)
    draw = np.random.default_rng(5)
    renderer = Renderer(tracks, settings(now.num_cars), CameraConfig(colour=colour))
    level = renderer.render(now, 0)
    now.cars["roll"] = draw.uniform(-0.5, 0.5, now.cars.shape)
    now.cars["pitch"] = draw.uniform(-0.3, 0.3, now.cars.shape)
    now.cars["z"] = draw.uniform(-0.02, 0.2, now.cars.shape)
    # One climbs, one lies on its side, one on its roof, one stands on its tail.
    now.cars["roll"][:4, 0], now.cars["pitch"][:4, 0] = (0.0, 1.5, 3.0, 0.2), (-0.4, 0.1, 0.0, -1.3)
    painted, cast = both(now, tracks, colour=colour)
    away = away_from_edges(cast)
    off = np.abs(painted.astype(int) - cast)
    each = [off[k][away[k]].mean() for k in range(len(off))]
    assert max(each) < 2
    assert off[away].mean() < 0.5
    assert np.abs(painted.astype(int) - level).mean() > 10


def test_randomised_pictures_agree_too():
    tracks = room(half=3.0)
    now = random_scenes(tracks, 6, seed=2)
    looks = VisualRandomization(light=0.3, colour=0.3, noise=8.0, blur=0.7)
    for colour in (False, True):
        painted, cast = both(now, tracks, looks, width=64, height=48, colour=colour)
        plain = both(now, tracks, width=64, height=48, colour=colour)[1]
        away = away_from_edges(plain)
        assert np.abs(painted.astype(int) - cast)[away].mean() < 1.0
        assert np.abs(cast.astype(int) - plain)[away].mean() > 4.0
