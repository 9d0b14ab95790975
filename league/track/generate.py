"""Random sound tracks for training: straights, hairpins, chicanes and sweeps from a seed."""

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy import ndarray
from numpy.random import Generator
from scipy import ndimage
from scipy.spatial import KDTree

from league.errors import TrackError
from league.track import files, spline
from league.track.track import Track

Direction = Literal["counter-clockwise", "clockwise"]

CLEARANCE = 0.1  # least distance between the borders of two stretches [m]

_ATTEMPTS = 400
_STEP = 0.05  # spacing of the drawn path [m]
_KNOT = 0.4  # spacing of the control points [m]
_PLAIN_SHARE = 0.02  # share of the draws that may be a plain loop
_PLAIN_TURNING = 2 * np.pi * 1.4  # a loop that turns less than this in all is plain [rad]

_PALETTES: tuple[dict[str, tuple[int, int, int]], ...] = (
    {},
    {"road": (64, 63, 61), "field": (126, 133, 65), "line": (223, 223, 222), "dash": (225, 143, 0)},
    {"road": (52, 50, 54), "field": (112, 104, 88), "line": (214, 212, 206)},
    {"road": (44, 46, 58), "field": (70, 118, 128), "line": (206, 208, 210)},
)
"""Floors to learn on: the defaults, the original's other floor, and two of our own."""


def generate(
    seed: int,
    *,
    min_radius: float = 0.5,
    width: tuple[float, float] = (0.6, 1.1),
    length: tuple[float, float] = (15.0, 40.0),
    direction: Direction | None = None,
) -> Track:
    """Draw a sound closed track; the same seed and settings give the same track.

    Width of the road and length of the centreline are ranges [m]; `min_radius` [m] is smoothed
    over 0.3 m.
    """
    if seed < 0:
        raise TrackError(f"seed is {seed}: give 0 or more")
    if not 0.25 <= min_radius <= 10:
        raise TrackError(f"min_radius is {min_radius}: give 0.25 to 10 m")
    if not 0.3 <= width[0] <= width[1] <= 4:
        raise TrackError(f"width is {width[0]} to {width[1]}: give a range within 0.3 to 4 m")
    if not 5 <= length[0] <= length[1] <= 200:
        raise TrackError(f"length is {length[0]} to {length[1]}: give a range within 5 to 200 m")
    if direction not in (None, "counter-clockwise", "clockwise"):
        raise TrackError(f"direction is {direction!r}: give counter-clockwise or clockwise")
    generator = np.random.default_rng(seed)
    for attempt in range(_ATTEMPTS):
        asked_width = round(float(generator.uniform(*width)), 3)
        asked_length = float(generator.uniform(*length))
        way = direction or ("counter-clockwise", "clockwise")[int(generator.integers(2))]
        shape = _SHAPES[int(generator.choice(len(_SHAPES), p=_SHARES))]
        path = shape(generator, asked_length, asked_width, min_radius)
        path = None if path is None else _finished(path, asked_length, way, generator)
        # A short loop may have no room for more than four corners.
        may_be_plain = generator.random() < _PLAIN_SHARE or attempt > 60
        if path is None or not _fits(path, asked_width, min_radius):
            continue
        if not may_be_plain and np.abs(_curvature(path)).sum() * _STEP < _PLAIN_TURNING:
            continue
        track = _build(seed, path, asked_width, way, generator)
        if track is None or track.min_radius < min_radius:
            continue
        if length[0] <= track.length <= length[1]:
            return track
    raise TrackError(
        f"no sound track was found for seed {seed} with min_radius {min_radius:g}, width "
        f"{width[0]:g} to {width[1]:g} and length {length[0]:g} to {length[1]:g} m; "
        "ask for a longer or narrower one, or a smaller radius"
    )


def _build(seed: int, path: ndarray, width: float, way: str, generator: Generator) -> Track | None:
    """Turn a path into a track through its own file, so that its text gives it again."""
    count = max(8, round(len(path) * _STEP / _KNOT))
    rows = np.linspace(0, len(path), count, endpoint=False).astype(int)
    palette = _PALETTES[int(generator.integers(len(_PALETTES)))]
    content = {
        "name": f"generated_{seed}",
        "title": f"Generated {seed}",
        "direction": way,
        "width": width,
        "line": "inside" if generator.random() < 0.75 else "outside",
        "colours": {part: list(rgb) for part, rgb in palette.items()},
        "origin": f"Generated from seed {seed}.",
        "points": files.rounded(path[rows], 3),
    }
    try:
        return files.built(content, f"the track of seed {seed}")
    except TrackError:
        return None


def _finished(path: ndarray, length: float, way: str, generator: Generator) -> ndarray:
    """Bring a counter-clockwise outline to its length, turn it, start it on its best straight."""
    angle = generator.uniform(0, 2 * np.pi)
    cos, sin = np.cos(angle), np.sin(angle)
    path = path @ np.array([[cos, sin], [-sin, cos]])
    if way == "clockwise":
        path = path[::-1]
    path = _even(path * (length / _length(path)))
    bend = np.abs(_curvature(path))
    straightness = ndimage.uniform_filter1d(bend, size=min(len(path), 41), mode="wrap")
    path = np.roll(path, -int(straightness.argmin()), axis=0)
    return path - path.min(axis=0) + 1.0


def _fits(path: ndarray, width: float, min_radius: float) -> bool:
    """Return, roughly and quickly, whether bends are wide enough and stretches far enough apart."""
    bend = ndimage.uniform_filter1d(np.abs(_curvature(path)), size=5, mode="wrap")
    if bend.max() > 1.05 / min_radius:
        return False
    thin = path[::2]
    pairs = KDTree(thin).query_pairs(width + CLEARANCE, output_type="ndarray")
    apart = pairs[:, 1] - pairs[:, 0]
    apart = np.minimum(apart, len(thin) - apart) * (2 * _STEP)
    return not (apart > spline.FOLD_REACH * width / 2).any()


def _blocks(generator: Generator, length: float, width: float, min_radius: float) -> ndarray | None:
    """Outline of a random patch of cells: straights, hairpins and chicanes."""
    pitch = max(2.2 * min_radius, width + CLEARANCE + 0.05)
    most = max(4, int(1.05 * length / pitch))
    sides = int(generator.integers(min(6, most), most + 1))
    corners = _outline(_patch(generator, sides - sides % 2))
    steps = generator.uniform(1.0, generator.uniform(1.0, 2.2), size=(2, 80)).cumsum(axis=1)
    corners = np.stack([steps[0][corners[:, 0] + 40], steps[1][corners[:, 1] + 40]], axis=1)
    shear = generator.uniform(-0.35, 0.35)
    corners = corners @ np.array([[1.0, 0.0], [shear, 1.0]])
    corners = corners + generator.normal(0.0, generator.uniform(0.05, 0.22), corners.shape)
    return _rounded(corners, length, min_radius, generator)


_EDGES = ((1, 0), (0, 1), (-1, 0), (0, -1))


def _patch(generator: Generator, sides: int) -> set[tuple[int, int]]:
    """Grow cells, without holes and without touching corners, until they have so many sides."""
    cells = {(0, 0)}
    perimeter = 4
    for _ in range(40 * sides):
        if perimeter >= sides:
            break
        # Growing from a random earlier or the latest cell gives lumps and arms.
        ordered = sorted(cells)
        x, y = ordered[int(generator.integers(len(ordered)))]
        dx, dy = _EDGES[int(generator.integers(4))]
        cell = (x + dx, y + dy)
        if cell in cells or not _joins_once(cells, cell) or max(map(abs, cell)) > 30:
            continue
        touching = sum((cell[0] + i, cell[1] + j) in cells for i, j in _EDGES)
        if touching == 1 or generator.random() < 0.3:
            cells.add(cell)
            perimeter += 4 - 2 * touching
    return cells


_RING = ((1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))


def _joins_once(cells: set[tuple[int, int]], cell: tuple[int, int]) -> bool:
    """Return whether a new cell keeps the outline one simple loop."""
    ring = [(cell[0] + i, cell[1] + j) in cells for i, j in _RING]
    runs = sum(now and not before for now, before in zip(ring, [ring[-1], *ring[:-1]], strict=True))
    return runs == 1 and any(ring[::2])


def _outline(cells: set[tuple[int, int]]) -> ndarray:
    """Return the corners of a patch's outline, counter-clockwise, shape (K, 2)."""
    after = {
        begin: end
        for x, y in cells
        for (dx, dy), begin, end in (
            ((0, -1), (x, y), (x + 1, y)),
            ((1, 0), (x + 1, y), (x + 1, y + 1)),
            ((0, 1), (x + 1, y + 1), (x, y + 1)),
            ((-1, 0), (x, y + 1), (x, y)),
        )
        if (x + dx, y + dy) not in cells
    }
    walk = [min(after)]
    while after[walk[-1]] != walk[0]:
        walk.append(after[walk[-1]])
    ring = np.array(walk)
    straight = (np.roll(ring, -1, axis=0) - ring == ring - np.roll(ring, 1, axis=0)).all(axis=1)
    return ring[~straight]


def _star(generator: Generator, length: float, width: float, min_radius: float) -> ndarray | None:
    """Polygon with near and far corners: fast bends of all angles, some bowing inward."""
    count = int(generator.integers(4, 5 + int(length / 4)))
    gaps = generator.uniform(0.5, 1.5, count)
    angle = np.cumsum(gaps) / gaps.sum() * 2 * np.pi
    radius = generator.uniform(generator.uniform(0.3, 0.8), 1.0, count)
    corners = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    corners[:, 0] *= generator.uniform(1.0, 2.0)
    return _rounded(corners, length, min_radius, generator)


def _flow(generator: Generator, length: float, width: float, min_radius: float) -> ndarray | None:
    """Sum of a few waves round a circle: no straight, bends that flow into each other."""
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    radius = np.ones_like(angle)
    for wave in range(2, 7):
        share = generator.normal(0.0, 0.5 / wave)
        radius += share * np.cos(wave * angle + generator.uniform(0, 2 * np.pi))
    if radius.min() < 0.15:
        return None
    path = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    path[:, 0] *= generator.uniform(1.0, 1.8)
    return path


_SHAPES: tuple[Callable[..., ndarray | None], ...] = (_blocks, _star, _flow)
_SHARES = (0.6, 0.25, 0.15)


def _rounded(
    corners: ndarray, length: float, min_radius: float, generator: Generator
) -> ndarray | None:
    """Round the corners of a polygon with arcs of varied radius, and soften where they begin.

    Returns None if a corner leaves no room for the smallest radius.
    """
    corners = corners * (1.08 * length / _length(corners))  # arcs cut corners short
    to_next = np.roll(corners, -1, axis=0) - corners
    sides = np.linalg.norm(to_next, axis=1)
    if sides.min() < 1e-6:
        return None
    out = to_next / sides[:, None]
    into = np.roll(out, 1, axis=0)
    cross = into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0]
    turn = np.arctan2(cross, (into * out).sum(axis=1))
    tan_half = np.tan(np.abs(turn) / 2)
    room = 0.5 * np.minimum(sides, np.roll(sides, 1))
    largest = room / np.maximum(tan_half, 1e-6)
    if (largest < 1.02 * min_radius).any():
        return None
    share = generator.uniform(0, 1, len(corners)) ** generator.uniform(0.3, 2.0)
    smallest = np.minimum(1.15 * min_radius, largest)
    radius = np.minimum(smallest + share * (largest - smallest), 6.0)
    pieces = [
        _arc(*parts) for parts in zip(corners, into, turn, radius, radius * tan_half, strict=True)
    ]
    path = _even(np.concatenate(pieces))
    soft = min(0.12, 0.25 * min_radius) / _STEP
    return ndimage.gaussian_filter1d(path, soft, axis=0, mode="wrap")


def _arc(corner: ndarray, into: ndarray, turn: float, radius: float, cut: float) -> ndarray:
    """Return points of the arc that replaces a corner, begun `cut` before it."""
    count = max(2, int(np.ceil(abs(turn) / 0.05)))
    part = np.linspace(0, abs(turn), count)
    aside = np.array([-into[1], into[0]]) * np.sign(turn)
    ahead = radius * np.sin(part)
    sideways = radius * (1 - np.cos(part))
    return corner - into * cut + into * ahead[:, None] + aside * sideways[:, None]


def _length(path: ndarray) -> float:
    return float(np.linalg.norm(np.roll(path, -1, axis=0) - path, axis=1).sum())


def _even(path: ndarray) -> ndarray:
    """Resample a closed polyline at even steps."""
    ring = np.concatenate([path, path[:1]])
    s = spline.travelled(ring)
    wanted = np.linspace(0, s[-1], max(16, round(s[-1] / _STEP)), endpoint=False)
    return np.stack([np.interp(wanted, s, ring[:, 0]), np.interp(wanted, s, ring[:, 1])], axis=1)


def _curvature(path: ndarray) -> ndarray:
    """Return the signed curvature of an evenly spaced closed path [1/m]."""
    step = np.roll(path, -1, axis=0) - path
    before = np.roll(step, 1, axis=0)
    cross = before[:, 0] * step[:, 1] - before[:, 1] * step[:, 0]
    return np.arctan2(cross, (before * step).sum(axis=1)) / _STEP
