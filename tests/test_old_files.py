"""Files written before the modules and settings were renamed still open and mean the same."""

import gzip
import re
import tarfile
from pathlib import Path

import pytest

from league import replay
from league.agents import checkpoint
from league.cli import main
from league.matchmaking.store import Store
from league.training.config import read

DATA = Path(__file__).parent / "data"


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Return a function that runs a command in a folder with the old files."""
    with tarfile.open(DATA / "version_1.run.tar.xz") as archive:
        archive.extractall(tmp_path, filter="data")
    (tmp_path / "league.db").write_bytes(gzip.decompress((DATA / "version_1.db.gz").read_bytes()))
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LEAGUE_URL", "sqlite:///league.db")
    return lambda *arguments: main(list(arguments))


def test_an_old_policy_is_read_and_raced(run, capsys):
    policy = checkpoint.load("version_1.pt")
    assert policy.card.reward.name == "centerline"
    assert run("evaluate", "version_1.pt", "--laps", "1", "--track", "reinvent_2018") == 0


def test_an_old_run_is_resumed(run, capsys):
    more = ("--steps", "96", "--plain", "--no-tensorboard")
    assert run("train", "--resume", "--out", "version_1.pt", *more) == 0
    assert "96 decisions" in capsys.readouterr().out
    stored = read(Path("version_1.run")).train
    assert (stored.rules, stored.obstacles) == ("deepracer", None)
    history = Path("version_1.run/history.jsonl").read_text().splitlines()
    assert [line.split(",")[1] for line in history if '"update"' in line] == [
        f'"number":{number}' for number in (1, 2, 3)
    ]


def test_an_old_league_has_the_same_standings_and_goes_on(run, capsys):
    assert run("upgrade") == 0
    assert "12 records begin the ledger" in capsys.readouterr().out
    assert run("standings") == 0
    out = capsys.readouterr().out
    assert re.search(r"centerline +league +1000", out)
    assert "4 races under rules c114134669dd" in out
    # Races of an earlier physics are not driven again, and nothing is planned that cannot be raced.
    assert run("run", "--heats", "2", "--same-owner", "--plain") == 2
    assert "league upgrade --physics" in capsys.readouterr().err
    with Store("sqlite:///league.db") as league:
        assert set(league.counts()) <= {"done", "planned"}
    assert run("upgrade", "--physics") == 0
    assert "ratings begin again" in capsys.readouterr().out
    assert run("upgrade", "--physics") == 0
    assert "ratings begin again" not in capsys.readouterr().out
    assert run("run", "--heats", "2", "--same-owner", "--plain") == 0
    assert run("audit", "--sample", "100%") == 0


def test_an_old_replay_is_read_but_not_raced_again(capsys):
    old = replay.read(DATA / "version_2.race")
    assert [entry.name for entry in old.spec.entries] == ["centerline", "cautious"]
    # It names no rules: it was driven under the original's, and still is.
    assert (old.spec.rules, old.spec.obstacles, old.spec.average_laps) == ("deepracer", 0, 1)
    assert main(["verify", str(DATA / "version_2.race")]) == 2
    assert "was raced with physics 4" in capsys.readouterr().err
