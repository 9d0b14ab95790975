"""What a user installs: the wheel holds the code and all tracks; nothing is fetched to run it."""

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*command, "--wheel-dir", str(folder), str(ROOT)], check=True)
    return next(folder.glob("*.whl"))


def test_wheel_holds_every_track_and_no_tests(wheel):
    names = zipfile.ZipFile(wheel).namelist()
    tracks = {Path(name).name for name in names if name.startswith("league/_tracks/")}
    assert {path.name for path in (ROOT / "tracks").glob("*.yaml")} <= tracks
    assert len([name for name in tracks if name.endswith(".yaml")]) == 12
    assert not [name for name in names if name.startswith(("tests/", "benchmarks/"))]


def test_unpacked_wheel_lists_its_tracks_away_from_the_checkout(wheel, tmp_path):
    zipfile.ZipFile(wheel).extractall(tmp_path)
    printed = subprocess.run(
        [
            sys.executable,
            "-c",
            "import league, sys; print(league.__file__);"
            "from league.cli import main; sys.exit(main(['tracks', 'list']))",
        ],
        cwd=tmp_path,
        env={"PYTHONPATH": str(tmp_path), "PATH": "/usr/bin:/bin", "COLUMNS": "120"},
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert str(tmp_path) in printed
    assert "reinvent_2018" in printed
