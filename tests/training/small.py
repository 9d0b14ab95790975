"""Runs so small that they train in a second: a blind car on one lap, four worlds, eight steps."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from league.agents import checkpoint
from league.agents.checkpoint import Card, Checkpoint
from league.agents.network import NetworkConfig
from league.envs.actions import ContinuousActions
from league.sim.config import CameraConfig, SensorConfig
from league.training.config import PpoConfig, RunConfig, TrainConfig
from league.training.run import Run
from tests import actor

CAMERA = SensorConfig(camera=CameraConfig(width=24, height=18))
SAMPLES = 32
"""Decisions of one update."""


def train(**changes) -> TrainConfig:
    """Return settings of a learner that observes its own motion and nothing else."""
    base = TrainConfig(
        num_worlds=4,
        action_space=ContinuousActions(-30.0, 30.0, 0.5, 1.0),
        sensors=SensorConfig(),
        network=NetworkConfig(channels=(4, 4), kernels=(3, 3), strides=(2, 2), hidden=(16,)),
        critic_hidden=(16,),
        ppo=PpoConfig(rollout=8, epochs=1, mini_batches=2),
        episode_s=2.0,
        save_every=2,
    )
    return replace(base, **changes)


def cfg(updates: int = 4, **changes) -> RunConfig:
    """Return settings of a run of some updates, judged on one lap."""
    base = RunConfig(
        train=train(),
        name="tiny",
        reward="centerline",
        minutes=0,
        steps=updates * SAMPLES,
        eval_laps=1,
        command="league train --out tiny.pt",
    )
    return replace(base, **changes)


def run(folder: Path, asked: RunConfig | None = None) -> Run:
    """Return a run that judges at once, in this process."""
    return Run(asked or cfg(), folder, background=False)


def weights(path: Path) -> dict[str, np.ndarray]:
    """Return the weights of a checkpoint."""
    return dict(checkpoint.load(path).weights)


def equal(one: Path, other: Path) -> bool:
    """Return whether two checkpoints hold the same numbers, to the bit."""
    mine, its = weights(one), weights(other)
    return mine.keys() == its.keys() and all(np.array_equal(mine[name], its[name]) for name in mine)


class CallbackRecorder:
    """Counts the updates it gets; may do something after an update."""

    def __init__(self, after=None) -> None:
        self.updates, self.evaluations, self.closed = [], [], 0
        self.races = []
        self._after = after

    def update(self, history, update) -> None:
        self.updates.append(update.number)
        if self._after is not None:
            self._after(update)

    def evaluated(self, history, evaluation) -> None:
        self.evaluations.append(evaluation)

    def racing(self, what) -> None:
        self.races.append(what)

    def close(self) -> None:
        self.closed += 1


def untrained(sensors: SensorConfig | None = None) -> Checkpoint:
    """Return a policy that has learnt nothing: it leaves the road within seconds."""
    card = Card(
        name="untrained",
        sensors=sensors or SensorConfig(),
        network=train().network,
        created="2025-06-01",
    )
    return actor.untrained(card)
