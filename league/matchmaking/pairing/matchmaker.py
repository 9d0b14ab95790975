"""The season's matchmaker: who is rated, who races next; a function of what has been raced.

Heats are planned in rounds, and two rounds are in the queue at a time, so that workers never wait
for a refit. Round n is planned from the results of rounds 1 to n - 2, whatever else is known by
then. So the same league raced by more workers, slower, or with a dozen crashes in between plans
the same heats, and ends with the same ratings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations

import numpy as np

from league.matchmaking import standings
from league.matchmaking.pairing.heat_spec import Half, Heat, Purpose, Ruleset
from league.matchmaking.pairing.schedule import (
    HeatPlan,
    PairingSettings,
    Standing,
    next_heats,
    next_state,
    validation_heats,
)
from league.matchmaking.store import RATED, Entry, EntryState, HeatRecord, Races, Store

ROUND = 4096
"""Heats of a round at most; heat k of round n has the draw n * ROUND + k."""
LEAST_ROUND = 8
"""Heats of a round at least."""
LOOK_BACK = 3000
"""Heats among which the latest round is looked for first."""


def found(store: Store, anchors: Sequence[str]) -> list[Entry]:
    """Enter scripted drivers as a new league's anchors; the first one is pinned to 1000.

    They ship with the program, so they need no validation.
    """
    entered = [
        store.submit(name, "league", scripted=name, anchor=True, card={"name": name})
        for name in anchors
    ]
    ids = [entry.id for entry in entered]
    store.move(dict.fromkeys(ids, "validating"))
    store.move(dict.fromkeys(ids, "placement"))
    return store.entries()


@dataclass(frozen=True)
class Round:
    """A round of heats in the queue."""

    number: int
    """From 1; 0 stands for none."""
    first: int
    """Number of its first heat; all earlier rounds have smaller ones."""
    open: bool
    """Whether any of its heats, or of an earlier round's, is not over."""
    earlier_open: bool
    """Whether any heat of an earlier round is not over."""


@dataclass(frozen=True)
class _Evidence:
    """What a round is planned from."""

    races: Races
    """Rated races."""
    before: int | None
    """Only heats with a smaller number count; None: all."""
    queued: list[HeatRecord]
    """Heats that are not part of the evidence but planned, whatever became of them."""

    def counts(self, heat: int) -> bool:
        """Return whether a heat's result may be looked at."""
        return self.before is None or heat < self.before


class Season:
    """A league's matchmaker; all it knows is in the store, so another may take over any time."""

    def __init__(
        self, store: Store, *, same_owner: bool = False, least_round: int = LEAST_ROUND
    ) -> None:
        """Take charge of a league.

        Args:
            store: the league.
            same_owner: whether entries of one owner meet; a league of one person needs it.
            least_round: heats of a round at least; a few for each worker.
        """
        self._store, self._least_round = store, least_round
        self._same_owner = same_owner
        self._latest = Round(0, 0, False, False)

    def plan(self) -> int:
        """Plan the next round if it is due, and move entries; return how many heats are new."""
        rules = self._store.settings.ruleset
        if self._still_early(rules.hash):
            return 0
        latest = self._find_latest(rules.hash)
        if latest.earlier_open:
            return 0
        if latest.number and (planned := self._planned(rules, latest, latest.first)):
            return self._store.plan(planned)
        if latest.open:
            return 0
        return self._store.plan(self._planned(rules, latest, None))

    def _still_early(self, ruleset: str) -> bool:
        """Return whether a heat before the latest known round is open, so that no round is due.

        It is asked after every heat, and nearly always so: reading one heat tells, where the
        rounds in the queue are hundreds of heats in a large league.
        """
        first = _season_heats(self._store.heats(("planned", "claimed"), limit=1), ruleset)
        return bool(first) and first[0].number < self._latest.first

    def _find_latest(self, ruleset: str) -> Round:
        """Return the newest round; what is known of it from last time saves reading."""
        known = self._latest
        since = known.first - 1
        if not known.number:
            since = max(0, sum(self._store.counts().values()) - LOOK_BACK)
        heats = _season_heats(self._store.heats(since=since), ruleset)
        if not heats and since > 0 and not known.number:
            heats = _season_heats(self._store.heats(), ruleset)
        if not heats:
            return Round(0, 0, False, False)
        number = max(_round(record) for record in heats)
        first = min(record.number for record in heats if _round(record) == number)
        waiting = self._store.heats(("planned", "claimed"))
        rounds = [_round(record) for record in _season_heats(waiting, ruleset)]
        earlier = any(one < number for one in rounds)
        self._latest = Round(number, first, bool(rounds), earlier)
        return self._latest

    def _planned(self, rules: Ruleset, latest: Round, before: int | None) -> list[Heat]:
        """Return the round after the latest one, and move entries to where they stand by now."""
        queued = self._store.heats(since=before - 1) if before else []
        evidence = _Evidence(
            self._store.races(rules.hash), before, _season_heats(queued, rules.hash)
        )
        number = latest.number + 1
        generator = np.random.default_rng([number, int(rules.hash[:12], 16)])
        settings = PairingSettings(
            field_size=rules.cars, tracks=rules.tracks, same_owner=self._same_owner
        )
        entries = self._store.entries()
        field_ = _Field.of(entries, evidence, self._validations(entries, rules.hash), settings)
        self._move(entries, field_)
        plans: list[HeatPlan] = []
        for newcomer in field_.newcomers:
            plans += validation_heats(newcomer, field_.standings, settings, generator)
        rated = [standing for standing in field_.standings if standing.state in RATED]
        wanted = min(max(self._least_round, len(rated) // 2), ROUND // 2)
        if field_.coming and all(standing.anchor for standing in rated):
            wanted = 0  # a new league's first entries need not wait for its anchors to be sure
        plans = plans[: ROUND // 2]
        id_of = {entry.number: entry.id for entry in entries}
        met = _met(evidence, {id: number for number, id in id_of.items()})
        plans += next_heats(rated, met, settings, generator, heats=wanted)
        return [
            _heat(plan, rules.hash, number * ROUND + index, id_of)
            for index, plan in enumerate(plans)
        ]

    def _validations(self, entries: Sequence[Entry], ruleset: str) -> dict[int, list[HeatRecord]]:
        """Return the validation heats of entries that are on their way in, by entry number."""
        return {
            entry.number: [
                record
                for record in self._store.heats(entries=[entry.number])
                if record.heat.purpose == "validation" and record.heat.ruleset == ruleset
            ]
            for entry in entries
            if entry.state in ("pending", "validating")
        }

    def _move(self, entries: Sequence[Entry], field_: _Field) -> None:
        """Write into the store where entries stand, one lawful step at a time."""
        for entry in entries:
            wanted, reason = field_.states[entry.number]
            if entry.state == wanted:
                continue
            if entry.state == "pending":
                self._store.move({entry.id: "validating"})
            if wanted in RATED and entry.state in ("pending", "validating"):
                self._store.move({entry.id: "placement"})
            self._store.move({entry.id: wanted}, reason=reason)


@dataclass
class _Field:
    """All entries as pairing sees them, by the evidence alone."""

    standings: list[Standing] = field(default_factory=list)
    newcomers: list[Standing] = field(default_factory=list)
    """Those whose validation heats are to be planned."""
    states: dict[int, tuple[EntryState, str]] = field(default_factory=dict)
    """Where each entry stands, and why it was refused."""
    coming: int = 0
    """Entries of which it is not known yet whether they pass."""

    @classmethod
    def of(
        cls,
        entries: Sequence[Entry],
        evidence: _Evidence,
        validations: dict[int, list[HeatRecord]],
        settings: PairingSettings,
    ) -> _Field:
        """Return where everybody stands."""
        field_ = cls()
        results = standings.results_of(evidence.races, before=evidence.before)
        passed = {n for n, heats in validations.items() if _passed(heats, evidence)}
        fitted = standings.rated(results, entries, passed)
        for entry in entries:
            state, reason = entry.state, entry.reason
            heats = validations.get(entry.number, [])
            if heats and any(record.state == "quarantined" for record in heats):
                state, reason = "refused", "the same race went two ways: it is not deterministic"
            elif entry.number in passed:
                state = "placement"
            elif heats:
                state = "validating"
                field_.coming += not all(evidence.counts(record.number) for record in heats)
            field_.states[entry.number] = (state, reason)
            if state in ("retired", "refused"):
                continue
            standing = Standing(
                entry.number, state, owner="" if entry.anchor else entry.owner, anchor=entry.anchor
            )
            if state == "pending":
                field_.newcomers.append(standing)
                field_.coming += 1
            elif state in RATED and fitted is not None:
                at = fitted.index(entry.number)
                sd = float(fitted.sd[at])
                standing = replace(
                    standing,
                    state=next_state(state, sd, settings=settings),
                    elo=float(fitted.elo[at]),
                    sd=sd,
                    races=int(fitted.races[at]),
                )
                field_.states[entry.number] = (standing.state, reason)
            field_.standings.append(standing)
        return field_


def _passed(heats: Sequence[HeatRecord], evidence: _Evidence) -> bool:
    return bool(heats) and all(
        record.state == "done" and evidence.counts(record.number) for record in heats
    )


def _met(evidence: _Evidence, number_of: dict[str, int]) -> dict[tuple[int, int], int]:
    """Return the heats in which each pair met or is to meet, by entry numbers."""
    races = evidence.races
    once = races.half == 0
    if evidence.before is not None:
        once &= races.heat < evidence.before
    grids = races.entries[once]
    met: dict[tuple[int, int], int] = {}
    for record in evidence.queued:
        if record.heat.purpose == "rated":
            numbers = sorted(number_of[id] for id in record.heat.entries)
            for pair in combinations(numbers, 2):
                met[pair] = met.get(pair, 0) + 1
    cars = grids.shape[1]
    for one in range(cars):
        for other in range(one + 1, cars):
            both = grids[(grids[:, one] >= 0) & (grids[:, other] >= 0)][:, [one, other]]
            pairs, counts = np.unique(np.sort(both, axis=1), axis=0, return_counts=True)
            for (a, b), count in zip(pairs.tolist(), counts.tolist(), strict=True):
                met[a, b] = met.get((a, b), 0) + count
    return met


def _heat(plan: HeatPlan, ruleset: str, draw: int, id_of: dict[int, str]) -> Heat:
    purpose: Purpose = "rated" if plan.rated else "validation"
    halves = tuple(Half(race.track, tuple(id_of[n] for n in race.entries)) for race in plan.races)
    return Heat(ruleset, halves, draw, purpose)


def _season_heats(records: Sequence[HeatRecord], ruleset: str) -> list[HeatRecord]:
    return [
        record
        for record in records
        if record.heat.purpose in ("rated", "validation")
        and record.heat.ruleset == ruleset
        and record.heat.draw >= ROUND
    ]


def _round(record: HeatRecord) -> int:
    return record.heat.draw // ROUND
