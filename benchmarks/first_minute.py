"""Whether the README's minute of training laps, with each of twenty seeds on one busy core.

The line is the README's own. All processes of a run share one core, with whatever else runs on the
machine. It takes 25 minutes: `python -m benchmarks first_minute`.
"""

import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.report import figure, heading, note, table

ROOT = Path(__file__).parents[1]
SEEDS = 20
LINE = re.compile(r"^league (train --reward examples/.* --minutes 1) --out \S+$", re.MULTILINE)


def first_minute(arguments: list[str], seed: int, core: int) -> tuple[bool, int]:
    """Train as the README says; return whether 3 of 3 laps were complete, and the decisions."""
    with tempfile.TemporaryDirectory() as folder:
        asked = [*arguments, "--seed", str(seed), "--out", str(Path(folder) / "mine.pt")]
        done = subprocess.run(
            [sys.executable, "-m", "league.cli", *asked],
            cwd=ROOT,
            preexec_fn=lambda: os.sched_setaffinity(0, {core}),
            capture_output=True,
            text=True,
            check=True,
        )
    decisions = re.search(r"(\d+) decisions in", done.stdout)
    assert decisions is not None, done.stdout
    return "3 of 3 laps complete" in done.stdout, int(decisions[1])


def main() -> None:
    """Print the figures."""
    heading("The first minute of training")
    found = LINE.search((ROOT / "README.md").read_text(encoding="utf-8"))
    assert found is not None, "the README's line is another one"
    arguments, core = shlex.split(found[1]), min(os.sched_getaffinity(0))
    row, complete = table("seed", "laps", "decisions"), 0
    for seed in range(SEEDS):
        laps, decisions = first_minute(arguments, seed, core)
        row(seed, "3 of 3" if laps else "NOT COMPLETE", f"{decisions:,}")
        complete += laps
    figure(f"seeds of {SEEDS} that drive 3 of 3 laps", complete, "", SEEDS)
    load = os.getloadavg()
    note(f"Programs that wanted a processor, over the last 1, 5 and 15 minutes: {load}.")


if __name__ == "__main__":
    main()
