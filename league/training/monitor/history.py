"""The metrics of a run: a row for each update and each evaluation, in a file that survives a kill.

The file holds JSON lines: a first line with the format, then rows in the order in which they
happened. A last line that a kill has torn is ignored.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from dataclasses import dataclass
from io import BufferedWriter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BeforeValidator, ConfigDict, Discriminator, Field, TypeAdapter

from league.atomic_file import replacing
from league.errors import PolicyError, brief, explaining

if TYPE_CHECKING:
    from league.racing.table import Evaluation

FORMAT = 1
TEACHING = "/teacher/learning"  # logged as 1 while a teacher learns (ppo/teacher.py)
_OLD_TEACHING = "/tutor/learning"  # its name in the files of older versions
_Number = Annotated[float, BeforeValidator(lambda value: math.nan if value is None else value)]
"""JSON has no NaN: it is written as null."""
_Unwritten = Annotated[float | None, Field(exclude=True)]
"""Shown while a run learns, and not written."""


@dataclass(frozen=True, kw_only=True)
class UpdateRow:
    """Metrics of an update."""

    __pydantic_config__ = ConfigDict(extra="forbid", ser_json_inf_nan="null")

    row: Literal["update"] = "update"
    number: int  # updates so far, this one included
    samples: int  # decisions learnt from so far, by all ranks
    time_s: float  # wall time of the run so far, of the parts before a resume too [s]
    collect_s: float  # wall time of this update's rollout: physics, cameras, reward and policy [s]
    learn_s: float  # wall time of this update's learning [s]
    reward: _Number  # mean reward of a step
    # Of the last training episodes; None before the first one ended.
    earned: float | None  # mean sum of rewards
    completion: float | None  # mean completion [%]
    losses: dict[str, _Number]  # mean losses by rsl-rl's names
    log: dict[str, _Number]  # means of the worlds' log over the steps
    # For charts only.
    learning_rate: _Unwritten = None  # step size of the optimiser
    mean_std: _Unwritten = None  # mean standard deviation of the actions
    episode_steps: _Unwritten = None  # mean steps between ends of episodes; None before any


@dataclass(frozen=True, kw_only=True)
class EvaluationRow:
    """Metrics of an evaluation."""

    __pydantic_config__ = ConfigDict(extra="forbid", ser_json_inf_nan="null")

    row: Literal["evaluation"] = "evaluation"
    number: int  # updates before it
    samples: int  # decisions learnt from before it
    time_s: float  # wall time of the run when it was known [s]: learning may have gone on meanwhile
    took_s: float  # wall time for which learning waited for it [s]
    completion: float  # mean completion [%]
    asked: int  # laps that were to be driven
    complete_laps: int  # laps completed
    clean_laps: int  # laps completed without a mistake
    best_lap_s: float | None  # best complete lap [s]
    last_lap_s: float | None  # last complete lap [s]
    mean_lap_s: float | None  # mean of the complete laps [s]
    best_flying_s: float | None  # best clean lap that began at speed [s]
    off_tracks: int  # times off the track
    crashes: int  # contacts to blame for
    best: bool  # whether the policy was then the best so far


# What a row takes as it is of an evaluation.
_OF_EVALUATION = (
    *("asked", "complete_laps", "clean_laps", "best_lap_s", "mean_lap_s", "best_flying_s"),
    *("off_tracks", "crashes"),
)
Row = UpdateRow | EvaluationRow
_ROW: TypeAdapter[Row] = TypeAdapter(Annotated[Row, Discriminator("row")])


class TrainingHistory:
    """The rows of a run, in memory and, if it has a path, in a file that is appended to."""

    def __init__(self, path: Path | None = None, rows: Iterable[Row] = ()) -> None:
        """Start with some rows, in a new file if any; PolicyError if it cannot be written."""
        rows = list(rows)
        self.updates = [row for row in rows if isinstance(row, UpdateRow)]
        self.evaluations = [row for row in rows if isinstance(row, EvaluationRow)]
        self._file: BufferedWriter | None = None
        if path is not None:
            with replacing(path, "the history", PolicyError) as file:
                head = json.dumps({"history": FORMAT}).encode() + b"\n"
                file.write_bytes(head + b"".join(map(_line, rows)))
            self._file = path.open("ab")

    @classmethod
    def resumed(cls, path: Path, number: int) -> TrainingHistory:
        """Continue a run's file after an update; rows of later ones go. See `read` for errors."""
        return cls(path, [row for row in read(path) if row.number <= number])

    @property
    def best(self) -> EvaluationRow | None:
        """The evaluation of the best policy so far."""
        return next((row for row in reversed(self.evaluations) if row.best), None)

    @property
    def time_s(self) -> float:
        """Wall time of the run up to its last row [s]; a resumed run counts on from here."""
        last = [rows[-1].time_s for rows in (self.updates, self.evaluations) if rows]
        return max(last, default=0.0)

    @property
    def samples(self) -> int:
        """Decisions learnt from so far."""
        return self.updates[-1].samples if self.updates else 0

    @property
    def teacher_learns(self) -> bool:
        """Whether the last update was a teacher's."""
        return bool(self.updates) and TEACHING in self.updates[-1].log

    def learnt_s(self, rows: Iterable[Row]) -> list[float]:
        """Return when the policy of each row had been learnt [s]: evaluations take a while."""
        times = {row.number: row.time_s for row in self.updates}
        return [times.get(row.number, row.time_s) for row in rows]

    def add_update(self, row: UpdateRow) -> None:
        """Add an update."""
        self.updates.append(row)
        self._write(row)

    def add_evaluation(
        self, evaluation: Evaluation, number: int, *, time_s: float, took_s: float, best: bool
    ) -> None:
        """Add an evaluation of the policy as it was after update `number`, `best` so far or not.

        `time_s` is the wall time of the run so far, `took_s` how long learning waited for it [s].
        """
        samples = next((row.samples for row in self.updates if row.number == number), 0)
        laps_s = evaluation.lap_times_s
        times = {"time_s": time_s, "took_s": took_s, "completion": evaluation.completion}
        row = EvaluationRow(
            number=number,
            samples=samples,
            last_lap_s=laps_s[-1] if laps_s else None,
            best=best,
            **{name: round(value, 4) for name, value in times.items()},
            **{name: getattr(evaluation, name) for name in _OF_EVALUATION},
        )
        self.evaluations.append(row)
        self._write(row)

    def close(self) -> None:
        """Close the file, with all that was added on the disk."""
        if self._file is not None:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self._file = None

    def _write(self, row: Row) -> None:
        if self._file is None:
            return
        failure = f"the history cannot be written to {self._file.name}"
        remedy = "give --out a place that can be written and has room"
        with explaining(failure, PolicyError, remedy):
            # One write of a whole line, flushed at once: a kill of the program cannot lose it, and
            # at worst tears the last one.
            self._file.write(_line(row))
            self._file.flush()


def read(path: Path) -> list[Row]:
    """Return the rows of a run's file but for a torn last line; PolicyError if it is none."""
    with explaining(f"{path} cannot be read", PolicyError, "give the folder of a training run"):
        lines = path.read_bytes().decode("utf-8", errors="replace").split("\n")
    try:
        head = json.loads(lines[0])
    except ValueError:
        head = None
    if not isinstance(head, dict) or head.get("history") != FORMAT:
        raise PolicyError(
            f"{path} begins with {brief(lines[0][:60])}: a training's history of format {FORMAT} "
            "was expected, so take the file away or start a new run with another --out"
        )
    rows: list[Row] = []
    # The text after the last line feed is a torn line, or empty.
    for number, line in enumerate(lines[1:-1], start=2):
        try:
            row = _ROW.validate_json(line)
        except ValueError as error:
            raise PolicyError(
                f"line {number} of {path} is no row of a training's history "
                f"({type(error).__name__}): remove the line, or start a new run with another --out"
            ) from error
        if isinstance(row, UpdateRow) and _OLD_TEACHING in row.log:
            row.log[TEACHING] = row.log.pop(_OLD_TEACHING)
        rows.append(row)
    return rows


def _line(row: Row) -> bytes:
    return _ROW.dump_json(row) + b"\n"


class TrainingCallback:
    """Shows or writes the metrics of a run, which is the same without it."""

    def update(self, history: TrainingHistory, update: UpdateRow) -> None:
        """Called after an update, which is the last row of the history."""

    def evaluated(self, history: TrainingHistory, evaluation: Evaluation) -> None:
        """Called after an evaluation, which is the last row of the history."""

    def racing(self, what: str) -> None:
        """Called before races after the last update, which take a while."""

    def close(self) -> None:
        """Called once at the end, also after an error or Ctrl-C."""
