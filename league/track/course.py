"""Track, one fixed course, and TrackSet, many of them as padded tables for a batch of worlds.

Frames: world x, y [m]; s [m] runs along the centreline in driving order from the start line;
lateral [m] is positive to the driver's left. The centreline is resampled at a uniform spacing of
about 5 cm, so a point's neighbours are found by dividing s.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from torch import Tensor

SPACING = 0.05
"""Wished distance between two points of a resampled centreline [m]."""

ROOM_MARGIN = 0.84
"""Distance from the road's bounding box to the wall round the room [m] (facts 3.1: 0.76-0.92)."""

_SEARCHES = 3
"""Steps of Newton's method in a projection."""

Rgb = tuple[int, int, int]


@dataclass(frozen=True)
class Colours:
    """What the floor is painted with, sRGB 0-255 (defaults: re:Invent 2018, facts section 3.1)."""

    road: Rgb = (36, 49, 64)
    field: Rgb = (95, 136, 104)
    line: Rgb = (194, 194, 190)
    dash: Rgb = (194, 117, 0)
    wall: Rgb = (36, 70, 81)


@dataclass(frozen=True, eq=False)
class Track:
    """One course, resampled; made by `league.track.files` or `league.track.generate`."""

    name: str
    """Short name: letters, digits, underscore."""
    title: str
    """What a person calls it."""
    center: np.ndarray
    """Centreline [m], shape (N, 2) float64, uniform spacing, driving order, row 0 on the start
    line. A closed track does not repeat row 0."""
    left: np.ndarray
    """Border on the driver's left [m], shape (N, 2): where the centreline's normal meets it."""
    right: np.ndarray
    """Border on the driver's right [m], shape (N, 2)."""
    closed: bool = True
    """False for a straight that ends at its last row."""
    line_inside: bool = True
    """True: the border is the outer edge of the white line; False: its inner edge."""
    line_width: float = 0.076
    """Width of the white border lines [m]."""
    colours: Colours = field(default_factory=Colours)
    origin: str = ""
    """Where the shape comes from."""
    text: str = ""
    """The YAML text it was made from, so that a replay can carry its track."""
    waypoints: np.ndarray | None = None
    """What reward functions are told [m], shape (M, 2), driving order; a closed track repeats row
    0 as the last. None: points evenly spaced along the centreline."""

    @cached_property
    def length(self) -> float:
        """Length of the centreline [m]."""
        return float(self.segment_lengths.sum())

    @cached_property
    def segment_lengths(self) -> np.ndarray:
        """Distance from each centre point to the next [m]; shape (N,), or (N - 1,) if open."""
        following = np.roll(self.center, -1, axis=0) if self.closed else self.center[1:]
        return np.linalg.norm(following - self.center[: len(following)], axis=1)

    @cached_property
    def width(self) -> float:
        """Usual distance between the borders [m]: the median, for bends may clip one."""
        return float(np.median(np.linalg.norm(self.left - self.right, axis=1)))

    @cached_property
    def tangent(self) -> np.ndarray:
        """Unit driving direction at each centre point, shape (N, 2), by central differences."""
        if self.closed:
            chord = np.roll(self.center, -1, axis=0) - np.roll(self.center, 1, axis=0)
        else:
            chord = np.gradient(self.center, axis=0)
        return chord / np.linalg.norm(chord, axis=1, keepdims=True)

    @cached_property
    def curvature(self) -> np.ndarray:
        """Signed curvature [1/m] over a window of about 0.3 m, shape (N,); positive turns left."""
        heading = np.unwrap(np.arctan2(self.tangent[:, 1], self.tangent[:, 0]))
        spacing = float(self.segment_lengths.mean())
        reach = max(1, round(0.15 / spacing))
        if self.closed:
            turn = heading[-1] + _wrapped(heading[0] - heading[-1]) - heading[0]
            padded = np.concatenate([heading[-reach:] - turn, heading, heading[:reach] + turn])
        else:
            padded = np.pad(heading, reach, mode="edge")
        return (padded[2 * reach :] - padded[: -2 * reach]) / (2 * reach * spacing)

    @property
    def min_radius(self) -> float:
        """Smallest radius of the centreline [m], smoothed over 0.3 m."""
        return float(1.0 / max(np.abs(self.curvature).max(), 1e-9))

    @cached_property
    def direction(self) -> Literal["counter-clockwise", "clockwise", "open"]:
        """Which way round it is driven."""
        if not self.closed:
            return "open"
        x, y = self.center.T
        area = np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y)
        return "counter-clockwise" if area > 0 else "clockwise"

    @cached_property
    def room(self) -> tuple[float, float, float, float]:
        """The wall round the field: x_min, y_min, x_max, y_max [m]."""
        outline = np.concatenate([self.left, self.right])
        low, high = outline.min(axis=0) - ROOM_MARGIN, outline.max(axis=0) + ROOM_MARGIN
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    def reversed(self) -> Track:
        """Return the same course driven the other way, from the same start line."""
        order = np.roll(np.arange(len(self.center))[::-1], 1 if self.closed else 0)
        return replace(
            self,
            name=f"{self.name}_reversed",
            title=f"{self.title}, reversed",
            center=self.center[order],
            left=self.right[order],
            right=self.left[order],
            text="",
            waypoints=None if self.waypoints is None else self.waypoints[::-1],
        )

    def mirrored(self) -> Track:
        """Return the course as a mirror along x shows it: left bends turn right."""
        flip = np.array([1.0, -1.0])
        return replace(
            self,
            name=f"{self.name}_mirrored",
            title=f"{self.title}, mirrored",
            center=self.center * flip,
            left=self.right * flip,
            right=self.left * flip,
            text="",
            waypoints=None if self.waypoints is None else self.waypoints * flip,
        )


@dataclass(frozen=True)
class Projection:
    """Where points lie on their track; every field has the points' shape."""

    s: Tensor
    """Distance along the centreline from the start line, in [0, length) [m] (closed tracks)."""
    lateral: Tensor
    """Distance to the left of the centreline [m]."""
    cos: Tensor
    """Cosine of the track's heading there."""
    sin: Tensor
    """Sine of the track's heading there."""
    curvature: Tensor
    """Signed curvature there [1/m], positive to the left."""
    left: Tensor
    """Distance from the centreline to the left border [m], positive."""
    right: Tensor
    """Distance from the centreline to the right border [m], positive."""


@dataclass(frozen=True, eq=False)
class TrackSet:
    """Several tracks as padded tables; `index` arguments say which track each world races on."""

    tracks: tuple[Track, ...]
    rows: Tensor
    """For each centre point its x, y [m], cosine and sine of the heading, curvature [1/m], distance
    to the left and right border [m], and then the same of the next point less this one's; shape
    (num_tracks * num_points, 14): one look-up brings all that is needed to interpolate."""
    num_points: int
    """Rows of each track, padded."""
    count: Tensor
    """Number of points of each track, int64, shape (num_tracks,)."""
    length: Tensor
    """Length of each track [m], shape (num_tracks,)."""
    spacing: Tensor
    """Distance between two points of each track [m], shape (num_tracks,)."""
    closed: Tensor
    """Whether each track is a loop, bool, shape (num_tracks,)."""
    room: Tensor
    """Wall of each track, x_min, y_min, x_max, y_max [m], shape (num_tracks, 4)."""
    inner: Tensor
    """Side of the enclosed border: +1 left (counter-clockwise, open), -1 right; (num_tracks,)."""

    @classmethod
    def of(cls, *tracks: Track, device: torch.device | str = "cpu") -> TrackSet:
        """Pad the tracks into one set of tables on a device."""
        if not tracks:
            raise ValueError("a TrackSet needs at least one track")
        num_points = max(len(track.center) for track in tracks)

        def vector(values: list, dtype: torch.dtype = torch.float32) -> Tensor:
            return torch.tensor(values, dtype=dtype, device=device)

        return cls(
            tracks=tuple(tracks),
            rows=torch.cat([_rows(track, num_points) for track in tracks]).to(device),
            num_points=num_points,
            count=vector([len(t.center) for t in tracks], torch.int64),
            length=vector([t.length for t in tracks]),
            spacing=vector([float(t.segment_lengths.mean()) for t in tracks]),
            closed=vector([t.closed for t in tracks], torch.bool),
            room=vector([t.room for t in tracks]),
            inner=vector([-1.0 if t.direction == "clockwise" else 1.0 for t in tracks]),
        )

    @property
    def device(self) -> torch.device:
        """Where the tables lie."""
        return self.rows.device

    @cached_property
    def all_closed(self) -> bool:
        """Whether every track is a loop."""
        return bool(self.closed.all())

    def at(self, index: Tensor, s: Tensor) -> tuple[Tensor, Tensor, Projection]:
        """Return centreline x, y and the track's frame at distance s.

        Args:
            index: track of each world, int64, shape (num_worlds,).
            s: any distance [m], wrapped on closed tracks, held at the ends of open ones; shape
                (num_worlds, ...).
        """
        s, columns = self._mixed(index, s)
        x, y, cos, sin, curvature, left, right = columns
        norm = torch.sqrt(cos * cos + sin * sin)
        frame = Projection(
            s=s,
            lateral=torch.zeros_like(s),
            cos=cos / norm,
            sin=sin / norm,
            curvature=curvature,
            left=left,
            right=right,
        )
        return x, y, frame

    def project(self, index: Tensor, x: Tensor, y: Tensor, near_s: Tensor) -> Projection:
        """Project points to the centreline, searching from where they were last seen.

        Newton's method on the distance to the centreline, started at `near_s`: a car stays on its
        own stretch where two stretches run side by side. Good to moves of about 1 m.

        Args:
            index: track of each world, int64, shape (num_worlds,).
            x: points [m], shape (num_worlds, ...).
            y: points [m].
            near_s: last known s of each point [m], same shape.
        """
        s = self._nearest(index, x, y, near_s)
        cx, cy, frame = self.at(index, s)
        return replace(frame, lateral=(y - cy) * frame.cos - (x - cx) * frame.sin)

    def _nearest(self, index: Tensor, x: Tensor, y: Tensor, s: Tensor) -> Tensor:
        """Return the places nearest to points that were last seen at s [m]."""
        if s.is_cpu:
            from league.track import along  # late: Numba takes a while

            told = torch.stack((x, y, s)).numpy().reshape(3, -1)
            found = along.nearest(self._tables, self.num_points, _host(index), told, _SEARCHES)
            return torch.from_numpy(found).reshape(s.shape)
        for _ in range(_SEARCHES):
            s, (cx, cy, cos, sin, curvature, _, _) = self._mixed(index, s)
            dx, dy = x - cx, y - cy
            before, across = dx * cos + dy * sin, dy * cos - dx * sin
            # A metre of s takes 1 - curvature * across off it; held positive inside tight turns.
            # That cos and sin are a little short of unit length between two points only shortens
            # the step.
            step = before / torch.clamp(1 - curvature * across, min=0.3)
            s = s + torch.clamp(step, -0.5, 0.5)
        return s

    def locate(self, index: Tensor, x: Tensor, y: Tensor) -> Projection:
        """Project points of which nothing is known: the nearest centre point, then `project`.

        Costs a pass over the whole table for each point; for placing, not for stepping.
        """
        flat = (x.shape[0], -1, 1)
        points = self.rows.reshape(-1, self.num_points, 14)[index]
        table_x = points[..., 0].unsqueeze(1)  # (num_worlds, 1, num_points)
        table_y = points[..., 1].unsqueeze(1)
        squared = (x.reshape(flat) - table_x) ** 2 + (y.reshape(flat) - table_y) ** 2
        nearest = squared.argmin(dim=-1).reshape(x.shape)
        return self.project(index, x, y, nearest * self._of(self.spacing, index, x))

    def signed_gap(self, index: Tensor, ahead: Tensor, behind: Tensor) -> Tensor:
        """Return how far `ahead` lies in front of `behind` along the track [m].

        On closed tracks the shorter way round is taken, in [-length / 2, length / 2).
        """
        gap = ahead - behind
        length = self._of(self.length, index, gap)
        wrapped = torch.remainder(gap + length * 0.5, length) - length * 0.5
        if self.all_closed:
            return wrapped
        return torch.where(self._of(self.closed, index, gap), wrapped, gap)

    def curvature_at(self, index: Tensor, s: Tensor) -> Tensor:
        """Return the signed curvature [1/m] at the centre point nearest to distance s.

        It is smoothed over 0.3 m, six points, so nothing is gained by interpolating. Arguments as
        of `at`.
        """
        last = self._of(self.count, index, s) - 1
        place = torch.round(s / self._of(self.spacing, index, s)).to(torch.int64)
        point = torch.remainder(place, last + 1)
        if not self.all_closed:
            held = torch.minimum(torch.clamp(place, min=0), last)
            point = torch.where(self._of(self.closed, index, s), point, held)
        return torch.take(self._curvature, point + self._of(self._first_row, index, s))

    def _mixed(self, index: Tensor, s: Tensor) -> tuple[Tensor, tuple[Tensor, ...]]:
        """Return s wrapped, and the seven columns of the table interpolated there."""
        if s.is_cpu:
            from league.track import along  # late: Numba takes a while

            places = _host(s).reshape(-1)
            there = along.interpolated(self._tables, self.num_points, _host(index), places)
            wrapped, *columns = torch.from_numpy(there).reshape(8, *s.shape).unbind()
            return wrapped, tuple(columns)
        length = self._of(self.length, index, s)
        # Rounding can make the remainder of a small negative number equal to the length.
        wrapped = torch.remainder(s, length)
        wrapped = torch.where(wrapped >= length, 0.0, wrapped)
        if not self.all_closed:
            held = torch.minimum(torch.clamp(s, min=0.0), length)
            wrapped = torch.where(self._of(self.closed, index, s), wrapped, held)
        place = wrapped / self._of(self.spacing, index, s)
        low = torch.minimum(place.to(torch.int64), self._of(self.count, index, s) - 1)
        part = torch.clamp(place - low, 0.0, 1.0)
        row = (low + self._of(self._first_row, index, s)).reshape(-1)
        found = self.rows.index_select(0, row).t().contiguous()  # (14, points)
        mixed = found[:7] + found[7:] * part.reshape(-1)
        return wrapped, mixed.reshape(7, *s.shape).unbind(0)

    @cached_property
    def _tables(self) -> tuple[np.ndarray, ...]:
        """What compiled code reads."""
        tables = (self.rows, self.count, self.length, self.spacing, self.closed)
        return tuple(table.numpy() for table in tables)

    @cached_property
    def _curvature(self) -> Tensor:
        return self.rows[:, 4].contiguous()

    @cached_property
    def _first_row(self) -> Tensor:
        return torch.arange(len(self.tracks), device=self.device) * self.num_points

    def _of(self, per_track: Tensor, index: Tensor, points: Tensor) -> Tensor:
        """Return each world's track's value, with as many trailing axes as the points have."""
        if len(self.tracks) == 1:
            return per_track  # of shape (1,): it broadcasts, to the same bits
        return _like(per_track.index_select(0, index), points)


def _host(tensor: Tensor) -> np.ndarray:
    """Return numpy's view of a tensor on the CPU, row by row as compiled code wants it."""
    return tensor.contiguous().numpy()


def _rows(track: Track, num_points: int) -> Tensor:
    """Return the table of one track, padded to some number of points; see TrackSet.rows."""
    columns = np.concatenate(
        [
            track.center,
            track.tangent,
            track.curvature[:, None],
            np.linalg.norm(track.left - track.center, axis=1)[:, None],
            np.linalg.norm(track.right - track.center, axis=1)[:, None],
        ],
        axis=1,
    )
    following = (
        np.roll(columns, -1, axis=0) if track.closed else np.vstack([columns[1:], columns[-1:]])
    )
    table = np.concatenate([columns, following - columns], axis=1)
    padded = np.pad(table, ((0, num_points - len(table)), (0, 0)), mode="edge")
    return torch.tensor(padded, dtype=torch.float32)


def _like(per_world: Tensor, points: Tensor) -> Tensor:
    """Give a per-world value as many trailing axes as the points have."""
    return per_world.reshape(per_world.shape + (1,) * (points.dim() - per_world.dim()))


def _wrapped(angle: float) -> float:
    return float((angle + np.pi) % (2 * np.pi) - np.pi)
