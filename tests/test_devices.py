"""A learner on another device: its tensors never meet the CPU's, and it sees the same bits.

The worlds stay on the CPU; observations are copied, and pictures painted here. Most tests pretend
an accelerator: its tensors hold real numbers on the CPU, say that they lie elsewhere, and refuse
what a real device refuses. It cannot tell whether a real one has all operations and which bits
they give: the last tests, which are skipped without CUDA, can.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from league.envs.adapters import rsl_vec_env
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig
from league.sim.config import (
    CameraConfig,
    LidarConfig,
    SensorConfig,
    SimConfig,
)
from league.track.track import TrackSet
from league.training.ppo.statistics import EpisodeStatistics
from tests.scenes import make_ring
from tests.training import learners

RING = make_ring(points=120)
TWO = SimConfig(kind="head_to_head", num_cars=2)
CAMERA = CameraConfig(width=16, height=12, rate_hz=7.5)
SEEING = (SensorConfig(camera=CAMERA, lidar=LidarConfig(rate_hz=10.0)),)
GPU = pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA on this machine")
ELSEWHERE = "lazy"
"""A device of torch's own that CPU builds know by name, and that nothing else here uses."""
_INDEXED = (torch.ops.aten.index.Tensor, torch.ops.aten.index_put_.default)
_COLLECTED = (torch.ops.aten.stack.default, torch.ops.aten.cat.default)


class Distant(Tensor):
    """A tensor that says it lies elsewhere."""

    inside: Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, inside: Tensor) -> Distant:
        if inside.dtype == torch.float64:
            raise TypeError("this device has no float64")  # Apple's has none
        made = Tensor._make_wrapper_subclass(
            cls,
            inside.shape,
            strides=inside.stride(),
            storage_offset=inside.storage_offset(),
            dtype=inside.dtype,
            device=ELSEWHERE,
        )
        made.inside = inside
        return made

    def tolist(self) -> list:
        return self.inside.tolist()

    def __deepcopy__(self, memo: dict) -> Distant:
        return Distant(self.inside.clone())

    @classmethod
    def __torch_dispatch__(cls, function, types, args=(), kwargs=None):
        return _called(function, args, kwargs or {})


class _Pretending(TorchDispatchMode):
    """Catches what has no tensor to be caught by: zeros, arange."""

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        return _called(function, args, kwargs or {})


def _called(function, args: tuple, kwargs: dict):
    if function.overloadpacket is torch.ops.aten.to:  # inference mode leaves it whole
        with _Pretending():
            return function.decompose(*args, **kwargs)
    given = [one for one in _leaves((*args, *kwargs.values())) if isinstance(one, Tensor)]
    _check(function, args, given)
    there = any(isinstance(one, Distant) for one in given)
    if kwargs.get("device") is not None:
        there = torch.device(kwargs["device"]).type == ELSEWHERE
        kwargs = {**kwargs, "device": "cpu"}
    known = {id(_inside(one)): one for one in given}

    def unwrapped(one: object) -> object:
        if not isinstance(one, Tensor) or id(one) in known:
            return known.get(id(one), one)
        return Distant(one) if there else one

    # What inference mode makes could not be viewed outside of it.
    with torch.inference_mode(False), torch.no_grad():
        inside = {name: _mapped(_inside, one) for name, one in kwargs.items()}
        return _mapped(unwrapped, function(*_mapped(_inside, args), **inside))


def _leaves(parts: Sequence[object]) -> Iterator[object]:
    for one in parts:
        if isinstance(one, tuple | list):
            yield from one
        else:
            yield one


def _mapped(change: Callable[[object], object], one: object) -> Any:
    if isinstance(one, tuple | list):
        return type(one)(_mapped(change, part) for part in one)
    return change(one)


def _inside(one: object) -> object:
    return one.inside if isinstance(one, Distant) else one


def _check(function, args: tuple, given: Sequence[Tensor]) -> None:
    """Refuse tensors of two devices, but for what a real device takes from the CPU."""
    if function is torch.ops.aten.copy_.default:
        return
    if function in _INDEXED and isinstance(args[0], Distant):
        given = [args[0], *args[2:3]]  # an index may lie on the CPU
    # So may a single number, if it is not combined with others.
    near = [one for one in given if one.dim() or function in _COLLECTED]
    near = [one for one in near if not isinstance(one, Distant)]
    if near and any(isinstance(one, Distant) for one in given):
        raise RuntimeError(f"{function} was given tensors of two devices")


@contextmanager
def pretending() -> Iterator[None]:
    """Have the other device; outside of it no tensor can be made there."""
    before = torch._C._only_lift_cpu_tensors()
    torch._C._set_only_lift_cpu_tensors(True)  # numbers go by way of the CPU, where we see them
    try:
        with _Pretending():
            yield
    finally:
        torch._C._set_only_lift_cpu_tensors(before)


def tensors(record: object) -> Iterator[Tensor]:
    """Return all tensors of a record, in order."""
    if isinstance(record, Tensor):
        yield record
    elif isinstance(record, dict):
        yield from tensors(tuple(record.values()))
    else:
        assert isinstance(record, tuple | list)
        for one in record:
            yield from tensors(one)


def check_both(run: Callable[[str], object]) -> None:
    """Do something on the CPU and elsewhere: what it returns stays there and has equal bits."""
    with pretending():
        elsewhere = list(tensors(run(ELSEWHERE)))
    assert elsewhere and all(isinstance(one, Distant) for one in elsewhere)
    for one, other in zip(elsewhere, tensors(run("cpu")), strict=True):
        assert torch.equal(one.inside, other)


def test_a_device_refuses_tensors_of_another_one():
    with pretending():
        there, rows = torch.ones(3, device=ELSEWHERE), torch.arange(2, device=ELSEWHERE)
        for wrong in (
            lambda: there + torch.ones(3),
            lambda: torch.ones(3)[rows],
            lambda: torch.stack([there, torch.ones(3)]),
            lambda: torch.where(torch.ones(3) > 0, there, 0.0),
            lambda: there.index_select(0, torch.arange(2)),
            lambda: there.__setitem__(rows, torch.ones(2)),
        ):
            with pytest.raises(RuntimeError, match="tensors of two devices"):
                wrong()
        with pytest.raises(TypeError, match="float64"):
            there.to(torch.float64)
        with pytest.raises(RuntimeError, match="numpy"):
            there.numpy()
        assert (there + torch.tensor(1.0)).tolist() == [2.0, 2.0, 2.0]


def drive(device: str, *, steps: int = 4, as_bytes: bool = False, **settings: Any) -> list[object]:
    """Return everything that a batch on a device hands out, step by step."""
    cfg = EnvConfig(mode="training", episode_s=0.2, **settings)
    cars = tuple(range(cfg.sim.num_cars))
    env = RacingVecEnv(
        TrackSet(RING), cfg, num_worlds=2, learners=cars, as_bytes=as_bytes, device=device
    )
    seen: list[object] = [dict(env.get_observations())]
    for step in range(steps):
        actions = torch.full((env.num_envs, 2), 0.1 * step).to(device)
        observations, rewards, dones, extras = env.step(actions)
        seen += [dict(observations), rewards, dones, extras["time_outs"]]
    env.close()
    return seen


@pytest.mark.parametrize("sim", [SimConfig(), TWO])
def test_a_batch_of_another_device_hands_out_the_same_bits(sim):
    check_both(lambda device: drive(device, sim=sim, sensors=SEEING))


def test_episodes_take_rows_of_another_device():
    def run(device: str) -> tuple[float | None, float | None]:
        episodes = EpisodeStatistics(2)
        for driven in ([0.4, 0.5], [0.9, 1.1]):
            episodes.add(
                torch.ones(2, device=device),
                torch.tensor([1, 0], device=device),
                torch.tensor(driven, device=device),
            )
        return episodes.completion, episodes.earned

    with pretending():
        assert run(ELSEWHERE) == run("cpu")


@GPU
@pytest.mark.parametrize("sim", [SimConfig(), TWO])
def test_worlds_hand_the_same_bits_to_a_gpu(monkeypatch, sim):
    # What is cast there has other bits: tests/envs/test_gpu_camera.py.
    monkeypatch.setattr(rsl_vec_env, "casts_rays", lambda device: False)
    # As bytes: a GPU divides by 255 in its own way.
    given: dict[str, Any] = {"sim": sim, "sensors": SEEING, "as_bytes": True}
    there = list(tensors(drive("cuda", **given)))
    assert {one.device.type for one in there} == {"cuda"}
    for one, other in zip(there, tensors(drive("cpu", **given)), strict=True):
        assert torch.equal(one.cpu(), other)


def learnt(first: int, state: Path) -> dict[str, np.ndarray]:
    """Learn on the GPU from one update to the fourth; the state after the second is kept."""
    made = learners.learner(dataclasses.replace(learners.settings(), device="cuda"))
    if first:
        made.restore(state)
    for number in range(first, 4):
        made.update(number / 4)
        if number == 1:
            made.save(state, {})
    assert next(iter(made._learnt().values())).device.type == "cuda"
    return dict(made.weights())


@GPU
def test_a_run_on_a_gpu_can_be_repeated_and_resumed(tmp_path):
    whole, again, resumed = (learnt(first, tmp_path / "state.pt") for first in (0, 0, 2))
    assert learners.same(whole, again)
    assert learners.same(whole, resumed)


@GPU
@pytest.mark.parametrize("launcher", [(), ("-m", "torch.distributed.run", "--nproc-per-node", "1")])
def test_a_policy_trained_on_a_gpu_races_on_the_cpu(tmp_path, launcher):
    policy = tmp_path / "policy.pt"
    train = [
        *("-m", "league.cli", "train", "--device", "cuda", "--num-worlds", "16"),
        *("--steps", "4096", "--out", str(policy), "--plain", "--no-tensorboard"),
    ]
    environment = os.environ | {"PYTHONPATH": str(Path(__file__).parents[1])}
    for command in ([*launcher, *train], ["-m", "league.cli", "race", str(policy), "--laps", "1"]):
        done = subprocess.run(
            [sys.executable, *command],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stdout + done.stderr
