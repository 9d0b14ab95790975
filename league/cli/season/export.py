"""`league export --csv` and `--json`: a league's results for other programs."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from league.atomic_file import replacing
from league.cli.season import base
from league.errors import ConfigError, StoreError

if TYPE_CHECKING:
    from league.matchmaking.store import Store

COLUMNS: tuple[str, ...] = (
    "heat", "race", "key", "purpose", "ruleset", "track", "seed", "slot", "entry", "id", "owner",
    "place", "finished", "laps", "total_s", "distance", "off_tracks", "crashes", "overtakes",
)  # fmt: skip


@dataclass(frozen=True)
class Wish:
    """Where to write what."""

    csv: Path | None
    """One line for each car of each race; "-" is the standard output."""
    json: Path | None
    """Rules, entries, standings and races."""


def write(store: Store, wish: Wish) -> None:
    """Write a league's results."""
    if wish.csv is not None:
        rows = _rows(store)
        text = io.StringIO()
        table = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        table.writeheader()
        table.writerows(rows)
        _put(wish.csv, text.getvalue(), f"{len(rows)} lines")
    if wish.json is not None:
        told = _document(store)
        _put(wish.json, json.dumps(told, indent=1, ensure_ascii=False) + "\n", "the league")


def _put(path: Path, text: str, what: str) -> None:
    if str(path) == "-":
        print(text, end="")
        return
    with replacing(path, "the export", ConfigError) as file:
        file.write_text(text, encoding="utf-8")
    print(f"Wrote {what}: {path}")


def _rows(store: Store) -> list[dict[str, object]]:
    """Return a line for each car of each race that is done."""
    entries = {entry.id: entry for entry in store.entries()}
    rows = []
    for record in store.heats(("done",)):
        if record.heat.audits:
            continue  # its results are those of the heat it audits
        for result in store.results(record.number):
            half = record.heat.halves[result.half]
            for car in sorted(result.result["order"], key=lambda car: car["car"]):
                entry = entries[half.grid[car["car"]]]
                rows.append(
                    {
                        "heat": record.number,
                        "race": result.half + 1,
                        "key": record.heat.key,
                        "purpose": record.heat.purpose,
                        "ruleset": record.heat.ruleset[:12],
                        "track": half.track,
                        "seed": record.seeds[result.half] if record.seeds else "",
                        "slot": car["car"] + 1,
                        "entry": entry.name,
                        "id": entry.id,
                        "owner": entry.owner,
                        "place": result.places[car["car"]],
                        **{name: car[name] for name in COLUMNS[12:]},
                    }
                )
    return rows


def _document(store: Store) -> dict[str, object]:
    from league.cli.season import standings as reading
    from league.matchmaking import standings

    settings = store.settings
    try:
        table = reading.told(standings.of(store))
    except StoreError:
        table = None
    return {
        "league": settings.name,
        "rules": base.plain(settings.ruleset),
        "ruleset": settings.ruleset.hash,
        "entries": base.plain(store.entries()),
        "standings": table,
        "races": _rows(store),
    }
