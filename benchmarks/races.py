"""How fast whole races run: with stereo cameras, in both solvers, and as a user starts them."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.cameras import TinyScene, one_ahead
from benchmarks.report import figure, heading, machine, seconds
from league import race
from league.agents import roster
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.race_spec import Entry, RaceSpec
from league.sim.config import CameraConfig, SensorConfig, SimConfig, SolverName
from league.track import files
from league.track.course import TrackSet


def stereo_rate(
    solver: SolverName,
    num_worlds: int,
    width: int,
    height: int,
    steps: int,
    *,
    by_pybullet: bool = False,
) -> float:
    """Return simulated car-seconds per wall second of two-car races with stereo cameras.

    Args:
        solver: physics.
        num_worlds: races side by side.
        width: of a picture [px].
        height: of a picture [px].
        steps: control steps to time.
        by_pybullet: whether PyBullet's software renderer makes the pictures instead of ours, of
            a scene that stands still.
    """
    tracks = TrackSet(files.load("reinvent_2018"))
    sim = SimConfig(kind="head_to_head", num_cars=2)
    camera = CameraConfig(width=width, height=height)
    sensors = SensorConfig(camera=None if by_pybullet else camera)
    cfg = EnvConfig(sim=sim, solver=solver, sensors=(sensors,))
    env = RaceEnv(tracks, cfg, num_worlds=num_worlds)
    drivers = [roster.load(name, tracks, sim.car) for name in ("racing_line", "centerline")]
    told = env.reset(seed=1)
    tiny = TinyScene(tracks, one_ahead(tracks, 1)[1], camera) if by_pybullet else None

    def drive() -> None:
        nonlocal told
        for _ in range(steps):
            if tiny is not None:
                tiny.pair(), tiny.pair()
            actions = np.stack([d.act(o) for d, o in zip(drivers, told, strict=True)], axis=1)
            told = env.step(actions).observations

    taken = seconds(drive, repeats=3)
    picture = told[0]["stereo"] if tiny is None else tiny.pair()[0]
    assert picture.std() > 5, "the picture is blank"
    assert env.world.cars["distance"].min() > 1.0, "the cars did not drive"
    env.close()
    if tiny is not None:
        tiny.close()
    return num_worlds * 2 * steps / 15 / taken


def three_laps(folder: Path) -> float:
    """Return how much faster than real time a three-lap race in Bullet with replay runs."""
    from league import replay

    spec = RaceSpec(entries=(Entry(name="racing_line"), Entry(name="centerline")), laps=3)
    race.run(spec)
    start = time.perf_counter()
    finished = race.run(spec)
    replay.write(finished.replay, folder / "three-laps.race")
    taken = time.perf_counter() - start
    assert all(car.finished for car in finished.result.order), "somebody did not finish"
    return finished.result.race_s / taken


def python(*arguments: str) -> float:
    """Return how long a process of Python takes [s]."""
    command = [sys.executable, *arguments]
    return seconds(lambda: subprocess.run(command, check=True, capture_output=True))


def main() -> None:
    """Print the figures."""
    heading("Races")
    print(machine())
    unit = "car-s per wall s"
    ours = stereo_rate("bullet", 1, 160, 120, 60)
    figure("Bullet, 1 world, two cars, stereo 160x120", ours, unit, 16)
    theirs = stereo_rate("bullet", 1, 160, 120, 15, by_pybullet=True)
    figure("  against the same with PyBullet's pictures", ours / theirs, "times")
    figure(
        "planar, 64 worlds, two cars, stereo 64x48",
        stereo_rate("planar", 64, 64, 48, 15),
        unit,
        200,
    )
    with tempfile.TemporaryDirectory() as folder:
        figure("three laps in Bullet with replay", three_laps(Path(folder)), "x real time", 8)
    help_s, bare_s = python("-m", "league.cli", "--help"), python("-c", "pass")
    figure("league --help", help_s, "s", 0.3, most=True)
    figure("  against Python that does nothing", help_s / bare_s, "times")


if __name__ == "__main__":
    main()
