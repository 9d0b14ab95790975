"""Cups: qualifying, then knock-out heats of four, of which two advance.

All of a cup follows from its entrants, its seed and the results of its heats; so whoever computes
the bracket plans the same heats, and a cup goes on after a kill like any heat.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from league.errors import StoreError, nearest_names
from league.matchmaking import documents
from league.matchmaking.pairing.heat_spec import Half, Heat, Ruleset
from league.matchmaking.store import RATED, Cup, HeatState, LeagueEntry, Store

DRAWS = 4096  # heats of a cup at most; heat k of cup n has the draw n * DRAWS + k
HEAT_OF, ADVANCE = 4, 2  # cars of a knock-out heat, and those of them that advance
LEAST, MOST = 2, 1024  # entrants of a cup


@dataclass(frozen=True)
class CupResult:
    """How an entrant did in a heat."""

    entry: str
    seed: int  # its place after qualifying, from 1; 0 in qualifying
    places: tuple[int, ...] = ()  # its place in each race
    lap_s: float | None = None  # its best lap in qualifying [s]; None without a complete lap
    distance: float = 0.0  # driven in qualifying [m]
    advances: bool = False  # whether it goes on, or has won the final


@dataclass(frozen=True)
class CupHeat:
    """A heat of a cup."""

    number: int | None  # of the heat; None before it is planned
    state: HeatState | None
    track: str
    runs: tuple[CupResult, ...]  # best first once it is over, before that in grid order


@dataclass(frozen=True)
class CupStage:
    """Heats that are raced at the same time."""

    name: str
    heats: tuple[CupHeat, ...]

    @property
    def over(self) -> bool:
        """Whether all of its heats are done."""
        return all(heat.state == "done" for heat in self.heats)


@dataclass(frozen=True)
class Bracket:
    """A cup as far as it has come."""

    stages: tuple[CupStage, ...]
    """Qualifying first; later stages appear when the one before is over."""
    due: Sequence[Heat]  # the heats of the last of them
    order: tuple[str, ...] = ()
    """Ids of the entries by how far they came, the winner first; empty before the end."""


def start(store: Store, name: str = "", *, anchors: bool = False) -> Cup:
    """Begin a cup of all rated entries and plan its qualifying; an empty name is its number.

    With `anchors` the league's own drivers take part, too. Too few or too many entries, or a name
    that is taken, are a StoreError.
    """
    entrants = [one.id for one in store.entries(RATED) if anchors or not one.anchor]
    if not LEAST <= len(entrants) <= MOST:
        raise StoreError(
            f"a cup has {LEAST} to {MOST} rated entrants, and this league has {len(entrants)} for "
            "it: submit more and let them race, or let the anchors take part (--anchors)"
        )
    rules = store.settings.ruleset
    alone = replace(rules, kind="time_trial", cars=1, obstacles=0, format="standing")
    kind = "head_to_head" if rules.kind == "time_trial" else rules.kind
    together = replace(rules, kind=kind, cars=HEAT_OF, format="standing")
    settings = {"entrants": entrants, "qualifying": alone.hash, "knock_out": together.hash}
    cup = store.start_cup(name, settings, [alone, together])
    advance(store)
    return cup


def named(store: Store, text: str) -> Cup:
    """Return the cup with this name or number (the last one for an empty text), or a StoreError."""
    known = store.cups()
    if not known:
        raise StoreError("this league has no cup yet: begin one with `league cup start`")
    found = [one for one in known if text in (one.name, str(one.number))] if text else known
    if not found:
        nearest = nearest_names(text, [one.name for one in known])
        raise StoreError(f"there is no cup {text!r} in this league; {nearest}")
    return found[-1]


def advance(store: Store) -> int:
    """Plan what is due in all running cups, freeze those that are over; return how many are new."""
    planned = 0
    for cup in store.cups():
        if cup.ended_s is not None:
            continue
        now = bracket(store, cup)
        if any(heat.number is None for heat in now.stages[-1].heats):
            planned += store.plan(now.due)
        if now.order:
            names = {entry.id: entry for entry in store.entries()}
            store.freeze(cup, document(cup, now, names))
    return planned


def document(cup: Cup, bracket: Bracket, entries: Mapping[str, LeagueEntry]) -> dict[str, Any]:
    """Return a cup as plain data, with the numbers and names of its entries (given by id)."""
    stages = documents.plain(bracket.stages)
    for run in (run for stage in stages for heat in stage["heats"] for run in heat["runs"]):
        entry = entries[run["entry"]]
        run |= {"entry": entry.number, "name": entry.name}
    order = [{"entry": entries[id].number, "name": entries[id].name} for id in bracket.order]
    about = {"number": cup.number, "name": cup.name, "season": cup.season, "seed": cup.seed}
    return {"cup": about, "stages": stages, "order": order}


def bracket(store: Store, cup: Cup) -> Bracket:
    """Return a cup as far as it has come."""
    rules = store.rulesets()
    qualifying, knock_out = (rules[cup.settings[name]] for name in ("qualifying", "knock_out"))
    entrants = cup.settings["entrants"]
    due = _heats(cup, qualifying, [(entry,) for entry in entrants], 0, stage=0)
    stages = [_qualified(cup, _stage(store, "Qualifying", due))]
    if not stages[0].over:
        return Bracket(tuple(stages), due)
    seeds = [heat.runs[0].entry for heat in stages[0].heats]
    seed_of = {entry: place for place, entry in enumerate(seeds, 1)}
    groups, used = _groups(seeds[: field_size(len(seeds))]), len(entrants)
    while True:
        due = _heats(cup, knock_out, groups, used, stage=len(stages))
        used += len(due)
        through = ADVANCE if len(groups) > 1 else 1
        stages.append(_stage(store, stage_name(len(groups)), due, seed_of, through))
        if not stages[-1].over:
            return Bracket(tuple(stages), due)
        if len(groups) == 1:
            return Bracket(tuple(stages), due, _order(stages))
        # Those who advance from the first and the last heat meet, and so on.
        passed = [[run.entry for run in heat.runs[:ADVANCE]] for heat in stages[-1].heats]
        pairs = zip(passed[: len(passed) // 2], reversed(passed), strict=False)
        groups = [tuple(sorted(one + other, key=seed_of.__getitem__)) for one, other in pairs]


def field_size(entrants: int) -> int:
    """Return how many of so many entrants the knock-out has: 4, 8, 16, ..., or 2 or 3."""
    if entrants < HEAT_OF:
        return entrants
    return HEAT_OF * 2 ** int(math.log2(entrants // HEAT_OF))


def _groups(seeds: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the first knock-out heats: the best qualifiers meet each other as late as possible."""
    heats = max(1, len(seeds) // HEAT_OF)
    if heats == 1:
        return [tuple(seeds)]
    picked = [(h, 2 * heats - 1 - h, 2 * heats + h, 4 * heats - 1 - h) for h in range(heats)]
    return [tuple(seeds[index] for index in one) for one in picked]


def stage_name(heats: int) -> str:
    """Return what the knock-out round of so many heats is called."""
    return {1: "Final", 2: "Semi-finals", 4: "Quarter-finals"}.get(heats, f"Last {HEAT_OF * heats}")


def _heats(
    cup: Cup, rules: Ruleset, grids: Sequence[tuple[str, ...]], first: int, *, stage: int
) -> list[Heat]:
    """Return the heats of a stage: one race alone, or two with the grid by qualifying and reversed.

    All are on the track that is drawn for the stage; `first` is the index of its first heat.
    """
    track = str(np.random.default_rng([cup.seed, stage]).choice(rules.tracks))
    heats: list[Heat] = []
    for draw, grid in enumerate(grids, cup.number * DRAWS + first):
        ways = (grid,) if stage == 0 else (grid, grid[::-1])
        halves = tuple(Half(track, way) for way in ways)
        heats.append(Heat(rules.hash, halves, draw=draw, purpose="cup"))
    return heats


def _stage(
    store: Store,
    name: str,
    due: Sequence[Heat],
    seed_of: Mapping[str, int] | None = None,
    through: int = 0,
) -> CupStage:
    """Return a stage as far as it has been raced; without seeds it is the qualifying."""
    seed_of = seed_of or {}
    records = {one.heat.key: one for one in store.heats_by_key([heat.key for heat in due])}
    numbers = [one.number for one in records.values() if one.state == "done"]
    results: dict[int, list[Any]] = {number: [] for number in numbers}
    for one in store.results(*numbers) if numbers else ():
        if not one.rejected:
            results[one.heat].append(one)
    heats = []
    for heat in due:
        record = records.get(heat.key)
        done = results.get(record.number, []) if record else []
        runs = [_run(heat, entry, seed_of.get(entry, 0), done) for entry in heat.halves[0].grid]
        if done and seed_of:
            runs.sort(key=lambda run: (sum(run.places), run.seed))
            runs = [replace(run, advances=at < through) for at, run in enumerate(runs)]
        number, state = (record.number, record.state) if record else (None, None)
        heats.append(CupHeat(number, state, heat.halves[0].track, tuple(runs)))
    return CupStage(name, tuple(heats))


def _run(heat: Heat, entry: str, seed: int, done: Sequence[Any]) -> CupResult:
    slots = [half.grid.index(entry) for half in heat.halves]
    places = tuple(one.places[slots[one.half]] for one in done)
    if seed or not done:
        return CupResult(entry, seed, places)
    (row,) = done[0].result["order"]
    return CupResult(entry, 0, places, min(row["lap_times_s"], default=None), row["distance"])


def _qualified(cup: Cup, stage: CupStage) -> CupStage:
    """Return the qualifying, sorted by lap, distance and a draw, once it is over."""
    if not stage.over:
        return stage
    lots = np.random.default_rng([cup.seed, 0, 1]).permutation(len(stage.heats)).tolist()
    lot_of = {heat.runs[0].entry: lot for heat, lot in zip(stage.heats, lots, strict=True)}

    def merit(heat: CupHeat) -> tuple[float, float, int]:
        run = heat.runs[0]
        return (math.inf if run.lap_s is None else run.lap_s, -run.distance, lot_of[run.entry])

    through = field_size(len(stage.heats))
    ordered = [
        replace(heat, runs=(replace(heat.runs[0], seed=place, advances=place <= through),))
        for place, heat in enumerate(sorted(stage.heats, key=merit), 1)
    ]
    return CupStage(stage.name, tuple(ordered))


def _order(stages: Sequence[CupStage]) -> tuple[str, ...]:
    """Return the entries by how far they came, then by their place there, then by qualifying."""
    order: dict[str, None] = {}
    for stage in stages[:0:-1]:
        placed = [
            (place, run.seed, run.entry)
            for heat in stage.heats
            for place, run in enumerate(heat.runs)
        ]
        order |= dict.fromkeys(entry for _, _, entry in sorted(placed))
    return (*order, *(h.runs[0].entry for h in stages[0].heats if h.runs[0].entry not in order))
