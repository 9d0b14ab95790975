"""Worlds on another device: its tensors never meet the CPU's, and races go as they do there.

There need be no accelerator for it: one is pretended. Its tensors hold real numbers on the CPU, say
that they lie elsewhere, and refuse what a real device refuses. It cannot tell whether a real one
has all operations and which bits they give.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from typing import Any

import actor
import numpy as np
import pytest
import torch
from league.sim.meeting_config import Meeting
from recorded import finish, spec
from scenes import follow_center, make_ring, make_straight, put_cars
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

from league.agents import roster
from league.agents.card import Card
from league.agents.checkpoint import Checkpoint
from league.agents.driver import Driver
from league.agents.network import NetworkConfig
from league.agents.policy import Policy
from league.envs.config import EnvConfig
from league.envs.opponents import Opponents
from league.envs.race_env import RaceEnv, Step
from league.envs.state import SIZE
from league.replay import Recorder, Replay
from league.sim.config import CameraConfig, CarConfig, LidarConfig, SensorConfig, SimConfig
from league.sim.planar import PlanarSolver
from league.sim.vehicle import forces
from league.sim.world import CarParameters, Motion, World
from league.track import files
from league.track.course import TrackSet
from league.training.episodes import Episodes
from league.training.selfplay import duels
from league.training.selfplay.opponent import Field, Opponent
from league.training.selfplay.pacer import Pacer
from league.training.selfplay.records import Records
from league.training.selfplay.settings import DuelConfig

CAR, RING = CarConfig(), make_ring(points=120)
TWO = SimConfig(kind="head_to_head", num_cars=2)
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

    def told(one: object) -> object:
        if not isinstance(one, Tensor) or id(one) in known:
            return known.get(id(one), one)
        return Distant(one) if there else one

    # What inference mode makes could not be viewed outside of it.
    with torch.inference_mode(False), torch.no_grad():
        inside = {name: _mapped(_inside, one) for name, one in kwargs.items()}
        return _mapped(told, function(*_mapped(_inside, args), **inside))


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
    # So may a single number, if it is not to be put beside others.
    near = [one for one in given if one.dim() or function in _COLLECTED]
    near = [one for one in near if not isinstance(one, Distant)]
    if near and any(isinstance(one, Distant) for one in given):
        raise RuntimeError(f"{function} was given tensors of two devices")


@contextmanager
def pretending() -> Iterator[None]:
    """Have the other device; outside of it nobody can make a tensor there."""
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
    elif isinstance(record, tuple | list):
        for one in record:
            yield from tensors(one)
    else:
        yield from tensors([getattr(record, one.name) for one in fields(record)])  # type: ignore


def check_both(run: Callable[[str], object]) -> None:
    """Do something on the CPU and elsewhere: what it returns stays there and has equal bits."""
    with pretending():
        elsewhere = list(tensors(run(ELSEWHERE)))
    assert elsewhere and all(isinstance(one, Distant) for one in elsewhere)
    for one, other in zip(elsewhere, tensors(run("cpu")), strict=True):
        assert torch.equal(one.inside, other)


def go(record: Any, device: str) -> Any:
    """Return a record of tensors moved to a device."""
    if isinstance(record, Tensor):
        return record.to(device)
    return replace(
        record, **{one.name: go(getattr(record, one.name), device) for one in fields(record)}
    )


def blind() -> Checkpoint:
    """Return a policy that is told its own motion alone."""
    card = Card(name="blind", sensors=SensorConfig(), network=NetworkConfig(hidden=(8,)))
    return actor.untrained(card, seed=1)


def race(
    device: str,
    drivers: Callable[[TrackSet], Mapping[int, Driver]],
    *,
    steps: int,
    watch: Callable[[Step], None] = lambda step: None,
    **settings: object,
) -> tuple[World, Tensor]:
    """Drive some cars of two worlds for some steps; return the worlds and the last actions."""
    tracks = TrackSet(RING, device=device)
    env = RaceEnv(tracks, EnvConfig(**settings), num_worlds=2, seed=3)  # type: ignore
    seated = Opponents(drivers(tracks))
    told = env.reset(seed=3)
    for _ in range(steps):
        step = env.step(seated.act(env.last_action, told))
        seated.watch(step)
        seated.forget(step.began)
        watch(step)
        told = step.observations
    env.close()
    return env.world, env.last_action


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


@pytest.mark.parametrize("name", roster.NAMES)
def test_scripted_drivers_drive_worlds_of_another_device(name):
    def run(device: str) -> object:
        # The car before it stands.
        return race(device, lambda tracks: {1: roster.load(name, tracks, CAR)}, steps=6, sim=TWO)

    check_both(run)


def test_a_driver_forgets_rows_of_another_device():
    def run(device: str) -> object:
        driver = roster.load("racing_line", TrackSet(RING, device=device), CAR)
        state = torch.rand((4, SIZE), generator=torch.Generator().manual_seed(2)).to(device)
        driver.act({"state": state})
        driver.reset(torch.tensor([1, 3], device=device))
        return driver.act({"state": state})

    check_both(run)


def test_a_policy_drives_worlds_of_another_device():
    kept = blind()

    def run(device: str) -> object:
        return race(device, lambda tracks: {0: Policy(kept, CAR, device=tracks.device)}, steps=4)

    check_both(run)


def random(*shape: int, size: float, seed: int) -> Tensor:
    return size * torch.randn(shape, generator=torch.Generator().manual_seed(seed))


@pytest.mark.parametrize("num_worlds", [1, 5, 200])
def test_places_along_tracks_are_compiled_on_the_cpu_to_the_bits_of_another_device(num_worlds):
    names = ("reinvent_2018", "needle_pass", "thread_lane")
    tracks = [make_straight(), *map(files.load, names)]
    index = torch.arange(num_worlds) % len(tracks)

    def run(device: str) -> object:
        courses = TrackSet(*tracks, device=device)
        track = index.to(device)
        s = random(num_worlds, 3, size=40.0, seed=1).to(device)
        x, y, frame = courses.at(track, s)
        aside = (random(num_worlds, 3, size=0.3, seed=seed).to(device) for seed in (2, 3, 4))
        near = [place + shift for place, shift in zip((x, y, s), aside, strict=True)]
        return x, y, frame, courses.project(track, *near)

    check_both(run)


@pytest.mark.parametrize("speed", [0.0, 0.02, 2.0])
def test_tyres_are_compiled_on_the_cpu_to_the_bits_of_another_device(speed):
    shape, names = (500, 2), ("velocity_x", "velocity_y", "yaw_rate")

    def run(device: str) -> object:
        def drawn(size: float, seed: int, middle: float = 0.0) -> Tensor:
            return (middle + random(*shape, size=size, seed=seed)).to(device)

        moving = {name: drawn(speed, seed) for seed, name in enumerate(names)}
        still = {"x": drawn(1.0, 3), "y": drawn(1.0, 4)}
        motion = Motion(**moving, **still, yaw=drawn(3.0, 5), steering=drawn(0.3, 6))
        rest = {name: drawn(0.0, 7) for name in ("latency_s", "camera_up", "camera_pitch")}
        grip, mass = drawn(0.05, 8, 0.7), drawn(0.5, 9, 8.2)
        cars = CarParameters(grip=grip, mass=mass, steering_offset=drawn(0.02, 10), **rest)
        asked = drawn(0.6, 11), drawn(speed, 12).abs()
        return forces(motion, *asked, cars, CAR, 1 / 120)

    check_both(run)


def test_contacts_are_worked_out_on_the_cpu_and_go_back():
    sim = SimConfig(kind="head_to_head", num_cars=3)
    # Two cars overlap, the third one stands in the wall.
    tracks = TrackSet(make_straight())
    world = put_cars(tracks, sim, [(3.0, 0.0), (3.2, 0.1), (6.0, 1.2)], num_worlds=2, speed=2.0)

    def run(device: str) -> object:
        solver = PlanarSolver(sim, TrackSet(make_straight(), device=device))
        here = go(world, device)
        outcome = solver.step(here, here.control)
        assert outcome.contacts.cars.tolist()[1][0] == [False, True, False]
        assert outcome.contacts.walls.tolist()[1] == [False, False, True]
        return outcome

    check_both(run)


def test_a_race_of_another_device_is_recorded_as_on_the_cpu():
    def run(device: str) -> Replay:
        tracks = TrackSet(RING, device=device)
        env = RaceEnv(tracks, EnvConfig(sim=TWO))
        recorder, told = Recorder(spec(), tracks), env.reset(seed=3)
        recorder.start(env.world)
        for _ in range(3):
            step = env.step(torch.stack([follow_center(dict(one)) for one in told], dim=1))
            recorder.add(env.world, env.last_action)
            told = step.observations
        return finish(recorder, 4)

    with pretending():
        elsewhere = run(ELSEWHERE).columns
    here = run("cpu").columns
    for one in fields(here):
        assert np.array_equal(getattr(here, one.name), getattr(elsewhere, one.name)), one.name


def test_sensors_read_worlds_of_another_device():
    sensors = SensorConfig(
        camera=CameraConfig(width=16, height=12, rate_hz=7.5), lidar=LidarConfig(rate_hz=10.0)
    )

    def run(device: str) -> object:
        seen = []
        race(
            device,
            lambda tracks: {},
            steps=4,
            watch=lambda step: seen.append([dict(one) for one in step.observations]),
            sim=TWO,
            sensors=(sensors, sensors),
            camera_path="ray",
        )
        return seen

    check_both(run)


def test_self_play_seats_opponents_in_worlds_of_another_device():
    results = {}

    def run(device: str) -> object:
        records, seated = Records(100), []

        def drivers(tracks: TrackSet) -> dict[int, Driver]:
            pacer = Pacer(tracks.tracks[0], CAR, 5, 1, device=tracks.device)
            slow = roster.load("centerline", tracks, CAR)
            seat = Opponent(1, SensorConfig(), 2, 5, records, device=tracks.device)
            field = Field(("pacer", "slow"), (pacer, slow), (0.5, 0.5), ((4.0, 4.0), (1.0, 2.0)))
            seat.choose_from(field, 7)
            seated.append(seat)
            return {1: seat}

        cfg = {"mode": "training", "meeting": Meeting(), "episode_s": 0.4}
        driven = race(device, drivers, steps=8, sim=TWO, **cfg)
        results[device] = records.state()
        return driven, seated[0].who, seated[0].speed_limit

    check_both(run)
    assert results["cpu"] and results[ELSEWHERE] == results["cpu"]


def test_duels_are_raced_on_another_device():
    cfg = DuelConfig(laps=1, slowest=12.0, grace_s=0.0)

    def run(device: str) -> object:
        tracks = TrackSet(RING, device=device)
        field = [roster.load(name, tracks, CAR) for name in ("racing_line", "centerline")]
        return duels.meet(tracks, CAR, field, [(0, 1)], cfg, races=2)

    with pretending():
        elsewhere = run(ELSEWHERE)
    assert elsewhere == run("cpu")


def test_episodes_are_told_of_rows_of_another_device():
    def run(device: str) -> tuple[float | None, float | None]:
        episodes = Episodes(2)
        for driven in ([0.4, 0.5], [0.9, 1.1]):
            episodes.add(
                torch.ones(2, device=device),
                torch.tensor([1, 0], device=device),
                {"driven": torch.tensor(driven, device=device)},
            )
        return episodes.completion, episodes.earned

    with pretending():
        assert run(ELSEWHERE) == run("cpu")
