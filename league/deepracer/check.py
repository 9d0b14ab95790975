"""`league reward check`: try a reward file on scripted drives of every kind of race."""

from __future__ import annotations

import math
import statistics
import threading
import time
from collections.abc import Iterator, MutableMapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy import ndarray

from league.deepracer import watchdog
from league.deepracer.params import KEYS, Params, ParamsBuilder
from league.deepracer.reward_file import Function, RewardFile
from league.envs.actions import encode
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.envs.rewards import Paid
from league.envs.state import INDEX
from league.errors import RewardError
from league.sim.config import RULES, ObstacleConfig, RaceKind, SimConfig
from league.sim.records import World
from league.track import files
from league.track.track import Track, TrackSet

TIME_LIMIT_S = 5.0  # Longest call, as in the original's validator [s].


@dataclass(frozen=True)
class DriveReport:
    """How a reward file did on one drive."""

    title: str  # What the drive shows.
    kind: str
    calls: int  # Steps rewarded.
    rewards: tuple[float, ...]  # Reward of each step, up to the first failure.
    failure: str | None  # Where and how it failed, or None.
    median_us: float  # Median time of a call [us], the user's own code alone.

    @property
    def mean(self) -> float:
        """Mean reward of a step; 0 if there was none."""
        return statistics.fmean(self.rewards) if self.rewards else 0.0


@dataclass(frozen=True)
class Report:
    """How a reward file did on all drives."""

    source: RewardFile
    drives: tuple[DriveReport, ...]
    keys: tuple[str, ...]  # Keys of `params` it has read, by name.
    unknown_keys: tuple[str, ...]  # Keys it has asked for that do not exist.
    warnings: tuple[str, ...]  # Advice.

    @property
    def needs_objects(self) -> bool:
        """Whether it reads objects, and fails on all drives without any and on no others."""
        alone = [one.kind == "time_trial" for one in self.drives]
        failed = [one.failure is not None for one in self.drives]
        reads = any("object" in key for key in self.keys)
        lacks = reads and not self.unknown_keys and any(alone) and not all(alone)
        return lacks and alone == failed

    @property
    def failures(self) -> tuple[DriveReport, ...]:
        """Drives on which it failed, except those without the objects that it needs."""
        return () if self.needs_objects else tuple(one for one in self.drives if one.failure)


class _Watched(dict[str, Any]):
    """Params that note the keys that are read, except those the user's own code has set."""

    def __init__(self, params: Params, read: set[str]) -> None:
        super().__init__(params)
        self._read, self._own = read, set()

    def __getitem__(self, key: str) -> object:
        if key not in self._own:
            self._read.add(key)
        return super().__getitem__(key)

    def __setitem__(self, key: str, value: object) -> None:
        self._own.add(key)
        super().__setitem__(key, value)

    def __iter__(self) -> Iterator[str]:
        # Not dict's own, or `dict(params)` would copy all values without a call of __getitem__.
        return iter(super().keys())

    def copy(self) -> dict[str, Any]:
        return dict(self)

    # Unlike dict's own, these call __getitem__.
    get, pop = MutableMapping.get, MutableMapping.pop  # type: ignore
    items, values = MutableMapping.items, MutableMapping.values  # type: ignore


class _Trial(Future["Report"]):
    """What the thread that runs the user's code has found, and when its last call began."""

    call_began, loaded = math.inf, False


def check(
    path: Path, *, kind: RaceKind | None = None, time_limit_s: float = TIME_LIMIT_S
) -> Report:
    """Try a reward file on scripted drives of one kind of race; None: of every kind.

    RewardError if the file cannot be read or loaded, or a call takes more than `time_limit_s` [s];
    loading may take longer, as in training, because it may import a large library.
    """
    source, trial = RewardFile.read(path), _Trial()
    recorded = [drive for drive in drives() if kind in (None, drive.kind)]

    def work() -> None:
        try:
            trial.set_result(_report(source, recorded, trial))
        except BaseException as error:
            trial.set_exception(error)  # raised again by the thread that waits

    thread = threading.Thread(target=work, daemon=True, name="reward")
    thread.start()
    while not trial.done():
        thread.join(0.02)
        limit_s = time_limit_s if trial.loaded else watchdog.TIME_LIMIT_S
        if thread.is_alive() and time.monotonic() - trial.call_began > limit_s:
            assert thread.ident is not None
            error = watchdog.stuck(str(source.path), thread.ident, limit_s)
            watchdog.throw(thread.ident, watchdog.Stopped)
            raise error
    return trial.result()


def _report(source: RewardFile, recorded: Sequence[Drive], trial: _Trial) -> Report:
    read: set[str] = set()
    trial.call_began = time.monotonic()
    function = source.instance()
    trial.call_began, trial.loaded = math.inf, True
    tried = tuple(_try(source, function, drive, read, trial) for drive in recorded)
    known = tuple(sorted(read.intersection(KEYS)))
    unknown = tuple(sorted(map(str, read.difference(KEYS))))
    return Report(source, tried, known, unknown, tuple(_warnings(tried, known, unknown)))


def _try(
    source: RewardFile, function: Function, drive: Drive, read: set[str], trial: _Trial
) -> DriveReport:
    rewards, times, failure = [], [], None
    for params in drive.params:
        watched, when = _Watched(params, read), f"{drive.title}, steps {params['steps']}"
        trial.call_began = time.monotonic()
        start = time.perf_counter()
        try:
            value = function(watched)
            times.append(time.perf_counter() - start)
            rewards.append(source.number(function, value, when))
        except RewardError as error:
            failure = str(error)
            break
        except watchdog.NOT_ITS_OWN:
            raise
        except BaseException as error:
            failure = str(source.failed(error, when, params))
            break
    median_us = 1e6 * statistics.median(times) if times else 0.0
    calls = len(drive.params)
    return DriveReport(drive.title, drive.kind, calls, tuple(rewards), failure, median_us)


def _warnings(
    tried: Sequence[DriveReport], keys: Sequence[str], unknown: Sequence[str]
) -> Iterator[str]:
    for key in unknown:
        yield f"it reads params[{key!r}], which does not exist"
    rewards = {reward for one in tried for reward in one.rewards}
    if len(rewards) == 1 and not any(one.failure for one in tried):
        yield f"it pays {min(rewards):g} for every step, whatever the car does"
    if not keys:
        yield "it reads nothing of params"
    if rewards and (largest := max(map(abs, rewards))) > 1000:
        yield f"it pays up to {largest:,.0f} for a step: learning is steadier with about 1"
    if "objects_heading" in keys:
        yield "it reads objects_heading: degrees here, as documented, but radians in the original"
    slow = max((one.median_us for one in tried), default=0.0)
    if slow > 1000:
        yield (
            f"it takes {slow / 1000:.1f} ms a call: with one car at most "
            f"{1e6 / slow:,.0f} steps a second, training will wait for it"
        )


@dataclass(frozen=True)
class Drive:
    """One scripted drive, as reward functions see it."""

    title: str  # What it shows.
    kind: RaceKind
    params: list[Params]  # Argument of the function, step by step.


class _ParamsRecorder:
    """A reward that pays nothing and keeps the params of a car."""

    terms = ()

    def __init__(self, sim: SimConfig, car: int) -> None:
        self.params: list[Params] = []
        self._builder = ParamsBuilder(sim, (car,))

    def restart(self, world: World, begun: ndarray) -> None:
        self._builder.restart(begun)

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: ndarray, verdicts: ndarray
    ) -> Paid:
        rows = self._builder.rows(tracks, before, world, verdicts)
        self.params.extend(params for _, _, params in rows)
        return np.zeros(verdicts.shape, np.float32), {}


def drives() -> tuple[Drive, ...]:
    """Return scripted drives of all kinds of races: about 700 steps, in a second or two."""
    track = files.load("reinvent_2018")
    other_way = track.mirrored()
    one_lap = replace(RULES["deepracer"], laps=1)
    alone = SimConfig(rules=one_lap)
    three = ObstacleConfig(count=3, places=((0.15, 1.0), (0.3, -1.0), (0.5, 0.0)))
    boxes = SimConfig(kind="obstacle_avoidance", rules=one_lap, obstacles=three)
    two = SimConfig(kind="head_to_head", num_cars=2, rules=one_lap)
    return (
        _drive("alone: a whole lap", track, alone, speeds=(2.0,)),
        _drive("alone: off the track", track, alone, speeds=(2.0,), straight_on=40),
        _drive("alone: a lap, clockwise", other_way, alone, speeds=(2.0,)),
        _drive("boxes: into one", track, boxes, speeds=(2.0,)),
        _drive("cars: into the one ahead", track, two, speeds=(1.2, 2.4)),
        _drive("cars: passing one", other_way, two, speeds=(1.6, 2.2), lanes=(0.19, -0.19)),
    )


def _drive(
    title: str,
    track: Track,
    sim: SimConfig,
    *,
    speeds: Sequence[float],
    lanes: Sequence[float] = (0.0, 0.0),
    straight_on: int | None = None,
) -> Drive:
    """Drive each car at its speed [m/s] and lane [m, left of the centreline], up to 15 s.

    The drive ends with an episode of the last car; from step `straight_on` it does not steer.
    """
    paid = sim.num_cars - 1
    recorder = _ParamsRecorder(sim, paid)
    env = RaceEnv(TrackSet(track), EnvConfig(sim=sim, mode="race"), seed=1, reward=recorder)
    observations = env.reset(seed=1)
    for number in range(15 * sim.step_hz):
        steered = [
            _follow(groups["state"], speed, lane, sim)
            for groups, speed, lane in zip(observations, speeds, lanes, strict=False)
        ]
        actions = np.stack(steered, axis=1)
        if straight_on is not None and number >= straight_on:
            actions[..., 0] = 0.0
        verdict = env.step(actions).verdicts[0, paid]
        if verdict["mistake"] or verdict["finished"]:
            break
    env.close()
    return Drive(title=title, kind=sim.kind, params=recorder.params)


def _follow(state: ndarray, speed: float, lane: float, sim: SimConfig) -> ndarray:
    """Return actions that follow a line parallel to the centreline, by two gains."""
    lateral, heading = state[:, INDEX["lateral"]] - lane, state[:, INDEX["heading_error"]]
    bend = state[:, INDEX["curvature_0.25m"]] - 1.5 * lateral - 2.5 * heading
    steering = np.arctan(sim.car.wheelbase * bend)
    return encode(steering, np.full_like(steering, speed), sim.car)
