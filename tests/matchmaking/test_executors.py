"""Executors: processes and Ray actors race jobs; one that dies is reported and replaced."""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import time
from contextlib import closing
from dataclasses import replace

import pytest

from league.errors import ConfigError
from league.matchmaking import workers
from league.matchmaking.loop import heat_driver
from league.matchmaking.pairing import heat_spec
from league.matchmaking.store import HeatProgress
from league.matchmaking.workers import ProcessExecutor
from league.matchmaking.workers.worker import HeatJob, HeatReport, RaceWorker
from league.replay import format as replay_format
from tests.matchmaking.season_kit import SHORT, new_league, submitted

ENDLESS = replace(SHORT, laps=1000, max_time_s=36_000.0)


LARGE = b"x" * 1_000_000
"""Weights that no pipe takes up before it is read."""


@pytest.fixture
def job(tmp_path) -> HeatJob:
    with new_league(f"sqlite:///{tmp_path / 'league.db'}") as store:
        submitted(store, "ann", senses="blind")
        entries = store.entries()
        heat = heat_spec.mirrored(SHORT.hash, ("reinvent_2018",) * 2, tuple(e.id for e in entries))
        field = {entry.id: heat_driver(store, entry) for entry in entries}
        return HeatJob(heat.key, 7, heat.halves, (3, 4), SHORT, field)


def reports(executor: workers.Executor, count: int, patience_s: float = 900.0) -> list[HeatReport]:
    found: list[HeatReport] = []
    give_up = time.monotonic() + patience_s
    while len(found) < count and time.monotonic() < give_up:
        found += [one for one in executor.wait(0.2) if isinstance(one, HeatReport)]
    return found


def pids() -> list[int]:
    """Return the worker processes of this one, in the order they were started."""
    children = multiprocessing.active_children()
    children.sort(key=lambda child: int(child.name.rpartition("-")[2]))
    return [child.pid or 0 for child in children]


def check_killed_worker(executor, job: HeatJob, pid: int) -> None:
    """One of two workers is killed mid-race; the other's result is as if nothing had happened."""
    alone = RaceWorker().race(job).outcome
    assert executor.free == 2
    executor.offer(replace(job, key="endless", ruleset=ENDLESS))
    executor.offer(job)
    (done,) = reports(executor, 1)
    assert done.outcome == alone and executor.free == 1
    os.kill(pid, signal.SIGKILL)
    (lost,) = reports(executor, 1)
    assert lost.key == "endless" and lost.outcome is None and "heat 7" in lost.traceback
    assert lost.lost  # with its worker, which is not the race's fault
    assert executor.free == 2
    executor.offer(job)
    executor.offer(replace(job, key="again"))
    both = {report.key: report.outcome for report in reports(executor, 2)}
    assert both[job.key] == alone and both["again"] is not None


def test_a_worker_sends_how_far_its_heat_has_come(job):
    sent: list[workers.News] = []
    with closing(ProcessExecutor(1)) as executor:
        executor.offer(replace(job, ruleset=ENDLESS))
        while len(sent) < 2:
            sent += executor.wait(60.0)
            assert executor.free == 0
    frames = [
        [replay_format.decode(content).num_frames for content in one.replays]
        for one in sent
        if isinstance(one, HeatProgress)
    ]
    assert len(frames) == len(sent)
    assert all(1 < first < second for first, second in zip(*frames[:2], strict=True))


def test_a_killed_process_is_reported_and_replaced(job):
    with closing(ProcessExecutor(2)) as executor:
        check_killed_worker(executor, job, pids()[0])


def test_a_stuck_heat_is_ended(job):
    with closing(ProcessExecutor(1, job_limit_s=0.5)) as executor:
        executor.offer(replace(job, ruleset=ENDLESS))
        (lost,) = reports(executor, 1)
        assert lost.outcome is None and "longer than" in lost.traceback and executor.free == 1
        assert not lost.lost


def test_a_process_that_died_idle_is_replaced_before_it_is_given_a_job(job):
    with closing(ProcessExecutor(1)) as executor:
        (pid,) = pids()
        os.kill(pid, signal.SIGKILL)
        time.sleep(0.2)
        executor.offer(job)
        (done, *_) = [r for r in reports(executor, 1) if r.outcome] or reports(executor, 1)
        assert done.key == job.key


def test_a_worker_that_dies_while_it_starts_costs_the_heat_no_try(job):
    others = pids()  # of tests before this one
    with closing(ProcessExecutor(1)) as executor:
        executor.offer(job)
        (worker,) = set(pids()) - set(others)
        os.kill(worker, signal.SIGKILL)  # it is only just beginning
        (done,) = reports(executor, 1)
        assert done.key == job.key and done.outcome is not None


def test_where_no_worker_can_start_the_run_ends_with_a_sentence(job, monkeypatch):
    monkeypatch.setattr(workers, "_work", _cannot_start)
    field = {id: replace(who, weights=LARGE) for id, who in job.drivers.items()}
    with closing(ProcessExecutor(1)) as executor:
        executor.offer(replace(job, drivers=field))
        with pytest.raises(ConfigError, match=r"3 worker processes in a row .* \(exit code 3\)"):
            reports(executor, 1)


def _cannot_start(pipe: object) -> None:
    """Stand for a worker that cannot load its libraries."""
    os._exit(3)


def test_workers_end_with_their_executor(job):
    executor = ProcessExecutor(2)
    started = pids()
    executor.close()
    executor.close()
    for pid in started:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)


def test_more_workers_than_a_machine_can_bear_are_refused(monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)  # so that few too many are enough
    with pytest.raises(ConfigError, match="9 workers were asked for: give 1 to 8"):
        workers.make_executor("processes", 9)


def test_no_workers_are_refused():
    with pytest.raises(ConfigError, match="0 workers"):
        workers.make_executor("processes", 0)


def test_without_ray_its_executor_says_how_to_install_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)  # as Python marks what cannot be imported
    with pytest.raises(ConfigError, match=r"racing-league\[cluster\]"):
        workers.make_executor("ray", 1)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Ray's own
def test_a_killed_ray_actor_is_reported_and_replaced(job, capfd):
    ray = pytest.importorskip("ray", reason='Ray is not installed: pip install ".[cluster]"')
    with closing(workers.make_executor("ray", 2)) as executor:
        first = executor._slots[0].actor  # it is busy later, and answers nothing
        pid = ray.get(first.__ray_call__.remote(lambda _: os.getpid()))
        check_killed_worker(executor, job, pid)
    assert capfd.readouterr().out == ""  # tables and JSON go there, and are piped on
