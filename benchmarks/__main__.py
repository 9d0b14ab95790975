"""Run all benchmarks, or those named: python -m benchmarks [cameras solvers ...]."""

import importlib
import sys

NAMES = (
    "tracks",
    "cameras",
    "adapters",
    "solvers",
    "lap_bound",
    "lap_optimum",
    "drivers",
    "races",
    "replays",
    "ratings",
    "rewards",
    "store",
    "league_throughput",
    "training",
    "garage",
)

if __name__ == "__main__":
    for name in sys.argv[1:] or NAMES:
        importlib.import_module(f"benchmarks.{name}").main()
