"""Races as a PettingZoo ParallelEnv, one agent for each car."""

from __future__ import annotations

import os
from typing import Any, Unpack

import numpy as np
from gymnasium.spaces import Box, Dict
from pettingzoo import ParallelEnv

from league.envs import make, state
from league.envs.actions import SIZE, of_agents
from league.envs.adapters import load_reward, spaces
from league.envs.adapters.rendering import EnvRenderer
from league.envs.make import EnvOptions
from league.envs.race_env import Observations, RaceEnv, Step
from league.track.track import Track

Observation = dict[str, np.ndarray]


def parallel_env(
    track: str | os.PathLike[str] | Track = "reinvent_2018",
    kind: make.RaceKind = "head_to_head",
    num_cars: int | None = None,
    *,
    sensors: make.Sensors = make.BOTH,
    privileged: bool = False,
    render_mode: str | None = None,
    view: str = "chase",
    max_cycles: int | None = None,
    **options: Unpack[EnvOptions],
) -> RaceParallelEnv:
    """Return a race in which every car is an agent: car_0, car_1, ...

    Args:
        track: name of a track, path of its .yaml file, or a Track.
        kind: time_trial, obstacle_avoidance or head_to_head.
        num_cars: agents; by default 2 in a head_to_head race, else 1.
        sensors: of the cars: names (stereo, lidar), CameraConfig or LidarConfig objects; the same
            for all, or a dict by agent.
        privileged: whether the agents also observe the truth, as group `state`.
        render_mode: rgb_array for pictures, human for the live viewer, or None.
        view: of pictures: chase, from behind the leader, or top.
        max_cycles: PettingZoo's name for the option max_steps.
        options: see league.envs.make.EnvOptions; bullet is the default solver here.

    Raises:
        LeagueError: an unknown track or name, or settings that contradict each other.
    """
    make.check_options(options, parallel_env)
    options.setdefault("solver", "bullet")
    make.set_longest(options, "max_cycles", max_cycles)
    cfg = make.configure(kind=kind, num_cars=num_cars, sensors=sensors, restarting=(), **options)
    tracks = make.course(track)
    reward = load_reward(options.get("reward"), tracks, cfg, 1, range(cfg.sim.num_cars))
    env = RaceEnv(tracks, cfg, reward=reward)
    return RaceParallelEnv(env, privileged=privileged, render_mode=render_mode, view=view)


class RaceParallelEnv(ParallelEnv[str, Any, np.ndarray]):
    """One race; an agent leaves when its race or episode ends, until the next reset.

    Observations are dicts of the groups its car carries (docs/observations.md), actions are
    float32 [steering, speed] in [-1, 1].
    """

    metadata = {  # noqa: RUF012
        "name": "league_v0",
        "render_modes": ["rgb_array", "human"],
        "render_fps": 15,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        env: RaceEnv,
        *,
        privileged: bool = False,
        render_mode: str | None = None,
        view: str = "chase",
    ) -> None:
        self._env, self.render_mode = env, render_mode
        self._renderer = EnvRenderer(env, render_mode, view)
        self._generator: np.random.Generator | None = None
        self.possible_agents = [f"car_{car}" for car in range(env.num_cars)]
        self.agents: list[str] = []
        self._observation_spaces = {
            agent: spaces.observation_space(env.cfg.sensors_of(car), privileged)
            for car, agent in enumerate(self.possible_agents)
        }
        self._action_spaces = {agent: spaces.action_space() for agent in self.possible_agents}
        self.observation_spaces = {**self._observation_spaces}
        self.action_spaces = {**self._action_spaces}
        limit, size = spaces.STATE_LIMIT, env.num_cars * state.SIZE
        self.state_space = Box(-limit, limit, (size,), np.float32)
        self._readers = [
            spaces.ObservationReader(space) for space in self._observation_spaces.values()
        ]
        self._infos = [spaces.Infos(env, car) for car in range(env.num_cars)]
        self._cars = {agent: car for car, agent in enumerate(self.possible_agents)}
        self._actions = np.zeros((1, env.num_cars, SIZE), np.float32)

    @property
    def race_env(self) -> RaceEnv:
        """The race, to look at."""
        return self._env

    def observation_space(self, agent: str) -> Dict:
        """Return the space of an agent's observations; always the same object."""
        return self._observation_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """Return the space of an agent's actions; always the same object."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Start a race from a seed; None goes on to another. `options` is not used."""
        if seed is not None:
            self._generator = np.random.default_rng(make.checked_seed(seed))
        elif self._generator is None:
            self._generator = np.random.default_rng()
        observations = self._env.reset(seeds=[make.draw_seed(self._generator)])
        self.agents = list(self.possible_agents)
        self._renderer.reset()
        return self._read(observations), self._infos_of(None)

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[
        dict[str, Observation],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Drive all cars for 1/15 s; ActionError if agents and actions do not match."""
        known = self.possible_agents if self._generator is not None else []
        checked = of_agents(actions, self.agents, known)
        if not self.agents:
            return {}, {}, {}, {}, {}
        for agent, action in checked.items():
            self._actions[0, self._cars[agent]] = action
        step = self._env.step(self._actions)
        self._renderer.update()
        rewards, terminated, truncated = map(
            self._by_agent, (step.rewards, step.terminated, step.truncated)
        )
        observations, infos = self._read(step.observations), self._infos_of(step)
        for agent in [name for name in self.agents if terminated[name] or truncated[name]]:
            self._env.retire(self._cars[agent])
            self.agents.remove(agent)
        return observations, rewards, terminated, truncated, infos

    def state(self) -> np.ndarray:
        """Return the truth about all cars, float32, (num_cars * league.envs.state.SIZE,)."""
        truth = np.concatenate([groups["state"][0] for groups in self._env.observations])
        return truth.clip(-spaces.STATE_LIMIT, spaces.STATE_LIMIT)

    def render(self) -> np.ndarray | None:
        """Return a picture, uint8 (height, width, 3), or show the race in the live viewer."""
        return self._renderer.render()

    def close(self) -> None:
        """Close the physics engine and the viewer; may be called twice."""
        self._renderer.close()
        self._env.close()

    def _read(self, observations: Observations) -> dict[str, Observation]:
        return {agent: self._readers[car].read(observations[car]) for agent, car in self._racing()}

    def _infos_of(self, step: Step | None) -> dict[str, dict[str, Any]]:
        return {agent: self._infos[car].of_first(step) for agent, car in self._racing()}

    def _by_agent(self, values: np.ndarray) -> dict[str, Any]:
        numbers = values[0].tolist()
        return {agent: numbers[car] for agent, car in self._racing()}

    def _racing(self) -> list[tuple[str, int]]:
        return [(agent, self._cars[agent]) for agent in self.agents]
