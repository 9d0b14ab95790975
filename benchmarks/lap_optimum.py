"""The fastest flying lap that the simulated car itself could drive, on every closed shipped track.

Where `lap_bound` (racing_line/racing_line.py) has a point, this has the car of
sim/physics/vehicle.py: inertia, two axles, brush tyres, load that moves with drive and brakes, a
steering that takes time. Its base may be where the point's may. The lap is found by direct
collocation (J. Betts, Practical Methods for Optimal Control and Estimation, chapter 4): states and
controls at each 10 cm of road, the trapezoidal rule between them, time minimised by an
interior-point method. It decides at each of these points, where drivers decide 15 times a second,
so they cannot quite reach it.

Whether the equations here are the simulator's is checked by driving the lap piece by piece with the
forces of vehicle.py, with its controls and nothing that corrects them.

Needs the extra `optimum`: pip install -c constraints.txt -e '.[optimum]'.
"""

# The checker does not know the arguments of compiled functions.
# pyright: reportCallIssue=false

from __future__ import annotations

import importlib.util
import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.interpolate import CubicSpline

from benchmarks.report import heading, note, table
from league.racing_line.racing_line import lap_bound, road_of
from league.sim import records
from league.sim.config import CarConfig, SimConfig
from league.sim.physics.vehicle import DRIVE_SHARE, push
from league.sim.settings import GRAVITY, settings
from league.track.track import Track, TrackSet

SPACING = 0.1
"""Distance between two points of a lap along the centreline [m]."""
STATES, CONTROLS = 6, 2
SMOOTH = 0.01
"""Where |z| of a tyre is rounded off, so that it has derivatives."""


@dataclass(frozen=True, eq=False)
class Lap:
    """A lap at N points; all arrays but the road's float64."""

    road: np.ndarray
    """The points, ROAD records (N,)."""
    time: float
    """Of the whole lap [s]."""
    lasts: np.ndarray
    """Time from each point to the next [s], (N,)."""
    states: np.ndarray
    """Lateral offset [m], yaw against the road [rad], speed ahead and to the left [m/s], yaw rate
    [rad/s] and angle of the front wheels [rad] at each point, (N, 6)."""
    controls: np.ndarray
    """Change of that angle [rad/s] and drive [m/s^2] from each point to the next, (N, 2)."""


def lap_optimum(track: Track, car: CarConfig) -> Lap:
    """Return the fastest lap found.

    Args:
        track: a closed course.
        car: the car.

    Raises:
        RuntimeError: the solver has found none.
    """
    import casadi as ca  # the extra `optimum`

    road = road_of(TrackSet(track), SPACING, -car.wheel_track / 2)
    bend, gap = _shape(road)
    count = len(gap)
    state, control, curvature = ca.MX.sym("x", STATES), ca.MX.sym("u", CONTROLS), ca.MX.sym("k")
    rates = ca.Function(
        "rates", [state, control, curvature], _rates(state, control, curvature, car)
    )
    states, controls = ca.MX.sym("X", STATES, count), ca.MX.sym("U", CONTROLS, count)
    after = [*range(1, count), 0]
    here = rates.map(count)(states, controls, bend[None])
    there = rates.map(count)(states[:, after], controls, bend[after][None])
    half = ca.DM(gap[None] / 2)
    lasts = (here[1] + there[1]) * half
    missed = states[:, after] - states - (here[0] + there[0]) * ca.repmat(half, STATES, 1)
    unknown = ca.vertcat(ca.vec(states), ca.vec(controls))
    # Of laps that are equally fast, the one with the calmest controls.
    restless = ca.sumsqr(controls[:, after] - controls)
    shares = ca.vertcat(ca.vec(here[2]), ca.vec(there[2]))
    solve = ca.nlpsol(
        "lap",
        "ipopt",
        {
            "x": unknown,
            "f": ca.sum2(lasts) + 1e-5 * restless,
            "g": ca.vertcat(ca.vec(missed), shares),
        },
        {
            "ipopt": {"print_level": 0, "sb": "yes", "max_iter": 1000},
            "print_time": False,
            "show_eval_warnings": False,  # a step too far is taken back
        },
    )
    least, most = _limits(road, car)
    zeros, ones = np.zeros(STATES * count), np.ones(shares.shape[0])
    found = solve(
        x0=_first_guess(road, bend, car),
        lbx=least,
        ubx=most,
        lbg=np.concatenate([zeros, -ones]),
        ubg=np.concatenate([zeros, ones]),
    )
    if not solve.stats()["success"]:
        raise RuntimeError(f"no lap of {track.name} was found: {solve.stats()['return_status']}")
    values = np.asarray(found["x"]).ravel()
    taken = np.asarray(ca.Function("lasts", [unknown], [lasts])(values)).ravel()
    cut = STATES * count
    return Lap(
        road=road,
        time=float(taken.sum()),
        lasts=taken,
        states=values[:cut].reshape(count, STATES),
        controls=values[cut:].reshape(count, CONTROLS),
    )


def _rates(state, control, curvature, car: CarConfig) -> list:
    """Return what vehicle.py does, for each metre of road, as expressions.

    First the states' change, then time [s/m], then shares of what there is: of each tyre's z and of
    the grip that each axle's drive may take.
    """
    import casadi as ca

    offset, yaw, ahead, left, turn, steering = (state[row] for row in range(STATES))
    steer, drive = control[0], control[1]
    arm, push, pushes, shares = car.wheelbase / 2, drive * car.mass / 2, [], []
    cos, sin = ca.cos(steering), ca.sin(steering)
    moved = drive * car.mass * car.mass_height / car.wheelbase
    front, rear = left + turn * arm, left - turn * arm
    for load, rolling, sliding in (
        (car.mass * GRAVITY / 2 - moved, cos * ahead + sin * front, cos * front - sin * ahead),
        (car.mass * GRAVITY / 2 + moved, ahead, rear),
    ):
        grip = car.grip * load
        rest = ca.sqrt(grip * grip - push * push)
        z = sliding / rolling * load * car.cornering_stiffness / (3 * rest)
        size = ca.sqrt(z * z + SMOOTH**2)
        pushes.append(-rest * z * (size * (size - 3) + 3))
        shares += [z, push / grip / float(DRIVE_SHARE)]
    aside = sin * push + cos * pushes[0]
    along = (ahead * ca.cos(yaw) - left * ca.sin(yaw)) / (1 - offset * curvature)
    change = ca.vertcat(
        ahead * ca.sin(yaw) + left * ca.cos(yaw),
        turn - curvature * along,
        (cos * push - sin * pushes[0] + push) / car.mass + left * turn,
        (aside + pushes[1]) / car.mass - ahead * turn,
        (aside - pushes[1]) * arm / car.yaw_inertia,
        steer,
    )
    return [change / along, 1 / along, ca.vertcat(*shares)]


def _shape(road: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the road's curvature [1/m] and its length from each point to the next [m]."""
    knots = np.append(road["s"], 2 * road["s"][-1] - road["s"][-2])
    points = np.stack(
        [np.append(road["x"], road["x"][0]), np.append(road["y"], road["y"][0])], axis=1
    )
    curve = CubicSpline(knots, points, bc_type="periodic")
    slope, bent = curve(road["s"], 1), curve(road["s"], 2)
    pace = np.hypot(*slope.T)
    bend = (slope[:, 0] * bent[:, 1] - slope[:, 1] * bent[:, 0]) / pace**3
    between = np.hypot(*curve((knots[1:] + knots[:-1]) / 2, 1).T)
    return bend, np.diff(knots) * (pace + 4 * between + np.roll(pace, -1)) / 6


def _limits(road: np.ndarray, car: CarConfig) -> tuple[np.ndarray, np.ndarray]:
    """Return the least and largest value of every unknown."""
    count = len(road["s"])
    highest = [math.pi / 3, car.max_speed, 2.0, 12.0, car.max_steering]
    lowest = [-math.pi / 3, 0.5, *(-value for value in highest[2:])]
    least = np.column_stack([road["low"], np.tile(lowest, (count, 1))])
    most = np.column_stack([road["high"], np.tile(highest, (count, 1))])
    slowest, fastest = (
        [-car.steering_rate, -car.max_braking],
        [car.steering_rate, car.max_acceleration],
    )
    return (
        np.concatenate([least.ravel(), np.tile(slowest, count)]),
        np.concatenate([most.ravel(), np.tile(fastest, count)]),
    )


def _first_guess(road: np.ndarray, bend: np.ndarray, car: CarConfig) -> np.ndarray:
    """Return the middle of the road, driven slowly."""
    zeros = np.zeros_like(bend)
    speed = zeros + 1.5
    states = [road["aside"], zeros, speed, zeros, 1.5 * bend, np.arctan(car.wheelbase * bend)]
    return np.concatenate([np.column_stack(states).ravel(), np.zeros(CONTROLS * len(bend))])


def strays(lap: Lap, car: CarConfig, steps: int = 40) -> tuple[float, float]:
    """Return how far the simulator's car is from the next point at most, in place and in speed.

    Each piece is driven by itself, from the lap's own state and with its controls.

    Args:
        lap: what was found.
        car: its car.
        steps: physics steps for each piece.

    Returns:
        Largest distance [m], and largest difference of velocity [m/s].
    """
    road, world = lap.road, settings(SimConfig(car=car, step_hz=1000, decimation=1))[0]
    across = np.arctan2(road["normal_y"], road["normal_x"]) - math.pi / 2
    states = lap.states.copy()
    states[:, 1] += across
    cos, sin = np.cos(states[:, 1]), np.sin(states[:, 1])
    begun = np.column_stack(
        [
            road["x"] + states[:, 0] * road["normal_x"],
            road["y"] + states[:, 0] * road["normal_y"],
            states[:, 1],
            cos * states[:, 2] - sin * states[:, 3],
            sin * states[:, 2] + cos * states[:, 3],
            states[:, 4],
            states[:, 5],
        ]
    )
    row = np.zeros(1, records.CAR)
    row["grip"], row["mass"] = car.grip, car.mass
    limits = (car.mass, car.yaw_inertia, car.speed_gain)
    driven = np.array(
        [
            _driven(row, world, start, *control, lasts / steps, steps, limits)
            for start, control, lasts in zip(begun, lap.controls, lap.lasts, strict=True)
        ]
    )
    off = driven - np.roll(begun, -1, axis=0)
    return float(np.hypot(off[:, 0], off[:, 1]).max()), float(np.hypot(off[:, 3], off[:, 4]).max())


@njit(error_model="numpy")
def _driven(row, settings, begun, steer, drive, dt, steps, limits):
    """Return x, y, yaw, velocity x and y, yaw rate and steering after a piece, (7,)."""
    mass, inertia, gain = limits
    now, car = begun.copy(), row[0]
    for _ in range(steps):
        car.x, car.y, car.yaw, car.velocity_x = now[0], now[1], now[2], now[3]
        car.velocity_y, car.yaw_rate, car.steering = now[4], now[5], now[6]
        rolling = math.cos(now[2]) * now[3] + math.sin(now[2]) * now[4]
        pushed = push(car, settings, np.float32(now[6]), np.float32(rolling + drive / gain))
        now[3] += dt * pushed.force_x / mass
        now[4] += dt * pushed.force_y / mass
        now[5] += dt * pushed.torque / inertia
        now[0], now[1] = now[0] + dt * now[3], now[1] + dt * now[4]
        now[2], now[6] = now[2] + dt * now[5], now[6] + dt * steer
    return now


def main() -> None:
    """Print the fastest lap next to the bound of a point."""
    from league.track import files

    car = CarConfig()
    heading("The fastest flying lap of the car itself")
    if importlib.util.find_spec("casadi") is None:
        note("Not measured: pip install -c constraints.txt -e '.[optimum]' brings what it needs.")
        return
    row = table("track", "bound", "optimum", "ratio", "ends of 10 cm are off by")
    for name in files.names():
        track = files.load(name)
        if not track.closed:
            continue
        bound, lap = lap_bound(track, car), lap_optimum(track, car)
        place, speed = strays(lap, car)
        laps = f"{bound:.3f} s", f"{lap.time:.3f} s", f"{lap.time / bound:.3f}"
        row(name, *laps, f"{1000 * place:.1f} mm, {speed:.3f} m/s")


if __name__ == "__main__":
    main()
