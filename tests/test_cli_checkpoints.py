"""Checkpoints on the command line: shown, exported, raced, and found again by their digests."""

import json

import numpy as np
import pytest

from league.agents import checkpoint
from league.agents.checkpoint import Card
from league.cli.race import entries, labels
from league.sim.config import SensorConfig

SHORT = ["--laps", "1", "--solver", "planar"]


@pytest.fixture
def blind(tmp_path):
    """Return a factory of checkpoints that see nothing and drive straight on, at some speed."""

    def save(name: str, seed: int = 0):
        card = Card(name="blind", sensors=SensorConfig(), created="2026-01-01", steps=1234)
        draw = np.random.default_rng(seed)
        weights = {
            part: draw.normal(0.0, 0.01, shape).astype(np.float32)
            for part, shape in card.weight_shapes.items()
        }
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        checkpoint.save(path, checkpoint.Checkpoint(card, weights))
        return path

    return save


def test_card_is_shown_as_a_table_and_as_json(league, blind):
    path = blind("a.pt")
    code, out, err = league("card", "a.pt")
    assert (code, err) == (0, "")
    assert "blind" in out
    assert "1,234 decisions" in out
    code, out, _ = league("card", "a.pt", "--json")
    answer = json.loads(out)
    assert answer["card"]["name"] == "blind"
    assert answer["digest"] == checkpoint.load(path).digest


def test_export_writes_next_to_the_checkpoint_or_to_out(league, blind, tmp_path):
    pytest.importorskip("onnx")
    blind("a.pt")
    code, out, _ = league("export", "a.pt")
    assert code == 0
    assert "a.onnx" in out
    assert (tmp_path / "a.onnx").stat().st_size > 1000
    code, _, _ = league("export", "a.pt", "--onnx", "b.onnx")
    assert (tmp_path / "b.onnx").read_bytes() == (tmp_path / "a.onnx").read_bytes()


@pytest.mark.parametrize(
    ("words", "written"),
    [
        ("a.pt", "a.onnx"),
        ("a.pt --onnx", "a.onnx"),
        ("--onnx a.pt", "a.onnx"),
        ("a.pt --onnx b.onnx", "b.onnx"),
        ("--onnx b.onnx a.pt", "b.onnx"),
        ("a.pt --onnx=b.onnx", "b.onnx"),
    ],
)
def test_onnx_is_written_whether_its_flag_has_a_value_or_none(
    league, blind, tmp_path, words, written
):
    pytest.importorskip("onnx")
    blind("a.pt")
    code, out, err = league("export", *words.split())
    assert (code, err) == (0, "")
    assert written in out
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["a.pt", written])


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        ("--onnx", "nothing was named to export"),
        ("a.pt --onnx b.onnx c.onnx", "would write b.onnx and c.onnx: give one file"),
        ("a.pt --onnx a.pt", "would write a.pt: give one file"),
        ("--onnx --csv x.csv", "a checkpoint was named together with --csv"),
    ],
)
def test_onnx_files_that_make_no_sense_are_refused_in_one_sentence(league, blind, words, reason):
    path = blind("a.pt")
    before = path.read_bytes()
    code, out, err = league("export", *words.split())
    assert (code, out) == (2, "")
    assert reason in err
    assert err.count("\n") == 1
    assert path.read_bytes() == before


def test_policy_is_raced_and_shown_by_its_files_name(league, blind):
    path = blind("a.pt")
    code, out, _ = league("race", "a.pt", "centerline", *SHORT, "--replay", "x.race", "--json")
    answer = json.loads(out)
    assert code == 0
    policy, scripted = answer["spec"]["entries"]
    assert policy == {"name": "a", "digest": checkpoint.load(path).digest, "path": "a.pt"}
    assert scripted == {"name": "centerline", "digest": "", "path": ""}
    assert {car["name"] for car in answer["order"]} == {"a", "centerline"}


def test_race_is_verified_with_the_policy_it_was_driven_by(league, blind, tmp_path):
    path = blind("a.pt")
    league("race", "a.pt", *SHORT, "--replay", "x.race")
    assert league("verify", "x.race")[0] == 0
    path.rename(tmp_path / "elsewhere.pt")
    code, _, err = league("verify", "x.race")
    assert code == 2
    assert checkpoint.load(tmp_path / "elsewhere.pt").digest[:12] in err
    assert "--policies" in err
    assert err.count("\n") == 1
    assert league("verify", "x.race", "--policies", "elsewhere.pt")[0] == 0
    blind("a.pt", seed=1)  # another policy of the same name
    code, _, err = league("verify", "x.race")
    assert code == 2
    assert "--policies" in err
    assert err.count("\n") == 1


def test_policy_is_evaluated_under_its_files_name(league, blind):
    blind("a.pt")
    code, out, _ = league("evaluate", "a.pt", *SHORT, "--episode", "--json")
    answer = json.loads(out)
    assert code == 0
    assert answer["driver"] == "a"
    assert answer["trials"][0]["status"] == "off_track"


def test_files_of_one_name_are_shown_with_their_folders(blind):
    assert labels(["runs/x/best.pt", "centerline", "runs/y/best.pt", "last.pt"]) == [
        "x/best",
        "centerline",
        "y/best",
        "last",
    ]
    assert labels(["best.pt", "best.pt"]) == ["best", "best"]
    one, other = blind("x/best.pt"), blind("y/best.pt", seed=1)
    found = entries([str(one), str(other)])
    assert [entry["name"] for entry in found] == ["x/best", "y/best"]
    assert found[0]["digest"] != found[1]["digest"]


@pytest.mark.parametrize("command", ["card", "export", "evaluate", "race"])
@pytest.mark.parametrize("content", [None, b"", b"PK not a checkpoint"])
def test_file_that_is_no_checkpoint_is_refused_in_one_sentence(league, tmp_path, command, content):
    if content is not None:
        (tmp_path / "a.pt").write_bytes(content)
    before = sorted(path.name for path in tmp_path.iterdir())
    code, out, err = league(command, "a.pt")
    assert (code, out) == (2, "")
    assert err.startswith("league: ")
    assert err.count("\n") == 1
    assert "a.pt" in err
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_policies_of_the_garage_are_named_everywhere(league, tmp_path):
    assert "rookie" in league("card", "rookie")[1]
    assert league("export", "rookie")[0] == 0
    assert (tmp_path / "rookie.onnx").exists()
    made = ("--solver", "planar", "--laps", "1", "--max-time-s", "0.6")
    assert league("init", "--anchors", "centerline", *made)[0] == 0
    code, out, _ = league("gauntlet", "rookie", "--workers", "1", "--json")
    assert code == 0 and json.loads(out)["against"][0][0] == "centerline"
    raced = ("--heats", "1", "--workers", "1")
    code, out, _ = league("compare", "novice", "rookie", *raced)
    assert code == 0 and "whether rookie is better than novice" in out
    code, out, _ = league("submit", "rookie", "--owner", "me")
    assert code == 0 and "rookie by me" in out
    # An entry comes before a policy of the same name.
    assert league("submit", "racer", "--owner", "me", "--name", "novice")[0] == 0
    code, _, err = league("compare", "novice", "racer", *raced)
    assert code == 2 and "novice and racer are the same driver" in err
    code, _, err = league("card", "blocker")
    assert code == 2 and "scripted driver" in err
