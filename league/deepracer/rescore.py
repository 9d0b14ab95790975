"""Scoring a recorded race with any reward: its worlds and verdicts rebuilt from the replay.

A replay keeps where everything was after penalties were applied, and all events. So a car that
crashed is taken from one step earlier, because it has been moved since; all else is as it was in
the race, up to the rounding of the file.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from league import figures
from league.envs.actions import decode
from league.envs.rewards import Reward
from league.errors import ReplayError
from league.figures import GRID, INK
from league.race_spec import EventKind
from league.replay import Replay
from league.sim.records import NOBODY, VERDICT, World


@dataclass(frozen=True)
class Score:
    """The rewards of a recorded race."""

    name: str  # Name of the reward.
    rewards: np.ndarray  # For each step and car, (num_steps, num_cars); 0 after a car's finish.
    raced: np.ndarray  # Steps each car raced before its finish, int64, (num_cars,).

    @property
    def totals(self) -> np.ndarray:
        """Sum of each car's rewards, (num_cars,)."""
        return self.rewards.sum(axis=0)


def score(replay: Replay, reward: Reward, name: str) -> Score:
    """Return what a reward of all cars gives for each step; RewardError if a function fails."""
    finished = _happened(replay, "finish")
    raced = np.where(finished.any(axis=0), finished.argmax(axis=0), replay.num_frames - 1)
    steps = []
    for number, (before, world, actions, verdicts) in enumerate(_steps(replay)):
        if number == 0:
            reward.restart(before, np.ones(before.cars.shape, np.bool_))
        step, _ = reward(replay.tracks, before, world, actions, verdicts)
        steps.append(step[0].copy())
    rewards = np.array(steps, dtype=np.float64).reshape(-1, replay.num_cars)
    rewards[np.arange(len(rewards))[:, None] >= raced] = 0.0
    return Score(name=name, rewards=rewards, raced=raced)


def _steps(replay: Replay) -> Iterator[tuple[World, World, np.ndarray, np.ndarray]]:
    """Yield the arguments of a reward for each step, with what a replay does not keep computed."""
    frames = replay.worlds()
    boxes = frames.obstacles
    place = replay.tracks.project(frames.track, boxes["x"], boxes["y"])
    boxes["s"], boxes["lateral"] = place.s, place.lateral
    finished = _happened(replay, "finish").cumsum(axis=0) > 0
    frames.cars["finish_s"] = np.where(finished, 0.0, np.inf)
    actions = replay.columns.actions.astype(np.float32).clip(-1.0, 1.0)
    verdicts = _verdicts(replay)
    for frame in range(1, replay.num_frames):
        verdict, action = verdicts[frame : frame + 1], actions[frame : frame + 1]
        before, world = frames.row(frame - 1), frames.row(frame).copy()
        crashed = verdict["crashed"]
        world.cars[crashed] = before.cars[crashed]
        steering, speed = decode(action, replay.sim.car)
        world.cars["target_steering"], world.cars["target_speed"] = steering, speed
        yield before, world, action, verdict


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
"""Flags of a verdict and their events."""


def _verdicts(replay: Replay) -> np.ndarray:
    """Return the VERDICT records of each frame; the first, on the grid, is empty.

    A record does not say how far a car came in the step in which it crashed: that step counts as
    none, so a built-in reward's gains on it and by it there differ from those of the race.
    """
    verdicts = np.zeros((replay.num_frames, replay.num_cars), VERDICT)
    verdicts["crashed_car"] = verdicts["crashed_obstacle"] = NOBODY
    hits = {"crash": "crashed_car", "obstacle_contact": "crashed_obstacle"}
    for event in replay.result.events:
        verdict = verdicts[_frame(replay, event.time_s), event.car]
        if event.kind in hits:
            verdict[hits[event.kind]] = NOBODY if event.other is None else event.other
        if event.kind == "overtake" and event.other is not None:
            verdict["overtook"] |= 1 << event.other
    for flag, kind in _FLAGS.items():
        verdicts[flag] = _happened(replay, kind)
    verdicts["lead_changed"] = _happened(replay, "lead_change").any(axis=1, keepdims=True)
    for struck in hits.values():
        verdicts["crashed"] |= verdicts[struck] != NOBODY
    for flag in ("off_track", "crashed", "immobilised", "reversed"):
        verdicts["mistake"] |= verdicts[flag]
    standing = replay.columns.penalty_s > 0
    was_standing = np.concatenate([np.zeros_like(standing[:1]), standing[:-1]])
    moved = np.diff(replay.columns.distance, axis=0, prepend=replay.columns.distance[:1])
    verdicts["advance"] = np.where(verdicts["crashed"] | was_standing, 0.0, moved)
    return verdicts


def _happened(replay: Replay, kind: EventKind) -> np.ndarray:
    """Return in which frames an event of a kind happened to which car, bool."""
    flags = np.zeros((replay.num_frames, replay.num_cars), np.bool_)
    for event in replay.result.events:
        if event.kind == kind:
            flags[_frame(replay, event.time_s), event.car] = True
    return flags


def _frame(replay: Replay, time_s: float) -> int:
    return min(round(time_s * replay.step_hz), replay.num_frames - 1)


_SMOOTHED_S = 1.0  # Width of the running mean drawn over each step's reward [s].


def draw(replay: Replay, scores: Sequence[Score], path: Path) -> None:
    """Write a PNG with a column for each score: its reward by step above, the sum so far below."""
    figure = figures.figure(6.4 * len(scores), 7.2)
    axes = figure.subplots(2, len(scores), sharex=True, squeeze=False)
    for column, score in enumerate(scores):
        top, bottom = axes[0, column], axes[1, column]
        for car, name in enumerate(replay.names):
            rewards = score.rewards[: score.raced[car], car]
            times, sums = replay.times_s[1 : 1 + len(rewards)], rewards.cumsum()
            smooth = _running_mean(rewards, round(_SMOOTHED_S * replay.step_hz))
            top.plot(times, rewards, color=f"C{car}", alpha=0.22, linewidth=0.7)
            top.plot(times, smooth, color=f"C{car}", linewidth=1.8)
            label = f"{name}   {score.totals[car]:+,.1f}"
            bottom.plot(times, sums, color=f"C{car}", linewidth=2.0, label=label)
            # A dashed stretch is a penalty, which begins at a dot.
            standing = replay.columns.penalty_s[1 : 1 + len(rewards), car] > 0
            begins = standing & ~np.concatenate([[False], standing[:-1]])
            stood = np.where(standing, sums, np.nan)
            bottom.plot(times, stood, color="white", lw=2.2, ls=(0, (2, 2)))
            bottom.plot(times[begins], sums[begins], "o", color=f"C{car}", markersize=5)
        top.set_title(score.name, loc="left", fontsize=13, fontweight="bold", color=INK, pad=10)
        top.set_ylabel("reward of a step\n(thick: mean over 1 s)", color=INK)
        bottom.set_ylabel("sum so far", color=INK)
        bottom.set_xlabel("race time [s]", color=INK)
        bottom.legend(loc="upper left", frameon=False, title="total", alignment="left")
        for axis in (top, bottom):
            axis.grid(True, color=GRID, linewidth=0.7)
            axis.set_axisbelow(True)
            figures.strip(axis, keep=("bottom",))
            axis.set_xlim(0.0, max(replay.duration_s, 1e-3))
    title = f"{replay.spec.title}   ·   dots: a penalty begins, its stretch is dashed"
    figure.suptitle(title, x=0.01, ha="left", fontsize=10, color="#6b7280")
    figures.save(figure, path, "the plot", ReplayError, dpi=120)


def _running_mean(values: np.ndarray, width: int) -> np.ndarray:
    """Return the mean over a window centred on each step, shorter at the ends."""
    if not len(values):
        return values
    window = np.ones(min(max(width, 1), len(values)))
    sums = np.convolve(values, window, "same")
    return sums / np.convolve(np.ones_like(values), window, "same")
