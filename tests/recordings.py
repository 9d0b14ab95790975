"""What stands in a Rerun recording, for the tests of those who write one."""

from __future__ import annotations

from pathlib import Path

from rerun.chunk import RrdReader

from league.rerun_view import layout


def texts_of(path: Path, entity: str) -> list[tuple[int, str]]:
    """Return when [ns] an entity shows which text, in order."""
    texts = []
    for chunk in RrdReader(path).stream():
        if chunk.entity_path.strip("/") == entity:
            batch = chunk.to_record_batch()
            assert not chunk.is_static
            columns = dict(zip(batch.schema.names, batch.columns, strict=True))
            name = next(name for name in columns if name.endswith("text"))
            times = columns[layout.TIMELINE].cast("int64").to_pylist()
            texts += zip(times, [text[0] for text in columns[name].to_pylist()], strict=True)
    return sorted(texts)


def rows_of(path: Path) -> dict[str, int]:
    """Return how many rows of changing data each entity of a recording has."""
    rows: dict[str, int] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        if not chunk.is_static:
            assert layout.TIMELINE in chunk.timeline_names
            name = chunk.entity_path.lstrip("/")
            rows[name] = rows.get(name, 0) + chunk.num_rows
    return rows
