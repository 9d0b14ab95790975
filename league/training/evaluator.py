"""Evaluations during training: policies drive in Bullet from the start line, in another process."""

from __future__ import annotations

import math
import multiprocessing
import os
import queue
import time
from dataclasses import dataclass, replace
from typing import Any

from league import subprocesses
from league.agents import roster
from league.agents.checkpoint import Checkpoint
from league.agents.policy import Policy
from league.errors import LeagueError, PolicyError
from league.racing.evaluate import evaluate
from league.racing.table import Evaluation
from league.sim.config import ObstacleConfig, RaceKind, SimConfig
from league.track.track import Track, TrackSet

CLEAN_RUNS = 20
"""Runs from the start line of which a card says how many were clean."""
TIMEOUT_S = 600.0
"""Longest wait for one evaluation [s]."""


@dataclass(frozen=True)
class EvalConfig:
    """What every policy of a run is evaluated on."""

    tracks: tuple[Track, ...]
    """Where it drives, one after the other."""
    laps: int = 3
    """Laps of each run."""
    trials: int = 1
    """Runs on each track."""
    kind: RaceKind = "time_trial"
    """Kind of race."""
    obstacles: int | None = None
    """Boxes or bots; None: six in obstacle avoidance, else none."""
    bots: bool = False
    """Bot cars instead of boxes."""
    opponents: tuple[str, ...] = ()
    """Drivers that race against it, behind it on the grid."""
    seed: int = 1_000
    """Seed of the first run; training draws others."""


@dataclass(frozen=True)
class EvalResult:
    """The evaluation of one policy."""

    number: int
    """Updates before it."""
    evaluation: Evaluation
    """All trials, on all tracks."""
    duration_s: float
    """How long it took [s]."""


def evaluate_policy(cfg: EvalConfig, checkpoint: Checkpoint) -> Evaluation:
    """Return the evaluation of a policy, with the trials of several tracks numbered through."""
    car = SimConfig().car
    evaluations = [
        evaluate(
            Policy(checkpoint, car),
            track,
            laps=cfg.laps,
            trials=cfg.trials,
            kind="head_to_head" if cfg.opponents else cfg.kind,
            mode="episode",
            seed=cfg.seed,
            obstacles=ObstacleConfig(count=cfg.obstacles, kind="bot" if cfg.bots else "box"),
            opponents=[roster.load(name, TrackSet(track), car) for name in cfg.opponents],
        )
        for track in cfg.tracks
    ]
    first = evaluations[0]
    if len(evaluations) == 1:
        return first
    trials = [
        (number * cfg.trials + trial.run, trial)
        for number, evaluation in enumerate(evaluations)
        for trial in evaluation.trials
    ]
    return first.model_copy(
        update={
            "track": f"{len(evaluations)} tracks",
            "asked": sum(evaluation.asked for evaluation in evaluations),
            "trials": tuple(
                trial.model_copy(update={"trial": number, "run": run})
                for number, (run, trial) in enumerate(trials, 1)
            ),
            "places": tuple(place for evaluation in evaluations for place in evaluation.places),
        }
    )


def clean_share(cfg: EvalConfig, checkpoint: Checkpoint) -> float:
    """Return the share of at least CLEAN_RUNS runs, over all tracks, without a mistake."""
    trials = math.ceil(CLEAN_RUNS / len(cfg.tracks))
    evaluation = evaluate_policy(replace(cfg, trials=trials), checkpoint)
    return round(evaluation.clean_runs / evaluation.runs, 4)


MODULES = (
    "league.agents.policy",
    "league.agents.roster",
    "league.racing.evaluate",
    "league.sim.physics.bullet",
    "league.sim.camera.paint_renderer",
)
"""Modules that an evaluating process imports."""


class Evaluator:
    """A process that evaluates policies in the order of submission, while learning goes on."""

    def __init__(self, cfg: EvalConfig, *, background: bool = True) -> None:
        """Prepare; the process starts with the first policy.

        Without `background` policies are evaluated at once, in this process.
        """
        self._cfg, self._background, self._process = cfg, background, None
        self._pending, self._results = 0, []
        if background:
            subprocesses.prepare(MODULES)
            self._policies = subprocesses.CONTEXT.Queue()
            self._answers = subprocesses.CONTEXT.Queue()
            # Left unread, a policy would keep this process from ending.
            self._policies.cancel_join_thread()

    @property
    def pending(self) -> int:
        """Policies submitted and not yet evaluated."""
        return self._pending

    def submit(self, number: int, checkpoint: Checkpoint) -> None:
        """Evaluate a policy as it was after an update.

        Raises:
            ConfigError: no process can be started.
        """
        if not self._background:
            self._results.append(_evaluated(self._cfg, number, checkpoint))
            return
        if self._process is None:
            self._process = subprocesses.start(_work, self._cfg, self._policies, self._answers)
        self._pending += 1
        self._policies.put((number, checkpoint.card, dict(checkpoint.weights)))

    def take(self, *, wait: bool = False) -> list[EvalResult]:
        """Return and forget the results so far; with `wait` at least one, if any is pending.

        Raises:
            PolicyError: the process has died.
        """
        results, self._results = self._results, []
        while self._pending:
            try:
                results.append(self._next(wait and not results))
            except queue.Empty:
                break
            self._pending -= 1
        return results

    def peek(self) -> tuple[EvalResult, ...]:
        """Return the results so far, which stay to be taken."""
        self._results = self.take()
        return tuple(self._results)

    def close(self) -> None:
        """Stop the process, whatever it is doing."""
        if self._process is not None:
            self._process.terminate()
            self._process.join(5.0)
            self._process = None
        if self._background:
            self._policies.close()
            self._answers.close()

    def _next(self, wait: bool) -> EvalResult:
        assert self._process is not None
        deadline = time.monotonic() + TIMEOUT_S
        while True:
            try:
                answer = self._answers.get(timeout=0.5) if wait else self._answers.get_nowait()
            except queue.Empty:
                if self._process.is_alive() and time.monotonic() < deadline:
                    if wait:
                        continue
                    raise
                self._pending = 0
                raise PolicyError(
                    "the process that evaluates has died: see whether memory ran out, and "
                    "go on with --resume"
                ) from None
            if isinstance(answer, str):
                raise PolicyError(answer)
            return answer


def _evaluated(cfg: EvalConfig, number: int, checkpoint: Checkpoint) -> EvalResult:
    started = time.perf_counter()
    evaluation = evaluate_policy(cfg, checkpoint)
    return EvalResult(number, evaluation, time.perf_counter() - started)


def _work(
    cfg: EvalConfig, policies: multiprocessing.Queue[Any], answers: multiprocessing.Queue[Any]
) -> None:
    """Evaluate until stopped."""
    os.nice(10)  # where cores are few, learning goes first
    while True:
        number, card, weights = policies.get()
        try:
            answers.put(_evaluated(cfg, number, Checkpoint(card, weights)))
        except LeagueError as error:
            answers.put(str(error))
            return
