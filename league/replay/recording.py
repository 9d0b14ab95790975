"""Recorder: copies each step of a race."""

from __future__ import annotations

import zlib

import numpy as np

from league import __version__
from league.errors import ReplayError
from league.race_spec import RaceResult, RaceSpec
from league.replay.replay import PARAMETERS, Columns, Replay
from league.sim import PHYSICS
from league.sim.config import SimConfig
from league.sim.records import World
from league.track.track import TrackSet

_FOR_GOOD_S = 1e5
"""Penalty in a replay of a car that is out of the race: longer than any race [s]."""
_KEPT = (
    *("x", "y", "yaw", "velocity_x", "velocity_y", "yaw_rate", "steering"),
    *("penalty_s", "distance", "laps", "ghost", "z", "roll", "pitch"),
)
"""Fields of a car that a replay keeps."""
_CHECKED = (*_KEPT, "retired")
"""Fields of a car that a frame's checksum covers."""


class Recorder:
    """Keeps copies of the steps of one race."""

    def __init__(self, spec: RaceSpec, tracks: TrackSet) -> None:
        """Start without a step; the world's `track` is an index of `tracks`."""
        self._tracks = tracks
        self._names = tuple(entry.name for entry in spec.entries)
        self._first: World | None = None
        # Records as they are; all arithmetic waits for `finish`.
        self._cars: list[np.ndarray] = []
        self._obstacles: list[np.ndarray] = []

    def start(self, world: World) -> None:
        """Keep the world on the grid, before the first step."""
        if world.num_worlds != 1:
            raise ValueError(f"a recorder keeps one race, not a batch of {world.num_worlds} worlds")
        if self._first is not None:
            raise ValueError("this recorder has started already: make a new one for each race")
        self._first = world.copy()
        self._keep(world)

    def add(self, world: World) -> None:
        """Keep a race, a batch of one, after one control step."""
        if self._first is None:
            raise ValueError("call start(world) before the first step")
        self._keep(world)

    def _keep(self, world: World) -> None:
        # Copies, so nothing that happens to the race later can reach the recording.
        self._cars.append(world.cars[0].copy())
        self._obstacles.append(world.obstacles[0].copy())

    def finish(self, result: RaceResult) -> Replay:
        """Return the race that was recorded.

        The columns are rounded here as on disk, so a replay does not change by being written.
        """
        if self._first is None:
            raise ValueError("nothing was recorded: call start(world) before the first step")
        world, columns = self._first, self._columns()
        if not columns.all_finite():
            raise ReplayError("the race left the numbers (NaN or infinity), so it cannot be kept")
        sizes = [world.obstacles[name][0] for name in ("half_length", "half_width")]
        return Replay(
            result=result,
            track=self._tracks.tracks[int(world.track[0])],
            names=self._names,
            step_hz=SimConfig().step_hz,
            parameters=np.stack([world.cars[name][0] for name in PARAMETERS], axis=1),
            obstacle_sizes=np.stack(sizes, axis=1),
            columns=columns.rounded(),
            league_version=__version__,
            physics=PHYSICS,
        )

    def _columns(self) -> Columns:
        cars, obstacles = _stacked(self._cars), _stacked(self._obstacles)
        actions = np.stack([cars["action_steering"], cars["action_speed"]], axis=-1)
        places = [obstacles[name] for name in ("x", "y", "yaw")]
        checksum = _checksums(*(cars[name] for name in _CHECKED), actions, *places)
        if all((place == place[:1]).all() for place in places):
            places = [place[:1] for place in places]
        kept = {name: cars[name].astype(np.float64) for name in _KEPT}
        # NaN stays NaN.
        penalty_s = np.where(cars["retired"], _FOR_GOOD_S, kept.pop("penalty_s"))
        names = ("obstacle_x", "obstacle_y", "obstacle_yaw")
        kept |= {name: place.astype(np.float64) for name, place in zip(names, places, strict=True)}
        kept |= {"actions": actions.astype(np.float64), "penalty_s": penalty_s}
        return Columns(**kept, checksum=checksum)


def _stacked(frames: list[np.ndarray]) -> np.ndarray:
    """Return records of all frames as one array; np.stack would compare their fields each time."""
    records = np.empty((len(frames), *frames[0].shape), frames[0].dtype)
    for number, frame in enumerate(frames):
        records[number] = frame
    return records


def _checksums(*parts: np.ndarray) -> np.ndarray:
    """Return the CRC-32 of each frame's exact bits and number, uint32, (num_frames,)."""
    frames = len(parts[0])
    number = np.arange(frames, dtype="<i8").reshape(frames, 1)
    rows = [np.ascontiguousarray(part.reshape(frames, -1)) for part in (number, *parts)]
    row_bytes = np.concatenate([row.view(np.uint8).reshape(frames, -1) for row in rows], axis=1)
    return np.array([zlib.crc32(row.tobytes()) for row in row_bytes], dtype=np.uint32)
