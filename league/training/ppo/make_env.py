"""The worlds a learner trains in, made from the settings of a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Literal

import torch

from league.agents.driver import Driver
from league.envs.adapters.rsl_vec_env import RacingVecEnv
from league.envs.config import EnvConfig, Scenarios
from league.envs.rewards import Reward
from league.sim.config import (
    RULES,
    DynamicsRandomization,
    ObstacleConfig,
    SimConfig,
    VisualRandomization,
)
from league.track.track import TrackSet
from league.training.config import GRIP_SPREAD, TrainConfig

_ENDLESS = 1000
"""Laps of a race in training: an episode is ended by a mistake or by time, not by the flag."""
LEARNER_ATTACKS = 0.5
"""Share of scenarios in which the only car that learns is sure to be the fastest of its group."""
VISUAL_RANDOMIZATION = VisualRandomization(light=0.3, colour=0.15, noise=6.0, blur=0.6)


def env_config(cfg: TrainConfig) -> EnvConfig:
    """Return the settings of the worlds."""
    sim = SimConfig(
        kind=cfg.kind,
        num_cars=cfg.num_cars,
        obstacles=ObstacleConfig(count=cfg.obstacles, kind="bot" if cfg.bots else "box"),
        rules=replace(RULES[cfg.rules], laps=_ENDLESS),
        spread=_spread(cfg.dynamics_randomization),
    )
    return EnvConfig(
        sim=sim,
        solver="planar",
        sensors=(cfg.sensors,) * cfg.num_cars,
        camera_path=camera_path(cfg.device),
        looks=VISUAL_RANDOMIZATION if cfg.visual_randomization else None,
        mode="training",
        reward=cfg.reward,
        episode_s=cfg.episode_s,
        # Cars that start anywhere on a lap hardly ever meet.
        scenarios=_scenarios(cfg),
    )


def _scenarios(cfg: TrainConfig) -> Scenarios | None:
    if cfg.num_cars == 1:
        return None
    return Scenarios(shortest=min(Scenarios.shortest, cfg.episode_s))


def _spread(share: float) -> DynamicsRandomization:
    """Return how far cars differ; a share of 1 as cars of one model do."""
    return DynamicsRandomization(
        grip=GRIP_SPREAD * share,
        mass=0.1 * share,
        latency_s=0.03 * share,
        steering_offset=0.02 * share,
        camera_position=0.01 * share,
        camera_angle=0.02 * share,
    )


def camera_path(device: torch.device | str) -> Literal["paint", "ray"]:
    """Return how pictures are rendered: by compiled painting on a CPU, by ray casting on a GPU."""
    return "paint" if torch.device(device).type == "cpu" else "ray"


def make(
    tracks: TrackSet,
    cfg: TrainConfig,
    *,
    opponents: Mapping[int, Driver | str] | None = None,
    reward: Reward | None = None,
) -> RacingVecEnv:
    """Build the worlds: in each, the cars without an opponent's driver learn.

    Args:
        tracks: where they learn.
        cfg: settings of the run.
        opponents: drivers of the other cars, by the number of the car.
        reward: in Python; None: the settings' own.
    """
    settings = env_config(cfg)
    if opponents and settings.scenarios is not None:
        # Attacks teach most, and the other cars' drivers do not learn from them.
        scenarios = replace(settings.scenarios, learner=LEARNER_ATTACKS)
        settings = replace(settings, scenarios=scenarios)
    return RacingVecEnv(
        tracks,
        settings,
        num_worlds=cfg.num_worlds,
        learners=[car for car in range(cfg.num_cars) if car not in (opponents or {})],
        opponents=opponents,
        action_space=cfg.action_space,
        reward=reward,
        as_bytes=True,
        seed=cfg.seed,
        device=cfg.device,
    )
