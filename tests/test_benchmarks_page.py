"""docs/benchmarks.md: what benchmarks write into it, and what they leave as it is."""

import pytest

from benchmarks import __main__ as benchmarks

BY_HAND = "## Whole commands\n\n| what | measured |\n|---|--:|\n| `make test` | 6 min |"


@pytest.fixture
def page(monkeypatch, tmp_path):
    path = tmp_path / "benchmarks.md"
    path.write_text(benchmarks.page_of({"tracks": "drawn"}, BY_HAND), encoding="utf-8")
    monkeypatch.setattr(benchmarks, "PAGE", path)
    return path


def test_a_written_section_leaves_the_others_and_what_is_written_by_hand(page):
    __import__("benchmarks.replays")
    benchmarks.write("replays", "| reading | 7 ms | ≤ 5 ms | not met |")
    found, by_hand = benchmarks.sections(page.read_text(encoding="utf-8"))
    assert found["tracks"] == "drawn"
    assert found["replays"].endswith("| reading | 7 ms | ≤ 5 ms | not met |")
    assert by_hand == BY_HAND
    head = page.read_text(encoding="utf-8").partition("# Figures")[0]
    assert "| replays | reading | 7 ms | ≤ 5 ms |" in head


def test_the_page_in_the_repository_survives_being_read_and_written():
    text = benchmarks.PAGE.read_text(encoding="utf-8")
    found, by_hand = benchmarks.sections(text)
    assert "## Whole commands" in by_hand
    assert benchmarks.page_of(found, by_hand) == text


def test_mutants_are_run_only_by_name():
    assert set(benchmarks.BY_NAME_ONLY) < set(benchmarks.NAMES)
