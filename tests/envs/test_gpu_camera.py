"""Pictures cast on a GPU: what goes there, and what comes back; on the CPU as far as it can do it.

Only the last test has a GPU; the others run the kernels' own code as the CPU compiles it.
"""

from __future__ import annotations

from contextlib import nullcontext
from typing import Any

import cv2
import numpy as np
import pytest
import torch

from league.envs.adapters import gpu_camera, rsl_vec_env
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig
from league.sim.config import CameraConfig, ObstacleConfig, SensorConfig, SimConfig
from league.sim.config import VisualRandomization as Looks
from league.track.track import TrackSet
from tests.scenes import make_ring
from tests.sim import looking, raycast

TRACKS = TrackSet(make_ring(points=120), *looking.room(half=4.0).tracks)
LOOKS = Looks(light=0.3, colour=0.3, noise=8.0, blur=0.7)
NUM_WORLDS = 4


@pytest.fixture
def on_the_cpu(monkeypatch):
    """Cast on the CPU what a GPU would cast."""

    def launch(loop: Any, num_pixels: int, *arguments: Any) -> None:
        loop(*(one.numpy() if isinstance(one, torch.Tensor) else one for one in arguments))

    monkeypatch.setattr(rsl_vec_env, "casts_rays", lambda device: True)
    monkeypatch.setattr(gpu_camera, "_cast", raycast.cast)
    monkeypatch.setattr(gpu_camera, "_develop", raycast.develop)
    monkeypatch.setattr(gpu_camera, "_shared", torch.Tensor.numpy)
    monkeypatch.setattr(gpu_camera, "_launch", launch)
    monkeypatch.setattr(torch.cuda, "device", lambda device: nullcontext())


def drive(device: str, **settings: Any) -> np.ndarray:
    """Return the pictures of a drive, from the start over some ends of episodes."""
    camera = {name: settings.pop(name) for name in ("colour", "rate_hz") if name in settings}
    carried = SensorConfig(
        camera=CameraConfig(width=64, height=48, **camera), frames=settings.pop("frames", 1)
    )
    sim = SimConfig(kind="head_to_head", num_cars=2, obstacles=ObstacleConfig(count=2))
    cfg = EnvConfig(sim=sim, sensors=(carried,) * 2, mode="training", episode_s=0.4, **settings)
    env = RacingVecEnv(
        TRACKS, cfg, num_worlds=NUM_WORLDS, learners=(0, 1), as_bytes=True, device=device
    )
    seen = [env.get_observations()["stereo"].cpu()]
    for step in range(9):
        actions = torch.full((env.num_envs, 2), 0.1 * step).to(device)
        seen.append(env.step(actions)[0]["stereo"].cpu())
    env.close()
    return torch.stack(seen).numpy()


VARIANTS = [
    {},
    {"frames": 3},
    {"frames": 2, "rate_hz": 10.0},
    {"colour": True, "looks": LOOKS},
    {"frames": 2, "looks": LOOKS},
]


def check_close(painted: np.ndarray, cast: np.ndarray) -> None:
    """Check that pictures agree but for edges, where paint and rays differ by a pixel."""
    square = np.ones((3, 3), np.uint8)
    flat = painted.reshape(-1, 48, 64)
    spread = [cv2.dilate(one, square).astype(int) - cv2.erode(one, square) for one in flat]
    off = np.abs(painted.astype(int) - cast).reshape(flat.shape)
    assert painted.std() > 20
    assert off[np.array(spread) < 40].mean() < 1.5
    assert off.mean() < 6


@pytest.mark.parametrize("settings", VARIANTS)
def test_pictures_cast_later_are_those_cast_at_once(monkeypatch, on_the_cpu, settings):
    later = drive("cpu", **settings)
    monkeypatch.setattr(rsl_vec_env, "casts_rays", lambda device: False)
    monkeypatch.setattr("league.sim.camera.renderer.Renderer", raycast.RayRenderer)
    assert np.array_equal(later, drive("cpu", **settings))


@pytest.mark.parametrize("settings", VARIANTS)
def test_cast_pictures_are_like_painted_ones(on_the_cpu, monkeypatch, settings):
    cast = drive("cpu", **settings)
    monkeypatch.setattr(rsl_vec_env, "casts_rays", lambda device: False)
    check_close(drive("cpu", **settings), cast)


def test_pictures_are_painted_where_no_ray_can_be_cast(monkeypatch):
    assert not rsl_vec_env.casts_rays(torch.device("cpu"))
    monkeypatch.setattr(rsl_vec_env, "find_spec", lambda name: None)
    assert not rsl_vec_env.casts_rays(torch.device("cuda"))


@pytest.mark.skipif(
    not rsl_vec_env.casts_rays(torch.device("cuda" if torch.cuda.is_available() else "cpu")),
    reason="no CUDA on this machine, or no numba-cuda",
)
@pytest.mark.parametrize("settings", VARIANTS)
def test_a_gpu_casts_what_the_cpu_casts(monkeypatch, settings):
    there = drive("cuda", **settings)
    monkeypatch.setattr("league.sim.camera.renderer.Renderer", raycast.RayRenderer)
    here = drive("cpu", **settings)
    # A GPU fuses multiplications with additions: now and then a ray meets another face.
    off = np.abs(there.astype(int) - here)
    assert here.std() > 20
    assert (off > 1).mean() < 1e-3
