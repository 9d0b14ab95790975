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
    r"(?<!\")(?<!')(?-i:[Nn]obody)",
    r"whom",
    r"beside",
    r"whose",
    r"told(?!\")",
    r"told_\w+|\w+_told\w*",
    r"(?<!--)(?<!\")(?<!/)tutor",
    r"(?:ask|from|of|tell|which) who",
)
"""Patterns that are matched as whole words, in any case; --tutor and the keys "told" and "tutor"
are names in older files and scripts, NOBODY is a number, "nobody" a driver that is not there."""
PATTERN = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)


def texts():
    """Return the files to check, by their path from the root."""
    paths = [*ROOT.glob("*.md"), ROOT / "Makefile", ROOT / "garage/train.sh"]
    for folder in ("docs", "garage", "tracks", "tests/data"):
        paths += (ROOT / folder).glob("*.md")
    for folder in ("league", "benchmarks", "examples", "tests"):
        paths += (ROOT / folder).rglob("*.py")
    paths += (ROOT / "league/web/templates").glob("*.html")
    names = sorted(path.relative_to(ROOT).as_posix() for path in paths)
    names.remove("docs/benchmarks.md")  # generated
    names.remove(Path(__file__).relative_to(ROOT).as_posix())
    return names


@pytest.mark.parametrize("name", texts())
def test_words_are_plain(name):
    lines = (ROOT / name).read_text(encoding="utf-8").splitlines()
    found = [
        f"{name}:{number}: {line.strip()}"
        for number, line in enumerate(lines, 1)
        if PATTERN.search(line)
    ]
    assert not found, "\n".join(found)
