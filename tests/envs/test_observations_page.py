"""The page docs/observations.md says what the code does."""

from __future__ import annotations

import math
import re
from pathlib import Path

from league.envs import observations, parallel_env, state
from league.envs.adapters import spaces
from league.sim.config import CameraConfig, LidarConfig

PAGE = (Path(__file__).parents[2] / "docs" / "observations.md").read_text(encoding="utf-8")


def test_the_table_of_the_state_has_every_field_at_its_place():
    listed = {}
    for indices, names in re.findall(r"^\| ([\d, ]+) \| ((?:`\w[\w.]*`(?:, )?)+) \|", PAGE, re.M):
        for index, name in zip(indices.split(", "), names.split(", "), strict=True):
            listed[name.strip("`")] = int(index)
    assert listed == state.INDEX
    assert f"float32 ({state.SIZE},)" in PAGE
    assert f"gap of {state.ABSENT_GAP:g} m" in PAGE


def test_the_numbers_of_the_sensors_are_those_of_the_settings():
    camera, lidar = CameraConfig(), LidarConfig()
    assert f"{camera.width} x {camera.height} by default" in PAGE
    focal = camera.width / 2 / math.tan(camera.field_of_view / 2)
    assert f"{focal:.1f} pixels at a width of {camera.width}" in PAGE
    assert f"{focal * camera.baseline:.1f} pixels apart" in PAGE
    assert f"{lidar.min_range} to {lidar.max_range:g} m" in PAGE
    assert f"Noise of {lidar.noise} m" in PAGE
    assert observations.MOTION_SCALE[:2] == (4.0, 8.0)


def test_every_key_of_an_info_is_explained():
    env = parallel_env(sensors=())
    _, infos = env.reset(seed=0)
    explained = set(re.findall(r"`(\w+)`", PAGE[PAGE.index("### What `info`") :]))
    assert set(infos["car_0"]) <= explained
    assert set(spaces.FLAGS) <= explained
