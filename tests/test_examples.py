"""The examples run as they stand; those of the doors are run by the doors' own tests."""

import runpy
from pathlib import Path

import pytest

from league.agents import checkpoint

EXAMPLES = Path(__file__).parents[1] / "examples"


def test_own_driver_finishes_its_race_against_the_leagues(capsys):
    runpy.run_path(str(EXAMPLES / "own_driver.py"), run_name="__main__")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2
    assert {line.split()[1] for line in lines} == {"weaver", "centerline"}
    assert all("best lap" in line for line in lines)


def test_a_driver_is_trained_with_a_reward_of_ones_own(capsys, monkeypatch):
    monkeypatch.setattr("sys.argv", ["train_with_reward.py", "0.001"])
    runpy.run_path(str(EXAMPLES / "train_with_reward.py"), run_name="__main__")
    first, second = capsys.readouterr().out.splitlines()
    # One update of 32 worlds and 64 steps takes longer than 0.06 s.
    assert first == "2048 decisions; the time was up"
    assert second.startswith("mine: ")


def test_a_driver_is_trained_in_a_loop_of_ones_own(capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["rsl_rl_loop.py", "1"])
    runpy.run_path(str(EXAMPLES / "rsl_rl_loop.py"), run_name="__main__")
    assert "rsl_rl.pt: drive it with" in capsys.readouterr().out
    assert checkpoint.load("rsl_rl.pt").card.name == "mine"


def test_a_driver_is_trained_with_stable_baselines3(capsys, monkeypatch, tmp_path):
    pytest.importorskip("stable_baselines3", reason="pip install '.[clients]' for this test")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.argv", ["sb3.py", "1024"])
    runpy.run_path(str(EXAMPLES / "sb3.py"), run_name="__main__")
    assert "sb3.pt: " in capsys.readouterr().out


def test_every_example_is_run_by_a_test():
    tests = "\n".join(path.read_text() for path in Path(__file__).parent.rglob("test_*.py"))
    forgotten = [path.stem for path in EXAMPLES.glob("*.py") if path.stem not in tests]
    assert not forgotten
