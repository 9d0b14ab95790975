"""Random light, colours, noise and blur: off is exactly off, and a world's look is its own."""

import numpy as np
import pytest

from league.errors import ConfigError
from league.sim.camera.renderer import Renderer
from league.sim.config import CameraConfig, VisualRandomization
from tests.sim.looking import random_scenes, room, settings, world
from tests.sim.raycast import RayRenderer

RENDERERS = [Renderer, RayRenderer]
SMALL = CameraConfig(width=64, height=48)
ALL = VisualRandomization(light=0.3, colour=0.3, noise=8.0, blur=0.7)


def look_at(renderer, now, looks, tracks=None) -> np.ndarray:
    return renderer(tracks or room(half=3.0), settings(now.num_cars), SMALL, looks).render(now, 0)


def later_on(now, steps: int):
    later = now.copy()
    later.worlds["step"] += steps
    return later


@pytest.mark.parametrize("renderer", RENDERERS)
def test_looks_of_zero_change_nothing(renderer):
    now = random_scenes(room(half=3.0), 3)
    assert np.array_equal(
        look_at(renderer, now, VisualRandomization()), look_at(renderer, now, None)
    )


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_randomised_world_looks_the_same_alone_and_in_a_batch(renderer):
    now = random_scenes(room(half=3.0), 3)
    together = look_at(renderer, now, ALL)
    for index in range(3):
        assert np.array_equal(look_at(renderer, now.row(index), ALL)[0], together[index])


@pytest.mark.parametrize("renderer", RENDERERS)
def test_worlds_with_other_seeds_look_different(renderer):
    same = world(room(half=3.0), [[(0, 0, 0)], [(0, 0, 0)]])  # seeds 1 and 2
    first, second = look_at(renderer, same, VisualRandomization(light=0.5)).astype(float)
    assert np.abs(first - second).mean() > 2


def test_light_is_one_gain_for_a_whole_race():
    now = world(room(half=3.0), [(0, 0, 0)])
    plain = look_at(Renderer, now, None).astype(float)
    bright = look_at(Renderer, now, VisualRandomization(light=0.3)).astype(float)
    later = look_at(Renderer, later_on(now, 9), VisualRandomization(light=0.3))
    gain = bright.sum() / plain.sum()
    assert 0.7 <= gain <= 1.3 and abs(gain - 1) > 0.01
    assert np.abs(bright - np.minimum(plain * gain, 255)).max() < 2
    assert np.array_equal(later, bright)


def test_noise_has_the_drawn_strength_and_is_new_in_every_picture():
    now = world(room(half=3.0), [[(0, 0, 0)]] * 8)
    plain = look_at(Renderer, now, None).astype(float)
    noisy = look_at(Renderer, now, VisualRandomization(noise=10.0))
    later = look_at(Renderer, later_on(now, 1), VisualRandomization(noise=10.0))
    spread = (noisy - plain).std(axis=(1, 2, 3))
    assert spread.min() > 0 and spread.max() <= 10.3 and spread.max() > 4
    assert np.abs((noisy - plain).mean()) < 0.3
    assert not np.array_equal(noisy, later)


def test_blur_smooths():
    now = world(room(half=3.0), [[(0, 0, 0)]] * 4)
    plain = look_at(Renderer, now, None).astype(float)
    soft = look_at(Renderer, now, VisualRandomization(blur=0.8)).astype(float)
    rough = np.abs(np.diff(plain, axis=3)).mean(axis=(1, 2, 3))
    smooth = np.abs(np.diff(soft, axis=3)).mean(axis=(1, 2, 3))
    assert (smooth < rough).all()
    assert np.abs(plain.mean() - soft.mean()) < 0.5


@pytest.mark.parametrize("wrong", [{"light": 1.0}, {"noise": -1.0}, {"blur": 3.0}])
def test_impossible_looks_are_refused(wrong):
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        VisualRandomization(**wrong)
