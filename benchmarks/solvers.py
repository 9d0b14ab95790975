"""How far the two solvers disagree, and how fast each steps: `python -m benchmarks.solvers`.

Both run the same car; they differ in arithmetic (torch in float32, Bullet in float64), and in how
contacts are found and solved. Without contact the paths must agree; in contact the outcome must.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from benchmarks.report import fastest, figure, heading, machine, product
from league.sim import grid, solvers
from league.sim.config import SimConfig, SolverName
from league.sim.world import Control, Motion, World
from league.track.course import Track, TrackSet

SEQUENCES, SHOVES = 200, 100
SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16384)


def open_floor() -> TrackSet:
    """Return a ring of a track of 20 m radius: all its inside is free for driving."""
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    ring = Track("ring", "Ring", 20.0 * direction, 19.6 * direction, 20.4 * direction)
    return TrackSet.of(ring)


def standing(sim: SimConfig, tracks: TrackSet, num_worlds: int, **motion: Tensor) -> World:
    """Return cars at rest in the middle of the floor, but for the fields of Motion given."""
    seed = torch.arange(num_worlds)
    world = grid.start(tracks, sim, seed, torch.zeros_like(seed))
    blank = torch.zeros_like(world.motion.x)
    names = ("x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate", "steering")
    return replace(world, motion=Motion(**(dict.fromkeys(names, blank) | motion)))


@dataclass(frozen=True)
class Drive:
    """How worlds ended, and which cars touched on the way."""

    motion: Motion
    touched: Tensor
    largest_slip: Tensor
    """Largest angle between heading and movement above 0.5 m/s [rad]."""


def drive(name: SolverName, sim: SimConfig, world: World, controls: list[Control]) -> Drive:
    """Apply the controls one after another."""
    physics = solvers.make(name, sim, open_floor(), world.num_worlds)
    touched = torch.zeros(world.num_worlds, dtype=torch.bool)
    slip = torch.zeros_like(world.motion.x)
    for control in controls:
        outcome = physics.step(world, control)
        touched |= outcome.contacts.cars.flatten(1).any(dim=1)
        m = outcome.motion
        ahead = torch.cos(m.yaw) * m.velocity_x + torch.sin(m.yaw) * m.velocity_y
        left = torch.cos(m.yaw) * m.velocity_y - torch.sin(m.yaw) * m.velocity_x
        fast = torch.hypot(ahead, left) > 0.5
        slip = torch.where(fast, torch.maximum(slip, torch.atan2(left, ahead).abs()), slip)
        world = replace(world, motion=m, control=control)
    physics.close()
    return Drive(world.motion, touched, slip)


def random_controls(count: int, steps: int) -> list[Control]:
    """Return smooth random sequences over the whole range of actions, one for each world.

    Sums of four slow sines (up to 1.5 Hz), some of which ask for far more than the tyres give.
    """
    generator = torch.Generator().manual_seed(7)

    def wave(low: float, high: float) -> Tensor:
        rate = torch.rand((count, 4), generator=generator) * 2 * math.pi * 1.5
        phase = torch.rand((count, 4), generator=generator) * 2 * math.pi
        time = torch.arange(steps).reshape(-1, 1, 1) / 15
        unit = torch.sin(time * rate + phase).sum(dim=2) * 0.6  # (steps, count)
        return (low + high) / 2 + torch.clamp(unit, -1, 1) * (high - low) / 2

    steering, speed = wave(-math.pi / 6, math.pi / 6), wave(0.1, 4.0)
    return [Control(steering[k].unsqueeze(1), speed[k].unsqueeze(1)) for k in range(steps)]


def open_loop() -> None:
    """Compare where 2 s of the same controls lead in both solvers."""
    sim, tracks = SimConfig(kind="time_trial"), open_floor()
    world = standing(sim, tracks, SEQUENCES)
    controls = random_controls(SEQUENCES, 30)
    planar, bullet = (drive(name, sim, world, controls) for name in ("planar", "bullet"))
    one, two = planar.motion, bullet.motion
    apart = torch.hypot(one.x - two.x, one.y - two.y).flatten()
    turned = torch.rad2deg((one.yaw - two.yaw + math.pi) % (2 * math.pi) - math.pi).abs().flatten()
    travel = torch.hypot(one.x, one.y)
    sliding = (planar.largest_slip > math.radians(20)).float().mean().item()
    assert travel.median() > 1.0, "the cars did not go anywhere"
    assert sliding > 0.1, "no car slid: the comparison is too easy"
    print(f"{SEQUENCES} sequences of 2 s, median distance {travel.median():.1f} m, ", end="")
    print(f"{sliding:.0%} slid by more than 20 deg, {(planar.largest_slip > 1.57).sum()} spun")
    figure("open loop: largest distance of the ends", apart.max().item() * 100, "cm", 2, most=True)
    figure("open loop: 95th percentile", apart.quantile(0.95).item() * 100, "cm")
    figure("open loop: largest turn between the ends", turned.max().item(), "deg", 1, most=True)
    figure("open loop: 95th percentile", turned.quantile(0.95).item(), "deg")


def shoves() -> None:
    """Compare who is ahead after 100 shoves: cars side by side steer into each other for 1 s."""
    sim, tracks = SimConfig(kind="head_to_head", num_cars=2), open_floor()
    generator = torch.Generator().manual_seed(11)

    def draw(low: float, high: float) -> Tensor:
        return low + torch.rand((SHOVES, 1), generator=generator) * (high - low)

    nothing, speed = torch.zeros((SHOVES, 1)), draw(1.0, 3.0)
    world = standing(
        sim,
        tracks,
        SHOVES,
        x=torch.cat((nothing, draw(-0.05, 0.05)), dim=1),
        y=torch.cat((nothing, draw(0.22, 0.30)), dim=1),
        velocity_x=torch.cat((speed, speed + draw(-0.3, 0.3)), dim=1),
    )
    steering = torch.cat((draw(0.05, 0.4), -draw(0.05, 0.4)), dim=1)
    targets = torch.cat((speed, speed), dim=1) + 0.5
    controls = [Control(steering, targets)] * 15
    planar, bullet = (drive(name, sim, world, controls) for name in ("planar", "bullet"))
    assert (planar.touched & bullet.touched).sum() >= 0.9 * SHOVES, "the cars missed each other"
    lead = [ended.motion.x[:, 0] - ended.motion.x[:, 1] for ended in (planar, bullet)]
    same = int(((lead[0] > 0) == (lead[1] > 0)).sum())
    assert 20 <= int((lead[1] > 0).sum()) <= 80, "one side always wins: the set says nothing"
    start = world.motion.x[:, 0] - world.motion.x[:, 1]
    kept = int(((start > 0) == (lead[1] > 0)).sum())
    print(f"{SHOVES} shoves; who led before still leads after it in {kept} (Bullet)")
    figure("shoves: same car ahead in both solvers", same, f"of {SHOVES}", 85)
    gap = (lead[0] - lead[1]).abs()
    figure("shoves: median difference of the lead", gap.median().item() * 100, "cm")


def stepping(name: SolverName, num_worlds: int, num_cars: int, *, close: bool = False) -> float:
    """Return the seconds that one control step takes.

    Args:
        name: solver.
        num_worlds: worlds.
        num_cars: cars in each.
        close: whether the cars run side by side, rubbing; otherwise 1 m apart.
    """
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    sim, tracks = SimConfig(kind=kind, num_cars=num_cars), open_floor()
    spread = torch.arange(num_cars) * (0.2 if close else 1.0)
    y = spread.expand(num_worlds, -1).contiguous().to(torch.float32)
    speed = torch.full_like(y, 2.0)
    world = standing(sim, tracks, num_worlds, y=y, velocity_x=speed)
    towards = torch.where(torch.arange(num_cars) % 2 == 0, 0.1, -0.1) * torch.ones_like(y)
    control = Control(towards if close else torch.zeros_like(y), speed)
    physics = solvers.make(name, sim, tracks, num_worlds)
    with torch.inference_mode():
        for _ in range(3):
            world = replace(world, motion=physics.step(world, control).motion)
        outcome = physics.step(world, control)
        taken = fastest(lambda: physics.step(world, control), 30)
    moved = (outcome.motion.x - world.motion.x) * sim.step_hz
    assert moved.min() > 1.5 and moved.max() < 2.5, "the cars do not drive at 2 m/s"
    assert outcome.contacts.cars.any() == (close and num_cars > 1), "cars touch, or fail to"
    physics.close()
    return taken


def speed() -> None:
    """Print what a control step of 8 physics steps costs."""
    print(machine(), f"threads {torch.get_num_threads()}")
    for name in ("planar", "bullet"):
        figure(
            f"{name}: 1 world x 2 cars, apart", stepping(name, 1, 2) * 1e3, "ms/step", 3, most=True
        )
        rubbing = stepping(name, 1, 2, close=True) * 1e3
        figure(f"{name}: 1 world x 2 cars, rubbing", rubbing, "ms/step")
    figure(
        "planar: 4,096 worlds x 2 cars, apart",
        stepping("planar", 4096, 2) * 1e3,
        "ms/step",
        9,
        most=True,
    )
    figure(
        "planar: 4,096 worlds x 2 cars, all rubbing",
        stepping("planar", 4096, 2, close=True) * 1e3,
        "ms/step",
    )
    print("\n| worlds | cars | ms/step | car-steps/s | products of that shape |")
    print("|--:|--:|--:|--:|--:|")
    for worlds, cars in [(size, 2) for size in SIZES] + [(1024, 1), (1024, 4), (1024, 8)]:
        taken = stepping("planar", worlds, cars)
        rate, products = worlds * cars / taken, taken / product(worlds, cars)
        print(f"| {worlds:,} | {cars} | {taken * 1e3:.2f} | {rate:,.0f} | {products:,.0f} |")


def main() -> None:
    """Print disagreement and speed."""
    heading("Solvers: planar against Bullet")
    open_loop()
    shoves()
    heading("Solvers: speed (physics alone)")
    speed()


if __name__ == "__main__":
    main()
