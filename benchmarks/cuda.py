"""What a learner on a GPU costs: the worlds' step, copies, cameras, and whole updates.

The worlds stay on the CPU. Needs CUDA and numba-cuda; run by name alone.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from unittest.mock import patch

import torch

from benchmarks.report import figure, heading, note
from benchmarks.training import ROOKIE, learner_config, learnt
from league.envs.adapters import rsl_vec_env
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig
from league.sim.config import CameraConfig, SensorConfig, SimConfig
from league.threads import num_threads
from league.track import files
from league.track.track import TrackSet
from league.training.ppo import make_env
from league.training.ppo.learner import Learner

WORLDS = (64, 1024, 4096)
CARS = 2
SEEING = CameraConfig(width=64, height=48)


def synchronised(call: Callable[[], object], times: int) -> float:
    """Return the median time of a call [s], until the GPU has done its part."""
    taken = []
    for number in range(times + 1):
        torch.cuda.synchronize()
        began = time.perf_counter()
        call()
        torch.cuda.synchronize()
        if number:  # the first one warms up
            taken.append(time.perf_counter() - began)
    return statistics.median(taken)


def step(tracks: TrackSet, num_worlds: int, device: str, camera: CameraConfig | None) -> float:
    """Return the time of a step of worlds of two learning cars [s]."""
    cfg = EnvConfig(
        sim=SimConfig(kind="head_to_head", num_cars=CARS),
        sensors=(SensorConfig(camera=camera),) * CARS,
        mode="training",
    )
    learners = tuple(range(CARS))
    env = RacingVecEnv(
        tracks, cfg, num_worlds=num_worlds, learners=learners, as_bytes=True, device=device
    )
    actions = torch.zeros(env.num_envs, 2, device=device)
    taken = synchronised(lambda: env.step(actions), 10)
    seen = env.get_observations()
    assert all(group.device.type == device for group in seen.values())
    assert camera is None or float(seen["stereo"].float().std()) > 10, "the pictures are blank"
    env.close()
    return taken


PAINTED = patch.object(rsl_vec_env, "casts_rays", lambda device: False)
"""Pictures of a learner on a GPU painted on the CPU and copied, as without numba-cuda."""


def steps(tracks: TrackSet) -> None:
    """Print what a step takes by number of worlds, with and without cameras."""
    for num_worlds in WORLDS:
        rows = f"{num_worlds:,} worlds x {CARS}"
        for device, camera, way, words in (
            ("cpu", None, nullcontext(), "no cameras, learner on the CPU"),
            ("cuda", None, nullcontext(), "no cameras, learner on the GPU"),
            ("cpu", SEEING, nullcontext(), "64x48 stereo, learner on the CPU"),
            ("cuda", SEEING, PAINTED, "64x48 stereo painted on the CPU, copied"),
            ("cuda", SEEING, nullcontext(), "64x48 stereo cast on the GPU"),
        ):
            with way:
                taken = step(tracks, num_worlds, device, camera)
            figure(f"{rows}, {words}", 1e3 * taken, "ms")


def updates(tracks: TrackSet) -> None:
    """Print how many decisions a second are learnt from, evaluations left out."""
    for num_worlds in (64, 1024):
        for device in ("cpu", "cuda"):
            cfg = replace(learner_config(num_worlds), device=device)
            learner = Learner(make_env.make(tracks, cfg), cfg)
            taken = synchronised(lambda: learner.update(0.0), 3)  # noqa: B023
            figure(f"learner, {num_worlds:,} worlds, {device}", cfg.samples / taken, "decisions/s")
            learner.env.close()


def main() -> None:
    """Print the figures."""
    heading("A learner on a GPU")
    if not torch.cuda.is_available():
        raise SystemExit("this benchmark needs a GPU that CUDA can use, and torch finds none")
    if not rsl_vec_env.casts_rays(torch.device("cuda")):
        raise SystemExit("this benchmark needs numba-cuda: pip install numba-cuda[cu13]")
    threads = f"{num_threads()} threads of worlds, {torch.get_num_threads()} of torch"
    note(f"{torch.cuda.get_device_name()}, {threads}, torch {torch.__version__}.")
    tracks = TrackSet(files.load("reinvent_2018"))
    steps(tracks)
    updates(tracks)
    for device in ("cpu", "cuda"):
        run = learnt([*ROOKIE, "--stop-when-complete", "1", "--seed", "1", "--device", device])
        laps = "3 of 3 laps" if run.complete else "NOT COMPLETE"
        figure(f"rookie on {device}: command to prompt, {laps}", run.wall_s, "s")


if __name__ == "__main__":
    main()
