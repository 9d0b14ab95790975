from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import cv2

EXAMPLES = Path(__file__).parents[2] / "examples"


def example(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec and spec.loader
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_pettingzoo_loop_finds_the_road_by_its_eyes(tmp_path):
    picture = tmp_path / "end.png"
    distance = example("pettingzoo_loop").main(6.0, str(picture))
    assert distance["car_0"] > 3.0  # 5 s at 0.8 m/s, less the start
    assert cv2.imread(str(picture)).shape == (360, 640, 3)


def test_the_gymnasium_loop_earns_progress():
    loop = example("gymnasium_loop")
    assert loop.one(steps=60) > 2.0  # metres in 4 s at up to 1.3 m/s
    assert -1.0 < loop.many(num_envs=4, steps=10) < 0.3
