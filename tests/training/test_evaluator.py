"""Policies are evaluated in a process of their own, in order, as in this one."""

import os
import pickle
import signal
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import pytest

from league.agents.policy import Policy
from league.errors import PolicyError
from league.racing.evaluate import evaluate
from league.sim.config import SimConfig
from league.track import files
from league.training import evaluator
from league.training.evaluator import EvalConfig, Evaluator, evaluate_policy
from tests.training.small import CAMERA, untrained

ONE = EvalConfig(tracks=(files.load("reinvent_2018"),), laps=1)
TWO = EvalConfig(tracks=(files.load("reinvent_2018"), files.load("peanut")), laps=1, trials=2)


def test_judgement_is_the_same_inline_and_in_a_process_beside():
    inline, background = Evaluator(ONE, background=False), Evaluator(ONE)
    try:
        for one in (inline, background):
            one.submit(7, untrained())
        (here,), (there,) = inline.take(), background.take(wait=True)
    finally:
        background.close()
    assert here.number == there.number == 7
    assert here.evaluation == there.evaluation == evaluate_policy(ONE, untrained())
    assert not here.evaluation.all_complete


def test_policies_are_judged_in_the_order_they_were_handed_over():
    one = Evaluator(ONE)
    try:
        for number in (1, 2, 3):
            one.submit(number, untrained())
        assert one.pending == [1, 2, 3]
        found = []
        while one.pending:
            found += one.take(wait=True)
        assert [judgement.number for judgement in found] == [1, 2, 3]
        assert one.take() == []
    finally:
        one.close()


def test_trials_on_several_tracks_are_counted_on():
    found = evaluate_policy(TWO, untrained())
    assert found.track == "2 tracks"
    assert found.asked == 4  # 2 tracks x 2 trials x 1 lap
    assert [trial.trial for trial in found.trials] == [1, 2, 3, 4]
    alone = evaluate_policy(EvalConfig(tracks=(TWO.tracks[1],), laps=1, trials=2), untrained())
    assert [t.time_s for t in found.trials[2:]] == [t.time_s for t in alone.trials]
    assert [t.run for t in found.trials] == [0, 1, 2, 3]


def test_policies_are_evaluated_as_the_command_does():
    found = evaluate_policy(replace(ONE, trials=2), untrained())
    same = evaluate(
        Policy(untrained(), SimConfig().car),
        ONE.tracks[0],
        laps=1,
        trials=2,
        mode="episode",
        seed=ONE.seed,
    )
    assert found.variation == same.variation == 1.0
    assert found.trials == same.trials


def test_share_of_clean_runs_is_of_twenty(monkeypatch):
    asked = []

    def counted(cfg, policy):
        asked.append(cfg.trials)
        return evaluate("centerline", "reinvent_2018", laps=1, trials=cfg.trials, solver="planar")

    monkeypatch.setattr(evaluator, "evaluate_policy", counted)
    assert evaluator.clean_share(ONE, untrained()) == 1.0
    evaluator.clean_share(replace(TWO, tracks=TWO.tracks * 6), untrained())
    assert asked == [20, 2]  # on one track, and on each of twelve


def test_judge_against_opponents_tells_one_place_for_each_run():
    found = evaluate_policy(
        EvalConfig(tracks=ONE.tracks, laps=1, opponents=("centerline",)), untrained()
    )
    assert found.kind == "head_to_head"
    assert len(found.places) == 1 and found.places[0] in (1, 2)


def test_death_of_the_process_gets_one_sentence():
    one = Evaluator(ONE)
    try:
        one.submit(1, untrained())
        assert one._pool is not None
        (process,) = one._pool._processes.values()
        os.kill(process.pid, signal.SIGKILL)
        process.join(10.0)
        with pytest.raises(PolicyError, match="the process that evaluates has died: see whether"):
            one.take(wait=True)
        assert one.take() == []  # reported once
    finally:
        one.close()


def test_judge_that_takes_no_orders_says_why(monkeypatch):
    one = Evaluator(EvalConfig(tracks=ONE.tracks, opponents=("nobody",)))
    try:
        one.submit(1, untrained())
        with pytest.raises(PolicyError, match="nobody"):
            one.take(wait=True)
    finally:
        one.close()


def test_judge_that_takes_too_long_is_given_up(monkeypatch):
    monkeypatch.setattr(evaluator, "TIMEOUT_S", 0.0)
    one = Evaluator(replace(ONE, trials=500))
    try:
        one.submit(1, untrained())
        with pytest.raises(PolicyError, match="the process that evaluates"):
            one.take(wait=True)
    finally:
        one.close()


def test_program_ends_although_policies_are_still_waiting(tmp_path):
    # More than a pipe holds: an order that is not read must not keep the learner from ending.
    (tmp_path / "policy.pickle").write_bytes(pickle.dumps(untrained(CAMERA)))
    script = tmp_path / "leave.py"
    script.write_text(
        textwrap.dedent(
            f"""
            import pickle
            import sys
            from pathlib import Path
            sys.path.insert(0, {str(Path(__file__).parents[2])!r})
            from league import subprocesses
            from league.track import files
            from league.training.evaluator import EvalConfig, Evaluator

            if __name__ == "__main__":
                policy = pickle.loads(Path(__file__).with_name("policy.pickle").read_bytes())
                judge = Evaluator(EvalConfig(tracks=(files.load("reinvent_2018"),)))
                for number in range(20):
                    judge.submit(number, policy)
                judge.close()
                print("left")
            """
        )
    )
    done = subprocess.run(
        [sys.executable, str(script)], capture_output=True, text=True, timeout=60, check=True
    )
    assert done.stdout == "left\n"


def test_ctrl_c_is_heard_as_before_once_the_judge_runs():
    before = signal.getsignal(signal.SIGINT)
    one = Evaluator(ONE)
    one.submit(1, untrained())
    one.close()
    assert signal.getsignal(signal.SIGINT) is before
