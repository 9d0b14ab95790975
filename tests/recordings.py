"""What stands in a Rerun recording, for the tests of those who write one."""

from __future__ import annotations

from pathlib import Path

from rerun.chunk import RrdReader

from league.rerun_view import paths


def rows_of(path: Path) -> dict[str, int]:
    """Return how many rows of changing data each entity of a recording has."""
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            assert paths.TIMELINE in chunk.timeline_names
            name = chunk.entity_path.lstrip("/")
            rows[name] = rows.get(name, 0) + chunk.num_rows
    return rows
