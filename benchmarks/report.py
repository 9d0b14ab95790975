"""What every benchmark prints alike: the machine, a heading, a figure beside its goal."""

import os
import platform
import statistics
import time
from collections.abc import Callable
from importlib.metadata import version


def heading(title: str) -> None:
    """Print a benchmark's title."""
    print(f"\n## {title}\n", flush=True)


def figure(
    name: str, value: float, unit: str, goal: float | None = None, *, most: bool = False
) -> bool:
    """Print one figure beside its goal; return whether the goal is met.

    Args:
        name: what was measured.
        value: the figure.
        unit: its unit.
        goal: what was aimed at, if anything.
        most: True when the goal is an upper bound.
    """
    met = goal is None or (value <= goal if most else value >= goal)
    aim = "" if goal is None else f"  goal {'<=' if most else '>='} {goal:g}"
    verdict = "" if goal is None else ("  met" if met else "  NOT MET")
    print(f"{name:62s} {value:12,.4g} {unit:18s}{aim}{verdict}", flush=True)
    return met


def machine() -> str:
    """Describe the machine in one line."""
    model = platform.processor() or platform.machine()
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            names = [line.split(":", 1)[1].strip() for line in lines if "model name" in line]
        model = names[0] if names else model
    except OSError:
        pass
    return (
        f"{os.cpu_count()} cores of {model}, Python {platform.python_version()}, "
        f"Numba {version('numba')}, torch {version('torch')}"
    )


def seconds(action: Callable[[], object], repeats: int = 5) -> float:
    """Return the median wall time of an action [s], after one call to warm up."""
    return statistics.median(_times(action, repeats))


def fastest(action: Callable[[], object], repeats: int = 40) -> float:
    """Return the least wall time of an action [s]: what it costs when nobody else runs."""
    return min(_times(action, repeats))


def _times(action: Callable[[], object], repeats: int) -> list[float]:
    action()
    taken = []
    for _ in range(repeats):
        start = time.perf_counter()
        action()
        taken.append(time.perf_counter() - start)
    return taken


def product(num_worlds: int, num_cars: int) -> float:
    """Return the time of one elementwise product of that shape [s], the yardstick of tables."""
    import numpy as np

    one = np.random.default_rng(0).random((num_worlds, num_cars), np.float32)
    return fastest(lambda: [one * one for _ in range(20)], 30) / 20
