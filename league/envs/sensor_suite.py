"""The sensors of all cars, each on its own clock; a sensor that is not due repeats its reading."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
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

Reading = Callable[[World, np.ndarray | None], np.ndarray]


class Groups(Mapping[str, np.ndarray]):
    """One car's groups; `state` is computed on access, because racing policies do not use it."""

    def __init__(
        self,
        held: Mapping[str, np.ndarray],
        motion: np.ndarray,
        car: int,
        states: Callable[[], np.ndarray],
    ) -> None:
        self._held, self._motion, self._car, self._states = held, motion, car, states

    def __getitem__(self, name: str) -> np.ndarray:
        if name == "motion":
            return self._motion
        return self._states()[self._car] if name == "state" else self._held[name]

    def __iter__(self) -> Iterator[str]:
        return iter((*self._held, "motion", "state"))

    def __len__(self) -> int:
        return len(self._held) + 2


class SensorSuite:
    """The sensors of all cars, with their last readings; part of RaceEnv's state."""

    def __init__(self, tracks: TrackSet, cfg: EnvConfig, device: str = "cpu") -> None:
        """Build the sensors that the cars carry; cars with equal cameras share a renderer."""
        self._tracks, self._cfg, self._device = tracks, cfg, device
        self._renderers: dict[CameraConfig, Renderer] = {}
        self._sensors: list[dict[str, tuple[float, Reading]]] = [
            self._sensors_of(car) for car in range(cfg.sim.num_cars)
        ]
        self._held: list[dict[str, np.ndarray]] = [{} for _ in self._sensors]
        self._carries = any(self._sensors)
        self._states: np.ndarray | None = None
        self._states_fresh = False
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        for held in self._held:
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

        def states() -> np.ndarray:
            if self._states is None:
                shape = (world.num_cars, world.num_worlds, state.SIZE)
                self._states = np.empty(shape, np.float32)
            if not self._states_fresh:
                self._states_fresh = True
                tables = (self._tracks.points, self._tracks.courses)
                over_worlds(
                    observations.states,
                    *(world.num_worlds, world.num_cars),
                    *(world.cars, world.obstacles, world.worlds, *tables, self._states),
                )
            return self._states

        return tuple(Groups(held, motions[car], car, states) for car, held in enumerate(self._held))

    def observe(self, world: World) -> None:
        """Read what is due, on each race's own clock: a race in a batch equals that race alone."""
        self._states_fresh = False
        if self._carries:
            self.read(world)

    def read(self, world: World) -> tuple[Mapping[str, np.ndarray], ...]:
        """Return the readings of each car's sensors, without own motion and the truth."""
        step_hz = self._cfg.sim.step_hz
        for car, sensors in enumerate(self._sensors):
            held = self._held[car]
            for name, (rate_hz, read) in sensors.items():
                if rate_hz >= step_hz:
                    held[name] = read(world, None)  # due at every step
                    continue
                new = observations.due(rate_hz, step_hz, world.worlds["step"])
                if self._stale is not None:
                    new = new | self._stale[:, car]
                if name not in held or new.all():
                    held[name] = read(world, None)
                elif new.any():
                    rows = np.flatnonzero(new)
                    fresh = held[name].copy()
                    fresh[rows] = read(world, rows)
                    held[name] = fresh
        self._stale = None
        return tuple(self._held)

    def _sensors_of(self, car: int) -> dict[str, tuple[float, Reading]]:
        carried = self._cfg.sensors_of(car)
        sensors: dict[str, tuple[float, Reading]] = {}
        if carried.camera is not None:
            renderer = self._renderer(carried.camera)
            sensors["stereo"] = (
                carried.camera.rate_hz,
                lambda world, rows: renderer.render(world, car, rows),
            )
        if carried.lidar is not None:
            from league.sim import lidar

            settings, sim, tracks = carried.lidar, self._cfg.sim, self._tracks

            def scan(world: World, rows: np.ndarray | None) -> np.ndarray:
                return lidar.scan(tracks, sim, settings, world, car, rows)

            sensors["lidar"] = (settings.rate_hz, scan)
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
