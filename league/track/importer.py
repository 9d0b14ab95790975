"""The community's track arrays (N rows of centre, inner border, outer border) as tracks of ours."""

import os
import re
import tokenize
import warnings
from io import BytesIO
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from league.atomic_file import read_plain
from league.errors import TrackError
from league.track import build, files, spline
from league.track.track import SPACING, Track

_CENTER_ERROR = 0.008  # largest distance of a given row from the fitted centreline [m]
_BORDER_ERROR = 0.002  # largest distance of a given row from the thinned border [m]
_FIRST_KNOTS = 0.8  # distance of the first knots of the fit [m]
_HEADER_FAULTS = (
    *(ValueError, SyntaxError, TypeError, KeyError, EOFError, OverflowError, MemoryError),
    *(RecursionError, tokenize.TokenError),
)


def read_npy(path: str | os.PathLike[str]) -> Track:
    """Import a community track file; nothing in it is executed and every number of it is checked.

    The array is floats of shape (N, 6) [m]: centre, inner border, outer border. Rows need not be
    perpendicular to the centreline: borders are taken as lines, and met by the centreline's
    normals. "Inner" may lie on either side of the driver. The rows' centres are kept as the track's
    waypoints, for reward functions that count on their numbers. It is named as the file.
    """
    where = os.fspath(path)
    rows = _read_rows(where)
    name = re.sub(r"\W+", "_", Path(where).stem, flags=re.ASCII).strip("_")[:64] or "track"
    return from_rows(rows, name, where)


def from_rows(rows: np.ndarray, name: str, where: str) -> Track:
    """Fit a track to rows of centre, inner and outer border [m], shape (N, 6)."""
    _check_rows(rows, where)
    rows = rows.astype(np.float64)
    center = _distinct(rows[:, :2])
    gap = float(np.linalg.norm(rows[-1, :2] - rows[0, :2]))
    steps = np.linalg.norm(np.diff(center, axis=0), axis=1)
    if len(center) < 4:
        raise TrackError(f"{where} has {len(center)} different centre points; a track needs 4")
    # Files repeat row 0 at the end; a loop that does not still ends one step before its start.
    closed = gap < 1.5 * float(np.median(steps))
    repeats = closed and gap < 0.3 * float(np.median(steps))
    if repeats and len(center) > 4:
        center = center[:-1]
    extent = np.ptp(center, axis=0).max()
    if extent > build.MAX_EXTENT or steps.sum() > build.MAX_LENGTH:
        raise TrackError(
            f"{where}: the track is {steps.sum():,.1f} m long and {extent:,.1f} m across; a track "
            f"has at most {build.MAX_LENGTH:g} m and {build.MAX_EXTENT:g} m (the unit is metres)"
        )
    twice = KDTree(center).query_pairs(1e-3)
    if twice:
        row = center[min(twice)[0]]
        raise TrackError(
            f"{where} comes twice to the place ({row[0]:.3f}, {row[1]:.3f}) m; rows must be in "
            "driving order, once round"
        )
    borders = [_border(rows[:, column : column + 2], closed, where) for column in (2, 4)]
    # The inner border lies on the driver's left if it does in the majority of the rows.
    along, to_inner = np.gradient(rows[:, :2], axis=0), rows[:, 2:4] - rows[:, 4:6]
    turn = along[:, 0] * to_inner[:, 1] - along[:, 1] * to_inner[:, 0]
    left, right = borders if np.median(turn) > 0 else borders[::-1]
    # The original's waypoints are the centres, on a loop ending with row 0's. None is dropped, not
    # even one that repeats the row before it: a reward function may name any by its number.
    waypoints = rows[:-1, :2] if repeats else rows[:, :2]
    waypoints = np.concatenate([waypoints, rows[:1, :2]]) if closed else waypoints
    points = _thinned_curve(center, closed)
    width = _usual_width(points, left, right, closed, where)
    return files.built(
        {
            "name": name,
            "title": name.replace("_", " "),
            "direction": spline.winding(points) if closed else "open",
            "width": width,
            # Older hand-made tracks measure inside: 24 and 26 inches, and the 0.906 m of 2020.
            "line": "outside" if width < 0.70 or 0.895 < width < 0.912 else "inside",
            "origin": "Imported from a community track array; which side of the border the white "
            "line lies on was guessed from the width.",
            "points": files.rounded(points, 3),
            "left": files.rounded(left, 3),
            "right": files.rounded(right, 3),
            "waypoints": waypoints.tolist(),
        },
        where,
    )


def _read_rows(where: str) -> np.ndarray:
    """Read the array after its header and size were found to be those of a track."""
    content = read_plain(where, files.MAX_BYTES, TrackError, "a .npy file")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # headers written by Python 2 make numpy warn
            _check_header(BytesIO(content), len(content), where)
            return np.load(BytesIO(content), allow_pickle=False)
    except _HEADER_FAULTS as error:
        reason = str(error).split("\n", maxsplit=1)[0][:100]
        raise TrackError(
            f"{where} is not a numpy array file ({reason}); write it with numpy.save"
        ) from None


def _check_header(file: BytesIO, size: int, where: str) -> None:
    version = np.lib.format.read_magic(file)
    if version == (1, 0):
        shape, _, dtype = np.lib.format.read_array_header_1_0(file)
    elif version == (2, 0):
        shape, _, dtype = np.lib.format.read_array_header_2_0(file)
    else:
        raise ValueError(f"format {version[0]}.{version[1]} is not known")
    if dtype.kind not in "fiu" or dtype.itemsize > 16:
        raise TrackError(f"{where} holds {dtype} values; a track array holds floating-point metres")
    if len(shape) != 2 or shape[1] != 6:
        raise TrackError(
            f"{where} has the shape {shape}; a track array is (N, 6): centre, inner and outer "
            "border, x and y each"
        )
    if not 4 <= shape[0] <= files.MAX_POINTS:
        raise TrackError(
            f"{where} has {shape[0]:,} rows; a track array has 4 to {files.MAX_POINTS}"
        )
    declared = file.tell() + shape[0] * shape[1] * dtype.itemsize
    if size != declared:
        raise TrackError(
            f"{where} has {size:,} bytes and its header promises {declared:,}; it was cut short "
            "or is no track: save it again"
        )


def _check_rows(rows: np.ndarray, where: str) -> None:
    bad = ~np.isfinite(rows) | (np.abs(np.nan_to_num(rows)) > files.MAX_COORDINATE)
    if bad.any():
        row, column = (int(place[0]) for place in np.nonzero(bad))
        raise TrackError(
            f"{where}, row {row}, column {column} is {rows[row, column]}; give finite metres "
            f"within {files.MAX_COORDINATE:g} m"
        )


def _distinct(line: np.ndarray) -> np.ndarray:
    """Drop rows that repeat the row before them."""
    steps = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return line[np.concatenate([[True], steps > 2e-3])]


def _border(line: np.ndarray, closed: bool, where: str) -> np.ndarray:
    """Clean one border: no repeated rows, no small loops in tight bends, no needless points."""
    line = _distinct(line)
    if closed and len(line) > 1 and np.linalg.norm(line[0] - line[-1]) < 2e-3:
        line = line[:-1]
    if len(line) < 3:
        raise TrackError(f"{where} has a border of {len(line)} different points; give 3 or more")
    return _thinned_line(_without_loops(line, closed))


def _without_loops(line: np.ndarray, closed: bool) -> np.ndarray:
    """Cut off the small loops that an offset line makes inside a bend tighter than its offset."""
    for _ in range(len(line)):
        crossing = build.first_crossing(line, closed=closed)
        if crossing is None or len(line) < 5:
            break
        first, second = crossing
        inside = second - first
        if closed and inside > len(line) / 2:
            kept = line[first + 1 : second + 1]
        else:
            kept = np.concatenate([line[: first + 1], line[second + 1 :]])
        if len(kept) < 0.7 * len(line):
            break  # a real crossing, which the check of the track will name
        line = kept
    return line


def _thinned_line(line: np.ndarray) -> np.ndarray:
    """Drop points of a polyline that lie on the line between their neighbours (Douglas-Peucker)."""
    keep = np.zeros(len(line), dtype=bool)
    keep[[0, len(line) // 2, -1]] = True
    spans = [(0, len(line) // 2), (len(line) // 2, len(line) - 1)]
    while spans:
        low, high = spans.pop()
        if high - low < 2:
            continue
        chord, inner = line[high] - line[low], line[low + 1 : high] - line[low]
        part = np.clip(inner @ chord / max(float(chord @ chord), 1e-12), 0.0, 1.0)
        off = np.linalg.norm(inner - part[:, None] * chord, axis=1)
        if off.max() > _BORDER_ERROR:
            worst = low + 1 + int(off.argmax())
            keep[worst] = True
            spans += [(low, worst), (worst, high)]
    return line[keep]


def _thinned_curve(center: np.ndarray, closed: bool) -> np.ndarray:
    """Choose as few rows as let the smooth curve pass within 8 mm of all of them."""
    s = spline.travelled(center)
    count = max(4, round(s[-1] / _FIRST_KNOTS))
    wanted = np.linspace(0, s[-1], count, endpoint=not closed)
    keep = np.zeros(len(center), dtype=bool)
    keep[np.abs(s[:, None] - wanted).argmin(axis=0)] = True
    while not keep.all():
        knots = np.flatnonzero(keep)
        if len(knots) >= 4:
            off = _off_curve(center, center[knots], closed)
            if off.max() <= _CENTER_ERROR:
                break
        else:
            off = np.where(keep, 0.0, 1.0)
        # One more knot in every gap that is off, at its worst row.
        gap = np.searchsorted(knots, np.arange(len(center)), side="right")
        for number in np.unique(gap[off > _CENTER_ERROR]):
            rows = np.flatnonzero((gap == number) & ~keep)
            if len(rows):
                keep[rows[off[rows].argmax()]] = True
        if len(knots) == keep.sum():
            break
    return center[keep]


def _off_curve(rows: np.ndarray, knots: np.ndarray, closed: bool) -> np.ndarray:
    """Return each row's distance from the smooth curve through the knots [m]."""
    curve = spline.resample(knots, closed=closed, spacing=0.02)
    nearest = KDTree(curve).query(rows)[1]
    normal = spline.left_normal(curve, closed=closed)[nearest]
    return np.abs(((rows - curve[nearest]) * normal).sum(axis=1))


def _usual_width(
    points: np.ndarray, left: np.ndarray, right: np.ndarray, closed: bool, where: str
) -> float:
    center = spline.resample(points, closed=closed, spacing=SPACING)
    normal = spline.left_normal(center, closed=closed)
    reaches = [
        spline.cast(center, side * normal, border, closed=closed, limit=4.0)
        for side, border in ((1, left), (-1, right))
    ]
    both = reaches[0] + reaches[1]
    if np.isnan(both).mean() > 0.2:
        raise TrackError(
            f"{where}: the borders do not lie on both sides of the centre; columns are centre, "
            "inner border, outer border, x and y each"
        )
    return round(float(np.nanmedian(both)), 3)
