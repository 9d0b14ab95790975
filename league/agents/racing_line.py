"""The fastest line round a track and the speed a car can hold on it: pure functions of track and car.

The car is a point on a friction ellipse (quasi-steady state): its lateral acceleration v^2 * curvature
and its longitudinal acceleration share the tyres' grip, within the limits of drive and brakes. The
line is found by sequential linear programming on lateral offsets and squared speeds together, which
minimises TIME, not curvature: each round linearises both about the last line, solves, and keeps
the answer if the exact forward-backward pass says that it is faster.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import linprog
from scipy.sparse import csr_array, diags_array, hstack, vstack

from league.sim.config import CarConfig
from league.track.course import Track

GRAVITY = 9.81
"""[m/s^2]."""
ELLIPSE_SIDES = 20
"""Sides of the polygon that stands for the friction ellipse while the line is sought."""
FOLD = 0.8
"""Largest curvature times lateral offset: beyond, lines across a bend would run backwards."""
SMOOTH = 0.4
"""Width of the average that takes kinks out of the centreline before lines are sought [m]."""
STEP = 0.03
"""Wished distance between two rows of a finished line [m]."""


@dataclass(frozen=True, eq=False)
class RacingLine:
    """A line round a track with a speed at every point; all arrays float64, shape (N,)."""

    s: np.ndarray
    """Distance along the CENTRELINE [m], uniform from 0; a closed line does not repeat row 0."""
    lateral: np.ndarray
    """Place of the car's base to the left of the centreline [m]."""
    heading: np.ndarray
    """Direction of the line minus the track's heading as TrackSet tells it [rad]."""
    curvature: np.ndarray
    """Signed curvature of the line [1/m], positive to the left."""
    speed: np.ndarray
    """Speed along the line [m/s]."""
    stretch: np.ndarray
    """Metres of line for each metre of centreline."""
    lap_time: float
    """Time of a flying lap [s]; on an open track, from end to end with a flying start."""
    closed: bool
    """Whether the line is a loop."""


@dataclass(frozen=True)
class Limits:
    """What the car's tyres, drive and steering allow."""

    lateral: float
    """Largest lateral acceleration [m/s^2]."""
    acceleration: float
    """Largest acceleration [m/s^2]."""
    braking: float
    """Largest deceleration [m/s^2]."""
    speed: float
    """Largest speed [m/s]."""
    curvature: float
    """Largest curvature the steering can follow [1/m]."""
    transfer: float
    """Share of an axle's load lost for each m/s^2 of drive or braking [s^2/m]; 0: none is."""

    @classmethod
    def of(cls, car: CarConfig, share: float = 1.0, *, load_transfer: bool = True) -> Limits:
        """Return a car's limits, with only a share of its grip used.

        With load transfer, the axle that braking or drive unloads slides first (each axle takes
        half of either); without, the car is a point with all its grip in every direction.
        """
        transfer = 2 * car.mass_height / car.wheelbase / GRAVITY if load_transfer else 0.0
        most = spare_grip(0.0, share * car.grip * GRAVITY, transfer)
        return cls(
            lateral=share * car.grip * GRAVITY,
            acceleration=min(car.max_acceleration, most),
            braking=min(car.max_braking, most),
            speed=car.max_speed,
            curvature=float(np.tan(car.max_steering)) / car.wheelbase,
            transfer=transfer,
        )


def spare_grip(cornering: float, lateral: float, transfer: float) -> float:
    """Return the drive or braking that tyres can give beside cornering [m/s^2].

    The axle that loses load carries (1 - t a) of its half and pushes a / 2 and y / 2 per mass:
    a^2 + y^2 = Y^2 (1 - t a)^2, solved for a.

    Args:
        cornering: lateral acceleration y [m/s^2].
        lateral: largest lateral acceleration Y [m/s^2].
        transfer: share of an axle's load t lost for each m/s^2 [s^2/m].
    """
    left = lateral * lateral - cornering * cornering
    if left <= 0:
        return 0.0
    square, half = 1 - (lateral * transfer) ** 2, lateral * lateral * transfer
    return ((half * half + square * left) ** 0.5 - half) / square


def optimal_line(
    track: Track,
    car: CarConfig,
    margin: float,
    *,
    share: float = 1.0,
    load_transfer: bool = True,
    spacing: float = 0.15,
    knot_spacing: float = 0.3,
    rounds: int = 20,
    curvature_rate: float = 12.0,
) -> RacingLine:
    """Return the fastest line whose base keeps a margin to both borders.

    Args:
        track: the course.
        car: its grip and limits.
        margin: smallest distance from the base to a border [m]; negative values let the base
            leave the road, as the rules do while one wheel still touches it.
        share: part of the grip that is used.
        load_transfer: whether braking and drive unload an axle.
        spacing: distance between two points of the line while it is sought [m].
        knot_spacing: distance between the knots of the smooth curves it is made of [m].
        rounds: most rounds of linear programming.
        curvature_rate: largest change of curvature along the line [1/m per m].
    """
    limits = Limits.of(car, share, load_transfer=load_transfer)
    road = _Road.of(track, spacing, margin)
    lateral = _fastest(road, limits, knot_spacing, rounds, curvature_rate)
    return _finish(track, road, lateral, limits)


def center_line(track: Track, car: CarConfig, *, share: float, top_speed: float) -> RacingLine:
    """Return the centreline itself, with the speed a share of the car's limits allows."""
    limits = replace(Limits.of(car, share), speed=top_speed)
    road = _Road.of(track, 0.15, 0.0)
    return _finish(track, road, road.aside, limits)


def speed_profile(
    curvature: np.ndarray, distance: np.ndarray, limits: Limits, closed: bool
) -> np.ndarray:
    """Return the highest speed at each point that grip, drive and brakes allow [m/s].

    A forward pass (drive) and a backward pass (brakes) over the corner speeds, each with what the
    friction ellipse leaves beside cornering.

    Args:
        curvature: at each point [1/m], shape (N,).
        distance: from each point to the next [m], shape (N,), or (N - 1,) if open.
        limits: what the car can do.
        closed: whether the last point is followed by the first; its speed must then fit.
    """
    bend = np.abs(curvature)
    top = np.minimum(limits.speed**2, limits.lateral / np.maximum(bend, 1e-9))
    # On a loop the slowest corner is never left faster than its corner speed: start there.
    first = int(top.argmin()) if closed else 0
    order = np.roll(np.arange(len(top)), -first)
    squared = top[order].tolist()
    bends, gaps = bend[order].tolist(), np.roll(distance, -first).tolist()
    if closed:
        squared, bends = [*squared, squared[0]], [*bends, bends[0]]
    _drive(squared, bends, gaps, limits.acceleration, limits)
    squared.reverse(), bends.reverse(), gaps.reverse()
    _drive(squared, bends, gaps, limits.braking, limits)
    squared.reverse()
    speed = np.empty(len(top))
    speed[order] = np.sqrt(squared[: len(top)])
    return speed


def travel_time(speed: np.ndarray, distance: np.ndarray) -> float:
    """Return the time along a line with constant acceleration between its points [s]."""
    following = np.roll(speed, -1)[: len(distance)]
    return float(np.sum(2 * distance / (speed[: len(distance)] + following)))


def _drive(
    squared: list[float], bends: list[float], gaps: list[float], most: float, limits: Limits
) -> None:
    """Lower squared speeds in place until none asks for more acceleration than there is."""
    for i, gap in enumerate(gaps):
        spare = spare_grip(bends[i] * squared[i], limits.lateral, limits.transfer)
        reach = squared[i] + 2 * gap * min(most, spare)
        if reach < squared[i + 1]:
            squared[i + 1] = reach


@dataclass(frozen=True, eq=False)
class _Road:
    """The track where the line is sought: centre points, normals and lateral bounds."""

    s: np.ndarray
    x: np.ndarray
    y: np.ndarray
    normal_x: np.ndarray
    normal_y: np.ndarray
    low: np.ndarray
    high: np.ndarray
    aside: np.ndarray
    closed: bool

    @classmethod
    def of(cls, track: Track, spacing: float, margin: float) -> _Road:
        step = track.length / max(8, round(track.length / spacing))
        count = round(track.length / step)
        s = np.arange(count if track.closed else count + 1) * step
        smooth = _spline(track, _smoothed(track))
        center, slope = smooth(s), smooth(s, 1)
        normal = np.stack([-slope[:, 1], slope[:, 0]], axis=1)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        aside = ((_spline(track, track.center)(s) - center) * normal).sum(axis=1)
        left = _spline(track, np.linalg.norm(track.left - track.center, axis=1))(s)
        right = _spline(track, np.linalg.norm(track.right - track.center, axis=1))(s)
        low = aside - np.maximum(right - margin, 0.0)
        high = aside + np.maximum(left - margin, 0.0)
        twist = smooth(s, 2)
        own = (slope[:, 0] * twist[:, 1] - slope[:, 1] * twist[:, 0]) / np.hypot(*slope.T) ** 3
        for bend, shift in ((own, 0.0), (_spline(track, track.curvature)(s), aside)):
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


def _fastest(
    road: _Road, limits: Limits, knot_spacing: float, rounds: int, curvature_rate: float
) -> np.ndarray:
    """Return the lateral offsets of the fastest line found, by smooth curves, then by finer ones."""
    lateral = np.clip(np.zeros_like(road.s), road.low, road.high)
    for spacing in (2 * knot_spacing, knot_spacing):
        curves = _basis(len(road.s), road.s[1] - road.s[0], spacing, road.closed)
        lateral = _descend(road, limits, curves, lateral, rounds, curvature_rate)
    return lateral


def _descend(
    road: _Road,
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
        if tried is not None and cost < 1.005 * best:
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


def _cost(road: _Road, lateral: np.ndarray, limits: Limits) -> float:
    """Return the time of a line [s], with a price on bends tighter than the steering allows."""
    bend, gap = road.measure(lateral)
    excess = np.maximum(np.abs(bend) - limits.curvature, 0.0)
    return travel_time(speed_profile(bend, gap, limits, road.closed), gap) + float(excess.sum())


def _linear_round(
    road: _Road,
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
    free = np.full(curves.shape[1], 0.5)
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
    if not answer.success:
        return None
    change = curves @ answer.x[: len(free)]
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
            for sign_y in (1, -1):
                sides.append((sign_a * p / norm, sign_y * y / norm, (p * a + y * y) / norm))
    return sorted(set(sides))


def _slopes(road: _Road, lateral: np.ndarray) -> tuple[csr_array, csr_array]:
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


def _spline(track: Track, values: np.ndarray) -> CubicSpline:
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


def _finish(track: Track, road: _Road, lateral: np.ndarray, limits: Limits) -> RacingLine:
    """Draw a smooth curve through a line's points and tell it in the track's own frame."""
    points = np.stack([road.x + lateral * road.normal_x, road.y + lateral * road.normal_y], axis=1)
    if road.closed:
        knots, points = np.append(road.s, track.length), np.concatenate([points, points[:1]])
    else:
        knots = road.s
    curve = CubicSpline(knots, points, bc_type="periodic" if road.closed else "natural")
    count = max(16, round(track.length / STEP))
    s = np.arange(count if road.closed else count + 1) * (track.length / count)
    center = np.stack([_linear(track, track.center[:, axis], s) for axis in (0, 1)], axis=1)
    tangent = np.stack([_linear(track, track.tangent[:, axis], s) for axis in (0, 1)], axis=1)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    place = s.copy()  # where the curve crosses the normal of the track at s
    for _ in range(8):
        ahead = ((curve(place) - center) * tangent).sum(axis=1)
        place = place - ahead / np.maximum((curve(place, 1) * tangent).sum(axis=1), 0.2)
    offset, slope, bent = curve(place) - center, curve(place, 1), curve(place, 2)
    pace = np.hypot(slope[:, 0], slope[:, 1])
    bend = (slope[:, 0] * bent[:, 1] - slope[:, 1] * bent[:, 0]) / pace**3
    following = np.roll(curve(place), -1, axis=0) if road.closed else curve(place)[1:]
    gap = np.linalg.norm(following - curve(place)[: len(following)], axis=1)
    speed = speed_profile(bend, gap, limits, road.closed)
    along = (slope * tangent).sum(axis=1)
    across = slope[:, 1] * tangent[:, 0] - slope[:, 0] * tangent[:, 1]
    return RacingLine(
        s=s,
        lateral=offset[:, 1] * tangent[:, 0] - offset[:, 0] * tangent[:, 1],
        heading=np.arctan2(across, along),
        curvature=bend,
        speed=speed,
        stretch=np.append(gap, gap[-1:])[: len(s)] / (track.length / count),
        lap_time=travel_time(speed, gap),
        closed=road.closed,
    )


def _linear(track: Track, values: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Return values at the centre points as TrackSet mixes them."""
    knots = np.arange(len(values)) * (track.length / (len(values) - (not track.closed)))
    return np.interp(s, knots, values, period=track.length if track.closed else None)
