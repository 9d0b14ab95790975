"""Rows shared out among threads: each once, and few of them on one thread."""

import os
import threading
from itertools import pairwise

import pytest

from league.threads import num_threads, processors, shared_out


@pytest.mark.parametrize(
    ("num_rows", "threads", "parts"), [(0, 3, 1), (19, 3, 1), (20, 3, 2), (31, 3, 3), (99, 1, 1)]
)
def test_each_row_is_worked_on_once(monkeypatch, num_rows, threads, parts):
    monkeypatch.setenv("OMP_NUM_THREADS", str(threads))
    barrier, done = threading.Barrier(parts), []

    def loop(start: int, stop: int, given: str) -> int:
        barrier.wait(10)  # all parts are under way at the same time
        done.append((start, stop, given))
        return start

    # Of the results that are not 0 the one of the earliest rows counts.
    found = shared_out(loop, num_rows, 10, "given")
    second = sorted(done)[1][0] if parts > 1 else 0
    assert found == second
    assert len(done) == parts
    bounds = [0, *(stop for _, stop, _ in sorted(done))]
    assert sorted(done) == [(*pair, "given") for pair in pairwise(bounds)]
    assert bounds[-1] == num_rows


def test_processors_are_counted_where_python_cannot_say_which_are_allowed(monkeypatch):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    assert num_threads() == processors() >= 1
    monkeypatch.delattr(os, "sched_getaffinity", raising=False)  # as on macOS
    monkeypatch.setattr(os, "cpu_count", lambda: 3)
    assert num_threads() == processors() == 3
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert processors() == 1
