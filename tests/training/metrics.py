"""What a learner and an evaluation tell, made by hand for the onlookers' tests."""

from __future__ import annotations

from dataclasses import replace

import torch

from league.racing.table import Evaluation, Trial
from league.training.monitor.history import TEACHING, TrainingHistory
from league.training.ppo.learner import Update
from league.training.ppo.statistics import EpisodeStatistics


def update(number: int, *, loss: float = 0.25) -> Update:
    """Return an update of 100 decisions, half a second of collecting and a second of learning."""
    return Update(
        number=number,
        samples=100 * number,
        collect_s=0.5,
        learn_s=1.0,
        reward=0.125,
        losses={"value": loss, "surrogate": -0.01},
        log={"/reward/progress": 0.125, "/drive/speed": 1.5},
    )


def episodes(completion: float) -> EpisodeStatistics:
    """Return the episodes of one row, of which one came so far and earned 5."""
    made = EpisodeStatistics(1)
    made.add(torch.tensor([5.0]), torch.tensor([1]), torch.tensor([completion]))
    return made


def evaluation(best_lap_s: float | None) -> Evaluation:
    """Return three trials: laps of the best time and a second more, and one that left the road."""
    laps = [] if best_lap_s is None else [best_lap_s, best_lap_s + 1.0]
    trials = [_trial(number, time_s, 100.0) for number, time_s in enumerate(laps, 1)]
    trials.append(_trial(len(trials) + 1, 4.0, 50.0))
    return Evaluation(
        driver="pupil",
        track="ring",
        kind="time_trial",
        mode="episode",
        solver="bullet",
        laps=3,
        asked=3,
        seed=0,
        trials=tuple(trials),
        places=(),
    )


def _trial(number: int, time_s: float, completion: float) -> Trial:
    complete = completion == 100.0
    return Trial(
        trial=number,
        run=0,
        seed=0,
        standing=number == 1,
        status="lap_complete" if complete else "off_track",
        time_s=time_s,
        completion=completion,
        off_tracks=0 if complete else 1,
        crashes=0,
        immobilised=0,
        reversed=0,
        penalty_s=0.0,
    )


def history(updates: int, *, judged_every: int = 4, slow_s: float = 2.0) -> TrainingHistory:
    """Return a run that gets better: 2 s and 100 decisions an update, judged now and then."""
    made = TrainingHistory()
    for number in range(1, updates + 1):
        made.add_update(update(number), episodes(number / updates), slow_s * number)
        if number % judged_every == 0:
            lap = None if number == judged_every else 9.0 - number / updates
            made.add_evaluation(
                evaluation(lap),
                made.updates[-1].number,
                time_s=slow_s * number + 0.5,
                took_s=0.5,
                best=number < updates,
            )
    return made


def self_play(updates: int, *, update_s: float = 8.0) -> TrainingHistory:
    """Return a run, one half of which a teacher learns from 20 times as many decisions."""
    made, samples = TrainingHistory(), 0
    for number in range(1, updates + 1):
        taught, stage = number <= updates // 2, 2 * number / updates % 1.0
        samples += 49_152 if taught else 2_048
        row = replace(update(number), samples=samples)
        row = replace(row, log=row.log | {TEACHING: 1.0}) if taught else row
        made.add_update(row, episodes(0.2 + 0.7 * stage), update_s * number)
        if not taught and number % 16 == 0:
            made.add_evaluation(
                evaluation(9.0 - stage),
                made.updates[-1].number,
                time_s=update_s * number + 3.0,
                took_s=0.0,
                best=True,
            )
    return made
