"""A racing line as tables that a batch of cars reads: beside each car, and ahead along the line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from league.racing_line.racing_line import RacingLine
from league.track.course import Track

NODE_GAP = 0.2
"""Distance between two nodes of a horizon [m]."""
NODES = 21
"""Nodes of a horizon, the first at the car."""


@dataclass(frozen=True, eq=False)
class Place:
    """Where the line is beside each car, (num_rows,)."""

    distance: Tensor
    """Along the line [m]."""
    lateral: Tensor
    """Line to the left of the centreline [m]."""
    heading: Tensor
    """Line's direction minus the track's [rad]."""


@dataclass(frozen=True, eq=False)
class Horizon:
    """The line ahead of each car, (num_rows, NODES): nodes NODE_GAP metres of line apart."""

    ahead: Tensor
    """Centreline metres from the car [m]."""
    lateral: Tensor
    """Line to the left of the centreline [m]."""
    curvature: Tensor
    """[1/m]."""
    speed: Tensor
    """Speed the line allows [m/s]."""
    left: Tensor
    """Distance from the centreline to the left border [m]."""
    right: Tensor
    """Distance from the centreline to the right border [m]."""
    x: Tensor
    """World frame [m]."""
    y: Tensor
    """World frame [m]."""
    normal_x: Tensor
    """The TRACK's normal to the left, along which lateral places are told."""
    normal_y: Tensor
    """The same."""


@dataclass(frozen=True, eq=False)
class Path:
    """A line's tables; uniform in s for `beside`, uniform along the line for `ahead_of`."""

    closed: bool
    length: float
    """Of the centreline [m]."""
    total: float
    """Of the line [m]."""
    by_s: Tensor
    """Columns distance, lateral, heading; a closed one repeats its first row at the end."""
    by_distance: Tensor
    """Columns s minus its even share, then those of a Horizon after `ahead`."""
    nodes: Tensor
    """How far ahead of a car a horizon's nodes lie along the line [m], (NODES,)."""

    @classmethod
    def of(cls, line: RacingLine, track: Track, *, device: torch.device | str = "cpu") -> Path:
        """Build the tables of a line on its track, on a device."""
        step = track.length / (len(line.s) if line.closed else len(line.s) - 1)
        run = np.concatenate([[0.0], np.cumsum(line.stretch * step)])
        run = run if line.closed else run[:-1]
        s = np.arange(len(run)) * step

        def whole(values: np.ndarray) -> np.ndarray:
            return np.append(values, values[0]) if line.closed else values

        def of_track(values: np.ndarray) -> np.ndarray:
            given = np.arange(len(values) + track.closed)
            spacing = track.length / (len(given) - 1)
            return np.interp(s, given * spacing, whole(values))

        lateral, total = whole(line.lateral), float(run[-1])
        even = np.linspace(0.0, total, len(run))
        tangent_x, tangent_y = (of_track(track.tangent[:, axis]) for axis in (0, 1))
        size = np.hypot(tangent_x, tangent_y)
        normal_x, normal_y = -tangent_y / size, tangent_x / size
        columns = [
            s,
            lateral,
            whole(line.curvature),
            whole(line.speed),
            of_track(np.linalg.norm(track.left - track.center, axis=1)),
            of_track(np.linalg.norm(track.right - track.center, axis=1)),
            of_track(track.center[:, 0]) + lateral * normal_x,
            of_track(track.center[:, 1]) + lateral * normal_y,
            normal_x,
            normal_y,
        ]
        ahead = [np.interp(even, run, column) for column in columns]
        ahead[0] = ahead[0] - even * (track.length / total)
        beside = [run, lateral, whole(line.heading)]
        return cls(
            closed=line.closed,
            length=track.length,
            total=total,
            by_s=_table(beside, device),
            by_distance=_table(ahead, device),
            nodes=torch.arange(NODES, dtype=torch.float32, device=device) * NODE_GAP,
        )

    def beside(self, s: Tensor) -> Place:
        """Return where the line is at these places of the track."""
        distance, lateral, heading = self._read(self.by_s, s, self.length)
        return Place(distance, lateral, heading)

    def ahead_of(self, place: Place) -> Horizon:
        """Return the line ahead of these places."""
        distance = place.distance.unsqueeze(1) + self.nodes
        uneven, *others = self._read(self.by_distance, distance, self.total)
        ahead = uneven - uneven[:, :1] + self.nodes * (self.length / self.total)
        return Horizon(ahead, *others)

    def _read(self, table: Tensor, where: Tensor, end: float) -> tuple[Tensor, ...]:
        """Mix the two rows next to each place; loops wrap, open lines hold their ends."""
        last = len(table) - 1
        where = torch.remainder(where, end) if self.closed else torch.clamp(where, 0.0, end)
        cell = torch.clamp(where * (last / end), 0.0, last)
        low = torch.clamp(cell.to(torch.int64), max=last - 1)
        part = (cell - low).unsqueeze(-1)
        mixed = table[low] + (table[low + 1] - table[low]) * part
        return mixed.unbind(dim=-1)


def _table(columns: list[np.ndarray], device: torch.device | str) -> Tensor:
    return torch.tensor(np.stack(columns, axis=1), dtype=torch.float32, device=device)


def read_nodes(values: Tensor, distance: Tensor) -> Tensor:
    """Return node values at distances ahead along the line, held at the ends.

    Args:
        values: (num_rows, NODES).
        distance: [m], (num_rows, K).
    """
    cell = torch.clamp(distance / NODE_GAP, 0.0, NODES - 1.0)
    low = torch.clamp(cell.to(torch.int64), max=NODES - 2)
    first = torch.gather(values, 1, low)
    return first + (torch.gather(values, 1, low + 1) - first) * (cell - low)
