"""What is compiled: what its cache on disk must not miss, and what if there is no disk."""

import ast
from pathlib import Path

import pytest

import league
from league import compiled

FILES = [
    path
    for path in sorted(Path(league.__file__).parent.rglob("*.py"))
    if "from league.compiled import" in path.read_text(encoding="utf-8")
]


def test_painter_contacts_tyres_places_and_what_rewards_are_told_are_compiled():
    names = ["telling.py", "raster.py", "collision.py", "tyres.py", "along.py"]
    assert [path.name for path in FILES] == names


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_what_is_compiled_takes_nothing_from_files_whose_change_the_cache_would_miss(path):
    tree = ast.parse(path.read_text(encoding="utf-8"))
    found = {
        node.module if isinstance(node, ast.ImportFrom) else alias.name
        for node in ast.walk(tree)
        if isinstance(node, (ast.Import, ast.ImportFrom))
        for alias in node.names
    }
    assert found <= {"math", "typing", "numpy", "numba", "league.compiled"}


def test_without_a_folder_to_write_to_it_compiles_all_the_same(monkeypatch):
    asked = []

    def njit(**settings):
        asked.append(settings)
        if settings.get("cache"):
            raise RuntimeError("cannot cache function: no locator available")
        return lambda function: function

    monkeypatch.setattr(compiled, "njit", njit)
    assert compiled.compiled(len) is len
    assert len(asked) == 2 and "cache" not in asked[1]
