"""Door 1: races as a PettingZoo ParallelEnv, one agent for each car."""

from __future__ import annotations

import os
from typing import Any, Unpack

import numpy as np
from gymnasium.spaces import Box, Dict
from pettingzoo import ParallelEnv

from league.envs import actions as door_actions
from league.envs import infos, make, seeds
from league.envs.adapters import spaces
from league.envs.adapters.rendering import Pictures
from league.envs.make import Settings
from league.envs.race_env import Observations, RaceEnv, Step
from league.track.track import Track

Told = dict[str, np.ndarray]


def parallel_env(
    track: str | os.PathLike[str] | Track = "reinvent_2018",
    kind: make.RaceKind = "head_to_head",
    num_cars: int | None = None,
    *,
    sensors: make.Sensors = make.BOTH,
    privileged: bool = False,
    render_mode: str | None = None,
    view: str = "chase",
    **settings: Unpack[Settings],
) -> MultiEnv:
    """Return a race in which every car is an agent: car_0, car_1, ...

    Args:
        track: name of a track, path of its .yaml file, or a Track.
        kind: time_trial, obstacle_avoidance or head_to_head.
        num_cars: agents; by default 2 in a head_to_head race, else 1.
        sensors: what the cars carry: names (stereo, lidar), CameraConfig or LidarConfig objects;
            the same for all, or a dict by agent.
        privileged: whether the agents are told the truth too, as group `state`.
        render_mode: rgb_array for pictures, human for the live viewer, or None.
        view: what is seen in pictures: chase, from behind the leader, or top.
        settings: the rest, see league.envs.make.Settings; bullet is the default solver here.

    Raises:
        LeagueError: an unknown track or name, or settings that contradict each other.
    """
    settings.setdefault("solver", "bullet")
    cfg = make.configure(kind=kind, num_cars=num_cars, sensors=sensors, restarting=(), **settings)
    env = RaceEnv(make.course(track), cfg)
    return MultiEnv(env, privileged=privileged, render_mode=render_mode, view=view)


class MultiEnv(ParallelEnv[str, Any, np.ndarray]):
    """One race; an agent whose race or episode has ended leaves, until the next reset.

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
        """Open the door to a race; use `parallel_env` to make one from plain words."""
        self._env, self.render_mode = env, render_mode
        self._pictures = Pictures(env, render_mode, view)
        self._seeds = seeds.Seeds()
        self.possible_agents = [f"car_{car}" for car in range(env.num_cars)]
        self.agents: list[str] = []
        self._told_spaces = {
            agent: spaces.observation(env.cfg.sensors_of(car), privileged)
            for car, agent in enumerate(self.possible_agents)
        }
        self._action_spaces = {agent: spaces.action() for agent in self.possible_agents}
        self.observation_spaces, self.action_spaces = {**self._told_spaces}, {**self._action_spaces}
        self._readers = [spaces.Reader(space) for space in self._told_spaces.values()]
        self._infos = [infos.Infos(env, car) for car in range(env.num_cars)]
        self._cars = {agent: car for car, agent in enumerate(self.possible_agents)}
        self._driven = np.zeros((1, env.num_cars, door_actions.SIZE), np.float32)
        self._was_reset = False

    def observation_space(self, agent: str) -> Dict:
        """Return the space of what an agent is told; always the same object."""
        return self._told_spaces[agent]

    def action_space(self, agent: str) -> Box:
        """Return the space of an agent's actions; always the same object."""
        return self._action_spaces[agent]

    def reset(
        self, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, Told], dict[str, dict[str, Any]]]:
        """Start a new race; nothing of the past remains.

        Args:
            seed: decides obstacles, noise and all else that is drawn; None goes on to another race.
            options: not used.
        """
        told = self._env.reset(seeds=[self._seeds.next(seed)])
        self.agents, self._was_reset = list(self.possible_agents), True
        self._pictures.started()
        return self._observations(told), self._told_infos(None)

    def step(
        self, actions: dict[str, np.ndarray]
    ) -> tuple[
        dict[str, Told],
        dict[str, float],
        dict[str, bool],
        dict[str, bool],
        dict[str, dict[str, Any]],
    ]:
        """Drive all cars for 1/15 s.

        Raises:
            ActionError: an agent without an action, an action without its agent, or no action.
        """
        known = self.possible_agents if self._was_reset else []
        given = door_actions.of_agents(actions, self.agents, known)
        if not self.agents:
            return {}, {}, {}, {}, {}
        for agent, action in given.items():
            self._driven[0, self._cars[agent]] = action
        step = self._env.step(self._driven)
        self._pictures.stepped()
        rewards, terminated, truncated = (
            self._by_agent(each) for each in (step.rewards, step.terminated, step.truncated)
        )
        observed = self._observations(step.observations)
        brought = (observed, rewards, terminated, truncated, self._told_infos(step))
        self._part_with([name for name in self.agents if terminated[name] or truncated[name]])
        return brought

    def state(self) -> np.ndarray:
        """Return the truth about all cars, float32, (num_cars * league.envs.state.SIZE,)."""
        return np.concatenate([groups["state"][0] for groups in self._env.observations])

    def render(self) -> np.ndarray | None:
        """Return a picture, uint8 (height, width, 3), or show the race in the live viewer."""
        return self._pictures.render()

    def close(self) -> None:
        """Give back the physics engine and the viewer; may be called twice."""
        self._pictures.close()
        self._env.close()

    def _part_with(self, leaving: list[str]) -> None:
        for agent in leaving:
            self._env.retire(self._cars[agent])
            self.agents.remove(agent)

    def _observations(self, told: Observations) -> dict[str, Told]:
        return {agent: self._readers[car].read(told[car]) for agent, car in self._racing()}

    def _told_infos(self, step: Step | None) -> dict[str, dict[str, Any]]:
        return {agent: self._infos[car].of_first(step) for agent, car in self._racing()}

    def _by_agent(self, values: np.ndarray) -> dict[str, Any]:
        numbers = values[0].tolist()
        return {agent: numbers[car] for agent, car in self._racing()}

    def _racing(self) -> list[tuple[str, int]]:
        return [(agent, self._cars[agent]) for agent in self.agents]
