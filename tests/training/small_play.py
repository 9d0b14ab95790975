"""Self-play so small that it takes a second: blind cars on a ring of 12 m, four worlds."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import actor
import numpy as np
from scenes import make_ring

from league.agents.card import Card
from league.agents.checkpoint import Checkpoint
from league.agents.network import NetworkConfig
from league.sim.config import CarConfig, SensorConfig
from league.track.track import TrackSet
from league.training.config import PpoConfig, TrainConfig
from league.training.ppo import make_env
from league.training.ppo.learner import Learner
from league.training.selfplay import SelfPlay, SelfPlayConfig
from league.training.selfplay.settings import MatchConfig

RING = TrackSet(make_ring())
CAR = CarConfig()
FREE = (CAR.max_speed,) * 2
"""Limits of an opponent that may go as fast as it can [m/s]."""
BLIND = NetworkConfig(hidden=(8,))
SHORT = SelfPlayConfig(
    candidate_every=1,
    rivals=2,
    races=2,
    matrix_races=2,
    match=MatchConfig(laps=1, slowest=12.0, grace_s=1.0),
)
TRAIN = TrainConfig(
    kind="head_to_head",
    num_cars=2,
    num_worlds=4,
    sensors=SensorConfig(),
    network=BLIND,
    critic_hidden=(8,),
    ppo=PpoConfig(rollout=8, epochs=1, mini_batches=2),
    save_every=1,
)
CARD = Card(name="blind", sensors=SensorConfig(), network=BLIND, created="2025-06-01")


def blind(seed: int = 0) -> Checkpoint:
    """Return a policy that has learnt nothing."""
    return actor.untrained(CARD, seed)


class Constant:
    """Always asks for the same."""

    sensors = SensorConfig()

    def __init__(self, steering: float, speed: float) -> None:
        self.name, self._action = f"{steering} {speed}", np.array([[steering, speed]], np.float32)

    def reset(self, rows):
        pass

    def act(self, observations):
        return self._action.repeat(len(observations["state"]), axis=0)


def playing(
    folder: Path,
    parent: Checkpoint | None = None,
    *,
    cfg: SelfPlayConfig = SHORT,
    **changes: Any,
) -> tuple[SelfPlay, Learner]:
    """Return self-play and its learner before either has begun, settings of training changed."""
    train = replace(TRAIN, **changes)
    play = SelfPlay(folder, RING, train, CARD, cfg=cfg, parent=parent)
    return play, Learner(make_env.make(RING, train, opponents=play.drivers()), train)


def learnt(tmp_path: Path, *args: Any, **changes: Any) -> tuple[SelfPlay, Learner]:
    """Return what `playing` does, one update and its save point later."""
    play, learner = playing(tmp_path, *args, **changes)
    play.begin(learner)
    learner.update(0.0)
    play.after_update(learner, 0.5)
    return play, learner


def saved(play: SelfPlay, learner: Learner, tmp_path: Path) -> dict:
    """Save a run of `tmp_path/run` with a copy of its folder; return self-play's state as JSON."""
    learner.save(tmp_path / "state.pt", {})
    shutil.copytree(tmp_path / "run", tmp_path / "copy")
    return json.loads(json.dumps(play.state()))
