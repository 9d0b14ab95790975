"""The Python examples of README.md and of the pages in docs/ are run as they stand."""

import re
import shutil
import textwrap
from pathlib import Path

import pytest

from league import replay
from league.agents import roster
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.track import files

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
# These need a network that others trained, or a car's cameras: only their grammar is checked.
UNFINISHED = ("convert.from_sb3(", "onnxruntime.InferenceSession(")


def examples(page: Path) -> list[str]:
    """Return the fenced Python of a page, and what stands indented below "In Python:"."""
    text = page.read_text()
    fenced = re.findall(r"^( *)```python\n(.*?)^ *```$", text, re.MULTILINE | re.DOTALL)
    indented = re.findall(r"^In Python:\n\n((?: {4}.*\n)+)", text, re.MULTILINE)
    return [textwrap.dedent(one) for one in (*(code for _, code in fenced), *indented)]


EXAMPLES = [
    pytest.param(code, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, code in enumerate(examples(page), 1)
]


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Make a folder current that has a.pt and FILE.race."""
    monkeypatch.chdir(tmp_path)
    shutil.copy(roster.garage()["novice"], "a.pt")
    spec = RaceSpec(
        kind="time_trial", entries=(Entry(name="racing_line"),), laps=3, solver="planar"
    )
    recorded = race.run(spec, track=files.load("reinvent_2018")).replay
    assert recorded is not None
    replay.write(recorded, "FILE.race")
    return tmp_path


@pytest.mark.parametrize("code", EXAMPLES)
def test_an_example_of_a_page_runs(code, folder):
    compiled = compile(code, "the example", "exec")
    if any(part in code for part in UNFINISHED):
        return
    times = {"times_s": [0.5, 1.0]}  # a name that an example leaves to its reader
    exec(compiled, {"__name__": "example", **times})


def test_examples_are_found_on_the_pages_that_have_some():
    found = {page.name for page in PAGES if examples(page)}
    assert {"README.md", "checkpoint.md", "replay.md", "rewards.md"} <= found
