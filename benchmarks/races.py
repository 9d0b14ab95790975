"""How fast whole races run: with stereo cameras, in both solvers, and as a user starts them."""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.cameras import TinyScene, one_ahead
from benchmarks.report import figure, heading, seconds
from league.agents import roster
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.sim.config import CameraConfig, SensorConfig, SimConfig, SolverName
from league.track import files
from league.track.track import TrackSet


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
    observations = env.reset(seed=1)
    tiny = TinyScene(tracks, one_ahead(tracks, 1)[1], camera) if by_pybullet else None

    def drive() -> None:
        nonlocal observations
        for _ in range(steps):
            if tiny is not None:
                tiny.pair(), tiny.pair()
            actions = np.stack(
                [d.act(o) for d, o in zip(drivers, observations, strict=True)], axis=1
            )
            observations = env.step(actions).observations

    taken = seconds(drive, repeats=3)
    picture = observations[0]["stereo"] if tiny is None else tiny.pair()[0]
    assert picture.std() > 5, "the picture is blank"
    assert env.world.cars["distance"].min() > 1.0, "the cars did not drive"
    env.close()
    if tiny is not None:
        tiny.close()
    return num_worlds * 2 * steps / 15 / taken


def three_laps(folder: Path, *drivers: str) -> tuple[float, float]:
    """Return the time of `league race --laps 3` in Bullet with a replay, and its race time [s]."""
    from league import replay

    path = folder / "three-laps.race"
    wall_s = python("-m", "league.cli", "race", *drivers, "--laps", "3", "--replay", str(path))
    result = replay.read(path).result
    assert all(car.finished for car in result.order), "a car did not finish"
    return wall_s, result.race_s


def python(*arguments: str) -> float:
    """Return how long a process of Python takes [s]."""
    command = [sys.executable, *arguments]
    return seconds(lambda: subprocess.run(command, check=True, capture_output=True))


def main() -> None:
    """Print the figures."""
    heading("Races")
    unit = "car-s per wall s"
    ours = stereo_rate("bullet", 1, 160, 120, 60)
    figure("Bullet, 1 world, two scripted cars, stereo 160x120, start left out", ours, unit, 60)
    theirs = stereo_rate("bullet", 1, 160, 120, 15, by_pybullet=True)
    figure("  against the same with PyBullet's pictures", ours / theirs, "times")
    figure(
        "planar, 64 worlds, two scripted cars, stereo 64x48, start left out",
        stereo_rate("planar", 64, 64, 48, 15),
        unit,
        200,
    )
    with tempfile.TemporaryDirectory() as folder:
        for drivers in (("racing_line", "cautious"), ("racer", "duelist")):
            wall_s, race_s = three_laps(Path(folder), *drivers)
            figure(f"league race {' '.join(drivers)} --laps 3, whole process", wall_s, "s")
            figure(
                f"  three laps of {' and '.join(drivers)} in Bullet with replay, whole process",
                race_s / wall_s,
                "x real time",
                15,
            )
    for solver in ("bullet", "planar"):
        names = ("centerline", "racing_line")
        wall_s = python("-m", "league.cli", "race", *names, "--solver", solver, "--replay", "none")
        name = f"league race {' '.join(names)}, {solver}, no replay, whole process"
        figure(name, wall_s, "s", 2, most=True)
    help_s, bare_s = python("-m", "league.cli", "--help"), python("-c", "pass")
    figure("league --help, whole process", help_s, "s", 0.3, most=True)
    figure("  against Python that does nothing", help_s / bare_s, "times")


if __name__ == "__main__":
    main()
