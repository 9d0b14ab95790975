"""How long a fresh installation compiles everything, as `make sync` has it done.

A copy of the package, without machine code and bytecode, is compiled in a temporary folder, and
checked to have then compiled whatever Python calls: `python -m benchmarks compilation`.
"""

import os
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.report import figure, heading, note
from league import precompile

ROOT = Path(__file__).parents[1]


def copied(folder: Path) -> Path:
    """Copy the package and its tracks to a folder, without what was made from the sources."""
    made = shutil.ignore_patterns("__pycache__")
    shutil.copytree(ROOT / "league", folder / "league", ignore=made)
    shutil.copytree(ROOT / "tracks", folder / "tracks")
    return folder / "league" / "__pycache__"


def busy_s() -> float:
    """Return the processor time of all processes that were started and have ended [s]."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """Print the figures."""
    heading("Compiling everything in a fresh installation")
    with tempfile.TemporaryDirectory() as folder:
        cache = copied(Path(folder))
        environment = os.environ | {"PYTHONPATH": folder}
        command = [sys.executable, "-P", "-m", "league.precompile"]
        before, began = busy_s(), time.perf_counter()
        subprocess.run(command, cwd=folder, env=environment, check=True)
        wall, busy = time.perf_counter() - began, busy_s() - before
        entries = {path.name.split("-")[0] for path in cache.glob("jit-*/*.nbc")}
        assert list(cache.glob("jit-*/complete")), "it has not come to its end"
        assert len(entries) > 30, f"it compiled {len(entries)} functions"
    processes = min(len(precompile.GROUPS), len(os.sched_getaffinity(0)))
    title = f"compilation of everything, {processes} processes"
    figure(f"{title}, wall time", wall, "s", 25, most=True)
    figure(f"{title}, processor time", busy, "s", 48, most=True)
    figure("functions that Python calls", len(entries), "")
    load = os.getloadavg()
    note(f"Programs that wanted a processor, over the last 1, 5 and 15 minutes: {load}.")


if __name__ == "__main__":
    main()
