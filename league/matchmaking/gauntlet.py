"""Races outside the season: audits, gauntlets of a checkpoint, comparisons of two drivers."""

from __future__ import annotations

import secrets
from collections import Counter, deque
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
from league.matchmaking.ratings.table import SIGMAS_95
from league.matchmaking.scope import RatingScope, scope
from league.matchmaking.store import RATED, HeatOutcome, LeagueEntry, Store
from league.matchmaking.workers import Executor
from league.matchmaking.workers.dispatcher import heat_driver
from league.matchmaking.workers.worker import HeatDriver, HeatJob, check_physics

TRIES = 3
"""Tries of a heat that is not in the store's queue."""
NEWCOMER_SD = 200.0
"""How far from the field a newcomer may be, at least, before it has raced [Elo].

A field of near equals says little about the next driver: with the field's own narrow spread the
newcomer's interval would miss the truth more often than it says.
"""


@dataclass(frozen=True)
class SeededHeat:
    """A heat that is raced outside the season."""

    heat: Heat
    seeds: tuple[int, ...]
    """Seed of each race."""


def pick_audit(store: Store, share: float, generator: np.random.Generator) -> list[SeededHeat]:
    """Return the audits of a share of the finished rated heats, at least one if there are any.

    Those audited before are left out, so that repeated audits reach all.
    """
    if not 0 < share <= 1:
        raise ConfigError(
            f"a sample of {100 * share:g} % was asked for: give more than 0, at most 100"
        )
    ruleset = store.settings.ruleset.hash
    records = store.heats(("done", "planned", "claimed"))
    audited = {record.heat.audits for record in records if record.heat.audits}
    unaudited = [
        record
        for record in records
        if record.state == "done"
        and record.heat.purpose == "rated"
        and record.heat.ruleset == ruleset
        and record.heat.key not in audited
    ]
    if not unaudited:
        return []
    number = max(1, round(share * len(unaudited)))
    picked = sorted(generator.choice(len(unaudited), size=number, replace=False))
    chosen = [unaudited[int(index)] for index in picked]
    return [SeededHeat(heat_spec.audit_of(one.heat), one.seeds or ()) for one in chosen]


def audit(
    store: Store,
    executor: Executor,
    audits: Sequence[SeededHeat],
    *,
    watch: Callable[[HeatOutcome, str], None] = lambda outcome, verdict: None,
) -> Counter[str]:
    """Run heats again; return how many got each verdict (a field of Received).

    Those that differ are in quarantine then, but for races in Bullet on another class of machine.
    They do not wait in the queue, but the store receives them as if they had.
    """
    store.plan([one.heat for one in audits])
    raced = {id for one in audits for id in one.heat.entries}
    field = {one.id: heat_driver(store, one) for one in store.entries() if one.id in raced}
    verdicts = Counter[str]()

    def judge(outcome: HeatOutcome) -> bool:
        verdict = store.complete("auditor", [outcome]).verdict(outcome.key)
        verdicts[verdict] += 1
        watch(outcome, verdict)
        return True

    race(executor, store, audits, field, watch=judge)
    return verdicts


def duel(store: Store, one: str, other: str, draw: int, salt: bytes) -> SeededHeat:
    """Return a heat of two contestants by the league's rules, with seeds of its own."""
    rules = store.settings.ruleset
    generator = np.random.default_rng([draw, *salt])
    tracks = generator.choice(rules.tracks, size=2, replace=len(rules.tracks) < 2)
    first = str(tracks[0])
    second = str(tracks[1]) if len(rules.tracks) >= 4 else first
    heat = heat_spec.mirrored(rules.hash, (first, second), (one, other), draw)
    return SeededHeat(heat, heat.seeds(salt))


def race(
    executor: Executor,
    store: Store,
    heats: Sequence[SeededHeat],
    field: dict[str, HeatDriver],
    *,
    watch: Callable[[HeatOutcome], bool] = lambda outcome: True,
) -> list[HeatOutcome]:
    """Race heats of a field (by id) that are not in the store's queue; return their outcomes.

    `watch` is called with each outcome in the order of the heats; False ends it early. A heat that
    could not be raced three times in a row is a StoreError.
    """
    rules = store.settings.ruleset
    check_physics(rules, "this league")
    waiting, failures = deque(range(len(heats))), Counter[int]()
    running, outcomes, watched = dict[str, int](), dict[int, HeatOutcome](), 0
    while len(outcomes) < len(heats):
        while executor.free and waiting:
            number = waiting.popleft()
            heat, seeds = heats[number].heat, heats[number].seeds
            contestants = {id: field[id] for id in heat.entries}
            executor.offer(HeatJob(heat.key, number, heat.halves, seeds, rules, contestants, False))
            running[heat.key] = number
        for report in executor.wait(0.5):
            number = running.pop(report.key)
            if report.outcome is not None:
                outcomes[number] = report.outcome
                continue
            failures[number] += 1
            if failures[number] == TRIES:
                last = (report.traceback.strip().splitlines() or ["no reason given"])[-1]
                raise StoreError(
                    f"a race failed {TRIES} times ({last[:200]}): look at the cause, try again"
                )
            waiting.appendleft(number)
        while watched in outcomes:
            watched += 1
            if not watch(outcomes[watched - 1]):
                return [outcomes[number] for number in range(watched)]
    return [outcomes[number] for number in range(len(heats))]


def points_of(heat: Heat, outcome: HeatOutcome, id: str) -> list[float]:
    """Return the points of a contestant of a duel in each of its races: 1, 0.5 for a tie, or 0."""
    points = []
    for half, result in zip(heat.halves, outcome.races, strict=True):
        slot = half.grid.index(id)
        points.append(0.5 + 0.5 * float(np.sign(result.places[1 - slot] - result.places[slot])))
    return points


@dataclass(frozen=True)
class GauntletResult:
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
    """The best rank that the races allow."""
    worst_rank: int
    """The worst rank that the races allow."""
    against: tuple[tuple[str, int, float], ...]
    """Name, races and points against each opponent."""


def opponents(store: Store, *, most: int = 8) -> list[LeagueEntry]:
    """Return opponents for a gauntlet: rated entries evenly spread over the table."""
    entries = {entry.number: entry for entry in store.entries(RATED)}
    try:
        order = [row.number for row in standings.of(store).rows]
    except StoreError:
        order = list(entries)
    ordered = [entries[number] for number in order if number in entries]
    if not ordered:
        raise StoreError("there is no entry to race in this league yet: submit entries first")
    spread = np.unique(np.linspace(0, len(ordered) - 1, min(most, len(ordered))).round())
    return [ordered[int(index)] for index in spread]


def gauntlet(
    store: Store,
    executor: Executor,
    newcomer: Checkpoint,
    field: Sequence[LeagueEntry],
    *,
    rounds: int = 1,
    watch: Callable[[HeatOutcome], bool] = lambda outcome: True,
) -> GauntletResult:
    """Race a checkpoint against opponents without submitting it; the league keeps nothing of it."""
    submission.check_sensors(newcomer.card.sensors, store.settings.ruleset)
    own = HeatDriver(newcomer.digest, newcomer.card.name, weights=submission.pack(newcomer))
    contestants = {entry.id: heat_driver(store, entry) for entry in field}
    contestants[own.id] = own
    salt = secrets.token_bytes(16)
    heats = [
        duel(store, own.id, entry.id, draw * len(field) + number, salt)
        for draw in range(rounds)
        for number, entry in enumerate(field)
    ]
    outcomes = race(executor, store, heats, contestants, watch=watch)
    return _placed(store, own.id, field, heats[: len(outcomes)], outcomes)


def _placed(
    store: Store,
    newcomer: str,
    field: Sequence[LeagueEntry],
    heats: Sequence[SeededHeat],
    outcomes: Sequence[HeatOutcome],
) -> GauntletResult:
    """Rate the newcomer with all entries, from all races of the league and its own."""
    entries = store.entries()
    number_of = {entry.id: entry.number for entry in entries}
    own = number_of[newcomer] = max(number_of.values()) + 1
    fitted = _fit_with(scope(store), heats, outcomes, number_of, entries)
    points: dict[str, list[float]] = {entry.id: [] for entry in field}
    for one, outcome in zip(heats, outcomes, strict=True):
        other = next(id for id in one.heat.entries if id != newcomer)
        points[other] += points_of(one.heat, outcome, newcomer)
    at = fitted.index(own)
    rank = 1 + int((fitted.elo > fitted.elo[at]).sum())
    low, high = fitted.elo - SIGMAS_95 * fitted.sd, fitted.elo + SIGMAS_95 * fitted.sd
    return GauntletResult(
        **fitted.line(at, "elo", "low95", "high95", "provisional", "one_sided"),
        rank=rank,
        best_rank=min(rank, 1 + int((low > high[at]).sum())),
        worst_rank=max(rank, len(fitted.entries) - int((high < low[at]).sum())),
        against=tuple((e.name, len(points[e.id]), sum(points[e.id])) for e in field),
    )


def _fit_with(
    within: RatingScope,
    heats: Sequence[SeededHeat],
    outcomes: Sequence[HeatOutcome],
    number_of: dict[str, int],
    entries: Sequence[LeagueEntry],
) -> Ratings:
    """Return the fit of a season with some heats more, of at least a newcomer's spread."""
    season = standings.results_of(within.races)
    first = int(season.heats.max(initial=0)) + 1
    grids = [[number_of[id] for id in half.grid] for one in heats for half in one.heat.halves]
    places = [result.places for outcome in outcomes for result in outcome.races]
    room = ((0, 0), (0, season.entries.shape[1] - 2))  # a duel has two cars, others may have more
    both = Results(
        heats=np.append(season.heats, np.repeat(np.arange(first, first + len(heats)), 2)),
        entries=np.concatenate([season.entries, np.pad(grids, room, constant_values=-1)]),
        places=np.concatenate([season.places, np.pad(places, room)]),
    )
    anchor = standings.anchor_of(both.entries, entries)
    fitted = ratings.fit(both, anchor=anchor, carried=within.carried)
    if fitted.prior_sd >= NEWCOMER_SD:
        return fitted
    wide = ratings.RatingSettings(prior_sd=NEWCOMER_SD)
    return ratings.fit(both, wide, anchor=anchor, carried=within.carried)


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
    heats = [duel(store, one.id, other.id, draw, salt) for draw in range(most_heats)]
    scores: list[float] = []
    comparison = sprt.compare(np.array(scores), settings)

    def judge(outcome: HeatOutcome) -> bool:
        nonlocal comparison
        scores.append(float(np.mean(points_of(heats[len(scores)].heat, outcome, other.id))))
        comparison = sprt.compare(np.array(scores), settings)
        watch(comparison)
        return comparison.decision == "undecided"

    race(executor, store, heats, {one.id: one, other.id: other}, watch=judge)
    return comparison
