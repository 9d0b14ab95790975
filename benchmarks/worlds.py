"""How fast worlds step: planar worlds without cameras, from 1 to 16,384, and by number of cars."""

import torch

from benchmarks.report import figure, heading, machine, seconds
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.sim.config import SimConfig
from league.track import files
from league.track.course import TrackSet

STEPS = 10


def make(num_worlds: int, num_cars: int) -> tuple[RaceEnv, torch.Tensor]:
    """Return worlds on their way, spread round the track, and the action they repeat."""
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    cfg = EnvConfig(sim=SimConfig(kind=kind, num_cars=num_cars), solver="planar", mode="training")
    env = RaceEnv(TrackSet.of(files.load("reinvent_2018")), cfg, num_worlds=num_worlds)
    actions = torch.zeros((num_worlds, num_cars, 2))
    actions[..., 1] = -0.3
    for _ in range(15):
        env.step(actions)
    return env, actions


def rate(num_worlds: int, num_cars: int) -> float:
    """Return car-steps per second of whole environment steps: physics, referee, reward, state."""
    env, actions = make(num_worlds, num_cars)

    def drive() -> None:
        for _ in range(STEPS):
            env.step(actions)

    taken = seconds(drive, repeats=3 if num_worlds > 4096 else 5)
    body = env.world.motion
    fastest = float(torch.maximum(*(v.abs() for v in (body.velocity_x, body.velocity_y))).max())
    assert 0.1 < fastest < 5.0, f"the fastest car moves at {fastest} m/s"
    return num_worlds * num_cars * STEPS / taken


def main() -> None:
    """Print the table."""
    heading("Planar worlds without cameras")
    print(machine(), f"threads {torch.get_num_threads()}")
    figure("4,096 worlds x 2 cars", rate(4096, 2), "car-steps/s", 500_000)
    print("\n| worlds | cars | car-steps/s | us per car-step |\n|--:|--:|--:|--:|")
    for worlds, cars in [(w, 2) for w in (1, 4, 16, 64, 256, 1024, 4096, 16384)] + [
        (1024, 1),
        (1024, 4),
        (1024, 8),
    ]:
        steps = rate(worlds, cars)
        print(f"| {worlds:,} | {cars} | {steps:,.0f} | {1e6 / steps:.2f} |", flush=True)


if __name__ == "__main__":
    main()
