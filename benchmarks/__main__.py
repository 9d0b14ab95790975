"""Run all benchmarks, or those named: python -m benchmarks [--write] [cameras solvers ...]."""

import argparse
import importlib
import re
import sys
from datetime import UTC, datetime
from pathlib import Path

from benchmarks import report
from league.atomic_file import replacing
from league.errors import LeagueError

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
    "web",
    "league_throughput",
    "training",
    "garage",
    "racing",
    "mutants",
)
BY_NAME_ONLY = ("mutants",)
"""Run only when they are named: they need a package of their own and half an hour."""
PAGE = Path(__file__).parents[1] / "docs" / "benchmarks.md"
INTRODUCTION = """# Benchmarks

`python -m benchmarks --write` writes this page; with names, `--write cameras races`, it replaces
these sections only. What stands under "Written by hand" is kept. Each benchmark in `benchmarks/`
checks that its result is sane. Times are wall time unless a row says otherwise; ratios are taken
side by side in one run. The machine is shared, and its pace drifts by 20 % and more, so a figure
near its goal may fall on either side of it.
"""
BY_HAND = "# Written by hand"
MISSED = re.compile(r"^\| (.+?) \| (.+?) \| (.+?) \| not met \|$", re.MULTILINE)


def sections(page: str) -> tuple[dict[str, str], str]:
    """Return the sections of a page by the name of their benchmark, and what is written by hand."""
    generated, _, by_hand = page.partition(f"\n{BY_HAND}\n")
    parts = re.split(r"^## (\w+)$", generated, flags=re.MULTILINE)
    found = dict(zip(parts[1::2], (text.strip() for text in parts[2::2]), strict=True))
    return found, by_hand.strip()


def page_of(found: dict[str, str], by_hand: str = "") -> str:
    """Return the page that is made of sections, with all goals that were missed at its head."""
    missed = [
        f"| {name} | {figure} | {measured} | {goal} |"
        for name in NAMES
        for figure, measured, goal in MISSED.findall(found.get(name, ""))
    ]
    head = (
        ["| benchmark | figure | measured | goal |", "|---|---|--:|--:|"] if missed else ["None."]
    )
    bodies = [f"## {name}\n\n{found[name]}" for name in NAMES if name in found]
    return (
        "\n".join((INTRODUCTION, "# Goals that were missed\n", *head, *missed, "", "# Figures", ""))
        + "\n\n".join(("", *bodies, *((BY_HAND, by_hand) if by_hand else ())))
        + "\n"
    )


def write(name: str, text: str) -> None:
    """Replace one section of the page."""
    source = sys.modules[f"benchmarks.{name}"].__doc__ or ""
    summary = source.split("\n\n")[0].replace("\n", " ")
    command = f"`python -m benchmarks {name}`, {datetime.now(UTC):%Y-%m-%d}"
    head = f"{summary}\n\n{command}; {report.machine()}."
    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    found, by_hand = sections(page)
    found[name] = f"{head}\n\n{text}"
    with replacing(PAGE, "the page", LeagueError) as new:
        new.write_text(page_of(found, by_hand), encoding="utf-8")


def main() -> None:
    """Run benchmarks, and write the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--write", action="store_true", help=f"write {PAGE.name}")
    given = parser.parse_args()
    unknown = set(given.names) - set(NAMES)
    if unknown:
        parser.error(f"unknown: {', '.join(sorted(unknown))}; choose from {', '.join(NAMES)}")
    print(report.machine())
    for name in given.names or (name for name in NAMES if name not in BY_NAME_ONLY):
        importlib.import_module(f"benchmarks.{name}").main()
        text = report.taken()
        if given.write:
            write(name, text)


if __name__ == "__main__":
    main()
