"""`render` of the adapters: a picture of the race, or the race in the live viewer."""

from __future__ import annotations

import logging
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from league.envs.race_env import RaceEnv
from league.errors import ConfigError
from league.race_spec import Entry, RaceSpec

if TYPE_CHECKING:
    from league.rerun_view import Live

MODES = ("rgb_array", "human")
VIEWS = ("chase", "top")
SIZE = (640, 360)  # width and height of pictures


class EnvRenderer:
    """Shows the first world of a RaceEnv; it never changes it."""

    def __init__(self, env: RaceEnv, mode: str | None, view: str, car: int | None = None) -> None:
        """Check the arguments. The chase camera follows `car`; None: the leader."""
        if mode is not None and mode not in MODES:
            raise ConfigError(f"render_mode is {mode!r}: choose one of {', '.join(MODES)}, or None")
        if view not in VIEWS:
            raise ConfigError(f"view is {view!r}: choose one of {', '.join(VIEWS)}")
        self._env, self._mode, self._view, self._car = env, mode, view, car
        self._live: Live | None = None
        self._shown = 0

    def reset(self) -> None:
        """Show the start of a race."""
        # The viewer's clock runs on from race to race.
        self._before = self._shown
        self.update()

    def update(self) -> None:
        """Show the worlds in the live viewer as they are now, in human mode."""
        if self._mode != "human":
            return
        if self._live is None:
            self._live = self._open_viewer()
        world = self._env.world
        self._shown = self._before + int(world.worlds["step"][0]) + 1
        worlds = world.worlds.copy()
        worlds["step"] += self._before
        self._live.add(replace(world, worlds=worlds))

    def render(self) -> np.ndarray | None:
        """Return a picture, uint8 (height, width, 3), in rgb_array mode, otherwise None."""
        if self._mode is None:
            raise ConfigError(
                "render was called with render_mode None: make the environment with "
                "render_mode='rgb_array' or 'human'"
            )
        if self._mode == "human":
            return None  # shown already, step by step
        from league.video import stills

        env, world = self._env, self._env.world
        if self._view == "top":
            return stills.top_view(env.tracks, env.cfg.sim, world, 0, *SIZE)
        car = int(world.worlds["leader"][0]) if self._car is None else self._car
        return stills.chase_view(env.tracks, env.cfg.sim, world, 0, car, *SIZE)

    def close(self) -> None:
        """Close the viewer, if it was opened."""
        if self._live is not None:
            self._live.close()
            self._live = None

    def _open_viewer(self) -> Live:
        from league.rerun_view import Live  # late: rerun is heavy

        sim, track = self._env.cfg.sim, self._env.tracks.tracks[0]
        entries = tuple(Entry(name=f"car_{car}") for car in range(sim.num_cars))
        spec = RaceSpec(
            track=track.name, kind=sim.kind, laps=sim.rules.laps, entries=entries,
            obstacles=sim.num_obstacles, obstacle_kind=sim.obstacles.kind,
        )  # fmt: skip
        live = Live.start(spec, track)
        logging.getLogger("league").warning("the race can be watched at %s", live.address)
        return live
