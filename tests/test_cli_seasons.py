"""`league season` and `league cup`, as a person types them."""

from __future__ import annotations

import json

import pytest

from league.cli import main
from league.matchmaking.store import Store
from tests.matchmaking import season_kit
from tests.matchmaking.season_kit import new_league


@pytest.fixture
def url(tmp_path, monkeypatch):
    url = f"sqlite:///{tmp_path / 'league.db'}"
    monkeypatch.setenv("LEAGUE_URL", url)
    new_league(url, anchors=("centerline", "racing_line", "cautious")).close()
    return url


def raced(url, heats):
    with Store(url) as store:
        season_kit.raced(store, heats, same_owner=True)


def test_a_league_goes_from_season_to_season(url, capsys):
    assert main(["season"]) == 0
    assert "has no seasons: all its races are one" in capsys.readouterr().out
    raced(url, 6)
    assert main(["season", "start", "Spring", "--division-size", "4"]) == 0
    assert "Spring has begun" in capsys.readouterr().out
    assert main(["season", "end"]) == 0
    assert "Spring has ended; its standings have the hash" in capsys.readouterr().out
    assert main(["run", "--workers", "1", "--plain"]) == 0
    assert "The season 'Spring' is over: begin the next one" in capsys.readouterr().out
    assert main(["season", "start"]) == 0
    assert main(["season", "--json"]) == 0
    documents = json.loads(capsys.readouterr().out.split("races it.\n", 1)[1])
    assert [one["season"]["name"] for one in documents] == ["Spring", "Season 2"]
    assert documents[0]["frozen"]["standings"]["races"] == 12
    assert documents[1]["frozen"] is None
    assert main(["season"]) == 0
    assert "Season 2" in capsys.readouterr().out
    with Store(url) as store:
        assert store.verify().mismatches == []


def test_a_cup_is_begun_raced_and_shown(url, capsys):
    assert main(["cup"]) == 2
    assert "no cup yet: begin one with `league cup start`" in capsys.readouterr().err
    assert main(["cup", "start"]) == 2
    assert "rated entrants, and this league has 0 for it" in capsys.readouterr().err
    assert main(["cup", "start", "May Cup", "--anchors"]) == 0
    assert "May Cup has begun with 3 entrants" in capsys.readouterr().out
    assert main(["cup"]) == 0
    assert "Not over yet" in capsys.readouterr().out
    raced(url, 4)
    assert main(["cup", "show", "May Cup"]) == 0
    out = capsys.readouterr().out
    assert "May Cup: Final" in out and "Winner: " in out
    assert main(["cup", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert [len(stage["heats"]) for stage in document["stages"]] == [3, 1]
    assert len(document["order"]) == 3


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["season", "end", "Spring"], "takes no name, 'Spring' was given"),
        (["season", "end"], "no entry"),
        (["season", "start", "", "--division-size", "1"], "give 2 or more"),
        (["season", "start", "\u202e"], "the name of a season is"),
        (["cup", "show", "--anchors"], "--anchors is for `league cup start`"),
    ],
)
def test_what_cannot_be_is_refused_in_a_sentence(url, arguments, said, capsys):
    if arguments == ["season", "end"]:
        with Store(url) as store:
            store.move({entry.id: "retired" for entry in store.entries()})
    assert main(arguments) == 2
    assert said in capsys.readouterr().err
    with Store(url) as store:
        assert store.seasons() == [] and store.cups() == []
