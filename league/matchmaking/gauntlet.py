"""Races outside the season: audits, gauntlets of a checkpoint, comparisons of two drivers."""

import secrets
from collections import Counter, deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from league.agents.checkpoint import Checkpoint
from league.errors import ConfigError, StoreError
from league.matchmaking import ratings, standings, submission
from league.matchmaking.loop import heat_driver
from league.matchmaking.pairing import heat_spec
from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.ratings import Ratings, Results, sprt
from league.matchmaking.ratings.pair_counts import score
from league.matchmaking.ratings.sprt import Comparison, SequentialSettings
from league.matchmaking.ratings.table import SIGMAS_95
from league.matchmaking.scope import RatingScope, scope
from league.matchmaking.store import RATED, HeatOutcome, HeatRecord, LeagueEntry, Store
from league.matchmaking.workers import Executor
from league.matchmaking.workers.worker import HeatDriver, HeatJob, HeatReport, check_physics

TRIES = 3  # tries of a heat that is not in the store's queue
NEWCOMER_SD = 200.0
"""How far from the field a newcomer may be, at least, before it has raced [Elo].

A field of near equals says little about the next driver: with the field's own narrow spread the
newcomer's interval would miss the truth more often than it says.
"""


def pick_audit(store: Store, share: float, generator: np.random.Generator) -> list[HeatRecord]:
    """Return a share of the finished rated heats to run again, at least one if there are any.

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
    return [unaudited[int(index)] for index in picked]


def audit(
    store: Store,
    executor: Executor,
    heats: Sequence[HeatRecord],
    *,
    watch: Callable[[int, str], None] = lambda number, verdict: None,
) -> Counter[str]:
    """Run heats again; return how many got each verdict (a field of Received).

    Those that differ are in quarantine then, but for races in Bullet on another class of machine.
    They do not wait in the queue, but the store receives them as if they had. `watch` is called
    with the number of each heat and its verdict.
    """
    audits = [heat_spec.audit_of(one.heat) for one in heats]
    store.plan(audits)
    rules, raced = store.settings.ruleset, {id for heat in audits for id in heat.entries}
    field = {one.id: heat_driver(store, one) for one in store.entries() if one.id in raced}
    jobs: list[HeatJob] = []
    for one, heat in zip(heats, audits, strict=True):
        drivers, seeds = {id: field[id] for id in heat.entries}, one.seeds or ()
        jobs.append(HeatJob(heat.key, one.number, heat.halves, seeds, rules, drivers, False))
    number_of, verdicts = {job.key: job.number for job in jobs}, Counter[str]()

    def judge(outcome: HeatOutcome) -> bool:
        verdict = store.complete("auditor", [outcome]).verdict(outcome.key)
        verdicts[verdict] += 1
        watch(number_of[outcome.key], verdict)
        return True

    race(executor, jobs, watch=judge)
    return verdicts


def duel(rules: Ruleset, one: HeatDriver, other: HeatDriver, draw: int, salt: bytes) -> HeatJob:
    """Return a heat of two contestants by the league's rules, with seeds of its own."""
    generator = np.random.default_rng([draw, *salt])
    tracks = generator.choice(rules.tracks, size=2, replace=len(rules.tracks) < 2)
    first = str(tracks[0])
    second = str(tracks[1]) if len(rules.tracks) >= 4 else first
    heat = heat_spec.mirrored(rules.hash, (first, second), (one.id, other.id), draw)
    drivers = {one.id: one, other.id: other}
    return HeatJob(heat.key, draw, heat.halves, heat.seeds(salt), rules, drivers, False)


def race(
    executor: Executor,
    jobs: Sequence[HeatJob],
    *,
    watch: Callable[[HeatOutcome], bool] = lambda outcome: True,
) -> list[HeatOutcome]:
    """Race heats under one ruleset that are not in the store's queue; return their outcomes.

    `watch` is called with each outcome in the order of the heats; False ends it early. A heat that
    could not be raced three times in a row is a StoreError.
    """
    check_physics(jobs[0].ruleset, "this league")
    waiting, failures = deque(range(len(jobs))), Counter[int]()
    place_of = {job.key: place for place, job in enumerate(jobs)}
    outcomes, watched = dict[int, HeatOutcome](), 0
    while len(outcomes) < len(jobs):
        while executor.free and waiting:
            executor.offer(jobs[waiting.popleft()])
        for report in executor.wait(0.5):
            if not isinstance(report, HeatReport):
                continue
            place = place_of[report.key]
            if report.outcome is not None:
                outcomes[place] = report.outcome
                continue
            failures[place] += 1
            if failures[place] == TRIES:
                last = (report.traceback.strip().splitlines() or ["no reason given"])[-1]
                raise StoreError(
                    f"a race failed {TRIES} times ({last[:200]}): look at the cause, try again"
                )
            waiting.appendleft(place)
        while watched in outcomes:
            watched += 1
            if not watch(outcomes[watched - 1]):
                return [outcomes[place] for place in range(watched)]
    return [outcomes[place] for place in range(len(jobs))]


def points_of(heat: HeatJob, outcome: HeatOutcome, id: str) -> list[float]:
    """Return the points of a contestant of a duel in each of its races: 1, 0.5 for a tie, or 0."""
    places: list[tuple[int, int]] = []
    for half, result in zip(heat.halves, outcome.races, strict=True):
        slot = half.grid.index(id)
        places.append((result.places[slot], result.places[1 - slot]))
    return score(*np.array(places).T).tolist()


@dataclass(frozen=True)
class GauntletResult:
    """How a newcomer did against the field."""

    elo: float  # its strength [Elo]
    low95: float  # lower end of the 95 % interval [Elo]
    high95: float  # upper end of the 95 % interval [Elo]
    provisional: bool  # known to worse than sd 50, or not connected to the anchor
    one_sided: bool  # won, or lost, every race: read the number as "at least", or "at most"
    rank: int  # where that would put it
    best_rank: int  # the best rank that the races allow
    worst_rank: int  # the worst rank that the races allow
    against: tuple[tuple[str, int, float], ...]  # name, races and points against each opponent


def opponents(store: Store, *, most: int) -> list[LeagueEntry]:
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
    rounds: int,
    watch: Callable[[HeatOutcome], bool],
) -> GauntletResult:
    """Race a checkpoint against opponents without submitting it; the league keeps nothing of it."""
    rules, salt = store.settings.ruleset, secrets.token_bytes(16)
    submission.check_sensors(newcomer.card.sensors, rules)
    own = HeatDriver(newcomer.digest, newcomer.card.name, weights=submission.pack(newcomer))
    others = [heat_driver(store, entry) for entry in field] * rounds
    heats = [duel(rules, own, other, draw, salt) for draw, other in enumerate(others)]
    outcomes = race(executor, heats, watch=watch)
    return _placed(store, own.id, field, heats[: len(outcomes)], outcomes)


def _placed(
    store: Store,
    newcomer: str,
    field: Sequence[LeagueEntry],
    heats: Sequence[HeatJob],
    outcomes: Sequence[HeatOutcome],
) -> GauntletResult:
    """Rate the newcomer with all entries, from all races of the league and its own."""
    entries = store.entries()
    number_of = {entry.id: entry.number for entry in entries}
    own = number_of[newcomer] = max(number_of.values()) + 1
    fitted = _fit_with(scope(store), heats, outcomes, number_of, entries)
    points: dict[str, list[float]] = {entry.id: [] for entry in field}
    for one, outcome in zip(heats, outcomes, strict=True):
        other = next(id for id in one.drivers if id != newcomer)
        points[other] += points_of(one, outcome, newcomer)
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
    heats: Sequence[HeatJob],
    outcomes: Sequence[HeatOutcome],
    number_of: dict[str, int],
    entries: Sequence[LeagueEntry],
) -> Ratings:
    """Return the fit of a season with some heats more, of at least a newcomer's spread."""
    season = standings.results_of(within.races)
    first = int(season.heats.max(initial=0)) + 1
    grids = [[number_of[id] for id in half.grid] for one in heats for half in one.halves]
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
    rules, salt = store.settings.ruleset, secrets.token_bytes(16)
    heats = [duel(rules, one, other, draw, salt) for draw in range(most_heats)]
    scores: list[float] = []

    def judge(outcome: HeatOutcome) -> bool:
        scores.append(float(np.mean(points_of(heats[len(scores)], outcome, other.id))))
        comparison = sprt.compare(np.array(scores), settings)
        watch(comparison)
        return comparison.decision == "undecided"

    race(executor, heats, watch=judge)
    return sprt.compare(np.array(scores), settings)
