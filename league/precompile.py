"""Compile the simulator once for an installation, in parallel, rather than bit by bit at first use.

As a program (`python -m league.precompile`, which `make sync` runs) it compiles what is missing.
"""

import contextlib
import gc
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from league import jit
from league.errors import LeagueError
from league.threads import processors

_COMPLETE = "complete"
_PACKAGE = Path(__file__).parent


def ensure() -> None:
    """Compile all that is not compiled yet, with progress on stderr; LeagueError if it fails."""
    folder = jit.cache_folder()
    if folder is None or (folder / _COMPLETE).exists():
        return
    done: list[str] = []
    one_at_a_time = threading.Lock()
    began = time.monotonic()
    _show(0, began)
    with ThreadPoolExecutor(processors()) as pool:

        def compile_group(parts: Iterable[str]) -> None:
            for part in _compiled(parts):
                with one_at_a_time:
                    done.append(part)
                    _show(len(done), began)

        for _ in pool.map(compile_group, GROUPS):
            pass
    import compileall  # late: it is needed once

    # An editable install has no bytecode, and containers often keep Python from writing any: then
    # each start would compile the sources again.
    compileall.compile_dir(_PACKAGE, quiet=2)
    (folder / _COMPLETE).touch()
    _remove_older(folder)


def _compiled(parts: Iterable[str]) -> Iterator[str]:
    """Compile parts in a process of their own (Numba is serial); yield each when it is done."""
    with (
        tempfile.TemporaryFile("w+") as errors,
        subprocess.Popen(
            [sys.executable, "-P", "-m", "league.precompile", *parts],
            # What this process can import, that one can, too: PYTHONPATH may hold the dependencies.
            env={**os.environ, "PYTHONPATH": os.pathsep.join([str(_PACKAGE.parent), *sys.path])},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        ) as process,
    ):
        assert process.stdout is not None
        yield from map(str.strip, process.stdout)
        if process.wait():
            errors.seek(0)
            last = (errors.read().strip().splitlines() or ["no message"])[-1]
            raise LeagueError(
                f"compiling the simulator failed ({last}): reinstall the league's dependencies"
            )


def _show(done: int, began: float) -> None:
    """Print the progress; on a terminal each line replaces the one before."""
    last = done == len(PARTS)
    if last or not done or sys.stderr.isatty():
        seconds = time.monotonic() - began
        print(
            f"Compiling the simulator, once for this installation: {done} of {len(PARTS)} parts, "
            f"{seconds:.0f} s",
            end="\r" if sys.stderr.isatty() and not last else "\n",
            file=sys.stderr,
            flush=True,
        )


def _remove_older(folder: Path) -> None:
    """Remove machine code of earlier sources that no program has begun to use within a day."""
    for other in folder.parent.glob("jit-*"):
        with contextlib.suppress(OSError):
            if other != folder and other.stat().st_mtime < time.time() - 86_400:
                shutil.rmtree(other)


def _worlds() -> None:
    """Reset and step of the planar simulator."""
    from league.envs.config import EnvConfig
    from league.envs.race_env import RaceEnv
    from league.sim.config import SimConfig

    sim = SimConfig(kind="head_to_head", num_cars=2)
    RaceEnv(_tracks(), EnvConfig(sim=sim)).step(np.zeros((1, 2, 2), np.float32))


def _sensors() -> None:
    """Lidar, running order and what critics see, without reset and step."""
    from league.envs.config import EnvConfig
    from league.envs.sensor_suite import SensorSuite
    from league.sim import referee
    from league.sim.config import LidarConfig, SensorConfig, SimConfig

    carried = (SensorConfig(lidar=LidarConfig(), history=1),)
    sim, world = SimConfig(kind="head_to_head", num_cars=2), _world()
    suite = SensorSuite(_tracks(), EnvConfig(sim=sim, sensors=carried))
    suite.read(world)
    for group in ("state", "truth"):  # "ahead" has the loop of "truth"
        suite.computed(group, world)
    referee.running_order(world.cars, False)


def _bullet() -> None:
    """Suspension and tyres of the Bullet solver, and the reward terms as Python calls them."""
    from league.envs.config import EnvConfig
    from league.envs.race_env import RaceEnv
    from league.envs.rewards import BuiltIn

    cfg = EnvConfig(solver="bullet", mode="training")
    env = RaceEnv(_tracks(), cfg, num_worlds=1, reward=BuiltIn(cfg.reward))
    env.step(np.zeros((1, 1, 2), np.float32))
    env.close()


def _scripted() -> None:
    """Racing line and scripted drivers."""
    from league.agents import roster
    from league.envs.state import SIZE
    from league.sim.config import CarConfig

    for name in ("racing_line", "centerline"):
        driver = roster.load(name, _tracks(), CarConfig())
        driver.act({"state": np.zeros((1, SIZE), np.float32)})


def _policies() -> None:
    """The forward pass of policies."""
    from league.agents.network import NetworkConfig, group_shapes, weight_shapes
    from league.agents.policy import Network
    from league.sim.config import SensorConfig

    cfg, shapes = NetworkConfig(), group_shapes(SensorConfig.full(64, 48))
    flat = sum(shape[0] for shape in shapes.values() if len(shape) == 1)
    weights = {
        name: np.zeros(shape, np.float32) for name, shape in weight_shapes(cfg, shapes, 2).items()
    }
    picture = np.zeros((1, *shapes["stereo"]), np.uint8)
    Network.of(cfg, shapes, weights).outputs(np.zeros((1, flat), np.float32), picture)


def _cameras() -> None:
    """The painter of pictures."""
    from league.sim.camera.renderer import Renderer
    from league.sim.config import CameraConfig, SimConfig

    sim = SimConfig(kind="head_to_head", num_cars=2)
    Renderer(_tracks(), sim, CameraConfig(width=32, height=24)).render(_world(), 0)


def _videos() -> None:
    """What films draw on whole pictures."""
    from league.sim.camera.scene_state import NEAR
    from league.sim.camera.tables import Optics, Pose
    from league.video.pixels import draw_shadow, mix

    pose = Pose(0.0, 0.0, 0.5, 1.0, 0.0, 1.0, 0.0)
    optics = Optics(1.0, 1.0, 1.0, np.zeros(1), 3, NEAR)
    picture, outline = np.zeros((4, 4, 3), np.uint8), np.column_stack([np.eye(2), [0, 0]])
    draw_shadow(picture.reshape(4, -1), 3, outline, 0.1, 0.5, optics, pose)
    for paint in (picture.copy(), np.broadcast_to(picture[0, 0], picture.shape)):
        mix(picture[:2, :2], paint[:2, :2], np.zeros((4, 4), np.uint8)[:2, :2], 256)


def _places() -> None:
    """Places along tracks, as replays and evaluations look them up."""
    tracks, world, place = _tracks(), np.zeros(1, np.int64), np.zeros((1, 1), np.float32)
    tracks.project(world, place, place)
    tracks.at(world, place)
    tracks.signed_gap(world, place, place)


def _reward_functions() -> None:
    """What DeepRacer's reward functions are given, and the trace of an evaluation."""
    from league.deepracer.check import drives

    drives()


def _tracks():  # noqa: ANN202
    from league.track import files
    from league.track.track import TrackSet

    return TrackSet(files.load("peanut"))


def _world():  # noqa: ANN202
    from league.sim import records

    cars, obstacles = np.zeros((1, 2), records.CAR), np.zeros((1, 0), records.OBSTACLE)
    return records.World(np.zeros(1, records.WORLD), cars, obstacles)


GROUPS: tuple[dict[str, Callable[[], None]], ...] = (
    {"worlds": _worlds, "bullet": _bullet, "reward_functions": _reward_functions},
    {
        **{"scripted": _scripted, "cameras": _cameras, "sensors": _sensors},
        **{"policies": _policies, "videos": _videos, "places": _places},
    },
)
"""Parts that one process compiles, each half of the work. Those that need a whole simulator are in
the first group, and nothing of the second calls what they compile, so neither does work twice."""
PARTS = {name: part for group in GROUPS for name, part in group.items()}


def _main() -> None:
    gc.disable()  # its searches take a tenth of the time; what they would free is little
    for part in sys.argv[1:]:
        PARTS[part]()
        print(part, flush=True)
    if len(sys.argv) == 1:
        ensure()


if __name__ == "__main__":
    _main()
