"""Scoring a recorded race with any reward: the worlds and verdicts of a replay, told again.

A replay keeps where everything was after penalties were applied, and all events. So a car that
crashed is looked at where it was one step earlier, for it has been moved since; all else is as it
was told in the race, up to the rounding of the file.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from league.envs.race_env import decode
from league.envs.rewards import Reward
from league.race_spec import EventKind
from league.replay import Replay
from league.sim.referee import NOBODY, Verdict
from league.sim.world import World, row, select


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
    home = _happened(replay, "finish").cumsum(dim=0).numpy() > 0
    raced = np.where(home.any(axis=0), home.argmax(axis=0), replay.num_frames - 1)
    for number, (before, world, actions, verdict) in enumerate(_steps(replay)):
        if number == 0:
            reward.restart(before, torch.ones_like(before.standing.ghost))
        earned, _ = reward(replay.tracks, before, world, actions, verdict)
        paid.append(earned[0].cpu().numpy())
    rewards = np.array(paid, dtype=np.float64).reshape(-1, replay.num_cars)
    rewards[np.arange(len(rewards))[:, None] >= raced] = 0.0
    return Score(name=name, rewards=rewards, raced=raced)


def _steps(replay: Replay) -> Iterator[tuple[World, World, Tensor, Verdict]]:
    frames = _completed(replay)
    actions = torch.from_numpy(replay.columns.actions.astype(np.float32)).clamp(-1.0, 1.0)
    seen = _verdicts(replay)
    for frame in range(1, replay.num_frames):
        before, world = row(frames, frame - 1), row(frames, frame)
        verdict = Verdict(*(getattr(seen, name)[frame : frame + 1] for name in _FIELDS))
        if bool(verdict.crashed.any()):
            # Obstacles are not counted as cars are, so the cars' records are mixed, not the world.
            world = replace(
                world,
                motion=select(verdict.crashed, before.motion, world.motion),
                standing=select(verdict.crashed, before.standing, world.standing),
            )
        world = replace(world, control=decode(replay.sim, actions[frame : frame + 1]))
        yield before, world, actions[frame : frame + 1], verdict


def _completed(replay: Replay) -> World:
    """Return all frames as a batch of worlds, with what a replay does not keep worked out."""
    worlds = replay.worlds()
    things, book = worlds.obstacles, worlds.standing
    if things.x.shape[1]:
        place = replay.tracks.locate(worlds.track, things.x, things.y)
        things = replace(things, s=place.s, lateral=place.lateral)
    home = _happened(replay, "finish").cumsum(dim=0) > 0
    finish_s = torch.where(home, 0.0, torch.inf)
    return replace(worlds, obstacles=things, standing=replace(book, finish_s=finish_s))


_FIELDS = tuple(Verdict.__dataclass_fields__)


def _verdicts(replay: Replay) -> Verdict:
    """Return what the referee found in each frame; the first, on the grid, is empty.

    A record does not tell how far a car came in the step in which it crashed: that step counts as
    none, so a built-in reward's gains on it and by it there differ from what the race paid.
    """
    crashed_car, crashed_obstacle = _with_whom(replay)
    crashed = (crashed_car != NOBODY) | (crashed_obstacle != NOBODY)
    moved = torch.from_numpy(np.diff(replay.columns.distance, axis=0, prepend=0.0))
    moved[0] = 0.0
    standing = torch.from_numpy(replay.columns.penalty_s > 0)
    was_standing = torch.cat([torch.zeros_like(standing[:1]), standing[:-1]])
    frames, cars = crashed.shape
    overtook = torch.zeros((frames, cars, cars), dtype=torch.bool)
    for event in replay.result.events:
        if event.kind == "overtake" and event.other is not None:
            overtook[_frame(replay, event.time_s), event.car, event.other] = True
    return Verdict(
        advance=torch.where(crashed | was_standing, 0.0, moved).to(torch.float32),
        off_track=_happened(replay, "off_track"),
        crashed=crashed,
        crashed_car=crashed_car,
        crashed_obstacle=crashed_obstacle,
        was_hit=_happened(replay, "contact"),
        wall=_happened(replay, "wall_contact"),
        immobilised=_happened(replay, "immobilised"),
        reversed=_happened(replay, "reversed"),
        lap=_happened(replay, "lap"),
        finished=_happened(replay, "finish"),
        overtook=overtook,
        lead_changed=_happened(replay, "lead_change").any(dim=1),
        released=_happened(replay, "put_back"),
    )


def _with_whom(replay: Replay) -> tuple[Tensor, Tensor]:
    """Return which car and which obstacle each car ran into in each frame, int64."""
    shape = (replay.num_frames, replay.num_cars)
    cars, things = (torch.full(shape, NOBODY, dtype=torch.int64) for _ in range(2))
    for event in replay.result.events:
        table = {"crash": cars, "obstacle_contact": things}.get(event.kind)
        if table is not None:
            other = NOBODY if event.other is None else event.other
            table[_frame(replay, event.time_s), event.car] = other
    return cars, things


def _happened(replay: Replay, kind: EventKind) -> Tensor:
    found = torch.zeros((replay.num_frames, replay.num_cars), dtype=torch.bool)
    for event in replay.result.events:
        if event.kind == kind:
            found[_frame(replay, event.time_s), event.car] = True
    return found


def _frame(replay: Replay, time_s: float) -> int:
    return min(round(time_s * replay.step_hz), replay.num_frames - 1)
