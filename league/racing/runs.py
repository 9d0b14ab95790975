"""Runs under way: what each step of a batch means for the trials of its evaluated cars."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from league.envs.race_env import Step
from league.racing.table import Mode, Status
from league.sim import referee
from league.sim.config import SimConfig
from league.sim.world import World, is_frozen
from league.track.track import TrackSet

_MISTAKES: tuple[tuple[str, Status], ...] = (
    ("off_track", "off_track"),
    ("crashed", "crashed"),
    ("immobilised", "immobilized"),
    ("reversed", "reversed"),
)


@dataclass(frozen=True)
class Seen:
    """Where the evaluated car of one run is in its trials after a step."""

    run: int
    """Number of the run, over all batches."""
    row: int
    """World of the batch."""
    trial: int
    """Number of the trial within its run, from 0."""
    step: int
    """Steps since the trial began, from 1."""
    status: str
    """"in_progress", "pause" while a penalty is stood, a mistake's name, or how the trial ended."""
    done: bool
    """Whether the trial ended in this step."""


@dataclass(frozen=True)
class Moment:
    """One step of a batch of runs; the evaluated car has slot 0."""

    tracks: TrackSet
    """The course."""
    sim: SimConfig
    """Settings of the worlds."""
    before: np.ndarray
    """CAR records before the step, (num_worlds, num_cars)."""
    judged: World
    """The worlds as the referee and the reward saw them, before any penalty moved a car."""
    world: World
    """The worlds after the step: who crashed has been put back."""
    step: Step
    """What the step brought."""
    seen: tuple[Seen, ...]
    """The runs that are still under way."""


Watcher = Callable[[Moment], None]
"""Told each step; it cannot change it."""


@dataclass
class Run:
    """One run from the start line: its trials so far and the counts of the running one."""

    number: int
    seed: int
    laps: int
    rows: list[dict] = field(default_factory=list)
    place: int = 0
    over: bool = False
    restart: bool = False
    standing: bool = True
    steps: int = 0
    penalty_s: float = 0.0
    counts: dict[str, int] = field(default_factory=lambda: dict.fromkeys(dict(_MISTAKES), 0))

    def note(self, row: int, mode: Mode, told: Told) -> Seen:
        """Write down a step of this run and say where it is."""
        self.steps += 1
        made = [name for name, _ in _MISTAKES if told.flags[name][row]]
        for name in made:
            self.counts[name] += 1
        self.penalty_s += told.penalty_s[row] if made and mode == "race" else 0.0
        mistake = dict(_MISTAKES)[made[0]] if made else None
        trial, step = len(self.rows), self.steps
        ending = self._ending(row, mode, mistake, told)
        if ending is not None:
            self._close(row, ending, told)
            self.over = len(self.rows) == self.laps or (mode == "race" and ending == "time_up")
            # After a mistake the next attempt begins at the line; after a lap the car drives on.
            self.restart = not self.over and (ending != "lap_complete" or bool(made))
            self.standing = self.restart
        pausing = "pause" if told.paused[row] else "in_progress"
        status = ending or mistake or pausing
        return Seen(self.number, row, trial, step, status, ending is not None)

    def _ending(self, row: int, mode: Mode, mistake: Status | None, told: Told) -> Status | None:
        if told.lap[row]:
            return "lap_complete"
        if mode == "episode" and mistake is not None:
            return mistake
        return "time_up" if told.truncated[row] else None

    def _close(self, row: int, ending: Status, told: Told) -> None:
        complete = ending == "lap_complete"
        share = 1.0 if complete else min(max(told.share[row], 0.0), 1.0)
        self.rows.append(
            {
                "standing": self.standing,
                "status": ending,
                "time_s": round(told.lap_s[row] if complete else told.elapsed_s[row], 4),
                "completion": round(100.0 * share, 2),
                "off_tracks": self.counts["off_track"],
                "crashes": self.counts["crashed"],
                "immobilised": self.counts["immobilised"],
                "reversed": self.counts["reversed"],
                "penalty_s": round(self.penalty_s, 4),
            }
        )
        self.counts = dict.fromkeys(self.counts, 0)
        self.steps, self.penalty_s = 0, 0.0
        self.place = told.place[row]


@dataclass(frozen=True)
class Told:
    """What a step told of the evaluated car of each world, as plain lists."""

    flags: dict[str, list[bool]]
    lap: list[bool]
    truncated: list[bool]
    paused: list[bool]
    penalty_s: list[float]
    lap_s: list[float]
    elapsed_s: list[float]
    share: list[float]
    place: list[int]

    @classmethod
    def of(
        cls, tracks: TrackSet, sim: SimConfig, before: np.ndarray, world: World, step: Step
    ) -> Told:
        """Read it off the cars before the step and the worlds after it."""
        now, seen = world.cars[:, 0], step.verdicts[:, 0]
        share = now["best_distance"] / tracks.lap_length(world.track) - now["laps"]
        time_s = world.worlds["step"] * sim.step_dt
        return cls(
            flags={name: seen[name].tolist() for name, _ in _MISTAKES},
            lap=seen["lap"].tolist(),
            truncated=step.truncated[:, 0].tolist(),
            paused=is_frozen(before[:, 0]).tolist(),
            penalty_s=now["penalty_s"].tolist(),
            lap_s=now["last_lap_s"].tolist(),
            elapsed_s=(time_s - now["lap_start_s"]).tolist(),
            share=share.tolist(),
            place=(referee.running_order(world.cars)[:, 0] + 1).tolist(),
        )
