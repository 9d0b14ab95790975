"""Whether the README's minute of training laps, with each of twenty seeds on one busy core.

The line is the README's own. All processes of a run share one core, with whatever else runs on the
machine. It takes 25 minutes: `python -m benchmarks first_minute`.
"""

import os
import re
import shlex

from benchmarks.report import figure, heading, note, table
from benchmarks.training import ROOT, learnt

SEEDS = 20
LINE = re.compile(r"^league (train --reward examples/.* --minutes 1) --out \S+$", re.MULTILINE)


def main() -> None:
    """Print the figures."""
    heading("The first minute of training")
    found = LINE.search((ROOT / "README.md").read_text(encoding="utf-8"))
    assert found is not None, "the README's line is another one"
    arguments, cores = shlex.split(found[1]), os.sched_getaffinity(0)
    row, complete = table("seed", "laps", "decisions"), 0
    os.sched_setaffinity(0, {min(cores)})  # of the programs that it starts, too
    try:
        for seed in range(SEEDS):
            run = learnt([*arguments, "--seed", str(seed)])
            row(seed, "3 of 3" if run.complete else "NOT COMPLETE", f"{run.samples:,}")
            complete += run.complete
    finally:
        os.sched_setaffinity(0, cores)  # for the benchmarks that follow
    figure(f"seeds of {SEEDS} that drive 3 of 3 laps", complete, "", SEEDS)
    load = os.getloadavg()
    note(f"Programs that wanted a processor, over the last 1, 5 and 15 minutes: {load}.")


if __name__ == "__main__":
    main()
