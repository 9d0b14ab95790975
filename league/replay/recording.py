"""Recorder: is told each step of a race and keeps it, without touching the race."""

from __future__ import annotations

import zlib
from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor

from league import __version__
from league.errors import ReplayError
from league.race_spec import RaceResult, RaceSpec
from league.replay.columns import NUM_ACTIONS, Columns
from league.replay.replay import PARAMETERS, Replay
from league.sim.world import World
from league.track.course import TrackSet

_FOR_GOOD_S = 1e5
"""What a replay tells as the penalty of a car that is out of the race: longer than any race [s]."""


class Recorder:
    """Keeps the steps of one race as it is told them; it looks at the race and never touches it."""

    def __init__(
        self,
        spec: RaceSpec,
        tracks: TrackSet,
        names: Sequence[str] | None = None,
        step_hz: int = 15,
    ) -> None:
        """Make a recorder for one race.

        Args:
            spec: what was asked.
            tracks: the tracks the world's `track` index points into.
            names: who drives each car, by grid slot; by default the spec's entries.
            step_hz: control steps per second.
        """
        self._tracks = tracks
        self._names = tuple(names or [entry.name for entry in spec.entries])
        self._step_hz = step_hz
        self._first: World | None = None
        # Tensors only, on the race's device; all arithmetic waits for `finish`.
        self._motion: list[Tensor] = []
        self._book: list[Tensor] = []
        self._counts: list[Tensor] = []
        self._actions: list[Tensor] = []
        self._obstacles: list[Tensor] = []

    def start(self, world: World) -> None:
        """Keep the world on the grid, before the first step."""
        if world.num_worlds != 1:
            raise ValueError(f"a recorder keeps one race, not a batch of {world.num_worlds} worlds")
        if self._first is not None:
            raise ValueError("this recorder has started already: make a new one for each race")
        self._first = world
        self._keep(world, world.motion.x.new_zeros((world.num_cars, NUM_ACTIONS)))

    def add(self, world: World, actions: Tensor) -> None:
        """Keep the world after one control step and the actions that led to it.

        Args:
            world: one race, num_worlds == 1.
            actions: in [-1, 1], (1, num_cars, 2) or (num_cars, 2).
        """
        if self._first is None:
            raise ValueError("tell the recorder the grid with start(world) before the first step")
        self._keep(world, actions)

    def _keep(self, world: World, actions: Tensor) -> None:
        # Stacking copies, so nothing that happens to the race later can reach the recording.
        m, standing, obstacles = world.motion, world.standing, world.obstacles
        self._motion.append(
            torch.stack((m.x, m.y, m.yaw, m.velocity_x, m.velocity_y, m.yaw_rate, m.steering))
        )
        self._book.append(torch.stack((standing.penalty_s, standing.distance)))
        self._counts.append(torch.stack((standing.laps, standing.ghost.to(torch.int64))))
        self._actions.append(actions.detach().reshape(-1, NUM_ACTIONS).clone())
        if obstacles.x.shape[1]:
            self._obstacles.append(torch.stack((obstacles.x, obstacles.y, obstacles.yaw)))

    def finish(self, result: RaceResult) -> Replay:
        """Return the race that was recorded.

        The columns are rounded here as on disk, so a replay does not change by being written.
        """
        if self._first is None:
            raise ValueError("nothing was recorded: tell the recorder the grid with start(world)")
        world = self._first
        track = self._tracks.tracks[int(world.track[0])]
        columns = self._columns(world.num_cars, world.obstacles.x.shape[1])
        if not columns.all_finite():
            raise ReplayError("the race left the numbers (NaN or infinity), so it cannot be kept")
        obstacles = world.obstacles
        return Replay(
            result=result,
            track=track,
            names=self._names,
            step_hz=self._step_hz,
            parameters=np.stack(
                [getattr(world.cars, name)[0].cpu().numpy() for name in PARAMETERS], axis=1
            ).astype(np.float32),
            obstacle_sizes=np.stack(
                [obstacles.half_length[0].cpu().numpy(), obstacles.half_width[0].cpu().numpy()],
                axis=1,
            ).astype(np.float32),
            columns=columns.rounded(),
            league_version=__version__,
        )

    def _columns(self, num_cars: int, num_obstacles: int) -> Columns:
        frames = len(self._motion)
        motion = _array(self._motion).reshape(frames, 7, num_cars)
        book = _array(self._book).reshape(frames, 2, num_cars)
        counts = _array(self._counts).reshape(frames, 2, num_cars)
        actions = _array([a.to(torch.float32) for a in self._actions])
        actions = actions.reshape(frames, num_cars, NUM_ACTIONS)
        places = np.zeros((frames, 3, 0), dtype=np.float32)
        if num_obstacles:
            places = _array(self._obstacles).reshape(frames, 3, num_obstacles)
        checksum = _checksums(motion, book, counts, actions, places)
        if (places == places[:1]).all():
            places = places[:1]
        x, y, yaw, velocity_x, velocity_y, yaw_rate, steering = motion.astype(np.float64).swapaxes(
            0, 1
        )
        return Columns(
            x=x,
            y=y,
            yaw=yaw,
            velocity_x=velocity_x,
            velocity_y=velocity_y,
            yaw_rate=yaw_rate,
            steering=steering,
            actions=actions.astype(np.float64),
            penalty_s=np.minimum(book[:, 0].astype(np.float64), _FOR_GOOD_S),  # NaN stays NaN
            ghost=counts[:, 1].astype(np.float64),
            laps=counts[:, 0].astype(np.float64),
            distance=book[:, 1].astype(np.float64),
            obstacle_x=places[:, 0].astype(np.float64),
            obstacle_y=places[:, 1].astype(np.float64),
            obstacle_yaw=places[:, 2].astype(np.float64),
            checksum=checksum,
        )


def _array(steps: list[Tensor]) -> np.ndarray:
    return torch.stack(steps).cpu().numpy()


def _checksums(*parts: np.ndarray) -> np.ndarray:
    """Return the CRC-32 of each frame's exact bits and number, uint32, (num_frames,)."""
    frames = len(parts[0])
    number = np.arange(frames, dtype="<i8").reshape(frames, 1)
    rows = [np.ascontiguousarray(part.reshape(frames, -1)) for part in (number, *parts)]
    row_bytes = np.concatenate([row.view(np.uint8).reshape(frames, -1) for row in rows], axis=1)
    return np.array([zlib.crc32(row.tobytes()) for row in row_bytes], dtype=np.uint32)
