"""Compiled loops over worlds, shared out among threads when there are many worlds.

Each thread drives worlds of its own, so results do not depend on how many there are. Plain Python
threads, because compiled code releases the interpreter: they survive a fork, unlike OpenMP's.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

CARS_EACH = 256
"""Fewest cars for which another thread is worth waking."""


def num_threads() -> int:
    """Return how many threads may work: OMP_NUM_THREADS, or the processors of this process."""
    asked = os.environ.get("OMP_NUM_THREADS", "")
    return int(asked) if asked.isdigit() and int(asked) > 0 else len(os.sched_getaffinity(0))


@cache
def _pool(process: int, size: int) -> ThreadPoolExecutor:
    return ThreadPoolExecutor(size, thread_name_prefix="worlds")


def over_worlds(
    loop: Callable[..., int], num_worlds: int, num_cars: int, *arguments: object
) -> int:
    """Run a loop over all worlds; return its first answer that is not 0, else 0.

    Args:
        loop: takes the first world, the world behind the last one, and the arguments.
        num_worlds: worlds to share out.
        num_cars: cars in each.
        arguments: handed on.
    """
    if num_worlds * num_cars < 2 * CARS_EACH or (threads := num_threads()) == 1:
        return loop(0, num_worlds, *arguments)
    threads = min(threads, num_worlds, num_worlds * num_cars // CARS_EACH)
    bounds = [num_worlds * part // threads for part in range(threads + 1)]
    pool = _pool(os.getpid(), num_threads())
    parts = [
        pool.submit(loop, bounds[part], bounds[part + 1], *arguments) for part in range(1, threads)
    ]
    answers = [loop(bounds[0], bounds[1], *arguments), *(part.result() for part in parts)]
    return next((answer for answer in answers if answer), 0)
