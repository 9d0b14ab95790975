"""How far the planar solver is from Bullet, and how fast they are: `python -m benchmarks solvers`.

Both drive the same car on the same tyres. The planar one keeps it flat and moves load between the
axles at once; in Bullet it stands on springs, leans and turns over.
"""

# The checker does not know the arguments of compiled functions.
# pyright: reportCallIssue=false

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from benchmarks.report import fastest, figure, heading, note, product, table
from league.agents.roster import NAMES, garage
from league.envs import step as stages
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.race_spec import CarResult, Entry, RaceSpec
from league.racing import race
from league.sim import records
from league.sim.config import SimConfig, SolverName
from league.track.track import Track, TrackSet

SEQUENCES, IMPACTS, BATCH = 200, 1000, 50
STEP_HZ = 15
SIZES = (1, 4, 16, 64, 256, 1024, 4096, 16384)
MOTION = list(records.CAR.names or ())[:13]
Controls = Callable[[int], np.ndarray]
"""Steering [rad] and speed [m/s] asked in a step, (num_worlds, num_cars, 2)."""


def open_floor() -> TrackSet:
    """Return a ring of a track of 20 m radius: all its inside is free for driving."""
    turn = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return TrackSet(Track("ring", "Ring", 20.0 * direction, 19.6 * direction, 20.4 * direction))


class Floor:
    """Worlds of which only the physics is stepped: no referee, no penalties."""

    def __init__(self, solver: SolverName, sim: SimConfig, num_worlds: int) -> None:
        self.name = solver
        self.env = RaceEnv(open_floor(), EnvConfig(sim=sim, solver=solver), num_worlds=num_worlds)
        self.cars, self.touched = self.env.world.cars, self.env._contacts

    def put(self, **motion: np.ndarray | float) -> None:
        """Put the cars at rest in the middle, but for the fields of motion given."""
        for name in (*MOTION, "target_steering", "target_speed"):
            self.cars[name] = motion.get(name, 0.0)
        if self.env._solver is not None:
            self.env._solver.reset()

    def step(self, controls: np.ndarray) -> None:
        """Move the cars through one control step."""
        env, world = self.env, self.env.world
        if env._solver is None:
            env._controls[:] = controls
            env._run(stages.PHYSICS, env._controls)
        else:
            env._solver.step(world, controls, self.touched)
        self.cars["target_steering"] = controls[..., 0]
        self.cars["target_speed"] = controls[..., 1]


@dataclass(frozen=True)
class Drive:
    """What some steps of many worlds brought."""

    cars: list[np.ndarray]
    """CAR records (num_worlds, num_cars) after each step."""
    touched: np.ndarray
    """Worlds in which the cars touched, bool."""


def drive(floor: Floor, controls: Controls, steps: int) -> Drive:
    """Step some worlds from where their cars are."""
    seen, touched = [], np.zeros(len(floor.cars), np.bool_)
    for k in range(steps):
        floor.step(controls(k))
        seen.append(floor.cars.copy())
        touched |= floor.touched["cars"].any(axis=1)
    return Drive(seen, touched)


def random_controls(count: int, steps: int) -> np.ndarray:
    """Return controls over the whole range of actions, (steps, count, 1, 2).

    Sums of four slow sines (up to 1.5 Hz), some of which ask for far more than the tyres give.
    """
    rng = np.random.default_rng(7)

    def wave(low: float, high: float) -> np.ndarray:
        rate, phase = rng.random((2, count, 4)) * 2 * math.pi * np.array([1.5, 1.0])[:, None, None]
        time = np.arange(steps).reshape(-1, 1, 1) / STEP_HZ
        unit = np.sin(time * rate + phase).sum(axis=2) * 0.6  # (steps, count)
        return (low + high) / 2 + unit.clip(-1, 1) * (high - low) / 2

    both = np.stack([wave(-math.pi / 6, math.pi / 6), wave(0.1, 4.0)], axis=-1)
    return both[:, :, None].astype(np.float32)


def apart(one: np.ndarray, two: np.ndarray, x: str, y: str) -> np.ndarray:
    """Return how far two fields of the cars are apart, as vectors."""
    return np.hypot(one[x] - two[x], one[y] - two[y]).ravel()


def spread(name: str, values: np.ndarray, unit: str) -> None:
    """Print the median and the 95th percentile."""
    figure(f"{name}, median", float(np.median(values)), unit)
    figure(f"{name}, 95th percentile", float(np.quantile(values, 0.95)), unit)


def open_loop() -> None:
    """Compare where 2 s of the same controls lead in both solvers."""
    sim, controls, ends = SimConfig(), random_controls(SEQUENCES, 30), []
    for name in ("planar", "bullet"):
        floor = Floor(name, sim, SEQUENCES)
        floor.put()
        ends.append(drive(floor, controls.__getitem__, 30).cars[-1])
        floor.env.close()
    travel = np.hypot(ends[0]["x"], ends[0]["y"])
    assert np.median(travel) > 1.0, "the cars did not go anywhere"
    assert (ends[1]["roll"] != 0).all(), "the cars did not lean"
    turned = (ends[0]["yaw"] - ends[1]["yaw"] + math.pi) % (2 * math.pi) - math.pi
    note(f"{SEQUENCES} drives of 2 s, median distance {np.median(travel):.1f} m")
    spread("open loop: between the ends", 100 * apart(*ends, "x", "y"), "cm")
    spread("open loop: turn between the ends", np.degrees(np.abs(turned)).ravel(), "deg")


def impacts() -> None:
    """Compare 1,000 impacts of two cars at all angles: velocities after it, places 1 s later."""
    sim, rng = SimConfig(kind="head_to_head", num_cars=2), np.random.default_rng(11)
    floors = [Floor(name, sim, BATCH) for name in ("planar", "bullet")]
    gaps, overturned, steps = [], [], (6, 21)  # the cars meet in the third step or so
    for _ in range(IMPACTS // BATCH):
        shape = (BATCH, 2)
        yaw, speed = rng.uniform(-math.pi, math.pi, shape), rng.uniform(1.5, 4.0, shape)
        velocity_x, velocity_y = speed * np.cos(yaw), speed * np.sin(yaw)
        motion = {
            "x": rng.uniform(-0.1, 0.1, shape) - 0.25 * velocity_x,
            "y": rng.uniform(-0.1, 0.1, shape) - 0.25 * velocity_y,
            **{"yaw": yaw, "velocity_x": velocity_x, "velocity_y": velocity_y},
        }
        asked = np.stack([np.zeros(shape), speed], axis=-1).astype(np.float32)
        driven = []
        for floor in floors:
            floor.put(**motion)
            driven.append(drive(floor, lambda _, asked=asked: asked, steps[1]))
        both = np.repeat(driven[0].touched & driven[1].touched, 2)
        after, later = ([one.cars[step - 1] for one in driven] for step in steps)
        rates = np.abs(after[0]["yaw_rate"] - after[1]["yaw_rate"]).ravel()
        velocities = apart(*after, "velocity_x", "velocity_y")
        gaps.append(np.stack([velocities, rates, apart(*later, "x", "y")])[:, both])
        overturned += np.abs(driven[1].cars[-1]["roll"]).max(axis=1)[both[::2]].tolist()
    for floor in floors:
        floor.env.close()
    velocities, rates, places = np.concatenate(gaps, axis=1)
    assert len(overturned) > 0.6 * IMPACTS, "most cars missed each other"
    note(f"{len(overturned)} of {IMPACTS} pairs touch in both solvers")
    spread("impacts: velocities after it differ by", velocities, "m/s")
    spread("impacts: yaw rates after it differ by", rates, "rad/s")
    spread("impacts: places one second later differ by", 100 * places, "cm")
    tipped = 100 * float(np.mean(np.array(overturned) > 1.0))
    figure("impacts: a car lies on its side or roof in Bullet", tipped, "%")


def raced(driver: str, solver: SolverName) -> CarResult:
    """Drive a time trial of six laps on reinvent_2018 and return how it ended."""
    spec = RaceSpec(kind="time_trial", laps=6, solver=solver, entries=(Entry(name=driver),))
    return race.run(spec, record=False).result.order[0]


def laps() -> None:
    """Print lap times and off-tracks in both solvers, and what Bullet costs."""
    row = table("driver", "planar, best lap", "off", "Bullet, best lap", "off", "longer by")
    losses = []
    for name in (*NAMES, *garage()):
        flat, real = raced(name, "planar"), raced(name, "bullet")
        assert flat.best_lap_s and real.best_lap_s, f"{name} completes no lap"
        losses.append(100 * (real.best_lap_s / flat.best_lap_s - 1))
        cells = (f"{flat.best_lap_s:.3f} s", flat.off_tracks)
        row(name, *cells, f"{real.best_lap_s:.3f} s", real.off_tracks, f"{losses[-1]:.2f} %")
    figure("largest loss of lap time in Bullet", max(losses), "%", 3, most=True)


def stepping(name: SolverName, num_worlds: int, num_cars: int, *, close: bool = False) -> float:
    """Return the seconds that one control step takes.

    Args:
        name: solver.
        num_worlds: worlds.
        num_cars: cars in each.
        close: whether the cars run side by side, rubbing; otherwise 1 m apart.
    """
    kind = "head_to_head" if num_cars > 1 else "time_trial"
    floor = Floor(name, SimConfig(kind=kind, num_cars=num_cars), num_worlds)
    floor.put(y=np.arange(num_cars) * (0.2 if close else 1.0), velocity_x=2.0)
    controls = np.full((num_worlds, num_cars, 2), 2.0, np.float32)
    controls[..., 0] = np.where(np.arange(num_cars) % 2 == 0, 0.1, -0.1) if close else 0.0
    seen = drive(floor, lambda _: controls, 3).cars[-1]
    taken = fastest(lambda: floor.step(controls), 30)
    assert (floor.cars["x"] - seen["x"]).min() > 2.0, "the cars do not drive at 2 m/s"
    floor.env.close()
    return taken


def speed() -> None:
    """Print what a control step costs."""
    for name, goal in (("planar", 0.1), ("bullet", 1.5)):
        free, rubbing = (stepping(name, 1, 2, close=close) * 1e3 for close in (False, True))
        figure(f"{name}: 1 world x 2 cars, apart", free, "ms/step", goal, most=True)
        figure(f"{name}: 1 world x 2 cars, rubbing", rubbing, "ms/step")
    row = table("worlds", "cars", "ms/step", "car-steps/s", "products of that shape")
    for worlds, cars in [(size, 2) for size in SIZES] + [(1024, 1), (1024, 4), (1024, 8)]:
        taken = stepping("planar", worlds, cars)
        rate, products = worlds * cars / taken, taken / product(worlds, cars)
        row(f"{worlds:,}", cars, f"{taken * 1e3:.2f}", f"{rate:,.0f}", f"{products:,.0f}")


def main() -> None:
    """Print disagreement and speed."""
    heading("Solvers: planar against Bullet")
    open_loop()
    impacts()
    laps()
    heading("Solvers: speed (physics alone)")
    speed()


if __name__ == "__main__":
    main()
