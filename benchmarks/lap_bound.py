"""The quasi-steady-state bound of a flying lap on every shipped track (racing_line/racing_line.py).

What the simulated car itself could do, with its axles and its inertia, tells lap_optimum.py.
"""

from __future__ import annotations

from benchmarks.report import heading, table
from league.racing_line.racing_line import lap_bound
from league.sim.config import CarConfig
from league.track import files


def main() -> None:
    """Print the bound of every shipped track."""
    car = CarConfig()
    heading("Quasi-steady-state bound of a flying lap")
    row = table("track", "length", "bound")
    for name in files.names():
        track = files.load(name)
        row(name, f"{track.length:.2f} m", f"{lap_bound(track, car):.3f} s")


if __name__ == "__main__":
    main()
