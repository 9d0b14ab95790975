"""Learners so small that an update takes a moment, on a ring of 12 m."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike
from rsl_rl.algorithms import PPO

from league.agents.network import NetworkConfig
from league.envs.actions import ActionSpace, ContinuousActions, DiscreteActions
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from league.track.track import TrackSet
from league.training.config import PpoConfig, TrainConfig
from league.training.ppo import make_env
from league.training.ppo.learner import Learner
from league.training.ppo.teacher import TaughtLearner, Teacher
from tests.scenes import make_ring

LIDAR = LidarConfig(beams=8)
CAMERA = CameraConfig(width=24, height=18)
LAYERS = NetworkConfig(channels=(4, 4), kernels=(3, 3), strides=(2, 2), hidden=(16,))
CHOICES = DiscreteActions(((20.0, 1.0), (0.0, 1.0), (-20.0, 1.0), (0.0, 2.0)))


def settings(
    *,
    seed: int = 0,
    space: ActionSpace | None = None,
    sensors: SensorConfig | None = None,
    num_worlds: int = 4,
    save_every: int = 2,
    normalise: bool = False,
    symmetry: bool = True,
) -> TrainConfig:
    return TrainConfig(
        num_worlds=num_worlds,
        seed=seed,
        action_space=space or ContinuousActions(),
        sensors=sensors or SensorConfig(camera=CAMERA, lidar=LIDAR),
        network=dataclasses.replace(LAYERS, normalise=normalise),
        critic_hidden=(16,),
        ppo=PpoConfig(rollout=8, epochs=2, mini_batches=2),
        symmetry=symmetry,
        episode_s=2.0,
        save_every=save_every,
    )


def learner(cfg: TrainConfig | None = None, **wishes: object) -> Learner:
    cfg = cfg or settings(**wishes)  # pyright: ignore
    return Learner(make_env.make(TrackSet(make_ring()), cfg), cfg)


def same(one: Mapping[str, ArrayLike], other: Mapping[str, ArrayLike]) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k]) for k in one)


def algorithm(one: Learner) -> PPO:
    """Return what rsl-rl learns with: its networks, its storage and its optimizer."""
    return one._alg


def teacher_of(one: TaughtLearner) -> Teacher:
    return one.teacher


def lesson_of(one: TaughtLearner):
    """Return the loss that draws a policy towards its teacher."""
    return one._lesson
