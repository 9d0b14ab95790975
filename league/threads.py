"""Compiled loops on several threads: compiled code releases the interpreter.

Python's threads survive a fork, unlike OpenMP's. Results do not depend on their number.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache


def shared_out(loop: Callable[..., int], num_rows: int, least: int, *arguments: object) -> int:
    """Run a compiled loop over all rows; return its first result that is not 0, else 0.

    Args:
        loop: takes the first row, the row behind the last one, and the arguments.
        num_rows: rows.
        least: fewest rows that are worth another thread.
        arguments: of the loop.
    """
    # Single environments come here at each step, so the processors are counted only for many rows.
    if num_rows < 2 * least or (threads := min(num_rows // least, num_threads())) < 2:
        return loop(0, num_rows, *arguments)
    bounds = [num_rows * part // threads for part in range(threads + 1)]
    pool = _pool(os.getpid(), num_threads())
    parts = [
        pool.submit(loop, bounds[part], bounds[part + 1], *arguments) for part in range(1, threads)
    ]
    results = [loop(bounds[0], bounds[1], *arguments), *(part.result() for part in parts)]
    return next((result for result in results if result), 0)


def num_threads() -> int:
    """Return how many threads may work: OMP_NUM_THREADS, or the processors of this process."""
    limit = os.environ.get("OMP_NUM_THREADS", "")
    return int(limit) if limit.isdigit() and int(limit) > 0 else processors()


def processors() -> int:
    """Return how many processors this process may use."""
    # Only on Linux can it be fewer than the machine has.
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@cache
def _pool(process: int, size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="worlds")
