"""What single races tell: points against those that the ratings promised, best and clean laps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from league.matchmaking.ratings.fit import expected_score
from league.matchmaking.standings import Standings
from league.matchmaking.store import BEST_MS, KNOWN, Store
from league.sim.config import RaceKind


@dataclass(frozen=True)
class RaceScore:
    """An entry's rated race."""

    heat: int
    """Number of the heat."""
    race: int
    """Number of the race within the heat, from 1."""
    track: str
    """Name of the track; empty if it is none of the ruleset's."""
    points: float
    """Opponents it came in ahead of, ties half."""
    expected: float
    """Points that the ratings promise it, grid slots included."""


def race_scores(rated: Standings, number: int, other: int | None = None) -> list[RaceScore]:
    """Return an entry's rated races, by heat and race.

    Args:
        rated: the standings.
        number: of the entry.
        other: number of the only opponent that counts; by default all count.
    """
    races, ratings = rated.races, rated.ratings
    mine = races.entries == number
    rows = np.flatnonzero(mine.any(axis=1))
    if other is not None:
        rows = rows[(races.entries[rows] == other).any(axis=1)]
    rows = rows[np.lexsort((races.half[rows], races.heat[rows]))]
    slot = mine[rows].argmax(axis=1)[:, None]
    entries, places = races.entries[rows], races.places[rows].astype(int)
    known = np.searchsorted(ratings.entries, entries).clip(max=len(ratings.entries) - 1)
    strengths = ratings.elo[known] + ratings.slot_advantages[: entries.shape[1]]
    counts = (entries >= 0) & (entries != number)
    if other is not None:
        counts &= entries == other
    place = np.take_along_axis(places, slot, axis=1)
    points = (place < places) + 0.5 * (place == places)
    expected = expected_score(np.take_along_axis(strengths, slot, axis=1) - strengths)
    names = dict(enumerate(rated.tracks))
    return [
        RaceScore(
            heat=int(races.heat[row]),
            race=int(races.half[row]) + 1,
            track=names.get(int(races.track[row]), ""),
            points=float(points[at][counts[at]].sum()),
            expected=float(np.asarray(expected)[at][counts[at]].sum()),
        )
        for at, row in enumerate(rows)
    ]


@dataclass(frozen=True)
class BestLap:
    """An entry's fastest complete lap on a track, penalties included."""

    number: int
    """Number of the entry."""
    lap_s: float
    """[s]."""
    heat: int
    """Number of the heat."""
    race: int
    """Number of the race within the heat, from 1."""


def best_laps(rated: Standings) -> dict[str, list[BestLap]]:
    """Return the fastest lap of each entry on each track of the ruleset, the fastest first.

    Among equal laps the earlier one counts.
    """
    races = rated.races
    lap_ms = (races.runs & BEST_MS).astype(np.int64)
    row, slot = np.nonzero(((races.runs & KNOWN) > 0) & (lap_ms > 0))
    # Only laps that are an entry's fastest on their track need to be put in order.
    size = int(races.entries.max(initial=0)) + 1
    place = races.track[row].astype(np.int64) * size + races.entries[row, slot]
    best_ms = np.full(256 * size, BEST_MS + 1, np.int64)
    np.minimum.at(best_ms, place, lap_ms[row, slot])
    fastest = lap_ms[row, slot] == best_ms[place]
    row, slot = row[fastest], slot[fastest]
    return _fastest(
        rated.tracks, races.track[row], races.entries[row, slot], lap_ms[row, slot],
        races.heat[row], races.half[row],
    )  # fmt: skip


@dataclass(frozen=True)
class Boards:
    """Time-attack boards, which later races can be added to."""

    laps: dict[str, list[BestLap]]
    """The fastest clean lap of each entry, the fastest first, by track."""
    last: dict[str, int]
    """Store.drives.last of each ruleset, by its hash."""


def time_attack(store: Store, kind: RaceKind, earlier: Boards | None = None) -> Boards:
    """Return the fastest clean lap of each entry in all races of a kind, by track.

    Races under all rules count that have the present physics, those of cups included. A lap is
    clean in a race without a fault: no leaving of the track, no contact to blame for, no standing
    still, no driving backwards. With earlier boards only later races are read; that is right unless
    heats were put in quarantine since.
    """
    found, last = (dict(earlier.laps), dict(earlier.last)) if earlier else ({}, {})
    physics = store.settings.ruleset.physics
    for hash, rules in store.rulesets().items():
        if (rules.kind, rules.physics) == (kind, physics):
            drives = store.drives(hash, since=last.get(hash, 0), rated=False)
            last[hash] = drives.last
            laps = _fastest(
                rules.tracks, drives.track, drives.entry, drives.clean_ms, drives.heat, drives.half
            )
            for track, own in laps.items():
                found[track] = _best_of(found.get(track, []) + own)
    return Boards(found, last)


def _best_of(laps: list[BestLap]) -> list[BestLap]:
    """Return the best one of each entry's laps, the fastest first."""
    ordered = sorted(laps, key=lambda lap: (lap.lap_s, lap.heat, lap.race))
    best: dict[int, BestLap] = {}
    for lap in ordered:
        best.setdefault(lap.number, lap)
    return list(best.values())


def _fastest(
    tracks: Sequence[str],
    track: np.ndarray,
    entry: np.ndarray,
    lap_ms: np.ndarray,
    heat: np.ndarray,
    half: np.ndarray,
) -> dict[str, list[BestLap]]:
    """Return the fastest lap of each entry on each track; all arrays (laps,), 0 ms for no lap."""
    order = np.lexsort((half, heat, lap_ms))
    order = order[lap_ms[order] > 0]
    found: dict[str, list[BestLap]] = {}
    for index, name in enumerate(tracks):
        on_track = order[track[order] == index]
        first = np.sort(np.unique(entry[on_track], return_index=True)[1])
        found[name] = [
            BestLap(
                number=int(entry[at]),
                lap_s=float(lap_ms[at]) / 1000,
                heat=int(heat[at]),
                race=int(half[at]) + 1,
            )
            for at in on_track[first]
        ]
    return found
