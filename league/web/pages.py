"""The data of every page, which /api/v1 returns as JSON; it is read from the store."""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from functools import lru_cache
from typing import Any

from league.errors import LeagueError, StoreError
from league.matchmaking import standings
from league.matchmaking.documents import heat_document, names_of
from league.matchmaking.standings import Row, Standings
from league.matchmaking.store import Entry, HeatRecord, Store, StoredResult
from league.replay import Replay, format
from league.track import files
from league.web import charts
from league.web.replay_data import player_data

FRESH_S = 2.0
"""Standings are computed again when they are older than this [s] and asked for."""
RECENT = 60
"""Newest heats among which the most contested race is looked for, and that are listed."""
TOP = 8
"""Entries of the standings on the home page."""
RECORDS = 8
"""Fastest drivers of each track."""
DRIVER_HEATS = 14
"""Newest heats on a driver's page."""
HISTORY_POINTS = 16
"""Moments of a rating's history."""
Document = dict[str, Any]


class NotFoundError(LeagueError):
    """A driver, heat, race or recording that this league does not have."""


class Pages:
    """Reads a league's pages; threads may share it."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._lock = threading.Lock()
        self._rated: Standings | None = None
        self._rated_s = float("-inf")
        self._past = lru_cache(maxsize=256)(self._history)
        self._replay = lru_cache(maxsize=16)(self._read_replay)
        self._featured = lru_cache(maxsize=1)(self._most_contested)

    def home(self) -> Document:
        """Return the most contested recent race, and the top of the standings."""
        rated, counts = self._standings(), self._store.counts()
        featured = self._featured(counts.get("done", 0))
        return {
            "rules": self._rules(),
            "counts": counts,
            "races": rated.num_races if rated else 0,
            "featured": self.heat(*featured) if featured else None,
            "scale": charts.interval_scale(rated.rows) if rated else None,
            "rows": rated.rows[:TOP] if rated else (),
            "entries": len(self._store.entries()),
        }

    def standings(self, owner: str, kind: str) -> Document:
        """Return the standings; ranks are those among all entries, whatever is filtered.

        Args:
            owner: only entries of this owner; empty for all.
            kind: only these: anchor, policy or scripted; empty for all.
        """
        rated = self._standings()
        rows = rated.rows if rated else ()
        kinds = {entry.number: _kind(entry) for entry in self._store.entries()}
        shown = [
            row for row in rows if owner in ("", row.owner) and kind in ("", kinds.get(row.number))
        ]
        return {
            "rules": self._rules(),
            "races": rated.num_races if rated else 0,
            "rejected": bool(rated and rated.goodness.rejected),
            "p_value": rated.goodness.p_value if rated else None,
            "scale": charts.interval_scale(rows) if rows else None,
            "rows": shown,
            "owners": sorted({row.owner for row in rows}),
            "kinds": sorted(set(kinds.values())),
            "owner": owner,
            "kind": kind,
        }

    def driver(self, number: int) -> Document:
        """Return an entry: its rating and how it came about, its record, its heats, its card."""
        entry, entries = self._entry(number), self._store.entries()
        rated = self._standings()
        row = next((row for row in rated.rows if row.number == number), None) if rated else None
        recent = self._store.heats(entries=[number])[-DRIVER_HEATS:][::-1]
        history = self._past(number, rated.num_races) if rated and row and row.races else ()
        return {
            "entry": entry,
            "standing": row,
            "history": history,
            "chart": charts.rating_history(history) if len(history) > 1 else None,
            "against": standings.records(rated, number) if rated and row else [],
            "heats": [self._listed(record, entries) for record in recent],
            "card": _card(entry),
        }

    def heats(self) -> Document:
        """Return the newest heats, the last one first, and how many are in each state."""
        entries = self._store.entries()
        records = self._newest()
        return {
            "heats": [self._listed(record, entries) for record in records],
            "counts": self._store.counts(),
        }

    def heat(self, number: int, race: str = "1") -> Document:
        """Return a heat, and the classification, laps and gaps of one of its races."""
        record = self._record(number)
        entries = self._store.entries()
        results = self._store.results(number)
        valid = [str(half + 1) for half in range(len(record.heat.halves))]
        if race not in valid:
            raise NotFoundError(f"Heat {number} has the races {' and '.join(valid)}.")
        half = int(race) - 1
        result = _accepted(results, half)
        replay = self._replay(result.replay) if result and result.replay else None
        grid = record.heat.halves[half].grid
        laps_s = (
            [lap for car in result.result["order"] for lap in car["lap_times_s"]] if result else []
        )
        by_id = {entry.id: entry for entry in entries}
        return {
            "heat": heat_document(record, names_of(entries)),
            "race": half + 1,
            "track": record.heat.halves[half].track,
            "seed": record.seeds[half] if record.seeds else None,
            "ruleset": record.heat.ruleset,
            "cars": [
                {"number": slot + 1, "entry": by_id[id].number, "name": by_id[id].name}
                for slot, id in enumerate(grid)
            ],
            "result": result.result if result else None,
            "places": result.places if result else (),
            "best_lap_s": min(laps_s, default=None),
            "hash": result.hash if result else None,
            "recording": result.replay if result else None,
            "disputed": len(results) > len(record.heat.halves),
            "map": charts.track_map(replay.track) if replay else None,
            "gaps": charts.gap_chart(replay) if replay else None,
            "events": player_data(replay)["events"] if replay else [],
            "physics": replay.physics if replay else None,
            "league_version": replay.league_version if replay else None,
        }

    def replay(self, number: int, race: int) -> Document:
        """Return what the player draws of a race."""
        self._record(number)
        result = _accepted(self._store.results(number), race - 1)
        if result is None or not result.replay:
            raise NotFoundError(f"Heat {number} has no recording of a race {race}.")
        return player_data(self._replay(result.replay))

    def tracks(self) -> Document:
        """Return the tracks of the present rules, and the fastest laps on each."""
        rated = self._standings()
        tracks = [files.load(name) for name in self._store.settings.ruleset.tracks]
        return {
            "tracks": [
                {
                    **files.report(track),
                    "map": charts.track_map(track),
                    "records": _records(rated.rows if rated else (), track.name),
                }
                for track in tracks
            ]
        }

    def _standings(self) -> Standings | None:
        """Return the standings of this moment or shortly before; None if no entry is rated."""
        with self._lock:
            if time.monotonic() - self._rated_s > FRESH_S:
                try:
                    self._rated = standings.of(self._store)
                except StoreError:
                    self._rated = None
                self._rated_s = time.monotonic()
            return self._rated

    def _entry(self, number: int) -> Entry:
        entry = next((one for one in self._store.entries() if one.number == number), None)
        if entry is None:
            raise NotFoundError(f"This league has no driver {number}: the standings list them.")
        return entry

    def _history(self, number: int, _num_races: int) -> list[standings.HistoryPoint]:
        return standings.history(self._store, self._entry(number), points=HISTORY_POINTS)

    def _read_replay(self, digest: str) -> Replay:
        return format.decode(self._store.blobs.get(digest))

    def _newest(self) -> list[HeatRecord]:
        planned = sum(self._store.counts().values())
        return self._store.heats(("done",), since=max(0, planned - 2 * RECENT))[::-1][:RECENT]

    def _most_contested(self, _num_done: int) -> tuple[int, str] | None:
        """Return the number of a heat and of its race with the most passes, then the closest one.

        Args:
            _num_done: heats that are done: the answer holds until there are more.
        """
        races = [
            (_contested(result), record.number, str(result.half + 1))
            for record in self._newest()
            if record.heat.purpose == "rated"
            for result in self._store.results(record.number)
            if result.replay and not result.rejected
        ]
        return max(races)[1:] if races else None

    def _record(self, number: int) -> HeatRecord:
        try:
            return self._store.heat(number)
        except (StoreError, OverflowError):
            raise NotFoundError(f"This league has no heat {number}.") from None

    def _listed(self, record: HeatRecord, entries: list[Entry]) -> Document:
        """Return a heat as a line of a list: who raced, who won."""
        names = names_of(entries)
        results = self._store.results(record.number)
        winners = []
        for number, half in enumerate(record.heat.halves):
            result = _accepted(results, number)
            if result is not None:
                winners.append(names[half.grid[result.places.index(min(result.places))]])
        return {**heat_document(record, names), "winners": winners}

    def _rules(self) -> Document:
        rules = self._store.settings.ruleset
        return {
            "hash": rules.hash,
            "tracks": rules.tracks,
            "laps": rules.laps,
            "cars": rules.cars,
            "kind": rules.kind,
            "solver": rules.solver,
        }


def _accepted(results: list[StoredResult], half: int) -> StoredResult | None:
    return next((one for one in results if one.half == half and not one.rejected), None)


def _contested(result: StoredResult) -> tuple[int, float]:
    """Return how contested a race was: passes and changes of the lead, then how close the end."""
    order = result.result["order"]
    passes = result.result["lead_changes"] + sum(car["overtakes"] for car in order)
    finished = [car["total_s"] for car in order if car["finished"]]
    gap_s = finished[1] - finished[0] if len(finished) > 1 else 1e6
    return int(passes), -float(gap_s)


def _kind(entry: Entry) -> str:
    return "anchor" if entry.anchor else entry.kind


def _records(rows: tuple[Row, ...], track: str) -> list[Document]:
    timed = sorted(
        (row.best_laps_s[track], row.number, row.name) for row in rows if track in row.best_laps_s
    )
    return [{"lap_s": lap_s, "entry": n, "name": name} for lap_s, n, name in timed[:RECORDS]]


def _card(entry: Entry) -> dict[str, str]:
    """Return what a checkpoint's card says, in the words of the page."""
    card = entry.card
    if entry.kind == "scripted":
        return {"driver": str(card.get("driver", entry.name)), "kind": "scripted"}
    network = _mapping(card.get("network"))
    shape = [f"{name}: {size}" for name, size in network.items() if name != "normalise"]
    sensors = _mapping(card.get("sensors"))
    actions = [
        f"{name.replace('_', ' ')} {value}"
        for name, value in _mapping(card.get("action_space")).items()
    ]
    lines = {
        "trained for": card.get("kind"),
        "sensors": ", ".join(name for name in sensors if isinstance(sensors[name], Mapping)),
        "network": "; ".join(shape),
        "actions": ", ".join(actions),
        "reward": _mapping(card.get("reward")).get("name"),
        "tracks": ", ".join(map(str, card.get("tracks") or ())),
        "decisions": f"{card['steps']:,}" if isinstance(card.get("steps"), int) else None,
        "parents": ", ".join(str(parent)[:12] for parent in card.get("parents") or ()),
        "licence": card.get("licence"),
        "made": card.get("created"),
        "league": card.get("league_version"),
        "command": card.get("command"),
        "nearly a copy of": entry.near_copy_of,
    }
    return {name: str(value) for name, value in lines.items() if value}


def _mapping(value: object) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}
