"""The league's commands, as a person types them: a small league from init to export."""

from __future__ import annotations

import csv
import io
import json
import re
import sqlite3
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from league.cli import main, tables
from tests.matchmaking import leagues


@pytest.fixture(scope="module")
def league(tmp_path_factory) -> Path:
    """Return the folder of a league in which two entries have raced for a moment."""
    from league.matchmaking.store import Store
    from tests.matchmaking.season_kit import raced, submitted

    folder = tmp_path_factory.mktemp("league")
    url = f"sqlite:///{folder / 'league.db'}"
    made = ["init", "--league", url, "--laps", "1", "--solver", "planar", "--max-time-s", "0.6"]
    assert main([*made, "--anchors", "centerline"]) == 0
    with Store(url) as store:
        for number, name in enumerate(("ann", "bob")):
            submitted(store, name, seed=number, senses="blind")
        raced(store, 10)
    return folder


@pytest.fixture
def printed(league, monkeypatch, capsys):
    """Return what a command prints, given that it ends well."""
    monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{league / 'league.db'}")
    monkeypatch.setenv("COLUMNS", "100")

    def run(*command: str, code: int = 0) -> str:
        capsys.readouterr()
        assert main(list(command)) == code
        return capsys.readouterr().out

    return run


def test_standings_show_everybody_with_an_interval(printed):
    text = printed("standings")
    assert all(name in text for name in ("ann", "bob", "centerline", "±"))
    table = json.loads(printed("standings", "--json"))
    assert [row["rank"] for row in table["entries"]] == [1, 2, 3]
    for row in table["entries"]:  # ratings are relative to the anchor, so its own is exact
        assert row["low95"] < row["elo"] < row["high95"] or row["anchor"]
    assert len(json.loads(printed("standings", "--json", "--top", "1"))["entries"]) == 1


def test_standings_and_show_tell_races_not_finished_and_clean_laps(printed):
    table = json.loads(printed("standings", "--json"))
    for row in table["entries"]:
        assert row["unfinished"] == 1.0 and row["best_laps_s"] == row["clean_laps_s"] == {}
    assert "DNF" in printed("standings") and "clean lap" in printed("standings")
    assert "not finished: 100 %, best clean lap: none" in printed("show", "ann")
    assert "the fastest one of a race without a mistake" in printed("standings")


def test_standings_fit_80_columns(printed, league, monkeypatch, capsys):
    from league.cli.season.standings import standings_table
    from league.matchmaking import standings
    from league.matchmaking.store import Store

    monkeypatch.setenv("COLUMNS", "80")
    with Store(f"sqlite:///{league / 'league.db'}") as store:
        table = standings.of(store)
    wide = {"name": "n" * 24, "owner": "o" * 24, "state": "provisional", "anchor": False}
    far = {"listed_by": -123.0, "rank": 10, "best_rank": 10, "worst_rank": 99, "races": 12345}
    laps = {"connected": False, "clean_laps_s": {"reinvent_2018": 59.0}}
    rows = tuple(replace(row, **wide, **far, **laps) for row in table.rows)
    tables.console().print(standings_table(replace(table, rows=rows)))
    text = capsys.readouterr().out
    assert max(map(len, text.splitlines())) <= 80 and "…" not in text and "provisional" in text
    assert text.count("n" * 24) == 3 and "clean lap" in text


def test_standings_show_the_value_they_are_sorted_by_and_the_states_of_entries(printed):
    rows = json.loads(printed("standings", "--json"))["entries"]
    listed = [row["listed_by"] for row in rows]
    assert listed == sorted(listed, reverse=True)
    for row in rows:
        uncertain = row["elo"] - 2 * row["sd"]
        assert row["listed_by"] == pytest.approx(uncertain if row["provisional"] else row["elo"])
    text = printed("standings")
    assert all(f" {value:.0f} " in text for value in listed)
    assert text.count("placement") == 3  # as in `league entries`; one of them is an anchor
    assert re.search(r"centerline .* 1000 ±0 +\*", text) and "* anchor" in text


def test_heats_fit_80_columns(printed, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    text = printed("heats", "--limit", "100")
    assert "validation" in text and "…" not in text and max(map(len, text.splitlines())) <= 80


@pytest.mark.parametrize(
    ("command", "heads"),
    [
        ("standings", "entry Elo by state races clean lap placement"),
        ("entries", "name owner state id kind submitted placement"),
        ("heats --limit 100", "heat grid purpose state track validation rated reinvent_2018"),
        ("heat 5", "entry slot laps time off crash passed"),
        ("show ann", "entry owner Elo races points promised residual"),
        ("h2h", "entry 1 2 3"),
        ("history ann", "heat races Elo, between"),
    ],
)
def test_tables_of_sixty_columns_have_all_their_words_whole(printed, monkeypatch, command, heads):
    monkeypatch.setenv("COLUMNS", "60")
    text = printed(*command.split())
    assert "…" not in text
    assert set(heads.split()) <= set(text.split()), text
    assert any(name in text.split() for name in ("ann", "centerline")), text


def test_matrix_shows_as_many_entries_as_there_is_room_for(printed, monkeypatch):
    monkeypatch.setenv("COLUMNS", "36")
    assert printed("h2h").splitlines()[2].split() == ["entry", "1", "2"]
    monkeypatch.setenv("COLUMNS", "60")
    assert printed("h2h").splitlines()[2].split() == ["entry", "1", "2", "3"]


def test_a_rating_apart_from_the_anchor_has_its_sign_explained(printed, tmp_path):
    url = f"sqlite:///{tmp_path / 'new.db'}"
    printed("init", "--league", url, "--anchors", "centerline", "cautious")
    text = printed("standings", "--league", url)
    assert "~" in text and "no chain of races leads to the anchor" in text


def test_a_heat_in_quarantine_shows_both_results_and_can_be_raced_again(printed, league):
    from league.matchmaking.store import HeatOutcome, RaceOutcome, Store

    copy = league / "disputed.db"
    with sqlite3.connect(league / "league.db") as there, sqlite3.connect(copy) as here:
        there.backup(here)
    url = f"sqlite:///{copy}"
    with Store(url) as store:
        record = next(r for r in store.heats(("done",)) if r.heat.purpose == "rated")
        results = store.results(record.number)
        lie = [RaceOutcome(r.places[::-1], {**r.result, "race_s": 0.0}) for r in results]
        store.complete("liar", [HeatOutcome(record.heat.key, tuple(lie))])
    number, on = str(record.number), ("--league", url)
    shown = printed("heat", number, *on)
    assert f"by {results[0].worker}" in shown and "by liar" in shown
    assert results[0].hash[:12] in shown and f"league retry {number}" in shown
    assert "waits to be raced again" in printed("retry", number, *on)
    with Store(url) as store:
        store.claim("third", 1)
        truth = tuple(RaceOutcome(r.places, r.result) for r in results)
        store.complete("third", [HeatOutcome(record.heat.key, truth)])
    assert "by liar, REJECTED" in printed("heat", number, *on)
    rejected = [
        r["rejected"] for r in json.loads(printed("heat", number, "--json", *on))["results"]
    ]
    assert sorted(rejected) == [False, False, True, True]


def test_entries_are_listed_with_their_states(printed):
    entries = json.loads(printed("entries", "--json"))
    assert [entry["name"] for entry in entries] == ["centerline", "ann", "bob"]
    assert {entry["state"] for entry in entries} == {"placement"}
    assert "anchor" in printed("entries")


def test_an_entry_is_shown_with_its_records(printed):
    shown = json.loads(printed("show", "ann", "--json"))
    assert shown["standing"]["name"] == "ann"
    assert sum(one["races"] for one in shown["against"]) == shown["standing"]["races"] > 0
    assert "Against" in printed("show", "ann")


def test_head_to_head_of_nobody_in_particular_is_the_matrix_with_residuals(printed, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    pairs = json.loads(printed("h2h", "--json"))
    assert len(pairs) == 3 and {pair["one"] for pair in pairs} <= {"ann", "bob", "centerline"}
    met = [pair for pair in pairs if pair["races"]]
    assert met and all(0 <= pair["points"] <= pair["races"] for pair in met)
    text = printed("h2h")
    for pair in met:
        assert f"{pair['points']:g}/{pair['races']}" in text
        assert f"{pair['races'] - pair['points']:g}/{pair['races']}" in text
        assert f"{pair['residual']:+.1f}" in text
    assert "…" not in text


def test_head_to_head_tells_the_difference_with_its_interval(printed):
    found = json.loads(printed("h2h", "ann", "centerline", "--json"))
    gap = found["difference"]
    assert gap["low95"] < gap["elo"] < gap["high95"] and found["heats"]
    assert "stronger one with probability" in printed("h2h", "ann", "centerline")


def test_history_ends_with_the_present_rating(printed):
    moments = json.loads(printed("history", "ann", "--json"))
    (row,) = (
        r for r in json.loads(printed("standings", "--json"))["entries"] if r["name"] == "ann"
    )
    assert moments[-1]["elo"] == pytest.approx(row["elo"])
    assert "over time" in printed("history", "ann")


def test_a_heat_is_shown_with_its_seeds_and_classification(printed):
    heats = json.loads(printed("heats", "--state", "done", "--json"))
    assert len(heats) == 10 and all(heat["state"] == "done" for heat in heats)
    number = str(heats[-1]["number"])
    heat = json.loads(printed("heat", number, "--json"))
    assert len(heat["seeds"]) == len(heat["results"]) == 2
    assert "Race 2 on reinvent_2018, seed" in printed("heat", number)
    assert printed("heat", heat["key"][:12]) == printed("heat", number)
    alone = next(str(heat["number"]) for heat in heats if len(heat["races"]) == 1)
    assert f"league view {number}   (the second race: --race 2)\n" in printed("heat", number)
    assert printed("heat", alone).endswith(f"Watch it: league view {alone}\n")


def test_a_race_of_the_league_can_be_watched(printed, tmp_path, capsys):
    number = str(json.loads(printed("heats", "--state", "done", "--json"))[-1]["number"])
    path = tmp_path / "heat.race"
    assert str(path) in printed("view", number, "--race", "2", "--save", str(path))
    assert path.stat().st_size > 100
    assert main(["view", str(path), "--race", "2"]) == 2
    assert "is one race: give --race with the number of a" in capsys.readouterr().err
    waiting = str(json.loads(printed("heats", "--state", "planned", "--json"))[-1]["number"])
    assert main(["view", waiting]) == 2
    assert f"heat {waiting} has not been raced yet (planned)" in capsys.readouterr().err
    recording = tmp_path / "heat.rrd"
    printed("view", number, "--rrd", str(recording), "--no-cameras")
    assert recording.stat().st_size > 1000


def test_an_audit_runs_heats_again_and_finds_that_they_agree(printed):
    waiting = json.loads(printed("heats", "--state", "planned", "--json", "--limit", "100"))
    text = printed("audit", "--sample", "1%", "--seed", "1", "--workers", "1")
    assert "1 heat was run again: 1 agree, 0 differ." in text
    assert waiting == json.loads(printed("heats", "--state", "planned", "--json", "--limit", "100"))
    assert printed("audit", "--sample", "0%", code=2) == ""  # refused before anything is computed


def test_an_audit_recomputes_all_races_whatever_is_run_again(printed, league, tmp_path):
    copy = tmp_path / "changed.db"
    with sqlite3.connect(league / "league.db") as there, sqlite3.connect(copy) as here:
        there.backup(here)
        here.execute("UPDATE entries SET anchor = 1 - anchor")
        here.execute("DELETE FROM races WHERE number = 1")
    command = ("audit", "--sample", "1%", "--workers", "1", "--league", f"sqlite:///{copy}")
    text = printed(*command, code=1)
    assert text.count("what it records was changed") == 3  # ann, bob, centerline
    assert "race 1: the standings miss it" in text and "4 mismatches." in text
    assert "the ledger no longer has the record xyz" in printed(*command, "--head", "xyz", code=1)


def test_an_audit_without_the_present_rules_says_so(printed, league, tmp_path):
    copy = tmp_path / "changed.db"
    with sqlite3.connect(league / "league.db") as there, sqlite3.connect(copy) as here:
        there.backup(here)
        here.execute("UPDATE league SET ruleset = 9")
    text = printed("audit", "--league", f"sqlite:///{copy}", code=1)
    assert text.startswith("the present rules are missing\n") and "1 mismatch." in text


def test_an_export_has_a_line_for_each_car(printed, tmp_path):
    rows = list(csv.DictReader(io.StringIO(printed("export", "--csv", "-"))))
    done = json.loads(printed("heats", "--state", "done", "--json", "--limit", "1000"))
    races = sum(len(heat["races"]) for heat in done if not heat["audits"])
    assert len(rows) == 2 * races
    assert {row["entry"] for row in rows} == {"ann", "bob", "centerline"}
    printed("export", "--json", str(tmp_path / "league.json"))
    document = json.loads((tmp_path / "league.json").read_text())
    assert len(document["races"]) == len(rows) and document["rules"]["laps"] == 1


def test_an_export_has_neither_formulas_nor_rejected_results_nor_everything_in_memory(
    printed, league, tmp_path, monkeypatch
):
    from league.cli.season import heats
    from league.matchmaking.store import HeatOutcome, RaceOutcome, Store

    copy = tmp_path / "formula.db"
    with sqlite3.connect(league / "league.db") as there, sqlite3.connect(copy) as here:
        there.backup(here)
        here.execute("UPDATE entries SET name = '=1+1' WHERE name = 'ann'")
    url = f"sqlite:///{copy}"
    before = printed("export", "--csv", "-", "--league", url)
    assert {row["entry"] for row in csv.DictReader(io.StringIO(before))} == {
        "'=1+1", "bob", "centerline",
    }  # fmt: skip
    with Store(url) as store:
        record = next(r for r in store.heats(("done",)) if r.heat.purpose == "rated")
        truth = tuple(RaceOutcome(r.places, r.result) for r in store.results(record.number))
        lie = tuple(replace(race, places=race.places[::-1]) for race in truth)
        store.complete("liar", [HeatOutcome(record.heat.key, lie)])
        store.retry(record.heat.key)
        store.claim("third")
        store.complete("third", [HeatOutcome(record.heat.key, truth)])
    sizes = []
    read = Store.results
    monkeypatch.setattr(Store, "results", lambda *a: sizes.append(len(a) - 1) or read(*a))
    monkeypatch.setattr(heats, "EXPORTED", 3)
    assert printed("export", "--csv", "-", "--league", url) == before
    assert max(sizes) == 3 and len(sizes) > 3
    written = []
    monkeypatch.setattr(Store, "results", lambda *a: written.append(sys.stdout.tell()) or read(*a))
    document = json.loads(printed("export", "--json", "-", "--league", url))
    assert 0 < written[0] < written[-1]  # it begins before the last results are read
    assert len(document["races"]) == before.count("\n") - 1
    assert document["races"][0].keys() == set(heats.COLUMNS)


def test_a_gauntlet_places_a_checkpoint_and_keeps_nothing(printed, league):
    from league.agents import checkpoint
    from tests.agents.trained import make_checkpoint

    path = league / "new.pt"
    checkpoint.save(path, make_checkpoint("blind", seed=9, name="new"))
    before = printed("entries"), printed("heats")
    found = json.loads(printed("gauntlet", str(path), "--workers", "1", "--json"))
    assert len(found["against"]) == 3 and all(races == 2 for _, races, _ in found["against"])
    assert 1 <= found["rank"] <= 4 and found["low95"] < found["elo"] < found["high95"]
    # Six races: the 95 % interval of a player at p = 0.5 all along would be +-280 Elo without a
    # prior, and no field of three is known well enough to make it less than +-100.
    assert found["provisional"] and found["high95"] - found["low95"] > 200
    assert found["best_rank"] <= found["rank"] <= found["worst_rank"]
    assert (printed("entries"), printed("heats")) == before


def test_a_comparison_stops_when_it_is_sure_or_out_of_heats(printed):
    wish = ("--heats", "3", "--workers", "1", "--json")
    found = json.loads(printed("compare", "ann", "centerline", *wish))
    assert found["heats"] == 3 and found["decision"] == "undecided"


def test_a_comparison_reports_its_progress_and_a_verdict_without_a_terminal(
    printed, capsys, monkeypatch
):
    from league.cli.season import heats
    from league.matchmaking.ratings import sprt

    monkeypatch.setattr(heats, "PRINT_EVERY_S", 0.0)
    assert main(["compare", "ann", "centerline", "--heats", "2", "--workers", "1"]) == 0
    out, err = capsys.readouterr()
    assert [line.split(":")[0] for line in err.splitlines()] == ["heat 1", "heat 2"]
    assert "Not decided after 2 heats: whether centerline is better than ann." in out
    settings = sprt.SequentialSettings()
    for score, sentence in ((1.0, "Yes, b is better than a."), (0.0, "No, b is not better than a")):
        result = sprt.compare(np.full(40, score), settings)
        assert heats.Compare("a", "b")._verdict(result, "a", "b").startswith(sentence)


def test_a_wrong_name_gives_the_nearest_ones(printed, capsys):
    assert printed("show", "centreline", code=2) == ""
    main(["show", "centreline"])
    assert "nearest: centerline" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("command", "sentence"),
    [
        (["audit", "--sample", "some"], "--sample 'some' is no share"),
        (["audit", "--sample", "0%"], "more than 0"),
        (["run", "--heats", "0"], "give 1 or more"),
        (["heats", "--limit", "0"], "give 1 or more"),
        (["standings", "--top", "-3"], "give 1 or more"),
        (["history", "ann", "--points", "0"], "give 1 or more"),
        (["run", "--workers", "-1"], "give 1 to "),
        (["audit", "--workers", "-1"], "give 1 to "),
        (["compare", "ann", "bob", "--elo0", "9", "--elo1", "1"], "elo1 must be the larger"),
        (["init", "--name", ""], "given no name"),
        (["retry", "1"], "only heats in error, in quarantine"),
        (["view", "999"], "no heat of this league"),
        (["view", "1", "--race", "7"], "no replay of race 7"),
        (["h2h", "ann", "ann"], "name two entries"),
        (["h2h", "ann"], "only 'ann' was given: name two entries"),
        (["h2h", "--top", "1"], "--top 1: give 2 or more"),
        (["compare", "ann", "ann"], "the same driver"),
        (["submit", "nobody"], "there is no driver 'nobody'"),
        (["submit", "blocker", "--owner", ""], "an owner's name is ''"),
        (["export"], "nothing was named to export"),
        (["init"], "there is a league"),
        (["init", "--cars", "1"], "--cars 1: a league's races have 2 to 8 cars"),
        (["init", "--cars", "9"], "have 2 to 8"),
        (["init", "--anchors", "fast"], "no scripted driver 'fast'"),
    ],
)
def test_wishes_that_cannot_be_met_are_refused_in_a_sentence(printed, capsys, command, sentence):
    printed(*command, code=2)
    main(command)
    err = capsys.readouterr().err
    assert sentence in err and err.count("\n") == 1


def test_without_a_league_its_commands_say_how_to_make_one(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{tmp_path / 'none.db'}")
    assert main(["standings"]) == 2
    assert "league init" in capsys.readouterr().err


def test_a_league_is_made_with_the_format_asked_for(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{tmp_path / 'league.db'}")
    assert main(["init", "--format", "pursuit", "--solver", "planar", "--laps", "1"]) == 0
    assert "1 lap, 2 cars, reinvent_2018, pursuit" in capsys.readouterr().out
    assert main(["run", "--workers", "1", "--heats", "1"]) == 0
    assert main(["export", "--json", "-"]) == 0
    out = capsys.readouterr().out
    assert json.loads(out[out.index("{") :])["rules"]["format"] == "pursuit"


def test_a_run_races_what_was_submitted_and_says_what_it_did(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("LEAGUE_URL", f"sqlite:///{tmp_path / 'league.db'}")
    made = ["init", "--laps", "1", "--solver", "planar", "--max-time-s", "0.6", "--anchors"]
    assert main([*made, "centerline"]) == 0
    assert main(["run", "--workers", "1", "--heats", "2"]) == 0
    assert "nothing to race" in capsys.readouterr().out
    from league.agents import checkpoint
    from tests.agents.trained import make_checkpoint

    checkpoint.save(tmp_path / "a.pt", make_checkpoint("blind", name="a"))
    assert main(["submit", str(tmp_path / "a.pt"), "--owner", "ann"]) == 0
    assert "already" not in capsys.readouterr().out
    assert main(["submit", str(tmp_path / "a.pt"), "--owner", "ann"]) == 0
    assert "a by ann is entered already: entry" in capsys.readouterr().out
    assert main(["submit", str(tmp_path / "a.pt"), "--owner", "ann", "--name", "b"]) == 0
    assert "entered already, as a; b is not a new entry" in capsys.readouterr().out
    assert main(["run", "--workers", "1", "--heats", "3"]) == 0
    out = capsys.readouterr().out
    assert "(validation) a - a" in out and "(rated)" in out and "3 heats, 4 races" in out
    assert main(["retire", "a"]) == 2
    assert "confirm with --yes" in capsys.readouterr().err
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("builtins.input", lambda question: "" if "no way back" in question else "y")
    assert main(["retire", "a"]) == 1
    assert "a stays placement" in capsys.readouterr().out
    assert main(["retire", "a", "--yes", "--reason", "tired"]) == 0
    assert "a is retired" in capsys.readouterr().out
    assert main(["retire", "a"]) == 0  # nothing is lost
    assert main(["submit", str(tmp_path / "a.pt"), "--owner", "ann"]) == 2
    assert "as a by ann, and retired: it cannot come back" in capsys.readouterr().err


def test_a_run_of_one_heat_says_so_in_the_singular(capsys):
    from league.cli.season.run import _print_tally
    from league.matchmaking.loop import Tally

    _print_tally(Tally(heats=1, races=1, failures=1), "")
    first, second = capsys.readouterr().out.splitlines()
    assert first.startswith("1 heat, 1 race, ") and second.startswith("Failed tries: 1; heats")


def test_upgrade_brings_an_older_league_up_to_date_and_makes_none(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["upgrade"]) == 2
    assert "there is no league" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
    assert main(["init", "--anchors", "centerline"]) == 0
    with sqlite3.connect("league.db") as database:
        for statement in leagues.FIRST_VERSION:
            database.execute(statement)
    assert main(["standings"]) == 2
    assert "bring it up to date with `league upgrade`" in capsys.readouterr().err
    assert main(["upgrade"]) == 0
    out = capsys.readouterr().out
    assert "version 0002: " in out and "version 0003: " in out and "is up to date" in out
    assert main(["standings"]) == 0
