"""How fast worlds step through each interface, and against another checkout of the league.

    python -m benchmarks.adapters [--against CHECKOUT] [--only WORD ...] [--rounds 3]

Each row runs in processes of its own, with one thread unless its name says otherwise; against
another checkout they take turns, so that both meet the same load. Only names that both know are
used: rows that the other cannot run are left out. A row replays the actions of a drive along the
centreline, so neither a driver nor the restart is in the figures.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

ROOT = Path(__file__).parents[1]
TRACK = "reinvent_2018"
BLOCKS = 7
"""The fastest of so many blocks counts."""
_RACE: dict[str, Any] = dict(kind="head_to_head", solver="planar", mode="race", laps=100)


@dataclass
class Drive:
    """A drive that can be repeated, one block of steps a time."""

    work: int
    """Steps, or car-steps, in a block."""
    start: Callable[[], object]
    """Begins again; not timed."""
    run: Callable[[], object]
    """Drives one block."""
    seen: Callable[[], Mapping[str, Any]]
    """What the cars observed last, and what a policy answered."""


def follow(state: np.ndarray, car: int = 0) -> np.ndarray:
    """Return actions along the centreline at 2.4 m/s, odd cars at 1.5, (num_rows, 2)."""
    from league.envs.state import INDEX

    error = 1.5 * state[:, INDEX["lateral"]] + 2.5 * state[:, INDEX["heading_error"]]
    steering = np.arctan(0.164 * (state[:, INDEX["curvature_0.25m"]] - error)) / 0.5236
    speed = np.full_like(steering, 0.2 - 0.5 * (car % 2))
    return np.stack([steering.clip(-1, 1), speed], axis=1).astype(np.float32)


def race_env(
    num_worlds: int,
    num_cars: int,
    steps: int,
    mode: Literal["race", "training"] = "training",
    *,
    truth: bool = False,
) -> Drive:
    """Drive a RaceEnv without cameras; in training cars are spread round the track.

    Args:
        num_worlds: worlds.
        num_cars: cars in each.
        steps: steps in a block.
        mode: race or training.
        truth: whether the `state` of all cars is read at each step, as learners' critics do.
    """
    from league.envs.race_env import RaceEnv

    # In a checkout of before the compiled loops the module has its old name.
    name = "make" if importlib.util.find_spec("league.envs.make") else "problem"
    problem: Any = importlib.import_module(f"league.envs.{name}")

    kind = "head_to_head" if num_cars > 1 else "time_trial"
    cfg = problem.configure(kind=kind, num_cars=num_cars, sensors=(), mode=mode, laps=100)
    env = RaceEnv(problem.course(TRACK), cfg, num_worlds=num_worlds)
    like = _maker(env.last_action)
    observations, actions = env.reset(seed=1), []
    for _ in range(steps):
        each = [follow(np.asarray(groups["state"]), car) for car, groups in enumerate(observations)]
        actions.append(like(np.stack(each, axis=1)))
        observations = env.step(actions[-1]).observations

    def run() -> None:
        for action in actions:
            observations = env.step(action).observations
            if truth:
                for groups in observations:
                    groups["state"]

    def seen() -> dict[str, np.ndarray]:
        observations = env.step(actions[-1]).observations
        return {
            f"{k} {name}": groups[name] for k, groups in enumerate(observations) for name in groups
        }

    return Drive(num_worlds * num_cars * steps, lambda: env.reset(seed=1), run, seen)


def _maker(sample: object) -> Callable[[np.ndarray], Any]:
    """Return what turns an array into the kind of a sample: an array, or a tensor."""
    if isinstance(sample, np.ndarray):
        return lambda array: array
    import torch

    return torch.from_numpy


def pettingzoo(steps: int = 300) -> Drive:
    """Drive two cars in a planar race through PettingZoo."""
    from league.envs import parallel_env

    guide, env = (parallel_env(sensors=(), privileged=one, **_RACE) for one in (True, False))
    observations, _ = guide.reset(seed=1)
    rows = []
    for _ in range(steps):
        rows.append(
            {a: follow(observations[a]["state"][None], int(a[-1]))[0] for a in observations}
        )
        observations, *_ = guide.step(rows[-1])
    last: Any = None

    def run() -> None:
        nonlocal last
        for actions in rows:
            last = env.step(actions)

    return Drive(
        steps,
        lambda: env.reset(seed=1),
        run,
        lambda: {f"{a} {name}": group for a in last[0] for name, group in last[0][a].items()},
    )


def gymnasium_env(sensors: Sequence[Any], steps: int = 300) -> Drive:
    """Drive a time trial through Gymnasium."""
    import gymnasium

    import league.envs  # noqa: F401  # registers the ids

    name = "league/TimeTrial-v0"
    guide = gymnasium.make(name, sensors=(), privileged=True, laps=100).unwrapped
    env = gymnasium.make(name, sensors=sensors, laps=100).unwrapped
    observations, _ = guide.reset(seed=1)
    actions = []
    for _ in range(steps):
        actions.append(follow(observations["state"][None])[0])
        observations, *_ = guide.step(actions[-1])
    last: Any = None

    def run() -> None:
        nonlocal last
        for action in actions:
            last = env.step(action)

    return Drive(steps, lambda: env.reset(seed=1), run, lambda: last[0])


def gymnasium_vector(num_envs: int = 64, steps: int = 30) -> Drive:
    """Drive time trials with cameras as one Gymnasium vector."""
    import gymnasium

    import league.envs  # noqa: F401

    name = "league/TimeTrial-v0"
    guide = gymnasium.make_vec(name, num_envs=num_envs, sensors=(), privileged=True, laps=100)
    env = gymnasium.make_vec(name, num_envs=num_envs, sensors=(_camera(),), laps=100)
    observations, _ = guide.reset(seed=1)
    actions = []
    for _ in range(steps):
        actions.append(follow(observations["state"]))
        observations, *_ = guide.step(actions[-1])
    last: Any = None

    def run() -> None:
        nonlocal last
        for action in actions:
            last = env.step(action)

    return Drive(num_envs * steps, lambda: env.reset(seed=1), run, lambda: last[0])


def sb3(batched: bool, num_envs: int = 16, steps: int = 30) -> Drive:
    """Drive time trials with cameras as SB3 does: in one batch, or as single environments."""
    from stable_baselines3.common.vec_env import DummyVecEnv

    from league.envs import SB3VecEnv
    from league.envs.adapters.gym_env import GymEnv

    guide = SB3VecEnv(num_envs, sensors=(), privileged=True, laps=100)
    if batched:
        env: Any = SB3VecEnv(num_envs, sensors=(_camera(),), laps=100)
    else:
        env = DummyVecEnv([lambda: GymEnv(sensors=(_camera(),), laps=100)] * num_envs)
    guide.seed(1)
    observations: Any = guide.reset()
    actions = []
    for _ in range(steps):
        actions.append(follow(observations["state"]))
        observations = guide.step(actions[-1])[0]
    last: Any = None

    def start() -> None:
        env.seed(1)
        env.reset()

    def run() -> None:
        nonlocal last
        for action in actions:
            last = env.step(action)

    return Drive(num_envs * steps, start, run, lambda: last[0])


def decision(times: int = 300) -> Drive:
    """Have a policy with cameras of 64x48 decide for one car."""
    from league.agents import roster
    from league.envs import make as problem
    from league.envs.race_env import RaceEnv
    from league.sim.config import CarConfig

    tracks = problem.course(TRACK)
    policy = roster.load(str(ROOT / "garage" / "novice.pt"), tracks, CarConfig())
    assert policy.sensors.camera is not None and policy.sensors.camera.width == 64
    env = RaceEnv(tracks, problem.configure(sensors=policy.sensors))
    observations = env.reset(seed=1)[0]
    actions: Any = None

    def run() -> None:
        nonlocal actions
        for _ in range(times):
            actions = policy.act(observations)

    return Drive(
        times, lambda: None, run, lambda: {"stereo": observations["stereo"], "actions": actions}
    )


def _camera() -> Any:
    from league.sim.config import CameraConfig

    return CameraConfig(width=64, height=48)


@dataclass(frozen=True)
class Row:
    """One figure."""

    name: str
    make: Callable[[], Drive]
    goal: float | None = None
    """Least rate [1/s]."""
    unit: str = "steps/s"
    threads: int = 1
    needs: str = ""
    """A package that may be missing; then the row is left out."""

    @property
    def title(self) -> str:
        """The name with what is left out."""
        if self.name.startswith("decision"):
            return f"{self.name}, its picture given"
        cameras = "" if "stereo" in self.name else ", no cameras"
        return f"{self.name}{cameras}, actions given"


CARS, WORLDS = (1, 2, 4, 8), (1, 4, 16, 64, 256, 1024, 4096, 16384)


def _sized(num_worlds: int, num_cars: int) -> Row:
    steps = max(5, min(300, 20_000 // num_worlds))
    name = f"RaceEnv, {num_worlds:,} x {num_cars}"
    return Row(name, lambda: race_env(num_worlds, num_cars, steps), None, "car-steps/s")


ROWS = (
    Row("RaceEnv, a race of 2", lambda: race_env(1, 2, 300, "race"), 100_000, "car-steps/s"),
    Row("PettingZoo, 2 cars", pettingzoo, 12_000),
    Row("Gymnasium, time trial", lambda: gymnasium_env(()), 15_000),
    Row("Gymnasium, time trial with 64x48 stereo", lambda: gymnasium_env((_camera(),)), 7_000),
    Row("Gymnasium, 64 worlds with 64x48 stereo", gymnasium_vector, 25_000, "car-steps/s"),
    Row("SB3VecEnv, 16 worlds, 64x48 stereo", partial(sb3, True), needs="stable_baselines3"),
    Row(
        "SB3's DummyVecEnv of 16 single environments, 64x48 stereo",
        partial(sb3, False),
        needs="stable_baselines3",
    ),
    Row("4,096 x 2, one core", lambda: race_env(4096, 2, 10), 1_200_000, "car-steps/s"),
    Row("4,096 x 2, two cores", lambda: race_env(4096, 2, 10), 2_200_000, "car-steps/s", 2),
    Row(
        "4,096 x 2, one core, state read",
        lambda: race_env(4096, 2, 10, truth=True),
        1_200_000,
        "car-steps/s",
    ),
    Row(
        "4,096 x 2, two cores, state read",
        lambda: race_env(4096, 2, 10, truth=True),
        2_200_000,
        "car-steps/s",
        2,
    ),
    Row("decision of a 64x48 policy", decision, 10_000, "decisions/s"),
)
SIZES = (
    *(_sized(worlds, 2) for worlds in WORLDS),
    *(_sized(1024, cars) for cars in CARS if cars != 2),
)


def measure(row: Row) -> dict[str, float]:
    """Return rates by wall and by processor time [1/s], and a checksum of what was observed."""
    drive = row.make()
    walls, busy = [], []
    for _ in range(1 + BLOCKS):
        drive.start()
        wall, cpu = time.perf_counter(), time.process_time()
        drive.run()
        walls.append(time.perf_counter() - wall)
        busy.append(time.process_time() - cpu)
    check, speed = 0, 0.0
    for name, group in sorted(drive.seen().items()):
        values = np.ascontiguousarray(group)
        assert np.isfinite(values).all(), f"{row.name}: {name} is not finite"
        assert name != "stereo" or values.std() > 5, f"{row.name}: the picture is blank"
        if name.endswith("motion"):
            speed = max(speed, 4.0 * float(values[..., 0].max()))
        check = zlib.crc32(values.tobytes(), check)
    still = row.name.startswith("decision")
    assert still or 1.0 < speed < 4.1, f"{row.name}: the fastest car drives {speed:.2f} m/s"
    # The first block warms up.
    return {
        "wall": drive.work / min(walls[1:]),
        "processor": drive.work / min(busy[1:]),
        "check": check,
    }


def apart(row: Row, tree: Path) -> dict[str, float] | None:
    """Measure a row in a process of its own with a checkout's league; None: it cannot."""
    environment = os.environ | {
        "PYTHONPATH": str(tree),
        "OMP_NUM_THREADS": str(row.threads),
        "OMP_WAIT_POLICY": "PASSIVE",
    }
    command = [sys.executable, "-P", __file__, "--row", row.name]
    done = subprocess.run(
        command, env=environment, cwd=tree, capture_output=True, text=True, check=False
    )
    if done.returncode:
        assert tree != ROOT, done.stderr
        print(f"{row.name}: {tree.name} cannot: {done.stderr.strip().splitlines()[-1]}")
        return None
    return json.loads(done.stdout.splitlines()[-1])


def show(row: Row, against: Path | None, rounds: int) -> dict[str, float] | None:
    """Print one row's figures, the best of some rounds; return ours."""
    from benchmarks.report import figure

    trees = [ROOT] if against is None else [ROOT, against]
    best: list[dict[str, float] | None] = [None] * len(trees)
    for _ in range(rounds):
        for k, tree in enumerate(trees):
            found, known = apart(row, tree), best[k]
            if found is not None and known is not None:
                found |= {name: max(found[name], known[name]) for name in ("wall", "processor")}
            best[k] = found
    ours, theirs = best[0], best[-1]
    if ours is None:
        return None
    # On a shared machine the clock on the wall shows the others' work too.
    wall_goal, goal = (row.goal, None) if row.threads > 1 else (None, row.goal)
    figure(f"{row.title} (checksum {int(ours['check']):08x})", ours["wall"], row.unit, wall_goal)
    figure(f"{row.title}, by processor time", ours["processor"], row.unit, goal)
    if against is not None and theirs is not None:
        figure("  the other checkout", theirs["wall"], row.unit)
        for clock in ("wall", "processor"):
            figure(f"  ours against it, {clock} time", ours[clock] / theirs[clock], "times")
    return ours


def main(arguments: Sequence[str] = ()) -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=_AsWritten)
    parser.add_argument("--against", type=Path, help="another checkout, measured in turn")
    parser.add_argument("--only", nargs="*", default=(), help="words of the rows to measure")
    parser.add_argument("--rounds", type=int, default=1, help="processes for each row")
    parser.add_argument("--row", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    rows = {row.name: row for row in (*ROWS, *SIZES)}
    if given.row:
        print(json.dumps(measure(rows[given.row])))
        return
    from benchmarks.report import figure, heading, note

    heading("Worlds through each interface")
    costs: dict[str, float] = {}
    for name, row in rows.items():
        if given.only and not any(word in name for word in given.only):
            continue
        if row.needs and importlib.util.find_spec(row.needs) is None:
            note(f"{name}: not measured, for {row.needs} is not installed.")
            continue
        found = show(row, given.against, given.rounds)
        if found is not None:
            costs[name] = 1e6 / found["processor"]
    for few, many in ((_sized(1, 2), _sized(16384, 2)), (_sized(1024, 1), _sized(1024, 8))):
        if few.name in costs and many.name in costs:
            growth = costs[many.name] / costs[few.name]
            name = f"cost of a car-step: {many.name} over {few.name}"
            figure(name, growth, "times", 1.0, most=True)


_AsWritten = argparse.RawDescriptionHelpFormatter

if __name__ == "__main__":
    main(sys.argv[1:])
