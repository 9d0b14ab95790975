"""What a learner and an evaluation tell, made by hand for the onlookers' tests."""

from __future__ import annotations

from dataclasses import replace

from league.racing.table import Evaluation, Trial
from league.training.monitor.history import TEACHING, TrainingHistory, UpdateRow


def update(
    number: int, completion: float = 0.5, time_s: float = 0.0, *, loss: float = 0.25
) -> UpdateRow:
    """Return an update of 100 decisions, half a second of collecting and a second of learning.

    Its episodes came so far, 0 to 1, and earned 5.
    """
    return UpdateRow(
        number=number,
        samples=100 * number,
        time_s=time_s,
        collect_s=0.5,
        learn_s=1.0,
        reward=0.125,
        earned=5.0,
        completion=100.0 * completion,
        losses={"value": loss, "surrogate": -0.01},
        log={"/reward/progress": 0.125, "/drive/speed": 1.5},
    )


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
        made.add_update(update(number, number / updates, slow_s * number))
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
        row = replace(update(number, 0.2 + 0.7 * stage, update_s * number), samples=samples)
        row = replace(row, log=row.log | {TEACHING: 1.0}) if taught else row
        made.add_update(row)
        if not taught and number % 16 == 0:
            made.add_evaluation(
                evaluation(9.0 - stage),
                made.updates[-1].number,
                time_s=update_s * number + 3.0,
                took_s=0.0,
                best=True,
            )
    return made
