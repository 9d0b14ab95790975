"""docs/exports.md has every column and key that the commands print, and no other."""

from __future__ import annotations

import csv
import io
import json
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from types import UnionType

import pytest

from league.agents import checkpoint
from league.cli import commands, main
from league.matchmaking.store import Store
from tests.agents.trained import make_checkpoint
from tests.matchmaking.season_kit import new_league, raced, submitted

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "exports.md").read_text(encoding="utf-8")
SECTIONS = dict(re.findall(r"^## `league (.*?)`\n(.*?)(?=^## |\Z)", PAGE, re.M | re.S))
RACE = "centerline racing_line --laps 1 --solver planar --variation 0"
PRINTED = {
    "export --csv": ["export --csv -"],
    "export --json": ["export --json -"],
    "standings --json": ["standings --json"],
    "entries --json": ["entries --json"],
    "show ENTRY --json": ["show ann --json"],
    "h2h A B --json": ["h2h ann centerline --json"],
    "h2h --json": ["h2h --json"],
    "history ENTRY --json": ["history ann --json"],
    "heats --json": ["heats --json --limit 99"],
    "heat HEAT --json": ["heat 5 --json"],
    "season --json": ["season --json"],
    "cup --json": ["cup --json"],
    "token list --json": ["token list --json"],
    "gauntlet FILE.pt --json": ["gauntlet new.pt --workers 1 --json"],
    "compare A B --json": ["compare ann centerline --heats 2 --workers 1 --json"],
    "race --json": [f"race {RACE} --json --replay raced"],
    "evaluate --json": [
        "evaluate centerline --laps 1 --solver planar --json",
        "evaluate centerline --laps 1 --solver planar --opponents racing_line --json",
    ],
    "replays --json": [f"race {RACE} --replay raced", "replays raced --json"],
    "tracks list --json": ["tracks list --json"],
    "card CHECKPOINT --json": ["card new.pt --json"],
    "reward check FILE.py --json": [f"reward check {ROOT}/examples/reward_avoid.py --json"],
    "reward score REPLAY REWARD --json": [
        f"race {RACE} --replay scored.race",
        "reward score scored.race centerline --json",
    ],
}
"""What prints what is in each section; of commands without JSON it makes what is needed."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a league that has all that the exports tell, and of a checkpoint."""
    folder = tmp_path_factory.mktemp("exports")
    checkpoint.save(folder / "new.pt", make_checkpoint("lidar", seed=9, name="new"))
    url = f"sqlite:///{folder / 'league.db'}"
    with new_league(url, anchors=("centerline", "racing_line", "cautious")) as store:
        submitted(store, "ann", seed=1)
        store.tokens.create("ann", ("submit",))
        raced(store, 14)
    for command in ("season start One", "season end", "season start Two", "cup start --anchors"):
        assert main([*command.split(), "--league", url]) == 0
    with Store(url) as store:
        raced(store, 6)  # the cup
    return folder


@pytest.fixture
def output_of(folder, monkeypatch, capsys):
    """Return what a command prints."""
    monkeypatch.chdir(folder)

    def run(command: str) -> str:
        assert main(command.split()) == 0
        return capsys.readouterr().out

    return run


def _documented(text: str) -> list[str]:
    """Return the paths in the first cells of the tables of a section."""
    cells = re.findall(r"^\| (`.*?) \|", text, re.M)
    return [path for cell in cells for path in re.findall(r"`(.*?)`", cell)]


def _paths(value: object, at: str = "") -> Iterator[str]:
    """Yield the path of everything in a document; of empty and missing things, their own."""
    if isinstance(value, dict) and value:
        for key, inner in value.items():
            yield from _paths(inner, f"{at}.{key}" if at else key)
    elif isinstance(value, list) and value:
        for inner in value:
            yield from _paths(inner, f"{at}[]")
    else:
        yield at


def _is_below(path: str, at: str) -> bool:
    """Return whether a documented path is that of something, or of a part of it."""
    return path == at or path.startswith((f"{at}.", f"{at}[]"))


@pytest.mark.parametrize("section", PRINTED)
def test_the_page_has_every_key_that_is_printed_and_no_other(output_of, section):
    paths = _documented(SECTIONS[section])
    assert len(paths) == len(set(paths)) > 0
    printed = set()
    for command in PRINTED[section]:
        text = output_of(command)
        if "--csv" in command:
            printed |= set(next(csv.reader(io.StringIO(text))))
        elif "--json" in command:
            printed |= set(_paths(json.loads(text)))
    free = [path.removesuffix("*") for path in paths if path.endswith(".*")]
    # What is empty or null here may have keys elsewhere.
    unknown = {
        one for one in printed
        if not one.startswith(tuple(free)) and not any(_is_below(path, one) for path in paths)
    }  # fmt: skip
    assert not unknown
    missing = {
        path for path in paths
        if not any(
            one.startswith(path.removesuffix("*")) or _is_below(path, one) for one in printed
        )
    }  # fmt: skip
    assert not missing


def _with_json(name: str, command: type) -> Iterator[str]:
    """Yield the command lines, without what they are given, that can print JSON."""
    hints = typing.get_type_hints(command, include_extras=True)
    if "json" in hints:
        yield f"{name} --json"
    inner = hints.get("command")
    for one in typing.get_args(inner) if isinstance(inner, UnionType) or inner else ():
        kind, *notes = typing.get_args(one)
        yield from _with_json(f"{name} {notes[0].name}", kind)


def test_every_command_with_json_has_a_section():
    wanted = {
        line
        for name in commands.COMMANDS
        for line in _with_json(name, commands.command_class(name))
    }
    known = {re.sub(r" [A-Z][A-Z.a-z]*(?= )", "", section) for section in SECTIONS}
    assert known == wanted | {"export --csv"}
    assert set(PRINTED) == set(SECTIONS)
