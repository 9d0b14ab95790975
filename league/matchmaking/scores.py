"""What races tell beyond the table: points against those promised, laps, the way to a rating."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from league.errors import StoreError, brief
from league.matchmaking import standings
from league.matchmaking.ratings import Carried, RatingData, refit
from league.matchmaking.ratings.pair_counts import ELO, changes
from league.matchmaking.ratings.table import SIGMAS_95, Strengths, expected_score
from league.matchmaking.scope import frozen_columns, scope
from league.matchmaking.standings import OwnRaces, Standings
from league.matchmaking.store import BEST_MS, CLEAN, LeagueEntry, Races, Store
from league.sim.config import RaceKind

TREND_HEATS = 50
"""So many of a season's newest heats, at most half of them, make the trend of a rating."""


@dataclass(frozen=True)
class RaceScore:
    """An entry's rated race."""

    heat: int
    race: int  # number of the race within the heat, from 1
    track: str  # name of the track; empty if it is none of the ruleset's
    points: float  # opponents it came in ahead of, ties half
    expected: float  # points that the ratings promise it, grid slots included


def race_scores(own: OwnRaces, tracks: Sequence[str], other: int | None = None) -> list[RaceScore]:
    """Return an entry's rated races, by heat and race; if given, only one other entry counts.

    `tracks` are those of the rules that the races are under.
    """
    races, counts = own.races, own.met
    if other is not None:
        counts = counts & (races.entries == other)
    names = dict(enumerate(tracks))
    rows = np.flatnonzero(counts.any(axis=1) | (other is None))
    columns = (
        races.heat[rows].tolist(),
        (races.half[rows].astype(int) + 1).tolist(),
        [names.get(track, "") for track in races.track[rows].tolist()],
        np.where(counts, own.points, 0.0).sum(axis=1)[rows].tolist(),
        np.where(counts, own.expected, 0.0).sum(axis=1)[rows].tolist(),
    )
    return list(map(RaceScore, *columns))


def heat_scores(own: OwnRaces) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return an entry's rated heats: numbers, points made, points promised, (heats,) each."""
    starts = changes(own.races.heat)
    if not len(starts):
        return own.races.heat, np.zeros(0), np.zeros(0)
    points, expected = (
        np.add.reduceat(np.where(own.met, some, 0.0).sum(axis=1), starts)
        for some in (own.points, own.expected)
    )
    return own.races.heat[starts], points, expected


def final_ratings(document: Mapping[str, Any]) -> Strengths:
    """Return the ratings that a season was frozen with, from its document."""
    entries, elo = frozen_columns(document, "number", "elo")
    return Strengths(entries, elo, np.array(document["standings"]["slot_advantages"]))


@dataclass(frozen=True)
class BestLap:
    """An entry's fastest clean lap on a track: one of a race in which it made no mistake."""

    number: int
    lap_s: float
    heat: int
    race: int
    """Number of the race within the heat, from 1."""


def clean_laps(races: Races, tracks: Sequence[str]) -> dict[str, list[BestLap]]:
    """Return the fastest clean lap of each entry on each of a ruleset's tracks, the fastest first.

    A lap is clean in a race without a fault: no leaving of the track, no contact to blame for, no
    standing still, no driving backwards. Among equal laps the earlier one counts.
    """
    row, slot = np.nonzero(races.runs & CLEAN)
    entry, track = races.entries[row, slot], races.track[row]
    lap_ms = (races.runs[row, slot] & BEST_MS).astype(np.int64)
    # Only laps that are an entry's fastest on their track need to be put in order.
    size = int(races.entries.max(initial=0)) + 1
    place = track.astype(np.int64) * size + entry
    best_ms = np.full(256 * size, BEST_MS + 1, np.int64)
    np.minimum.at(best_ms, place, lap_ms)
    fastest = np.flatnonzero(lap_ms == best_ms[place])
    heat, half = races.heat[row], races.half[row]
    fastest = fastest[np.lexsort((half[fastest], heat[fastest], lap_ms[fastest]))]
    found: dict[str, list[BestLap]] = {}
    for index, name in enumerate(tracks):
        on_track = fastest[track[fastest] == index]
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


def joined_laps(
    earlier: dict[str, list[BestLap]], later: dict[str, list[BestLap]]
) -> dict[str, list[BestLap]]:
    """Return the fastest lap of each entry from those of some races and of later ones."""
    found = dict(earlier)
    for track, laps in later.items():
        known = found.setdefault(track, [])
        best_s = {lap.number: lap.lap_s for lap in known} if laps else {}
        # Among equal laps the earlier heat counts, which may have come in later.
        faster = [lap for lap in laps if lap.lap_s <= best_s.get(lap.number, np.inf)]
        if faster:
            best: dict[int, BestLap] = {}
            for lap in sorted(known + faster, key=lambda lap: (lap.lap_s, lap.heat, lap.race)):
                best.setdefault(lap.number, lap)
            found[track] = list(best.values())
    return found


@dataclass(frozen=True)
class Boards:
    """Time-attack boards, which later races can be added to."""

    laps: dict[str, list[BestLap]]
    """The fastest clean lap of each entry, the fastest first, by track."""
    last: dict[str, int]  # Races.last of each ruleset, by its hash


def time_attack(
    store: Store, kind: RaceKind, earlier: Boards | None = None, known: Races | None = None
) -> Boards:
    """Return the fastest clean lap of each entry in all races of a kind, by track.

    Races under all rules count that have the present physics, those of cups included. With earlier
    boards only later races are read; that is right unless heats were put in quarantine since.
    `known` are the rated races under the present rules, if they have been read already.
    """
    found, last = (dict(earlier.laps), dict(earlier.last)) if earlier else ({}, {})
    present = store.settings.ruleset
    for hash, rules in store.rulesets().items():
        if (rules.kind, rules.physics) != (kind, present.physics):
            continue
        if hash == present.hash and known is not None and hash not in last:
            races = [known, store.races(hash, rated=False)]
            last[hash] = known.last
        else:
            races = [store.races(hash, since=last.get(hash, 0), rated=None)]
            last[hash] = races[0].last
        for some in races:
            found = joined_laps(found, clean_laps(some, rules.tracks))
    return Boards(found, last)


@dataclass(frozen=True)
class Pole:
    """How much of the results the first slot of the grid decides."""

    races: int  # rated races of two cars or more
    won: float  # share of them won from the first slot, a shared win in part
    low95: float  # lower end of its 95 % interval (Wilson, as if races were independent)
    high95: float  # upper end of it
    even: float  # the share that a slot without any advantage wins: one over the number of cars
    elo: float  # what the first slot is worth over the mean of all slots, drivers being equal [Elo]
    elo_low95: float  # lower end of its 95 % interval [Elo]
    elo_high95: float  # upper end of it [Elo]


def pole(rated: Standings) -> Pole | None:
    """Return what the first slot of the grid decides; None without a race of two cars."""
    results = standings.results_of(rated.races).by_heat()
    present = results.entries >= 0
    cars = present.sum(axis=1)
    results, present, cars = results.rows(cars > 1), present[cars > 1], cars[cars > 1]
    races = len(results)
    if not races:
        return None
    best = results.places.min(axis=1, where=present, initial=255)
    first = (results.places == best[:, None]) & present
    won = float((first[:, 0] / first.sum(axis=1)).mean())
    # Wilson's interval stays within 0 and 1, also where every race was won from one slot.
    squared = SIGMAS_95**2 / races
    middle = (won + squared / 2) / (1 + squared)
    half = np.sqrt(squared * (won * (1 - won) + squared / 4)) / (1 + squared)
    slot = rated.ratings.slot_advantages[0], rated.ratings.slot_sd[0]
    elo, reach = float(slot[0]), SIGMAS_95 * float(slot[1])
    return Pole(
        races=races,
        won=won,
        low95=float(middle - half),
        high95=float(middle + half),
        even=float((1 / cars).mean()),
        elo=elo,
        elo_low95=elo - reach,
        elo_high95=elo + reach,
    )


@dataclass(frozen=True)
class HistoryPoint:
    """An entry's rating at some time."""

    heat: int
    """Number of the last heat counted."""
    races: int
    """Races of the entry up to then, those of earlier seasons under the same rules included."""
    elo: float
    """Strength [Elo]."""
    low95: float
    """Lower end of the 95 % interval [Elo]."""
    high95: float
    """Upper end of the 95 % interval [Elo]."""
    season: int = 0
    """Number of the season; 0 in a league without seasons."""


def history(store: Store, entry: LeagueEntry, *, points: int = 20) -> list[HistoryPoint]:
    """Return an entry's rating as it was after evenly many of its heats, and last as it is now.

    Each is fitted to the races of its season up to then, so later corrections of results count.
    Seasons under other rules than the present ones are left out: their ratings are no comparison.
    """
    ruleset = store.settings.ruleset.hash
    races, entries = store.races(ruleset), store.entries()
    mine = np.unique(races.heat[(races.entries == entry.number).any(axis=1)])
    if not len(mine):
        raise StoreError(
            f"{brief(entry.name)} has not raced for its rating yet: let the league run first"
        )
    picked = np.unique(np.linspace(0, len(mine) - 1, min(points, len(mine))).round().astype(int))
    seasons = [one for one in store.seasons() if one.ruleset == ruleset] or [None]
    moments: list[HistoryPoint] = []
    raced = 0
    for season in seasons:
        within = scope(store, ruleset, season, races)
        # Others may have raced since its last heat, and their races move its rating too.
        heats = {*mine[picked[:-1]].tolist(), int(within.races.heat.max(initial=0))}
        own = np.array(sorted(heats - {0}), dtype=np.int64)
        for heat in own[season.has(own)] if season else own:
            before = standings.results_of(within.races, before=heat + 1)
            found = standings.rated(before, entries, carried=within.carried)
            if found is None or entry.number not in found[1].entries:
                continue
            fitted = found[1]
            at = fitted.index(entry.number)
            moments.append(
                HistoryPoint(
                    heat=int(heat),
                    races=raced + int(fitted.races[at]),
                    **fitted.line(at, "elo", "low95", "high95"),
                    season=season.number if season else 0,
                )
            )
        raced = moments[-1].races if moments else 0
    return moments


def trends(
    rated: Standings, carried: Carried | None, pause: Callable[[], None] = lambda: None
) -> dict[int, float]:
    """Return by how much the season's newest heats changed each rating [Elo], by entry number.

    `carried` is what was known before the season; `pause` is called between steps.
    """
    heats = np.sort(rated.races.heat)  # np.unique takes ten times as long
    heats = heats[changes(heats)]
    newest = heats[len(heats) - min(TREND_HEATS, len(heats) // 2) :]
    if not len(newest):
        return {}
    earlier = standings.results_of(rated.races, before=int(newest[0]))
    pause()
    data = RatingData.of(earlier, rated.ratings.entries)
    pause()
    changed = rated.ratings.elo - refit(data, rated.ratings, carried, pause)
    raced = data.races > 0
    return dict(zip(data.entries[raced].tolist(), changed[raced].tolist(), strict=True))


def own_history(rated: Standings, own: OwnRaces, *, points: int) -> list[HistoryPoint]:
    """Return an entry's rating over its heats, all others rated as they are now.

    It takes milliseconds in a league of any size; `history` fits all ratings for each point.
    """
    ratings = rated.ratings
    needed = own.strengths - ratings.slot_advantages[own.slot]  # a rating at which the two are even
    middle, spread = float(ratings.elo.mean()), ratings.prior_sd
    heats = own.races.heat
    picked = np.unique(np.linspace(1, len(heats), min(points, len(heats))).round().astype(int))
    counted = np.arange(len(heats)) < picked[:, None]  # (moments, races)
    met = counted[:, :, None] & own.met
    elos, sds = _own_ratings(own.points, needed, met, middle, spread)
    moments = [
        HistoryPoint(int(heats[count - 1]), count, elo, elo - SIGMAS_95 * sd, elo + SIGMAS_95 * sd)
        for count, elo, sd in zip(picked.tolist(), elos.tolist(), sds.tolist(), strict=True)
    ]
    now = ratings.line(ratings.index(own.number), "elo", "low95", "high95")
    return [*moments[:-1], HistoryPoint(int(rated.races.heat.max()), len(heats), **now)]


def _own_ratings(
    points: np.ndarray, needed: np.ndarray, met: np.ndarray, middle: float, spread: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the likeliest ratings, and their standard deviations, given those of all opponents.

    Against each car there are the points made and the rating `needed` to be even with it, (races,
    cars); `met` tells whether it counts at a moment, (moments, races, cars).
    """
    at, moments = met.any(axis=0), len(met)
    counts, points, needed = met[:, at].astype(float), points[at], needed[at]  # (moments, cars met)
    elo, information = np.full(moments, middle), np.ones(moments)
    moving = np.ones(moments, bool)
    for _ in range(50):
        chance = np.asarray(expected_score(elo[:, None] - needed))
        gradient = (counts * (points - chance)).sum(axis=1) / ELO - (elo - middle) / spread**2
        curved = (counts * (chance * (1 - chance))).sum(axis=1) / ELO**2 + 1 / spread**2
        information = np.where(moving, curved, information)
        step = np.where(moving, np.clip(gradient / curved, -200.0, 200.0), 0.0)
        elo = elo + step
        moving &= np.abs(step) >= 0.01
        if not moving.any():
            break
    return elo, information**-0.5
