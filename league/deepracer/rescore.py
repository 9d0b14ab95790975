"""Scoring a recorded race with any reward: the worlds and verdicts of a replay, told again.

A replay keeps where everything was after penalties were applied, and all events. So a car that
crashed is looked at where it was one step earlier, for it has been moved since; all else is as it
was told in the race, up to the rounding of the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from league.envs.race_env import decode
from league.envs.rewards import Reward
from league.race_spec import EventKind
from league.replay import Replay
from league.sim.records import NOBODY, VERDICT
from league.sim.world import World


@dataclass(frozen=True)
class Score:
    """What a reward pays for a recorded race."""

    name: str
    """What the reward is called."""
    rewards: np.ndarray
    """For each step and car, (num_steps, num_cars); 0 after a car's finish."""
    raced: np.ndarray
    """Steps each car raced before it was home, int64, (num_cars,)."""

    @property
    def totals(self) -> np.ndarray:
        """Sum of each car's rewards, (num_cars,)."""
        return self.rewards.sum(axis=0)


def score(replay: Replay, reward: Reward, name: str) -> Score:
    """Return what a reward pays each car for each step of a recorded race.

    Args:
        replay: the race.
        reward: what pays; it should pay all cars.
        name: what it is called.

    Raises:
        RewardError: a user's function fails.
    """
    paid = []
    home = _happened(replay, "finish").cumsum(axis=0) > 0
    raced = np.where(home.any(axis=0), home.argmax(axis=0), replay.num_frames - 1)
    for number, (before, world, actions, verdicts) in enumerate(_steps(replay)):
        if number == 0:
            reward.restart(before, np.ones(before.cars.shape, np.bool_))
        earned, _ = reward(replay.tracks, before, world, actions, verdicts)
        paid.append(earned[0].copy())
    rewards = np.array(paid, dtype=np.float64).reshape(-1, replay.num_cars)
    rewards[np.arange(len(rewards))[:, None] >= raced] = 0.0
    return Score(name=name, rewards=rewards, raced=raced)


def _steps(replay: Replay) -> Iterator[tuple[World, World, np.ndarray, np.ndarray]]:
    frames = _completed(replay)
    actions = replay.columns.actions.astype(np.float32).clip(-1.0, 1.0)
    verdicts = _verdicts(replay)
    for frame in range(1, replay.num_frames):
        seen, world = verdicts[frame : frame + 1], frames.row(frame).copy()
        before, asked = frames.row(frame - 1), actions[frame : frame + 1]
        world.cars[seen["crashed"]] = before.cars[seen["crashed"]]
        steering, speed = decode(replay.sim, asked)
        world.cars["target_steering"], world.cars["target_speed"] = steering, speed
        yield before, world, asked, seen


def _completed(replay: Replay) -> World:
    """Return all frames as a batch of worlds, with what a replay does not keep worked out."""
    worlds = replay.worlds()
    things = worlds.obstacles
    place = replay.tracks.project(worlds.track, things["x"], things["y"])
    things["s"], things["lateral"] = place.s, place.lateral
    home = _happened(replay, "finish").cumsum(axis=0) > 0
    worlds.cars["finish_s"] = np.where(home, 0.0, np.inf)
    return worlds


_FLAGS: dict[str, EventKind] = {
    "off_track": "off_track",
    "was_hit": "contact",
    "wall": "wall_contact",
    "immobilised": "immobilised",
    "reversed": "reversed",
    "lap": "lap",
    "finished": "finish",
    "released": "put_back",
}
"""Flags of a verdict and the events that tell of them."""


def _verdicts(replay: Replay) -> np.ndarray:
    """Return what the referee found in each frame; the first, on the grid, is empty.

    A record does not tell how far a car came in the step in which it crashed: that step counts as
    none, so a built-in reward's gains on it and by it there differ from what the race paid.
    """
    found = np.zeros((replay.num_frames, replay.num_cars), VERDICT)
    found["crashed_car"] = found["crashed_obstacle"] = NOBODY
    for event in replay.result.events:
        seen = found[_frame(replay, event.time_s), event.car]
        if event.kind == "crash":
            seen["crashed_car"] = NOBODY if event.other is None else event.other
        if event.kind == "obstacle_contact":
            seen["crashed_obstacle"] = NOBODY if event.other is None else event.other
        if event.kind == "overtake" and event.other is not None:
            seen["overtook"] |= 1 << event.other
    for flag, kind in _FLAGS.items():
        found[flag] = _happened(replay, kind)
    found["lead_changed"] = _happened(replay, "lead_change").any(axis=1, keepdims=True)
    found["crashed"] = (found["crashed_car"] != NOBODY) | (found["crashed_obstacle"] != NOBODY)
    for flag in ("off_track", "crashed", "immobilised", "reversed"):
        found["mistake"] |= found[flag]
    standing = replay.columns.penalty_s > 0
    was_standing = np.concatenate([np.zeros_like(standing[:1]), standing[:-1]])
    moved = np.diff(replay.columns.distance, axis=0, prepend=replay.columns.distance[:1])
    found["advance"] = np.where(found["crashed"] | was_standing, 0.0, moved)
    return found


def _happened(replay: Replay, kind: EventKind) -> np.ndarray:
    found = np.zeros((replay.num_frames, replay.num_cars), np.bool_)
    for event in replay.result.events:
        if event.kind == kind:
            found[_frame(replay, event.time_s), event.car] = True
    return found


def _frame(replay: Replay, time_s: float) -> int:
    return min(round(time_s * replay.step_hz), replay.num_frames - 1)
