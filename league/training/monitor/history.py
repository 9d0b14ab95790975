"""The record of a run: a row for each update and each evaluation, in a file that survives a kill.

The file holds JSON lines: a first line that says what it is, then rows in the order in which they
happened. A line that a kill has torn is dropped when it is read back.
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass, fields
from io import TextIOWrapper
from pathlib import Path
from typing import TYPE_CHECKING

from league.atomic_file import replacing
from league.errors import PolicyError, brief

if TYPE_CHECKING:
    from league.racing.table import Evaluation
    from league.training.ppo.episode_stats import Episodes
    from league.training.ppo.learner import Update

FORMAT = 1


@dataclass(frozen=True)
class UpdateRow:
    """What was known after an update."""

    number: int
    """Updates so far, this one included."""
    samples: int
    """Decisions learnt from so far."""
    time_s: float
    """Wall time of the run so far, of the parts before a resume too [s]."""
    collect_s: float
    """Wall time of this update's collecting: physics, cameras, reward, the policy's choices [s]."""
    learn_s: float
    """Wall time of this update's learning [s]."""
    reward: float
    """Mean reward of a step."""
    earned: float | None
    """Mean sum of rewards of the last training episodes; None before the first one ended."""
    completion: float | None
    """Mean completion of the last training episodes [%]; None before the first one ended."""
    losses: dict[str, float]
    """Mean losses by rsl-rl's names."""
    log: dict[str, float]
    """Means of the worlds' log over the steps."""


@dataclass(frozen=True)
class EvaluationRow:
    """What an evaluation came to."""

    number: int
    """Updates before it."""
    samples: int
    """Decisions learnt from before it."""
    time_s: float
    """Wall time of the run when it was known [s]: learning may have gone on meanwhile."""
    took_s: float
    """Wall time for which learning waited for it [s]."""
    completion: float
    """Mean completion [%]."""
    asked: int
    """Laps that were to be driven."""
    complete_laps: int
    """Laps completed."""
    clean_laps: int
    """Laps completed without a mistake."""
    best_lap_s: float | None
    """Best complete lap [s]."""
    last_lap_s: float | None
    """Last complete lap [s]."""
    mean_lap_s: float | None
    """Mean of the complete laps [s]."""
    best_flying_s: float | None
    """Best clean lap that began at speed [s]."""
    off_tracks: int
    """Times off the track."""
    crashes: int
    """Contacts to blame for."""
    best: bool
    """Whether the policy was then the best so far."""


Row = UpdateRow | EvaluationRow
_KINDS: dict[str, type[UpdateRow] | type[EvaluationRow]] = {
    "update": UpdateRow,
    "evaluation": EvaluationRow,
}


class History:
    """The rows of a run, in memory and, if it has a path, in a file that is appended to."""

    def __init__(self, path: Path | None = None, rows: Iterable[Row] = ()) -> None:
        """Begin with some rows; a file of that name is replaced.

        Raises:
            PolicyError: the file cannot be written.
        """
        self.updates: list[UpdateRow] = []
        self.evaluations: list[EvaluationRow] = []
        self._file: TextIOWrapper | None = None
        rows = list(rows)
        for row in rows:
            self._keep(row)
        if path is not None:
            self._file = _begun(path, rows)

    @classmethod
    def resumed(cls, path: Path, number: int) -> History:
        """Go on from a run's file after an update: what came later was lost with it, and is cut.

        Raises:
            PolicyError: the file is no history, or cannot be written.
        """
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
    def number(self) -> int:
        """Updates so far."""
        return self.updates[-1].number if self.updates else 0

    def add_update(self, update: Update, episodes: Episodes, time_s: float) -> UpdateRow:
        """Write down an update, and what training episodes have come to.

        Args:
            update: what the learner returned.
            episodes: the learner's episodes.
            time_s: wall time of the run so far, earlier parts of a resumed run included [s].
        """
        row = UpdateRow(
            number=update.number,
            samples=update.samples,
            time_s=round(time_s, 4),
            collect_s=round(update.collect_s, 4),
            learn_s=round(update.learn_s, 4),
            reward=update.reward,
            earned=episodes.earned,
            completion=None if episodes.completion is None else 100.0 * episodes.completion,
            losses={name: float(value) for name, value in update.losses.items()},
            log={name: float(value) for name, value in update.log.items()},
        )
        self._add(row)
        return row

    def add_evaluation(
        self,
        evaluation: Evaluation,
        *,
        time_s: float,
        took_s: float,
        best: bool,
        number: int | None = None,
    ) -> EvaluationRow:
        """Write down an evaluation of the policy as it was after an update.

        Args:
            evaluation: the table of trials.
            time_s: wall time of the run so far [s].
            took_s: how long learning waited for it [s].
            best: whether the policy is the best so far.
            number: updates before it; None: the last one.
        """
        number = self.number if number is None else number
        samples = next((row.samples for row in self.updates if row.number == number), 0)
        row = EvaluationRow(
            number=number,
            samples=samples,
            time_s=round(time_s, 4),
            took_s=round(took_s, 4),
            completion=round(evaluation.completion, 4),
            asked=evaluation.asked,
            complete_laps=evaluation.complete_laps,
            clean_laps=evaluation.clean_laps,
            best_lap_s=evaluation.best_lap_s,
            last_lap_s=evaluation.lap_times_s[-1] if evaluation.lap_times_s else None,
            mean_lap_s=evaluation.mean_lap_s,
            best_flying_s=evaluation.best_flying_s,
            off_tracks=evaluation.off_tracks,
            crashes=evaluation.crashes,
            best=best,
        )
        self._add(row)
        return row

    def close(self) -> None:
        """Close the file, with all that was added on the disk."""
        if self._file is not None:
            self._file.flush()
            os.fsync(self._file.fileno())
            self._file.close()
            self._file = None

    def _keep(self, row: Row) -> None:
        if isinstance(row, UpdateRow):
            self.updates.append(row)
        else:
            self.evaluations.append(row)

    def _add(self, row: Row) -> None:
        self._keep(row)
        if self._file is None:
            return
        try:
            # One write of a whole line, handed to the system at once: a kill of the program cannot
            # lose it, and at worst tears the last one.
            self._file.write(_line(row))
            self._file.flush()
        except OSError as refusal:
            raise PolicyError(
                f"the history cannot be written to {self._file.name} ({refusal.strerror}): "
                "give --out a place that can be written and has room"
            ) from refusal


def read(path: Path) -> list[Row]:
    """Return the rows of a run's file in order; a torn last line is left out.

    Raises:
        PolicyError: there is no such file, or it is no history.
    """
    try:
        lines = path.read_bytes().decode("utf-8", errors="replace").split("\n")
    except OSError as error:
        raise PolicyError(
            f"{path} cannot be read ({error.strerror}): give the folder of a training run"
        ) from error
    _check_head(path, lines[0])
    # What follows the last line feed was never finished.
    whole = lines[1:-1]
    rows: list[Row] = []
    for number, line in enumerate(whole, start=2):
        try:
            rows.append(_row(json.loads(line)))
        except (ValueError, TypeError, KeyError) as error:
            raise PolicyError(
                f"line {number} of {path} is no row of a training's history "
                f"({type(error).__name__}): remove the line, or start a new run with another --out"
            ) from error
    return rows


def _check_head(path: Path, line: str) -> None:
    try:
        head = json.loads(line)
    except ValueError:
        head = None
    if not isinstance(head, dict) or head.get("history") != FORMAT:
        raise PolicyError(
            f"{path} begins with {brief(line[:60])}: a training's history of format {FORMAT} was "
            "expected, so take the file away or start a new run with another --out"
        )


def _begun(path: Path, rows: Iterable[Row]) -> TextIOWrapper:
    """Write the file anew, whole or not at all, and open it to be appended to."""
    with replacing(path, "the history", PolicyError) as file:
        lines = [json.dumps({"history": FORMAT}) + "\n", *map(_line, rows)]
        file.write_text("".join(lines), encoding="utf-8")
    return path.open("a", encoding="utf-8", newline="\n")


def _line(row: Row) -> str:
    kind = next(name for name, kind in _KINDS.items() if isinstance(row, kind))
    told = {"row": kind, **{name: _told(value) for name, value in asdict(row).items()}}
    return json.dumps(told, allow_nan=False, separators=(",", ":")) + "\n"


def _told(value: object) -> object:
    """Return a value as JSON knows it: a loss that is NaN becomes null."""
    if isinstance(value, dict):
        return {name: _told(one) for name, one in value.items()}
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def _row(told: dict) -> Row:
    kind = _KINDS[told.pop("row")]
    if told.keys() != {one.name for one in fields(kind)}:
        raise KeyError(sorted(told))
    for name in ("losses", "log"):
        if name in told:
            told[name] = {k: math.nan if v is None else float(v) for k, v in told[name].items()}
    if told.get("reward", 0.0) is None:
        told["reward"] = math.nan
    return kind(**told)
