"""Strangers' names are printed as they stand: no markup, no pictures, no links, no escapes."""

from __future__ import annotations

from pathlib import Path

import pytest

from league.agents import checkpoint
from league.cli import main, tables

CLOSING, LINKED, OWNER = "[/x]", "[link=e]:car:", "[/b]"
"""The first is an error where markup is read, the second a link and a picture."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """Return the folder of a league with entries of such names, and of their checkpoints."""
    from league.matchmaking import loop
    from league.matchmaking.loop import Dispatcher
    from league.matchmaking.pairing.matchmaker import Matchmaker
    from league.matchmaking.store import Store
    from tests.agents.trained import make_checkpoint
    from tests.matchmaking.season_kit import Here, submitted

    folder = tmp_path_factory.mktemp("names")
    url = f"sqlite:///{folder / 'league.db'}"
    made = ["init", "--league", url, "--laps", "1", "--solver", "planar", "--max-time-s", "0.6"]
    assert main([*made, "--name", CLOSING, "--anchors", "centerline"]) == 0
    with Store(url) as store:
        for number, name in enumerate((CLOSING, LINKED)):
            submitted(store, name, seed=number, senses="blind", owner=f"{OWNER}{number}")
        loop.run(store, Dispatcher(store, Here()), Matchmaker(store), heats=8)
    checkpoint.save(folder / "[x].pt", make_checkpoint("blind", name=LINKED))
    return folder


@pytest.fixture
def printed(folder, monkeypatch, capsys):
    """Return what a command prints on a terminal, given that it ends well."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{folder / 'league.db'}")
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("FORCE_COLOR", "1")  # links and colours are made on terminals only

    def run(*command: str) -> str:
        capsys.readouterr()
        assert main(list(command)) == 0
        return capsys.readouterr().out

    return run


@pytest.mark.parametrize(
    ("command", "names"),
    [
        (["entries"], (CLOSING, LINKED)),
        (["standings"], (CLOSING, LINKED)),
        (["heats", "--limit", "20"], (CLOSING, LINKED)),
        (["h2h"], (CLOSING, LINKED)),
        (["h2h", CLOSING, LINKED], (CLOSING, LINKED)),
        (["show", CLOSING], (CLOSING, LINKED)),
        (["show", LINKED], (CLOSING, LINKED)),
        (["history", CLOSING], (CLOSING,)),
        (["history", LINKED], (LINKED,)),
    ],
)
def test_names_of_entries_are_printed_as_they_stand(printed, command, names):
    text = printed(*command)
    assert all(name in text for name in names)
    assert "\x1b]8" not in text and "\N{AUTOMOBILE}" not in text


def test_owners_are_printed_as_they_stand(printed):
    assert f"{OWNER}1" in printed("entries")
    assert f"{OWNER}0" in printed("show", CLOSING)


def test_a_heats_grid_and_results_name_entries_as_they_stand(printed, folder):
    from league.matchmaking.store import Store

    with Store(f"sqlite:///{folder / 'league.db'}") as store:
        numbers = {
            name: store.heats(("done",), entries=[store.entry(name).number])[-1].number
            for name in (CLOSING, LINKED)
        }
    for name, number in numbers.items():
        assert name in printed("heat", str(number))


def test_a_cards_name_is_printed_as_it_stands(printed):
    text = printed("card", "[x].pt")
    assert LINKED in text and "[x].pt" in text and "\x1b]8" not in text


def test_a_file_whose_name_looks_like_markup_is_raced_and_evaluated_under_it(printed):
    short = ("--laps", "1", "--solver", "planar")
    assert "[x]" in printed("race", "[x].pt", *short, "--replay", "none")
    assert "[x]: time trial on" in printed("evaluate", "[x].pt", *short, "--episode")


def test_the_page_of_a_run_shows_names_as_they_stand(folder, monkeypatch, capsys, tmp_path):
    from league.cli.season.run import LivePage
    from league.matchmaking import loop
    from league.matchmaking.loop import Dispatcher
    from league.matchmaking.pairing.matchmaker import Matchmaker
    from league.matchmaking.store import Store
    from tests.matchmaking.season_kit import Here

    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setenv("COLUMNS", "100")
    copy = tmp_path / "league.db"
    copy.write_bytes((folder / "league.db").read_bytes())
    with Store(f"sqlite:///{copy}") as store:
        dispatcher = Dispatcher(store, Here())
        page = LivePage(store, dispatcher)
        with page.live:
            loop.run(store, dispatcher, Matchmaker(store), heats=4, watch=page.show)
    text = capsys.readouterr().out
    assert CLOSING in text and "\\[" not in text
    assert "\x1b]8" not in text and "\N{AUTOMOBILE}" not in text


def test_a_bar_describes_what_is_done_as_it_stands(monkeypatch, capsys):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with tables.progress() as progress:
        progress.add_task("[/x] :car:", total=1)
        progress.refresh()
    assert "[/x] :car:" in capsys.readouterr().err


def test_what_cannot_be_printed_is_spelled():
    assert tables.spelled("a\x1b[31m\u202e\tb\nc é") == "a\\x1b[31m\\u202e\\tb\nc é"


def test_a_reason_cannot_move_the_cursor(printed, folder, monkeypatch, tmp_path):
    copy = tmp_path / "league.db"
    copy.write_bytes((folder / "league.db").read_bytes())
    on = ("--league", f"sqlite:///{copy}")
    printed("retire", CLOSING, "--yes", "--reason", "red\x1b[2J", *on)
    assert "red\\x1b[2J" in printed("entries", *on)
    assert "red\\x1b[2J" in printed("show", CLOSING, *on)
