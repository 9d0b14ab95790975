"""Results of mutants.py: which test caught which mutant, in a file for each part."""

import ast
import json
from functools import cache
from pathlib import Path
from typing import Any

from league.atomic_file import replacing
from league.errors import LeagueError


def name_of(one: Any) -> str:
    """Return what tells a mutant from all others: its place and its operator."""
    line, column = one.start_pos
    operator = one.operator_name.rpartition("/")[2]
    return f"{one.module_path}:{line}:{column} {operator} {one.occurrence}"


@cache
def source_of(test: str) -> str:
    """Return the source of a test function, by its id; of what is no test, nothing."""
    path, _, name = test.partition("::")
    if not name:
        return ""
    text = Path(path).read_text(encoding="utf-8")
    wanted = name.partition("[")[0]
    found = [
        ast.get_source_segment(text, node) or ""
        for node in ast.parse(text).body
        if isinstance(node, ast.FunctionDef) and node.name == wanted
    ]
    return "".join(found)


class Results:
    """Which test caught which mutant of a part, kept in a file as they come.

    With the same modules and tests, a run that was stopped continues. After a change of tests,
    survivors are tried again, and so are mutants with another version of the test that caught
    them. After a change of modules all are, and the file says with which test to begin.
    """

    def __init__(self, path: Path, modules: str, tests: str) -> None:
        kept = json.loads(path.read_text()) if path.exists() else {}
        self._path, self._key = path, {"modules": modules, "tests": tests}
        self.before: dict[str, str | None] = kept.get("caught_by", {})
        """Of the last run."""
        stay = {} if kept.get("modules") != modules else self.before
        if kept.get("tests") != tests:
            sources = {by: source_of(by) for by in filter(None, set(stay.values()))}
            stay = {
                mutant: by
                for mutant, by in stay.items()
                if by and sources[by] and sources[by] == kept["sources"].get(by)
            }
        self._write(stay)

    def all(self) -> dict[str, str | None]:
        """Return the results, of forks too: the test by the mutant, None of a survivor."""
        return json.loads(self._path.read_text())["caught_by"]

    def add(self, one: Any, caught_by: str | None) -> None:
        """Keep a result."""
        self._write(self.all() | {name_of(one): caught_by})

    def left(self, chosen: list) -> list:
        """Return the mutants that were not tried yet."""
        done = self.all()
        return [one for one in chosen if name_of(one) not in done]

    def _write(self, caught_by: dict[str, str | None]) -> None:
        sources = {by: source_of(by) for by in sorted(filter(None, set(caught_by.values())))}
        with replacing(self._path, "results", LeagueError) as new:
            kept = {**self._key, "caught_by": caught_by, "sources": sources}
            new.write_text(json.dumps(kept, indent=1))
