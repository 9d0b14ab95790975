"""Races beside the season: audits, a gauntlet for a checkpoint, and is B better than A."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from league.agents.checkpoint import Checkpoint
from league.errors import ConfigError, StoreError
from league.matchmaking import ratings, standings, submission
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Heat
from league.matchmaking.ratings import Ratings, Results, sprt
from league.matchmaking.ratings.sprt import Comparison, SequentialSettings
from league.matchmaking.store import RATED, Entry, HeatOutcome, Store
from league.matchmaking.workers import Executor
from league.matchmaking.workers.dispatcher import heat_driver
from league.matchmaking.workers.worker import HeatDriver, HeatJob, HeatReport, check_physics

TRIES = 3
"""Tries of a heat that is not the store's."""
NEWCOMER_SD = 200.0
"""How far from the field a newcomer may be, at least, before it has raced [Elo].

A field of near equals says little about who comes next: with its own narrow spread the newcomer's
interval would miss the truth more often than it says.
"""


@dataclass(frozen=True)
class Duel:
    """What a heat beside the season is made of."""

    heat: Heat
    """Races, with the grid reversed in the second."""
    seeds: tuple[int, ...]
    """Seed of each race."""


def pick_audit(store: Store, share: float, generator: np.random.Generator) -> list[Duel]:
    """Return the audits of a share of the finished rated heats, at least one if there are any.

    Those audited before are left out, so that repeated audits reach everybody.
    """
    if not 0 < share <= 1:
        raise ConfigError(
            f"a sample of {100 * share:g} % was asked for: give more than 0, at most 100"
        )
    ruleset = store.settings.ruleset.hash
    records = store.heats(("done", "planned", "claimed"))
    audited = {record.heat.audits for record in records if record.heat.audits}
    open_ = [
        record
        for record in records
        if record.state == "done"
        and record.heat.purpose == "rated"
        and record.heat.ruleset == ruleset
        and record.heat.key not in audited
    ]
    if not open_:
        return []
    count = max(1, round(share * len(open_)))
    picked = generator.choice(len(open_), size=count, replace=False)
    chosen = [open_[int(index)] for index in sorted(picked)]
    return [Duel(heat_spec.audit_of(record.heat), record.seeds or ()) for record in chosen]


def audit(
    store: Store,
    executor: Executor,
    audits: Sequence[Duel],
    *,
    watch: Callable[[HeatOutcome, bool], None] = lambda outcome, agrees: None,
) -> int:
    """Run heats again; return how many differ, which puts them in quarantine.

    They do not wait in the queue, but the store is told of them as if they had.
    """
    store.plan([one.heat for one in audits])
    entries = {entry.id: entry for entry in store.entries()}
    wanted = {id for one in audits for id in one.heat.entries}
    field = {id: heat_driver(store, entries[id]) for id in wanted}
    differ = 0

    def judge(outcome: HeatOutcome) -> bool:
        nonlocal differ
        agrees = not store.complete("auditor", [outcome]).quarantined
        differ += not agrees
        watch(outcome, agrees)
        return True

    race(executor, store, audits, field, watch=judge)
    return differ


def duel(store: Store, one: str, other: str, draw: int, salt: bytes) -> Duel:
    """Return a heat of two contestants by the league's rules, with seeds of its own."""
    rules = store.settings.ruleset
    generator = np.random.default_rng([draw, *salt])
    tracks = generator.choice(rules.tracks, size=2, replace=len(rules.tracks) < 2)
    first = str(tracks[0])
    second = str(tracks[1]) if len(rules.tracks) >= 4 else first
    heat = heat_spec.mirrored(rules.hash, (first, second), (one, other), draw)
    return Duel(heat, heat.seeds(salt))


def race(
    executor: Executor,
    store: Store,
    duels: Sequence[Duel],
    field: dict[str, HeatDriver],
    *,
    watch: Callable[[HeatOutcome], bool] = lambda outcome: True,
) -> list[HeatOutcome]:
    """Race heats that are not the store's; outcomes are in the order of the duels.

    Args:
        executor: where they are raced.
        store: whose rules count.
        duels: what is raced.
        field: who takes part.
        watch: told each outcome in the order of the duels; False ends it early.

    Raises:
        StoreError: a heat could not be raced three times in a row.
    """
    rules = store.settings.ruleset
    check_physics(rules, "this league")
    waiting = [(number, TRIES) for number in range(len(duels))]
    under_way: dict[str, tuple[int, int]] = {}
    outcomes: dict[int, HeatOutcome] = {}
    told = 0
    while len(outcomes) < len(duels):
        while executor.free and waiting:
            number, tries = waiting.pop(0)
            one = duels[number]
            some = {id: field[id] for id in one.heat.entries}
            job = HeatJob(one.heat.key, number, one.heat.halves, one.seeds, rules, some, False)
            executor.offer(job)
            under_way[one.heat.key] = (number, tries)
        for report in executor.wait(0.5):
            number, tries = under_way.pop(report.key)
            if report.outcome is None:
                _give_up(report, tries)
                waiting.insert(0, (number, tries - 1))
                continue
            outcomes[number] = report.outcome
        while told in outcomes:
            told += 1
            if not watch(outcomes[told - 1]):
                return [outcomes[number] for number in range(told)]
    return [outcomes[number] for number in range(len(duels))]


def _give_up(report: HeatReport, tries: int) -> None:
    if tries <= 1:
        last = (report.traceback.strip().splitlines() or ["no reason told"])[-1]
        raise StoreError(
            f"a race failed {TRIES} times ({last[:200]}): look at the cause, try again"
        )


@dataclass(frozen=True)
class Gauntlet:
    """How a newcomer did against the field."""

    elo: float
    """Its strength [Elo]."""
    low95: float
    """Lower end of the 95 % interval [Elo]."""
    high95: float
    """Upper end of the 95 % interval [Elo]."""
    provisional: bool
    """Known to worse than sd 50, or not connected to the anchor."""
    one_sided: bool
    """Won, or lost, every race: read the number as "at least", or "at most"."""
    rank: int
    """Where that would put it."""
    best_rank: int
    """The rank it may have: only those count above it whose whole interval is above its own."""
    worst_rank: int
    """The rank it may have: only those count below it whose whole interval is below its own."""
    against: tuple[tuple[str, int, float], ...]
    """Name, races and points against each opponent."""


def opponents(store: Store, *, most: int = 8) -> list[Entry]:
    """Return opponents for a gauntlet: rated entries evenly spread over the table."""
    entries = {e.number: e for e in store.entries(RATED)}
    try:
        table = standings.of(store)
        ordered = [entries[row.number] for row in table.rows if row.number in entries]
    except StoreError:
        ordered = list(entries.values())
    if not ordered:
        raise StoreError("there is nobody to race in this league yet: submit entries first")
    picked = np.unique(np.linspace(0, len(ordered) - 1, min(most, len(ordered))).round())
    return [ordered[int(index)] for index in picked]


def gauntlet(
    store: Store,
    executor: Executor,
    given: Checkpoint,
    field: Sequence[Entry],
    *,
    rounds: int = 1,
    watch: Callable[[HeatOutcome], bool] = lambda outcome: True,
) -> Gauntlet:
    """Race a checkpoint against opponents without submitting it; the league keeps nothing of it."""
    submission.check_sensors(given.card.sensors, store.settings.ruleset)
    newcomer = HeatDriver(given.digest, given.card.name, weights=submission.pack(given))
    contestants = {entry.id: heat_driver(store, entry) for entry in field}
    contestants[newcomer.id] = newcomer
    salt = secrets.token_bytes(16)
    duels = [
        duel(store, newcomer.id, entry.id, draw * len(field) + number, salt)
        for draw in range(rounds)
        for number, entry in enumerate(field)
    ]
    outcomes = race(executor, store, duels, contestants, watch=watch)
    return _placed(store, newcomer.id, field, duels, outcomes)


def _placed(
    store: Store,
    newcomer: str,
    field: Sequence[Entry],
    duels: Sequence[Duel],
    outcomes: Sequence[HeatOutcome],
) -> Gauntlet:
    """Rate the newcomer with everybody else, from all races of the league and its own."""
    entries = store.entries()
    number_of = {entry.id: entry.number for entry in entries}
    own = number_of[newcomer] = max(number_of.values()) + 1
    season = standings.results_of(store.races())
    fitted = _with(season, duels[: len(outcomes)], outcomes, number_of, entries)
    at = fitted.index(own)
    points = {entry.id: [0, 0.0] for entry in field}
    for one, outcome in zip(duels, outcomes, strict=False):
        for half, told in zip(one.heat.halves, outcome.races, strict=True):
            other = next(id for id in half.grid if id != newcomer)
            mine, theirs = (told.places[half.grid.index(id)] for id in (newcomer, other))
            points[other][0] += 1
            points[other][1] += 0.5 + 0.5 * float(np.sign(theirs - mine))
    low, high = float(fitted.low95[at]), float(fitted.high95[at])
    rank = 1 + int((fitted.elo > fitted.elo[at]).sum())
    return Gauntlet(
        elo=float(fitted.elo[at]),
        low95=low,
        high95=high,
        provisional=bool(fitted.provisional[at]),
        one_sided=bool(fitted.one_sided[at]),
        rank=rank,
        best_rank=min(rank, 1 + int((fitted.low95 > high).sum())),
        worst_rank=max(rank, len(fitted.entries) - int((fitted.high95 < low).sum())),
        against=tuple((e.name, int(points[e.id][0]), points[e.id][1]) for e in field),
    )


def _with(
    season: Results,
    duels: Sequence[Duel],
    outcomes: Sequence[HeatOutcome],
    number_of: dict[str, int],
    entries: Sequence[Entry],
) -> Ratings:
    """Return the fit of a season with some heats more, of at least a newcomer's spread."""
    width = season.entries.shape[1]
    first = int(season.heats.max(initial=0)) + 1
    heats, grids, places = [], [], []
    for heat, (one, outcome) in enumerate(zip(duels, outcomes, strict=True), first):
        for half, told in zip(one.heat.halves, outcome.races, strict=True):
            heats.append(heat)
            grids.append([number_of[id] for id in half.grid] + [-1] * (width - 2))
            places.append([*told.places] + [0] * (width - 2))
    both = Results(
        heats=np.concatenate([season.heats, np.array(heats, dtype=np.int64)]),
        entries=np.concatenate([season.entries, np.array(grids, dtype=np.int64)]),
        places=np.concatenate([season.places, np.array(places, dtype=np.int64)]),
    )
    raced = set(np.unique(both.entries).tolist())
    anchors = [entry.number for entry in entries if entry.anchor and entry.number in raced]
    anchor = min(anchors, default=None)
    fitted = ratings.fit(both, anchor=anchor)
    if fitted.prior_sd >= NEWCOMER_SD:
        return fitted
    return ratings.fit(both, ratings.RatingSettings(prior_sd=NEWCOMER_SD), anchor=anchor)


def compare(
    store: Store,
    executor: Executor,
    one: HeatDriver,
    other: HeatDriver,
    settings: SequentialSettings,
    *,
    most_heats: int,
    watch: Callable[[Comparison], None] = lambda comparison: None,
) -> Comparison:
    """Race two contestants until the sequential test is sure, or the heats are used up.

    Outcomes are judged in the order they were planned, so that fast races do not weigh more.
    """
    salt = secrets.token_bytes(16)
    duels = [duel(store, one.id, other.id, draw, salt) for draw in range(most_heats)]
    scores: list[float] = []
    found = sprt.compare(np.array(scores), settings)

    def judge(outcome: HeatOutcome) -> bool:
        nonlocal found
        heat = duels[len(scores)].heat
        points = [
            0.5 + 0.5 * float(np.sign(told.places[half.grid.index(one.id)]
                                      - told.places[half.grid.index(other.id)]))
            for half, told in zip(heat.halves, outcome.races, strict=True)
        ]  # fmt: skip
        scores.append(float(np.mean(points)))
        found = sprt.compare(np.array(scores), settings)
        watch(found)
        return found.decision == "undecided"

    race(executor, store, duels, {one.id: one, other.id: other}, watch=judge)
    return found
