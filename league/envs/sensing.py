"""Each sensor on its own clock: what is new is made, what is not due is told again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from functools import cache
from typing import TYPE_CHECKING

from torch import Tensor

from league.envs import observations
from league.envs.config import EnvConfig
from league.sim.config import CameraConfig
from league.sim.world import World
from league.track.course import TrackSet

if TYPE_CHECKING:  # OpenCV and Numba come late
    from league.sim.camera.renderer import Renderer

Reading = Callable[[World, Tensor | None], Tensor]


class Told(Mapping[str, Tensor]):
    """One car's groups; `state` is worked out when somebody asks: a policy in a race never does."""

    def __init__(
        self, groups: Mapping[str, Tensor], car: int, states: Callable[[], tuple[Tensor, ...]]
    ) -> None:
        self._groups, self._car, self._states = groups, car, states

    def __getitem__(self, name: str) -> Tensor:
        return self._states()[self._car] if name == "state" else self._groups[name]

    def __iter__(self) -> Iterator[str]:
        return iter((*self._groups, "state"))

    def __len__(self) -> int:
        return len(self._groups) + 1


class Sensing:
    """The sensors of all cars, with their last readings; part of RaceEnv's state."""

    def __init__(self, tracks: TrackSet, cfg: EnvConfig) -> None:
        """Build the sensors that the cars carry; cars with equal cameras share a renderer."""
        self._tracks, self._cfg = tracks, cfg
        self._renderers: dict[CameraConfig, Renderer] = {}
        self._sensors: list[dict[str, tuple[float, Reading]]] = [
            self._sensors_of(car) for car in range(cfg.sim.num_cars)
        ]
        self.reset()

    def reset(self) -> None:
        """Forget all readings."""
        self._held: list[dict[str, Tensor]] = [{} for _ in self._sensors]
        self._stale: Tensor | None = None

    def refresh(self, who: Tensor) -> None:
        """Have the sensors of these cars read at once, due or not; bool, (num_worlds, num_cars)."""
        self._stale = who if self._stale is None else self._stale | who

    def observe(self, world: World, last_action: Tensor) -> tuple[Mapping[str, Tensor], ...]:
        """Return each car's groups; a reading that is not due is the last one.

        Sensors run on each race's own clock, so that a race in a batch is told what it would be
        told alone.
        """
        motions = observations.motions(world, last_action)
        states = cache(lambda: observations.states(self._tracks, self._cfg.sim, world))
        return tuple(
            Told({**held, "motion": motions[car]}, car, states)
            for car, held in enumerate(self.read(world))
        )

    def read(self, world: World) -> tuple[Mapping[str, Tensor], ...]:
        """Return what each car's sensors read, without own motion and the truth."""
        step_hz = self._cfg.sim.step_hz
        for car, sensors in enumerate(self._sensors):
            held = self._held[car]
            for name, (rate_hz, read) in sensors.items():
                if rate_hz >= step_hz:
                    held[name] = read(world, None)  # due at every step
                    continue
                new = observations.due(rate_hz, step_hz, world.step)
                if self._stale is not None:
                    new = new | self._stale[:, car]
                if name not in held or bool(new.all()):
                    held[name] = read(world, None)
                elif bool(new.any()):
                    rows = new.nonzero()[:, 0]
                    fresh = held[name].clone()
                    fresh[rows] = read(world, rows)
                    held[name] = fresh
        self._stale = None
        return tuple(dict(held) for held in self._held)

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

            def scan(world: World, rows: Tensor | None) -> Tensor:
                return lidar.scan(tracks, sim, settings, world, car, rows)

            sensors["lidar"] = (settings.rate_hz, scan)
        return sensors

    def _renderer(self, camera: CameraConfig) -> Renderer:
        if camera not in self._renderers:
            if self._cfg.camera_path == "ray":
                from league.sim.camera.ray import RayRenderer as Chosen
            else:
                from league.sim.camera.paint import PaintRenderer as Chosen
            made = Chosen(self._tracks, self._cfg.sim, camera, self._cfg.looks)
            self._renderers[camera] = made
        return self._renderers[camera]
