"""Messages, docstrings and docs are plain technical English: words that must not come back."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
WORDS = (
    r"anew",
    r"leave --\S+ away",
    r"cannot be gone on",
    r"goes on from where",
    r"somebody",
    r"whom",
)
"""Patterns that are matched as whole words, in any case."""
PRIVATE_WORDS = (r"[Tt]old(?!\")", r"[Nn]obody", r"[Bb]eside", r"[Ww]hose", r"(?<!--)[Tt]utor")
"""Patterns for the places below; NOBODY, --tutor and a file's key "told" are names."""
CLEANED = (
    *("CONTRIBUTING.md", "README.md", "docs/", "league/agents/", "league/cli/"),
    *("league/deepracer/", "league/matchmaking/", "league/racing/", "league/racing_line/"),
    *("league/replay/", "league/rerun_view/", "league/track/", "league/video/"),
)
"""Places without private words."""
NOT_YET_CHECKED = (
    "league/envs/adapters",
    # Compiled files: a change of a docstring compiles the simulator again.
    "league/sim",
    "league/envs/episodes.py",
)
"""Places whose texts are still to be gone through."""
PATTERN = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)
PRIVATE = re.compile(rf"\b({'|'.join(PRIVATE_WORDS)})\b")


def texts():
    """Return the files to check, by their path from the root."""
    paths = [ROOT / "CONTRIBUTING.md", ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    for folder in ("league", "benchmarks", "examples"):
        paths += (ROOT / folder).rglob("*.py")
    names = sorted(path.relative_to(ROOT).as_posix() for path in paths)
    names.remove("docs/benchmarks.md")  # generated
    return [name for name in names if not name.startswith(NOT_YET_CHECKED)]


@pytest.mark.parametrize("name", texts())
def test_words_are_plain(name):
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    found = [
        f"{name}:{number}: {line.strip()}"
        for number, line in enumerate(lines, 1)
        if PATTERN.search(line) or (name.startswith(CLEANED) and PRIVATE.search(line))
    ]
    assert not found, "\n".join(found)


def test_places_that_are_not_yet_checked_exist():
    assert all((ROOT / name).exists() for name in NOT_YET_CHECKED)
