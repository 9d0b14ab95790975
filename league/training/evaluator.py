"""Evaluations during training: policies drive in Bullet from the start line, in another process."""

import math
import os
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from statistics import fmean
from typing import NamedTuple

from league import subprocesses
from league.agents.checkpoint import Checkpoint
from league.agents.policy import Policy
from league.errors import PolicyError
from league.racing.evaluate import evaluate
from league.racing.table import Evaluation, Trial
from league.sim.config import ObstacleConfig, RaceKind, SimConfig
from league.track.track import Track

CLEAN_RUNS = 20  # runs from the start line of which a card says how many were clean
TIMEOUT_S = 600.0  # longest wait for one evaluation [s]


@dataclass(frozen=True)
class EvalConfig:
    """What every policy of a run is evaluated on."""

    tracks: tuple[Track, ...]  # where it drives, one after the other
    laps: int = 3  # laps of each run
    trials: int = 1  # runs on each track
    kind: RaceKind = "time_trial"  # kind of race
    obstacles: ObstacleConfig = field(default_factory=ObstacleConfig)  # boxes or bots
    opponents: tuple[str, ...] = ()  # drivers that race against it, behind it on the grid
    seed: int = 1_000  # seed of the first run; training draws others


class EvalResult(NamedTuple):
    """The evaluation of one policy."""

    number: int  # updates before it
    policy: Checkpoint  # what was evaluated
    evaluation: Evaluation  # all trials, on all tracks


def evaluate_policy(cfg: EvalConfig, checkpoint: Checkpoint) -> Evaluation:
    """Return the evaluation of a policy, with the trials of several tracks numbered through."""
    car = SimConfig().car
    evaluations: list[Evaluation] = []
    trials: list[Trial] = []
    for number, track in enumerate(cfg.tracks):
        evaluation = evaluate(
            Policy(checkpoint, car),
            track,
            laps=cfg.laps,
            trials=cfg.trials,
            kind=cfg.kind,
            mode="episode",
            seed=cfg.seed,
            obstacles=cfg.obstacles,
            opponents=cfg.opponents,
        )
        evaluations.append(evaluation)
        for trial in evaluation.trials:
            run = number * cfg.trials + trial.run
            trials.append(trial.model_copy(update={"trial": len(trials) + 1, "run": run}))
    if len(evaluations) == 1:
        return evaluations[0]
    together = {
        "track": f"{len(evaluations)} tracks",
        "asked": sum(one.asked for one in evaluations),
        "trials": tuple(trials),
        "places": tuple(place for one in evaluations for place in one.places),
    }
    return evaluations[0].model_copy(update=together)


def clean_share(cfg: EvalConfig, checkpoint: Checkpoint) -> float:
    """Return the share of at least CLEAN_RUNS runs, over all tracks, without a mistake."""
    trials = math.ceil(CLEAN_RUNS / len(cfg.tracks))
    evaluation = evaluate_policy(replace(cfg, trials=trials), checkpoint)
    return round(evaluation.clean_runs / evaluation.runs, 4)


def merit_of(evaluation: Evaluation) -> tuple[float, ...]:
    """Return what the best has most of: laps, distance, pace; against others, places first."""
    mean = evaluation.mean_lap_s
    laps = evaluation.complete_laps / evaluation.asked
    driven = (laps, round(evaluation.completion, 3), -mean if mean is not None else -1e9)
    return (-fmean(evaluation.places), *driven) if evaluation.places else driven


MODULES = (  # that an evaluating process imports
    *("league.agents.policy", "league.agents.roster", "league.racing.evaluate"),
    *("league.sim.physics.bullet", "league.sim.camera.renderer"),
)


class Evaluator:
    """A process that evaluates policies in the order of submission, while learning goes on."""

    def __init__(self, cfg: EvalConfig, *, background: bool = True) -> None:
        """Prepare; the process starts with the first policy. Without `background` there is none."""
        self._cfg, self._background = cfg, background
        self._results: list[EvalResult] = []
        self._jobs: list[tuple[int, Checkpoint, Future[Evaluation]]] = []
        self._pool: ProcessPoolExecutor | None = None
        if background:
            subprocesses.prepare(MODULES)

    @property
    def pending(self) -> list[int]:
        """Numbers of the policies that were submitted, until their results are taken."""
        return [result.number for result in self._results] + [number for number, *_ in self._jobs]

    def submit(self, number: int, checkpoint: Checkpoint) -> None:
        """Evaluate a policy as it was after an update; ConfigError if no process can be started."""
        if not self._background:
            evaluation = evaluate_policy(self._cfg, checkpoint)
            self._results.append(EvalResult(number, checkpoint, evaluation))
            return
        with subprocesses.failing_in_one_sentence():
            if self._pool is None:
                self._pool = ProcessPoolExecutor(1, subprocesses.CONTEXT, _begin)
            job = self._pool.submit(evaluate_policy, self._cfg, checkpoint)
            self._jobs.append((number, checkpoint, job))

    def take(self, *, wait: bool = False) -> list[EvalResult]:
        """Return and forget the results, with `wait` one at least; PolicyError if it has died."""
        results, self._results = self._results, []
        while self._jobs and (self._jobs[0][2].done() or (wait and not results)):
            number, checkpoint, job = self._jobs.pop(0)
            try:
                results.append(EvalResult(number, checkpoint, job.result(TIMEOUT_S)))
            except (BrokenProcessPool, TimeoutError):
                self._jobs.clear()
                raise PolicyError(
                    "the process that evaluates has died: see whether memory ran out, and "
                    "go on with --resume"
                ) from None
        return results

    def peek(self) -> tuple[EvalResult, ...]:
        """Return the results so far, which stay to be taken."""
        self._results = self.take()
        return tuple(self._results)

    def close(self) -> None:
        """Stop the process, whatever it is doing."""
        pool, self._pool = self._pool, None
        if pool is not None:
            for process in pool._processes.values():  # pyright: ignore[reportPrivateUsage]
                process.terminate()
            pool.shutdown(cancel_futures=True)


def _begin() -> None:
    subprocesses.settle()
    os.nice(10)  # where cores are few, learning goes first
