"""The search for the fastest line: sequential linear programming on offsets and speeds together.

It minimises TIME, not curvature: each round linearises lateral offsets and squared speeds about the
last line, solves, and keeps the answer if the exact forward-backward pass says that it is faster.
Lines are smooth curves beside a smoothed centreline, coarse ones first, then finer ones.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, hstack, vstack

from league.agents.pace import Limits, spare_grip, speed_profile, travel_time
from league.track.course import Track

ELLIPSE_SIDES = 20
"""Sides of the polygon that stands for the friction ellipse while the line is sought."""
FOLD = 0.8
"""Largest curvature times lateral offset: beyond, lines across a bend would run backwards."""
SMOOTH = 0.4
"""Width of the average that takes kinks out of the centreline before lines are sought [m]."""


@dataclass(frozen=True, eq=False)
class Road:
    """The track where the line is sought; arrays of shape (N,)."""

    s: np.ndarray
    """Distance along the centreline [m]."""
    x: np.ndarray
    """Smoothed centreline, world frame [m]."""
    y: np.ndarray
    """Smoothed centreline, world frame [m]."""
    normal_x: np.ndarray
    """Unit normal of it to the left."""
    normal_y: np.ndarray
    """Unit normal of it to the left."""
    low: np.ndarray
    """Smallest lateral offset from it [m]."""
    high: np.ndarray
    """Largest lateral offset from it [m]."""
    aside: np.ndarray
    """Where the centreline itself lies beside it [m]."""
    closed: bool
    """Whether the last point is followed by the first."""

    @classmethod
    def of(cls, track: Track, spacing: float, margin: float) -> Road:
        """Sample a track at about this spacing, keeping a margin to its borders [m]."""
        step = track.length / max(8, round(track.length / spacing))
        count = round(track.length / step)
        s = np.arange(count if track.closed else count + 1) * step
        smooth = spline(track, _smoothed(track))
        center, slope = smooth(s), smooth(s, 1)
        normal = np.stack([-slope[:, 1], slope[:, 0]], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        aside = ((spline(track, track.center)(s) - center) * normal).sum(axis=1)
        left = spline(track, np.linalg.norm(track.left - track.center, axis=1))(s)
        right = spline(track, np.linalg.norm(track.right - track.center, axis=1))(s)
        low = aside - np.maximum(right - margin, 0.0)
        high = aside + np.maximum(left - margin, 0.0)
        twist = smooth(s, 2)
        own = (slope[:, 0] * twist[:, 1] - slope[:, 1] * twist[:, 0]) / np.hypot(*slope.T) ** 3
        for bend, shift in ((own, 0.0), (spline(track, track.curvature)(s), aside)):
            fold = FOLD / np.maximum(np.abs(bend), 1e-9)
            low = np.where(bend < 0, np.maximum(low, shift - fold), low)
            high = np.where(bend > 0, np.minimum(high, shift + fold), high)
        return cls(
            s=s,
            x=center[:, 0],
            y=center[:, 1],
            normal_x=normal[:, 0],
            normal_y=normal[:, 1],
            low=np.minimum(low, high),
            high=np.maximum(low, high),
            aside=aside,
            closed=track.closed,
        )

    def before(self, values: np.ndarray) -> np.ndarray:
        """Values of the previous point; an open road is prolonged straight on."""
        shifted = np.roll(values, 1)
        if not self.closed:
            shifted[0] = 2 * values[0] - values[1]
        return shifted

    def after(self, values: np.ndarray) -> np.ndarray:
        """Values of the next point."""
        shifted = np.roll(values, -1)
        if not self.closed:
            shifted[-1] = 2 * values[-1] - values[-2]
        return shifted

    def bend_and_gap(
        self, back: np.ndarray, here: np.ndarray, ahead: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return curvature (circle through three points) and distance to the next point."""
        px, py = self.x + here * self.normal_x, self.y + here * self.normal_y
        ax = self.after(self.x) + ahead * self.after(self.normal_x) - px
        ay = self.after(self.y) + ahead * self.after(self.normal_y) - py
        bx = px - self.before(self.x) - back * self.before(self.normal_x)
        by = py - self.before(self.y) - back * self.before(self.normal_y)
        a, b = np.hypot(ax, ay), np.hypot(bx, by)
        return 2 * (bx * ay - by * ax) / (a * b * np.hypot(ax + bx, ay + by)), a

    def measure(self, lateral: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return curvature and distances of a line; an open one has one distance less."""
        bend, gap = self.bend_and_gap(self.before(lateral), lateral, self.after(lateral))
        return bend, gap if self.closed else gap[:-1]


def fastest(
    road: Road, limits: Limits, knot_spacing: float, rounds: int, curvature_rate: float
) -> np.ndarray:
    """Return the lateral offsets [m] of the fastest line found, (N,).

    Args:
        road: where to seek it.
        limits: what the car can do.
        knot_spacing: distance between the knots of the smooth curves it is made of [m].
        rounds: most rounds of linear programming for each fineness.
        curvature_rate: largest change of curvature along the line [1/m per m].
    """
    lateral = np.clip(np.zeros_like(road.s), road.low, road.high)
    for spacing in (2 * knot_spacing, knot_spacing):
        curves = _basis(len(road.s), road.s[1] - road.s[0], spacing, road.closed)
        lateral = _descend(road, limits, curves, lateral, rounds, curvature_rate)
    return lateral


def _descend(
    road: Road,
    limits: Limits,
    curves: csr_array,
    lateral: np.ndarray,
    rounds: int,
    curvature_rate: float,
) -> np.ndarray:
    """Return the best line of several rounds; a slightly slower one may be a step to a faster."""
    best = here = _cost(road, lateral, limits)
    winner, reach = lateral, 0.5
    for _ in range(rounds):
        tried = _linear_round(road, lateral, limits, curves, reach, curvature_rate)
        cost = _cost(road, tried, limits) if tried is not None else np.inf
        if cost > here - 1e-3 * best:
            reach *= 0.6
        if tried is None:
            continue
        if cost < 1.005 * best:
            lateral, here = tried, cost
        if cost < best:
            best, winner = cost, tried
        if reach < 0.03:
            break
    return winner


def _basis(count: int, step: float, knot_spacing: float, closed: bool) -> csr_array:
    """Return uniform cubic B-splines at the points, (N, number of knots); rows sum to 1."""
    cells = max(4, round((count if closed else count - 1) * step / knot_spacing))
    place = np.arange(count) * (cells / (count if closed else count - 1))
    cell = np.minimum(place.astype(int), cells - 1)
    u = place - cell
    weights = [(1 - u) ** 3, 3 * u**3 - 6 * u**2 + 4, -3 * u**3 + 3 * u**2 + 3 * u + 1, u**3]
    columns = [(cell + k) % cells if closed else cell + k for k in range(4)]
    rows = np.tile(np.arange(count), 4)
    shape = (count, cells if closed else cells + 3)
    values = np.concatenate(weights) / 6
    return csr_array((values, (rows, np.concatenate(columns))), shape=shape)


def _cost(road: Road, lateral: np.ndarray, limits: Limits) -> float:
    """Return the time of a line [s], with a price on bends tighter than the steering allows."""
    bend, gap = road.measure(lateral)
    excess = np.maximum(np.abs(bend) - limits.curvature, 0.0)
    return travel_time(speed_profile(bend, gap, limits, road.closed), gap) + float(excess.sum())


def _linear_round(
    road: Road,
    lateral: np.ndarray,
    limits: Limits,
    curves: csr_array,
    reach: float,
    curvature_rate: float,
) -> np.ndarray | None:
    """Solve the problem linearised about a line; None if the solver finds no answer.

    Unknowns: changes of the lateral offset n, as a sum of smooth curves, and of the squared speed e
    at every point. With curvature k and distance d to the next point: lateral acceleration k e,
    longitudinal acceleration (e' - e) / 2 d. `reach` bounds the change of curvature [1/m].
    """
    bend, gap = road.measure(lateral)
    energy = speed_profile(bend, gap, limits, road.closed) ** 2
    gap = gap if road.closed else np.append(gap, gap[-1])
    bend_by, gap_by = (slope @ curves for slope in _slopes(road, lateral))
    step = _step(len(lateral), road.closed)
    rise = step @ energy / (2 * gap)
    along = hstack([_scaled(-rise / gap, gap_by), _scaled(0.5 / gap, step)], format="csr")
    across = hstack([_scaled(energy, bend_by), diags_array(bend)], format="csr")
    nothing = csr_array((len(lateral), len(lateral)))
    offsets, bends = (hstack([rows, nothing], format="csr") for rows in (curves, bend_by))
    turns = hstack([step @ bend_by, nothing], format="csr")
    turn, most_turn = step @ bend, curvature_rate * float(gap.mean())
    parts = [
        (along, limits.acceleration - rise),
        (-along, limits.braking + rise),
        (bends, np.minimum(limits.curvature - bend, reach)),
        (-bends, np.minimum(limits.curvature + bend, reach)),
        (turns, most_turn - turn),
        (-turns, most_turn + turn),
        (offsets, road.high - lateral),
        (-offsets, lateral - road.low),
    ]
    for slope_a, slope_y, most in _grip_sides(limits):
        room = most - slope_a * rise - slope_y * bend * energy
        parts.append((slope_a * along + slope_y * across, room))
    shape = curves.shape
    assert shape is not None  # the sparse arrays' type hints say it may be
    free = np.full(shape[1], 0.5)
    answer = linprog(
        _time_slopes(gap, gap_by, energy, road.closed),
        A_ub=vstack([rows for rows, _ in parts], format="csc"),
        # A line that breaks a limit now may stay as it is, but not get worse.
        b_ub=np.concatenate([np.maximum(room, 0.0) for _, room in parts]),
        bounds=np.stack(
            [
                np.concatenate([-free, -0.9 * energy]),
                np.concatenate([free, limits.speed**2 - energy + 1e-9]),
            ],
            axis=1,
        ),
        method="highs",
    )
    found = answer.x
    if found is None or not answer.success:
        return None
    change = curves @ found[: len(free)]
    return np.clip(lateral + change, road.low, road.high)


def _grip_sides(limits: Limits) -> list[tuple[float, float, float]]:
    """Return tangents p a + q y <= r to what the tyres can give along (a) and across (y)."""
    sides = []
    for angle in np.linspace(0, np.pi / 2, ELLIPSE_SIDES // 4 + 1):
        y = limits.lateral * float(np.sin(angle))
        a = spare_grip(y, limits.lateral, limits.transfer)
        p = a + limits.lateral**2 * limits.transfer * (1 - limits.transfer * a)
        norm = float(np.hypot(p, y))
        for sign_a in (1, -1):
            sides += [
                (sign_a * p / norm, sign_y * y / norm, (p * a + y * y) / norm) for sign_y in (1, -1)
            ]
    return sorted(set(sides))


def _slopes(road: Road, lateral: np.ndarray) -> tuple[csr_array, csr_array]:
    """Return the derivatives of curvature and of distance by the lateral offsets, (N, N) each."""
    count, tiny = len(lateral), 1e-6
    points = [road.before(lateral), lateral, road.after(lateral)]
    here = np.arange(count)
    columns = [(here - 1) % count, here, (here + 1) % count]
    bend_by, gap_by = csr_array((count, count)), csr_array((count, count))
    for which, column in enumerate(columns):
        moved = [p + tiny * (i == which) for i, p in enumerate(points)]
        back = [p - tiny * (i == which) for i, p in enumerate(points)]
        (bend_1, gap_1), (bend_0, gap_0) = road.bend_and_gap(*moved), road.bend_and_gap(*back)
        inside = np.full(count, road.closed) | (column == here + which - 1)
        for name, change in (("bend", bend_1 - bend_0), ("gap", gap_1 - gap_0)):
            values = np.where(inside, change / (2 * tiny), 0.0)
            part = csr_array((values, (here, column)), shape=(count, count))
            if name == "bend":
                bend_by = bend_by + part
            else:
                gap_by = gap_by + part
    return bend_by, gap_by


def _time_slopes(
    gap: np.ndarray, gap_by: csr_array, energy: np.ndarray, closed: bool
) -> np.ndarray:
    """Return the derivative of T = sum 2 d / (v + v') by offsets and squared speeds, (2 N,)."""
    speed = np.sqrt(energy)
    sums = speed + np.roll(speed, -1)
    weight = np.ones(len(gap))
    if not closed:
        weight[-1] = 0.0
    share = weight * gap / sums**2
    return np.concatenate([gap_by.T @ (2 * weight / sums), -(share + np.roll(share, 1)) / speed])


def _step(count: int, closed: bool) -> csr_array:
    """Return the matrix that takes values to the next point's minus this one's."""
    here = np.arange(count)
    ones = np.ones(count)
    if not closed:
        ones[-1] = 0.0
    columns = np.concatenate([here, (here + 1) % count])
    return csr_array((np.concatenate([-ones, ones]), (np.tile(here, 2), columns)))


def _scaled(factors: np.ndarray, rows: csr_array) -> csr_array:
    return csr_array(diags_array(factors) @ rows)


def spline(track: Track, values: np.ndarray) -> CubicSpline:
    """Return values given at the centre points as a smooth function of s."""
    s = np.arange(len(values)) * (track.length / (len(values) - (not track.closed)))
    if not track.closed:
        return CubicSpline(s, values, bc_type="natural")
    return CubicSpline(
        np.append(s, track.length), np.concatenate([values, values[:1]]), bc_type="periodic"
    )


def _smoothed(track: Track) -> np.ndarray:
    """Return the centre points averaged over SMOOTH metres, so that no kink of theirs is driven."""
    step = track.length / (len(track.center) - (not track.closed))
    reach = min(int(3 * SMOOTH / step), (len(track.center) - 1) // 2)
    weights = np.exp(-0.5 * (np.arange(-reach, reach + 1) * step / SMOOTH) ** 2)
    weights /= weights.sum()
    points = track.center
    if track.closed:
        padded = np.concatenate([points[-reach:], points, points[:reach]]) if reach else points
    else:  # prolonged by reflection through its ends, which keeps a straight straight
        before = 2 * points[0] - points[reach:0:-1]
        after = 2 * points[-1] - points[-2 : -2 - reach : -1]
        padded = np.concatenate([before, points, after])
    return np.stack([np.convolve(padded[:, axis], weights, "valid") for axis in (0, 1)], axis=1)
