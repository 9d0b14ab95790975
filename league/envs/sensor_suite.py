"""The sensors of all cars, each on its own clock; a sensor that is not due repeats its reading."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from league.envs import observations, state
from league.envs.config import EnvConfig
from league.envs.step import worlds_per_thread
from league.portable_math import f32
from league.sim.config import FRAME_STEPS, CameraConfig, SensorConfig
from league.sim.records import NOBODY, World
from league.threads import shared_out
from league.track.track import TrackSet

if TYPE_CHECKING:  # OpenCV comes late
    from league.sim.camera.renderer import Renderer

Reading = Callable[[World, int, np.ndarray | None], np.ndarray]
_COMPUTED: dict[str, tuple[Callable[..., int], int, tuple[f32, ...]]] = {
    "state": (observations.states, state.SIZE, ()),
    "truth": (observations.truths, observations.TRUTH_SIZE, (f32(np.inf),)),
    "ahead": (observations.truths, observations.TRUTH_SIZE, (f32(observations.BEHIND),)),
}
"""Loop, size and settings of the groups that are computed on access."""


class Groups(Mapping[str, np.ndarray]):
    """One car's groups; those of the true state are computed on access, as few policies use them.

    `truth` and `ahead` are always there, and listed where the car carries them.
    """

    def __init__(self, suite: SensorSuite, car: int, world: World, motions: np.ndarray) -> None:
        # References alone, so that the groups of a pickled environment are its own.
        self._suite, self._car, self._world, self._motions = suite, car, world, motions

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "motion":
            return self._motions[self._car]
        if name in _COMPUTED:
            return self._suite.computed(name, self._world)[self._car]
        return self._suite.held[self._car][name]

    def __iter__(self) -> Iterator[str]:
        return iter(
            (*self._suite.held[self._car], *self._suite.privileged[self._car], "motion", "state")
        )

    def __len__(self) -> int:
        return sum(1 for _ in self)


class SensorSuite:
    """The sensors of all cars, with their last readings; part of RaceEnv's state."""

    def __init__(
        self, tracks: TrackSet, cfg: EnvConfig, renderers: Mapping[int, Renderer] | None = None
    ) -> None:
        """Build the sensors that the cars carry; `renderers` are those of some cars' cameras.

        The others are made here; cars with equal cameras share one.
        """
        self._tracks, self._cfg, self._given = tracks, cfg, renderers or {}
        self._renderers: dict[CameraConfig, Renderer] = {}
        self._sensors: list[dict[str, tuple[float, Reading]]] = [
            self._sensors_of(car) for car in range(cfg.sim.num_cars)
        ]
        self._readings: list[dict[str, np.ndarray]] = [{} for _ in self._sensors]
        self.held: list[dict[str, np.ndarray]] = [{} for _ in self._sensors]
        """What each car is given: its last readings, with the earlier ones that it keeps."""
        self._kept_steps = [_kept_steps(cfg.sensors_of(car)) for car in range(cfg.sim.num_cars)]
        self.carries = any(self._sensors) or any(self._kept_steps)
        """Whether any car keeps readings."""
        late = [hz < cfg.sim.step_hz for own in self._sensors for hz, _ in own.values()]
        self.remembers = any(late) or any(self._kept_steps)
        """Whether any car is given readings of an earlier step."""
        self.privileged = [cfg.sensors_of(car).privileged for car in range(cfg.sim.num_cars)]
        self._computed: dict[str, np.ndarray] = {}
        self._fresh: set[str] = set()
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        for held in (*self.held, *self._readings):
            held.clear()
        self._stale: np.ndarray | None = None
        self._past: dict[tuple[str, int], list[np.ndarray]] = {}
        """What each car read in the last step and before it, newest first, by group and car."""

    def refresh(self, cars: np.ndarray) -> None:
        """Read the sensors of these cars next time, due or not; bool, (num_worlds, num_cars)."""
        if self.carries and cars.any():
            self._stale = cars.copy() if self._stale is None else self._stale | cars

    def refresh_after(self, verdicts: np.ndarray) -> None:
        """Read the sensors of the cars that the referee has moved next time, due or not."""
        if self.carries:
            thrown = verdicts["forced_off"] & (verdicts["crashed_obstacle"] != NOBODY)
            self.refresh(verdicts["crashed"] | verdicts["released"] | thrown)

    def groups(self, world: World, motions: np.ndarray) -> tuple[Groups, ...]:
        """Return each car's groups, views of live data; motions is (num_cars, num_worlds, 5)."""
        return tuple(Groups(self, car, world, motions) for car in range(len(self.held)))

    def computed(self, name: str, world: World) -> np.ndarray:
        """Return a computed group of all cars, float32 (num_cars, num_worlds, SIZE)."""
        loop, size, settings = _COMPUTED[name]
        if name not in self._computed:
            self._computed[name] = np.empty((world.num_cars, world.num_worlds, size), np.float32)
        if name not in self._fresh:
            self._fresh.add(name)
            tables = (self._tracks.points, self._tracks.courses, self._computed[name])
            arrays = (world.cars, world.obstacles, world.worlds, *tables, *settings)
            shared_out(loop, world.num_worlds, worlds_per_thread(world.num_cars), *arrays)
        return self._computed[name]

    def observe(self, world: World) -> None:
        """Read what is due, on each race's own clock: a race in a batch equals that race alone."""
        self._fresh.clear()
        if self.carries:
            self.read(world)

    def read(self, world: World) -> tuple[Mapping[str, np.ndarray], ...]:
        """Return the readings of each car's sensors, without own motion and the truth."""
        step_hz = self._cfg.sim.step_hz
        for car, sensors in enumerate(self._sensors):
            held = self._readings[car]
            for name, (rate_hz, read) in sensors.items():
                if rate_hz >= step_hz:
                    held[name] = read(world, car, None)  # due at every step
                    continue
                new = observations.due(rate_hz, step_hz, world.worlds["step"])
                if self._stale is not None:
                    new = new | self._stale[:, car]
                if name not in held or new.all():
                    held[name] = read(world, car, None)
                elif new.any():
                    rows = np.flatnonzero(new)
                    held[name] = _with(held[name], rows, read(world, car, rows))
        self._remember(world, self._stale)
        self._stale = None
        return tuple(self.held)

    def _remember(self, world: World, moved: np.ndarray | None, *, again: bool = False) -> None:
        """Bring the groups with earlier readings up to date, newest first.

        A car that begins or was put elsewhere has no past: all of it is what it reads now. `again`:
        these are other readings of the same step.
        """
        for car, held in enumerate(self.held):
            held.update(self._readings[car])
            for name, most in self._kept_steps[car].items():
                now = held[name] if name == "stereo" else self._reading(world, car)
                past = self._past.get((name, car), [now] * (most + 1))[again:][:most]
                if moved is not None and moved[:, car].any():
                    # Earlier readings belong to observations already handed out: not in place.
                    fresh = moved[:, car].reshape(-1, *[1] * (now.ndim - 1))
                    past = [np.where(fresh, now, one) for one in past]
                self._past[name, car] = kept = [now, *past]
                given = kept[::FRAME_STEPS] if name == "stereo" else past
                held[name] = np.concatenate(given, axis=1)

    def _reading(self, world: World, car: int) -> np.ndarray:
        """Return motion and lidar of a car now, float32 (num_worlds, 5 + size)."""
        motion = np.empty((world.num_worlds, len(observations.MOTION_FIELDS)), np.float32)
        observations.motions(np.ascontiguousarray(world.cars[:, car]), motion)
        lidar = self.held[car].get("lidar")
        return motion if lidar is None else np.concatenate([motion, lidar], axis=1)

    def observe_again(self, world: World, rows: np.ndarray) -> None:
        """Read the sensors of these races, which have just been started again; not the others'."""
        self._fresh.clear()
        self._stale = None
        for car, sensors in enumerate(self._sensors):
            for name, (_, read) in sensors.items():
                kept = self._readings[car][name]
                self._readings[car][name] = _with(kept, rows, read(world, car, rows))
        moved = np.zeros((world.num_worlds, world.num_cars), np.bool_)
        moved[rows] = True
        self._remember(world, moved, again=True)

    def _sensors_of(self, car: int) -> dict[str, tuple[float, Reading]]:
        carried = self._cfg.sensors_of(car)
        sensors: dict[str, tuple[float, Reading]] = {}
        if carried.camera is not None:
            renderer = self._given.get(car) or self._renderer(carried.camera)
            sensors["stereo"] = carried.camera.rate_hz, renderer.render
        if carried.lidar is not None:
            from league.sim import lidar

            scan = partial(lidar.scan, self._tracks, self._cfg.sim, carried.lidar)
            sensors["lidar"] = carried.lidar.rate_hz, scan
        return sensors

    def _renderer(self, camera: CameraConfig) -> Renderer:
        if camera not in self._renderers:
            from league.sim.camera.renderer import Renderer

            arguments = (self._tracks, self._cfg.sim, camera, self._cfg.looks)
            self._renderers[camera] = Renderer(*arguments)
        return self._renderers[camera]


def _kept_steps(carried: SensorConfig) -> dict[str, int]:
    """Return of how many earlier steps a car keeps readings, by group; none of 0 steps."""
    steps = {"stereo": FRAME_STEPS * (carried.frames - 1), "history": carried.history}
    return {name: most for name, most in steps.items() if most}


def _with(array: np.ndarray, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return a copy of an array with other values in some rows."""
    changed = array.copy()
    changed[rows] = values
    return changed
