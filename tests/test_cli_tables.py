"""Tables of every command in 60 columns: names of 24 characters are whole, and no text is cut."""

from __future__ import annotations

import json
import sqlite3

import pytest

from league.agents import checkpoint
from league.cli import main, tables
from tests.agents.trained import make_checkpoint
from tests.matchmaking.season_kit import new_league, raced, submitted

NAMES = ("unbroken_name_24_letters", "another_name_24_letters_")
OWNERS = ("somebody_with_24_letters", "who_has_24_letters_, too")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Return the folder of a league of long names, of a replay of them and of checkpoints."""
    folder = tmp_path_factory.mktemp("long")
    with new_league(f"sqlite:///{folder / 'league.db'}") as store:
        for name, owner in zip(NAMES, OWNERS, strict=True):
            submitted(store, name, seed=NAMES.index(name), owner=owner, senses="blind")
            checkpoint.save(folder / f"{name}.pt", make_checkpoint("blind", name=name))
            store.tokens.create(owner, ["submit", "worker"])
        raced(store, 12)
    return folder


@pytest.fixture
def printed(folder, monkeypatch, capsys):
    """Return what a command prints in 60 columns."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", "60")

    def run(command: str) -> str:
        assert main(command.split()) == 0
        return capsys.readouterr().out

    return run


@pytest.mark.parametrize(
    "command",
    [
        "standings",
        "entries",
        "heats",
        "heat 8",
        f"show {NAMES[0]}",
        "h2h",
        "token list",
        f"gauntlet {NAMES[0]}.pt --workers 1 --opponents 3",
        f"race {NAMES[0]}.pt {NAMES[1]}.pt --laps 1 --solver planar --seed 1 --replay none",
    ],
)
def test_names_of_24_characters_are_whole_in_60_columns(printed, command):
    rows = _rows(printed(command))
    shown = OWNERS if command == "token list" else NAMES[command.startswith("show") :]
    for name in shown:
        of_it = [row for row in rows if name[:12] in row]
        assert of_it and all(name in row for row in of_it), rows
    assert "…" not in "".join(rows) and max(map(len, rows)) <= 60, rows


def _rows(text: str) -> list[str]:
    """Return the heads and lines of all tables in what a command printed."""
    lines = text.splitlines()
    rules = [k for k, line in enumerate(lines) if line.strip() and not line.strip(" ─")]
    ends = [next(k for k in range(rule, len(lines)) if not lines[k].strip()) for rule in rules]
    shown = [one for k, end in zip(rules, ends, strict=True) for one in lines[k - 1 : end]]
    return [line for line in shown if line.strip(" ─")]


def test_columns_that_have_no_room_are_named_below_the_table(printed, monkeypatch):
    text = printed("standings")
    assert "In a wider terminal also: owner, ranks, DNF" in text
    assert OWNERS[0] not in text and "provisional" not in text
    monkeypatch.setenv("COLUMNS", "120")
    wide = printed("standings")
    assert "wider terminal" not in wide and OWNERS[0] in wide


@pytest.mark.parametrize("width", [40, 60, 80, 120])
def test_a_name_too_long_for_a_line_wraps_and_none_of_it_is_lost(monkeypatch, capsys, width):
    monkeypatch.setenv("COLUMNS", str(width))
    name = "".join(chr(0x4E00 + k) if k % 7 == 0 else chr(97 + k % 26) for k in range(100))
    heads = ("entry", "state", "races", "owner")
    tables.table("Names", heads, [(name, "provisional", "12345", "o" * 50)], "owner")
    lines = capsys.readouterr().out.splitlines()
    body = [line for line in lines[4:] if line.strip() and "wider" not in line]
    assert "".join(line.split()[0] for line in body) == name
    assert "12345" in body[0] and "provisional" in body[0]
    assert "…" not in "".join(lines)


def test_states_and_kinds_are_the_same_words_everywhere(printed, folder, monkeypatch):
    copy = folder / "states.db"
    with sqlite3.connect(folder / "league.db") as there, sqlite3.connect(copy) as here:
        there.backup(here)
        here.execute(f"UPDATE entries SET state = 'ranked' WHERE name != '{NAMES[1]}'")
    monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{copy}")
    monkeypatch.setenv("COLUMNS", "120")
    states = {"centerline": "ranked", NAMES[0]: "ranked", NAMES[1]: "placement"}
    kinds = {"centerline": "anchor", NAMES[0]: "policy", NAMES[1]: "policy"}
    for entry in json.loads(printed("entries --json")):
        assert entry["state"] == states[entry["name"]]
        assert ("anchor" if entry["anchor"] else entry["kind"]) == kinds[entry["name"]]
    for row in json.loads(printed("standings --json"))["entries"]:
        assert (row["state"], row["anchor"]) == (states[row["name"]], row["name"] == "centerline")
    listed = {words[0]: words for words in map(str.split, _rows(printed("entries")))}
    rated = {words[1]: words for words in map(str.split, _rows(printed("standings")))}
    for name, state in states.items():
        assert state in listed[name] and kinds[name] in listed[name]
        assert state in rated[name] and "anchor" not in rated[name]
        assert ("*" in rated[name]) == (kinds[name] == "anchor")
        assert f"{state}, {kinds[name]}" in printed(f"show {name}")
        assert json.loads(printed(f"show {name} --json"))["entry"]["state"] == state


def test_texts_of_tables_that_leave_nothing_out_take_the_whole_width(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "60")
    tables.table("Drivers", ("name", "how it drives"), [("racer", "word " * 30)])
    lines = capsys.readouterr().out.splitlines()
    assert 55 <= max(len(line.rstrip()) for line in lines[4:]) <= 60


def test_a_grid_of_eight_names_takes_the_width_that_is_there(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "100")
    grid = " - ".join(f"driver_number_{k}" for k in range(8))
    tables.table("Heats", ("heat", "grid", "state"), [("17", grid, "done")], "state")
    lines = [line for line in capsys.readouterr().out.splitlines()[4:] if line.strip()]
    assert len(lines) == 2 and "done" in lines[0]
