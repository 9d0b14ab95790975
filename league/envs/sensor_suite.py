"""The sensors of all cars, each on its own clock; a sensor that is not due repeats its reading."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from league.envs import observations, state
from league.envs.config import EnvConfig
from league.envs.step import over_worlds
from league.sim.config import CameraConfig
from league.sim.world import World
from league.track.track import TrackSet

if TYPE_CHECKING:  # OpenCV comes late
    from league.sim.camera.paint_renderer import Renderer

Reading = Callable[[World, int, np.ndarray | None], np.ndarray]


class Groups(Mapping[str, np.ndarray]):
    """One car's groups; `state` is computed on access, because racing policies do not use it."""

    def __init__(self, suite: SensorSuite, car: int, world: World, motions: np.ndarray) -> None:
        # References alone, so that the groups of a pickled environment are its own.
        self._suite, self._car, self._world, self._motions = suite, car, world, motions

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "motion":
            return self._motions[self._car]
        if name == "state":
            return self._suite.states(self._world)[self._car]
        return self._suite.held[self._car][name]

    def __iter__(self) -> Iterator[str]:
        return iter((*self._suite.held[self._car], "motion", "state"))

    def __len__(self) -> int:
        return len(self._suite.held[self._car]) + 2


class SensorSuite:
    """The sensors of all cars, with their last readings; part of RaceEnv's state."""

    def __init__(self, tracks: TrackSet, cfg: EnvConfig, device: str = "cpu") -> None:
        """Build the sensors that the cars carry; cars with equal cameras share a renderer."""
        self._tracks, self._cfg, self._device = tracks, cfg, device
        self._renderers: dict[CameraConfig, Renderer] = {}
        self._sensors: list[dict[str, tuple[float, Reading]]] = [
            self._sensors_of(car) for car in range(cfg.sim.num_cars)
        ]
        self.held: list[dict[str, np.ndarray]] = [{} for _ in self._sensors]
        """The last readings of each car."""
        self._carries = any(self._sensors)
        self._states: np.ndarray | None = None
        self._states_fresh = False
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        for held in self.held:
            held.clear()
        self._stale: np.ndarray | None = None

    def refresh(self, cars: np.ndarray) -> None:
        """Read the sensors of these cars next time, due or not; bool, (num_worlds, num_cars)."""
        if self._carries and cars.any():
            self._stale = cars.copy() if self._stale is None else self._stale | cars

    def refresh_after(self, verdicts: np.ndarray) -> None:
        """Read the sensors of the cars that the referee has moved next time, due or not."""
        if self._carries:
            self.refresh(verdicts["crashed"] | verdicts["released"])

    def groups(self, world: World, motions: np.ndarray) -> tuple[Groups, ...]:
        """Return each car's groups, views of the last readings and of the live worlds.

        Own motion is float32 (num_cars, num_worlds, 5).
        """
        return tuple(Groups(self, car, world, motions) for car in range(len(self.held)))

    def states(self, world: World) -> np.ndarray:
        """Return the `state` groups of all cars, float32 (num_cars, num_worlds, 40)."""
        if self._states is None:
            self._states = np.empty((world.num_cars, world.num_worlds, state.SIZE), np.float32)
        if not self._states_fresh:
            self._states_fresh = True
            tables = (self._tracks.points, self._tracks.courses)
            over_worlds(
                observations.states,
                *(world.num_worlds, world.num_cars),
                *(world.cars, world.obstacles, world.worlds, *tables, self._states),
            )
        return self._states

    def observe(self, world: World) -> None:
        """Read what is due, on each race's own clock: a race in a batch equals that race alone."""
        self._states_fresh = False
        if self._carries:
            self.read(world)

    def read(self, world: World) -> tuple[Mapping[str, np.ndarray], ...]:
        """Return the readings of each car's sensors, without own motion and the truth."""
        step_hz = self._cfg.sim.step_hz
        for car, sensors in enumerate(self._sensors):
            held = self.held[car]
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
                    fresh = held[name].copy()
                    fresh[rows] = read(world, car, rows)
                    held[name] = fresh
        self._stale = None
        return tuple(self.held)

    def observe_again(self, world: World, rows: np.ndarray) -> None:
        """Read the sensors of these races, which have just been started again; not the others'."""
        self._states_fresh, self._stale = False, None
        for car, sensors in enumerate(self._sensors):
            for name, (_, read) in sensors.items():
                fresh = self.held[car][name].copy()
                fresh[rows] = read(world, car, rows)
                self.held[car][name] = fresh

    def _sensors_of(self, car: int) -> dict[str, tuple[float, Reading]]:
        carried = self._cfg.sensors_of(car)
        sensors: dict[str, tuple[float, Reading]] = {}
        if carried.camera is not None:
            sensors["stereo"] = carried.camera.rate_hz, self._renderer(carried.camera).render
        if carried.lidar is not None:
            from league.sim import lidar

            scan = partial(lidar.scan, self._tracks, self._cfg.sim, carried.lidar)
            sensors["lidar"] = carried.lidar.rate_hz, scan
        return sensors

    def _renderer(self, camera: CameraConfig) -> Renderer:
        if camera not in self._renderers:
            arguments = (self._tracks, self._cfg.sim, camera, self._cfg.looks)
            if self._cfg.camera_path == "ray":
                from league.sim.camera.raycast import RayRenderer

                self._renderers[camera] = RayRenderer(*arguments, device=self._device)
            else:
                from league.sim.camera.paint_renderer import PaintRenderer

                self._renderers[camera] = PaintRenderer(*arguments)
        return self._renderers[camera]
