"""docs/benchmarks.md: what benchmarks write into it, and what they leave as it is."""

import pytest

from benchmarks import __main__ as benchmarks
from benchmarks import races, report

BY_HAND = "## Whole commands\n\n| what | measured |\n|---|--:|\n| `make test` | 6 min |"


@pytest.fixture
def page(monkeypatch, tmp_path):
    path = tmp_path / "benchmarks.md"
    monkeypatch.setattr(benchmarks, "PAGE", path)
    path.write_text(benchmarks.summary(BY_HAND), encoding="utf-8")
    return path


def test_a_benchmark_has_a_page_and_its_goals_stand_on_the_page_of_all(page):
    __import__("benchmarks.replays")
    __import__("benchmarks.tracks")
    rows = (
        "| reading | 7 ms | ≤ 5 | not met |\n| writing | 6 ms | ≤ 6 | met |\n| size | 3 kB |  |  |"
    )
    benchmarks.write("replays", rows)
    benchmarks.write("tracks", "| drawing | 3 s | ≤ 4 | met |")
    text = page.read_text(encoding="utf-8")
    missed, _, met = text.partition("# Goals that were met")
    link = "[replays](benchmarks/replays.md)"
    assert f"| {link} | reading | 7 ms | ≤ 5 |" in missed
    assert f"| {link} | writing | 6 ms | ≤ 6 |" in met
    assert "| drawing | 3 s | ≤ 4 |" in met
    assert "size" not in text
    assert text.endswith(f"{BY_HAND}\n")
    own = page.parent / "benchmarks" / "replays.md"
    assert rows in own.read_text(encoding="utf-8")


def test_the_page_in_the_repository_has_the_goals_of_the_pages_next_to_it():
    text = benchmarks.PAGE.read_text(encoding="utf-8")
    _, _, by_hand = text.partition(f"\n{benchmarks.BY_HAND}\n")
    assert benchmarks.summary(by_hand.strip()) == text
    assert len(text.splitlines()) < 200


def test_mutants_are_run_only_by_name():
    assert set(benchmarks.BY_NAME_ONLY) < set(benchmarks.NAMES)


def test_each_figure_of_the_races_has_a_name_of_its_own(monkeypatch):
    for name in ("stereo_rate", "python"):
        monkeypatch.setattr(races, name, lambda *_, **__: 1.0)
    monkeypatch.setattr(races, "three_laps", lambda *_: (1.0, 1.0))
    report.taken()
    races.main()
    names = [row.split("|")[1] for row in report.taken().splitlines() if row.startswith("|")]
    assert len(names) > 10 and len(set(names)) == len(names)


def test_figures_after_a_table_stand_in_a_table_of_their_own():
    report.taken()
    report.table("driver", "lap")("racer", "4.5 s")
    for name in ("one", "two"):
        report.figure(name, 1.0, "s", 2.0, most=True)
    head = "| figure | measured | goal | met |\n| --- | --: | --: | --: |"
    rows = "| one | 1 s | ≤ 2 | met |\n| two | 1 s | ≤ 2 | met |"
    assert report.taken().endswith(f"| racer | 4.5 s |\n\n{head}\n{rows}")
