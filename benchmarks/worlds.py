"""How fast worlds step: planar worlds without cameras, from 1 to 16,384, and by number of cars."""

import multiprocessing
from multiprocessing.synchronize import Barrier

import torch

from benchmarks.report import figure, heading, machine, product, seconds
from league.envs.config import EnvConfig
from league.envs.race_env import Observations, RaceEnv
from league.envs.state import INDEX
from league.sim.config import SimConfig
from league.track import files
from league.track.course import TrackSet

STEPS = 10


def make(num_worlds: int, num_cars: int) -> tuple[RaceEnv, Observations]:
    """Return worlds on their way, spread round the track."""
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    cfg = EnvConfig(sim=SimConfig(kind=kind, num_cars=num_cars), solver="planar", mode="training")
    env = RaceEnv(TrackSet.of(files.load("reinvent_2018")), cfg, num_worlds=num_worlds)
    told = env.reset(seed=1)
    for _ in range(20):
        told = env.step(follow(told)).observations
    return env, told


def follow(told: Observations) -> torch.Tensor:
    """Return actions that follow the centreline at 1.5 to 2.5 m/s; each slot at its own speed."""
    actions = []
    for car, groups in enumerate(told):
        state = groups["state"]
        lateral, heading = state[:, INDEX["lateral"]], state[:, INDEX["heading_error"]]
        curvature = state[:, INDEX["curvature_0.25m"]]
        steering = torch.atan(0.164 * (curvature - 1.5 * lateral - 2.5 * heading)) / 0.5236
        speed = torch.full_like(steering, -0.3 + 0.5 * (car % 2))
        actions.append(torch.stack([steering.clamp(-1, 1), speed], dim=1))
    return torch.stack(actions, dim=1)


def rate(num_worlds: int, num_cars: int, together: Barrier | None = None) -> float:
    """Return car-steps per second of whole environment steps: physics, referee, reward, state.

    The cars are driven round the track and run into each other now and then, so contacts,
    restarts and the little driver's own few operations are in the figure.

    Args:
        num_worlds: worlds.
        num_cars: cars in each.
        together: what to wait at before the clock starts, if others are timed at once.
    """
    env, told = make(num_worlds, num_cars)

    def drive() -> None:
        nonlocal told
        for _ in range(STEPS):
            told = env.step(follow(told)).observations

    if together is not None:
        together.wait()
    taken = seconds(drive, repeats=3 if num_worlds > 4096 else 7)
    fastest = max(float(groups["state"][:, INDEX["speed_ahead"]].max()) for groups in told)
    assert 1.0 < fastest < 4.1, f"the fastest car moves at {fastest} m/s"
    return num_worlds * num_cars * STEPS / taken


_TOGETHER: list[Barrier] = []


def _begin(together: Barrier) -> None:
    torch.set_num_threads(1)
    _TOGETHER.append(together)


def _half(num_worlds: int) -> float:
    return rate(num_worlds, 2, _TOGETHER[0])


def on_two_cores(num_worlds: int) -> float:
    """Return car-steps per second of worlds of two cars, half of them in each of two processes."""
    context = multiprocessing.get_context("spawn")
    with context.Pool(2, _begin, (context.Barrier(2),)) as pool:
        return sum(pool.map(_half, [num_worlds // 2] * 2, chunksize=1))


def main() -> None:
    """Print the table."""
    heading("Planar worlds without cameras")
    print(machine())
    print("One torch thread: below some 30,000 cars a second one costs more than it brings.\n")
    torch.set_num_threads(1)
    rate(4096, 2)  # memory that is asked for the first time comes slowly
    one = rate(4096, 2)
    two = on_two_cores(4096)
    figure("4,096 worlds x 2 cars, on one core", one, "car-steps/s")
    figure("4,096 worlds x 2 cars, on two cores", two, "car-steps/s", 500_000)
    figure("  against one core", two / one, "times")
    print(
        "\n| worlds | cars | car-steps/s | us per car-step | ms per step | products of that shape |"
    )
    print("|--:|--:|--:|--:|--:|--:|")
    sizes = [(worlds, 2) for worlds in (1, 4, 16, 64, 256, 1024, 4096, 16384)]
    for worlds, cars in [*sizes, (1024, 1), (1024, 4), (1024, 8)]:
        steps = rate(worlds, cars)
        step_ms = 1000 * worlds * cars / steps
        products = step_ms / 1000 / product(worlds, cars)
        print(
            f"| {worlds:,} | {cars} | {steps:,.0f} | {1e6 / steps:.2f} | {step_ms:.2f} "
            f"| {products:,.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
