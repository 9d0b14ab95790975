"""The judge: evaluates policies in Bullet from the start line, beside the learner."""

from __future__ import annotations

import multiprocessing
import os
import queue
import time
from collections.abc import Sequence
from dataclasses import dataclass

from league import subprocesses
from league.agents import roster
from league.agents.checkpoint import Checkpoint
from league.agents.policy import Policy
from league.errors import LeagueError, PolicyError
from league.racing.evaluate import evaluate
from league.racing.table import Evaluation
from league.sim.config import ObstacleConfig, RaceKind, SimConfig
from league.track.track import Track, TrackSet

PATIENCE_S = 600.0
"""Longest wait for one judgement [s]."""


@dataclass(frozen=True)
class Exam:
    """What a policy is asked to do, the same every time."""

    tracks: tuple[Track, ...]
    """Where it drives, one after the other."""
    laps: int = 3
    """Laps of each run."""
    trials: int = 1
    """Runs on each track."""
    kind: RaceKind = "time_trial"
    """Kind of race."""
    obstacles: int = 6
    """Boxes or bots, in obstacle avoidance."""
    bots: bool = False
    """Bot cars instead of boxes."""
    opponents: tuple[str, ...] = ()
    """Who races against it, behind it on the grid."""
    seed: int = 1_000
    """Seed of the first run; training draws others."""


@dataclass(frozen=True)
class Judgement:
    """What came of an exam."""

    number: int
    """Updates before it."""
    evaluation: Evaluation
    """All trials, on all tracks."""
    took_s: float
    """How long it took [s]."""


def judged(exam: Exam, checkpoint: Checkpoint) -> Evaluation:
    """Return how a policy does in an exam; trials of several tracks are counted on."""
    car = SimConfig().car
    kind: RaceKind = "head_to_head" if exam.opponents else exam.kind
    found = []
    for track in exam.tracks:
        tracks = TrackSet(track)
        found.append(
            evaluate(
                Policy(checkpoint, car),
                track,
                laps=exam.laps,
                trials=exam.trials,
                kind=kind,
                mode="episode",
                seed=exam.seed,
                obstacles=ObstacleConfig(count=exam.obstacles, kind="bot" if exam.bots else "box"),
                opponents=[roster.load(name, tracks, car) for name in exam.opponents],
            )
        )
    return joined(found)


def joined(found: Sequence[Evaluation]) -> Evaluation:
    """Return evaluations on several tracks as one, with the trials counted on."""
    first = found[0]
    if len(found) == 1:
        return first
    trials = [one for evaluation in found for one in evaluation.trials]
    return first.model_copy(
        update={
            "track": f"{len(found)} tracks",
            "asked": sum(one.asked for one in found),
            "trials": tuple(
                one.model_copy(update={"trial": number}) for number, one in enumerate(trials, 1)
            ),
            "places": tuple(place for one in found for place in one.places),
        }
    )


MODULES = (
    "league.agents.policy",
    "league.agents.roster",
    "league.racing.evaluate",
    "league.sim.physics.bullet",
    "league.sim.camera.paint_renderer",
)
"""Modules that an evaluating process imports."""


class Judge:
    """A process that judges what it is handed, in order, while learning goes on."""

    def __init__(self, exam: Exam, *, beside: bool = True) -> None:
        """Have it ready; its process starts with the first policy.

        Args:
            exam: what every policy is asked to do.
            beside: whether to judge in a process of its own, or at once in this one.
        """
        self._exam, self._waiting, self._done = exam, 0, []
        self._beside, self._process = beside, None
        if beside:
            subprocesses.prepare(MODULES)
            self._orders, self._answers = subprocesses.CONTEXT.Queue(), subprocesses.CONTEXT.Queue()
            # Left unread, an order would keep this process from ending.
            self._orders.cancel_join_thread()

    @property
    def waiting(self) -> int:
        """Policies handed over and not yet judged."""
        return self._waiting

    def hand(self, number: int, checkpoint: Checkpoint) -> None:
        """Hand over a policy as it was after an update.

        Raises:
            ConfigError: no process can be started.
        """
        if not self._beside:
            started = time.perf_counter()
            evaluation = judged(self._exam, checkpoint)
            self._done.append(Judgement(number, evaluation, time.perf_counter() - started))
            return
        if self._process is None:
            self._process = subprocesses.start(_work, self._exam, self._orders, self._answers)
        self._waiting += 1
        self._orders.put((number, checkpoint.card, dict(checkpoint.weights)))

    def take(self, *, wait: bool = False) -> list[Judgement]:
        """Return the judgements that have come; with `wait` at least one, if any is due.

        Raises:
            PolicyError: the process has died.
        """
        found, self._done = self._done, []
        while self._waiting:
            try:
                found.append(self._next(wait and not found))
            except queue.Empty:
                break
            self._waiting -= 1
        return found

    def come(self) -> tuple[Judgement, ...]:
        """Return the judgements that have come; they stay, to be taken later."""
        self._done = self.take()
        return tuple(self._done)

    def close(self) -> None:
        """Stop it, whatever it is doing."""
        if self._process is not None:
            self._process.terminate()
            self._process.join(5.0)
            self._process = None
        if self._beside:
            self._orders.close()
            self._answers.close()

    def _next(self, wait: bool) -> Judgement:
        assert self._process is not None
        patience = time.monotonic() + PATIENCE_S
        while True:
            try:
                answer = self._answers.get(timeout=0.5) if wait else self._answers.get_nowait()
            except queue.Empty:
                if self._process.is_alive() and time.monotonic() < patience and not wait:
                    raise
                if not self._process.is_alive() or time.monotonic() >= patience:
                    self._waiting = 0
                    raise PolicyError(
                        "the process that evaluates has died: see whether memory ran out, and "
                        "go on with --resume"
                    ) from None
                continue
            if isinstance(answer, str):
                raise PolicyError(answer)
            return answer


def _work(exam: Exam, orders: multiprocessing.Queue, answers: multiprocessing.Queue) -> None:
    """Judge until stopped."""
    os.nice(10)  # where cores are few, learning goes first
    while True:
        number, card, weights = orders.get()
        started = time.perf_counter()
        try:
            evaluation = judged(exam, Checkpoint(card, weights))
        except LeagueError as error:
            answers.put(str(error))
            return
        answers.put(Judgement(number, evaluation, time.perf_counter() - started))
