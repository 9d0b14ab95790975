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
    "compilation",
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
    "cuda",
    "first_minute",
    "garage",
    "racing",
    "mutants",
)
BY_NAME_ONLY = ("mutants", "first_minute", "cuda")
"""Run only when they are named: two take half an hour each, one needs a GPU."""
PAGE = Path(__file__).parents[1] / "docs" / "benchmarks.md"
INTRODUCTION = """# Benchmarks

`python -m benchmarks --write` writes this page and those it links to; with names, `--write cameras
races`, these alone. What stands under "Written by hand" is kept. Each benchmark in `benchmarks/`
checks that its result is sane. Times are wall time unless a row says otherwise; ratios are taken
side by side in one run. The machine is shared, and its pace drifts by 20 % and more, so a figure
near its goal may fall on either side of it.
"""
BY_HAND = "# Written by hand"
WITH_GOAL = re.compile(r"^\| *(.+?) \| (.+?) \| ([≤≥].+?) \| (met|not met) \|$", re.MULTILINE)


def folder() -> Path:
    """Return the folder of the pages with everything that a benchmark prints."""
    return PAGE.with_suffix("")


def summary(by_hand: str) -> str:
    """Return the page that has all figures with a goal, those that missed it first."""
    rows: dict[str, list[str]] = {"met": [], "not met": []}
    links = []
    for name in NAMES:
        page = folder() / f"{name}.md"
        if page.exists():
            links.append(link := f"[{name}]({folder().name}/{page.name})")
            for figure, measured, goal, met in WITH_GOAL.findall(page.read_text(encoding="utf-8")):
                rows[met].append(f"| {link} | {figure} | {measured} | {goal} |")
    lines = [INTRODUCTION, f"Everything they print: {', '.join(links)}."]
    for title, met in (("Goals that were missed", "not met"), ("Goals that were met", "met")):
        head = ["| benchmark | figure | measured | goal |", "|---|---|--:|--:|"]
        lines += ["", f"# {title}", "", *(head + rows[met] if rows[met] else ["None."])]
    return "\n".join((*lines, "", BY_HAND, "", by_hand)) + "\n"


def write(name: str, text: str) -> None:
    """Write the page of one benchmark, and the page that has all goals."""
    source = sys.modules[f"benchmarks.{name}"].__doc__ or ""
    first = source.split("\n\n")[0].replace("\n", " ")
    command = f"`python -m benchmarks {name}`, {datetime.now(UTC):%Y-%m-%d}; {report.machine()}."
    folder().mkdir(exist_ok=True)
    with replacing(folder() / f"{name}.md", "the page", LeagueError) as new:
        new.write_text(f"# {name}\n\n{first}\n\n{command}\n\n{text}\n", encoding="utf-8")
    page = PAGE.read_text(encoding="utf-8") if PAGE.exists() else ""
    _, _, by_hand = page.partition(f"\n{BY_HAND}\n")
    with replacing(PAGE, "the page", LeagueError) as new:
        new.write_text(summary(by_hand.strip()), encoding="utf-8")


def main() -> None:
    """Run benchmarks, and write the page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--write", action="store_true", help="write docs/benchmarks.md")
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
