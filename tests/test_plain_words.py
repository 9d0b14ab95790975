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
    r"(?-i:[Nn]obody)",
    r"whom",
    r"beside",
    r"whose",
    r"told(?!\")",
    r"(?<!--)(?<!\")(?<!/)tutor",
    r"(?:ask|from|of|tell|which) who",
)
"""Patterns that are matched as whole words, in any case; --tutor and the keys "told" and "tutor"
are names in older files and scripts, NOBODY is a number."""
PATTERN = re.compile(rf"\b({'|'.join(WORDS)})\b", re.IGNORECASE)


def texts():
    """Return the files to check, by their path from the root."""
    paths = [ROOT / "CONTRIBUTING.md", ROOT / "README.md", *(ROOT / "docs").glob("*.md")]
    for folder in ("league", "benchmarks", "examples"):
        paths += (ROOT / folder).rglob("*.py")
    paths += (ROOT / "league/web/templates").glob("*.html")
    names = sorted(path.relative_to(ROOT).as_posix() for path in paths)
    names.remove("docs/benchmarks.md")  # generated
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
