"""Executors: processes and Ray actors race jobs; one that dies is told of and replaced."""

from __future__ import annotations

import os
import signal
import sys
import time
from contextlib import closing
from dataclasses import replace

import pytest
from season_kit import SHORT, new_league, submitted

from league.errors import ConfigError
from league.matchmaking import workers as executors
from league.matchmaking.pairing import heat_spec
from league.matchmaking.workers import processes
from league.matchmaking.workers.dispatcher import contestant
from league.matchmaking.workers.processes import Processes
from league.matchmaking.workers.worker import Job, Pit, Report

ENDLESS = replace(SHORT, laps=1000, max_time_s=36_000.0)


LARGE = b"x" * 1_000_000
"""Weights that no pipe takes up before somebody reads."""


@pytest.fixture
def job(tmp_path) -> Job:
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        submitted(store, "ann", senses="blind")
        entries = store.entries()
        heat = heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(e.id for e in entries))
        field = {entry.id: contestant(store, entry) for entry in entries}
        return Job(heat.key, 7, heat.halves, (3, 4), SHORT, field)


def reports(executor: executors.Executor, count: int, patience_s: float = 900.0) -> list[Report]:
    found: list[Report] = []
    give_up = time.monotonic() + patience_s
    while len(found) < count and time.monotonic() < give_up:
        found += executor.wait(0.2)
    return found


def check_killed_worker(executor, job: Job) -> None:
    """One of two workers is killed mid-race; the other's result is as if nothing had happened."""
    alone = Pit().race(job).outcome
    assert executor.free == executor.num_workers == 2
    executor.offer(replace(job, key="endless", ruleset=ENDLESS))
    executor.offer(job)
    (done,) = reports(executor, 1)
    assert done.outcome == alone and executor.free == 1
    os.kill(executor.pids[0] if isinstance(executor, Processes) else killed(executor), 9)
    (lost,) = reports(executor, 1)
    assert lost.key == "endless" and lost.outcome is None and "heat 7" in lost.traceback
    assert executor.free == 2
    executor.offer(job)
    executor.offer(replace(job, key="again"))
    both = {report.key: report.outcome for report in reports(executor, 2)}
    assert both[job.key] == alone and both["again"] is not None


def killed(executor) -> int:
    """Return the process of the Ray actor that is busy, which answers nothing meanwhile."""
    return executor.first_pid


def test_a_killed_process_is_told_of_and_replaced(job):
    with closing(Processes(2)) as executor:
        check_killed_worker(executor, job)


def test_a_stuck_heat_is_ended(job):
    with closing(Processes(1, job_limit_s=0.5)) as executor:
        executor.offer(replace(job, ruleset=ENDLESS))
        (lost,) = reports(executor, 1)
        assert lost.outcome is None and "longer than" in lost.traceback and executor.free == 1


def test_a_process_that_died_idle_is_replaced_before_it_is_given_a_job(job):
    with closing(Processes(1)) as executor:
        (pid,) = executor.pids
        os.kill(pid, signal.SIGKILL)
        time.sleep(0.2)
        executor.offer(job)
        (done, *_) = [r for r in reports(executor, 1) if r.outcome] or reports(executor, 1)
        assert done.key == job.key


def test_a_worker_that_dies_while_it_starts_costs_the_heat_no_try(job):
    with closing(Processes(1)) as executor:
        executor.offer(job)
        os.kill(executor.pids[0], signal.SIGKILL)  # it is only just beginning
        (done,) = reports(executor, 1)
        assert done.key == job.key and done.outcome is not None


def test_where_no_worker_can_start_the_run_ends_with_a_sentence(job, monkeypatch):
    monkeypatch.setattr(processes, "_work", _cannot_start)
    field = {id: replace(who, weights=LARGE) for id, who in job.field.items()}
    with closing(Processes(1)) as executor:
        executor.offer(replace(job, field=field))
        with pytest.raises(ConfigError, match=r"3 worker processes in a row .* \(exit code 3\)"):
            reports(executor, 1)


def _cannot_start(pipe: object) -> None:
    """Stand for a worker whose libraries cannot be loaded."""
    os._exit(3)


def test_workers_end_with_their_executor(job):
    executor = Processes(2)
    pids = executor.pids
    executor.close()
    executor.close()
    for pid in pids:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_more_workers_than_a_machine_can_bear_are_refused(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # so that few too many are enough
    with pytest.raises(ConfigError, match="9 workers were asked for: give 1 to 8"):
        executors.make("processes", 9)


def test_no_workers_and_unknown_executors_are_refused():
    with pytest.raises(ConfigError, match="0 workers"):
        executors.make("processes", 0)
    with pytest.raises(ConfigError, match="no executor 'slurm'"):
        executors.make("slurm", 1)  # pyright: ignore[reportArgumentType]


def test_without_ray_its_executor_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)  # as Python marks what cannot be imported
    with pytest.raises(ConfigError, match=r"racing-league\[cluster\]"):
        executors.make("ray", 1)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_killed_ray_actor_is_told_of_and_replaced(job, capfd):
    pytest.importorskip("ray", reason='Ray is not installed: pip install ".[cluster]"')
    with closing(executors.make("ray", 2)) as executor:
        executor.first_pid = executor.pids[0]
        check_killed_worker(executor, job)
    assert capfd.readouterr().out == ""  # tables and JSON go there, and are piped on
