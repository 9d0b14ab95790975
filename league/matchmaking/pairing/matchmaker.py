"""The season's matchmaker: plans rounds of heats and moves entries between their states.

Heats are planned in rounds, and two rounds are in the queue at a time, so that workers never wait
for a refit. Round n is planned from the results of rounds 1 to n - 2, whatever else is known by
then. So the same league raced by more workers, slower, or with a dozen crashes in between plans
the same heats, and ends with the same ratings. A round's size depends on the field alone.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any

import numpy as np

from league.matchmaking import cups, divisions, safety, standings
from league.matchmaking.divisions import SeasonSettings
from league.matchmaking.pairing import schedule
from league.matchmaking.pairing.heat_spec import Half, Heat, Ruleset
from league.matchmaking.pairing.schedule import Contender, HeatPlan, Meetings
from league.matchmaking.ratings import Carried, RatingData, Ratings
from league.matchmaking.scope import scope
from league.matchmaking.store import (
    RATED,
    EntryState,
    HeatRecord,
    LeagueEntry,
    Races,
    Season,
    Store,
)

LineUp = Callable[[int, str], float]
"""What an entry's place on the grid of a track is decided by: its number and the track's name."""
ROUND = 4096  # heats of a round at most; heat k of round n has the draw n * ROUND + k
LEAST_ROUND = 8  # heats of a round at least; more workers than heats in two rounds have to wait
LOOK_BACK = 3000  # heats among which the latest round is looked for first


def enter_anchors(store: Store, anchors: Sequence[str]) -> None:
    """Enter scripted drivers as a new league's anchors; the first one is pinned to 1000.

    They ship with the program, so they need no validation.
    """
    ids = [
        store.submit(name, "league", scripted=name, anchor=True, card={"name": name}).id
        for name in anchors
    ]
    store.move(dict.fromkeys(ids, "validating"))
    store.move(dict.fromkeys(ids, "placement"))


def entries_with_reasons(store: Store) -> list[LeagueEntry]:
    """Return a league's entries; the reason of one that is not rated yet is what it waits for."""
    return [
        replace(entry, reason=waits_for(store, entry))
        if entry.state in ("pending", "validating")
        else entry
        for entry in store.entries()
    ]


def waits_for(store: Store, entry: LeagueEntry) -> str:
    """Return why an entry is not rated yet, and what to do about it."""
    heats = _validations(store, entry, store.settings.ruleset.hash)
    if not heats:
        return "its validation heats are not planned yet: `league run` plans and races them"
    for record in heats:
        if record.state in ("error", "cancelled"):
            last = (record.traceback.strip().splitlines() or ["it was cancelled"])[-1]
            return (
                f"its validation heat {record.number} was given up ({last[:200]}): mend the "
                f"cause, then `league retry {record.number}`"
            )
        if record.state == "quarantined":
            return f"its validation heat {record.number} went two ways: the next plan refuses it"
    waiting = [record.number for record in heats if record.state in ("planned", "claimed")]
    if waiting:
        listed = ", ".join(map(str, waiting))
        return f"it waits for its validation heats ({listed}): `league run` races them"
    return "its validation heats are done: `league run` rates it when it plans its next round"


def _validations(store: Store, entry: LeagueEntry, ruleset: str) -> list[HeatRecord]:
    return [
        record
        for record in store.heats(entries=[entry.number])
        if record.heat.purpose == "validation" and record.heat.ruleset == ruleset
    ]


@dataclass(frozen=True)
class _Round:
    """A round of heats in the queue."""

    number: int = 0  # from 1; 0 stands for none
    first: int = 0  # number of its first heat; all earlier rounds have smaller ones
    open: bool = False  # whether any of its heats, or of an earlier round's, is not over
    earlier_open: bool = False  # whether any heat of an earlier round is not over


@dataclass(frozen=True)
class _Past:
    """What a round is planned from."""

    races: Races  # rated races of the season that count
    carried: Carried | None  # ratings of the season before
    before: int | None  # only heats with a smaller number count; None: all
    queued: list[HeatRecord]  # planned heats that do not count, whatever became of them

    def counts(self, heat: int) -> bool:
        """Return whether a heat's result may be looked at."""
        return self.before is None or heat < self.before

    def passed(self, validations: Sequence[HeatRecord]) -> bool:
        """Return whether an entry's validation heats are all done."""
        return bool(validations) and all(
            record.state == "done" and self.counts(record.number) for record in validations
        )

    def meetings(self, number_of: dict[str, int]) -> Meetings:
        """Return the heats in which each pair met or is to meet, by entry numbers."""
        first = RatingData.of(standings.results_of(self.races.where(self.races.half == 0)))
        one, other = (
            first.entries[some].tolist() for some in (first.counts.one, first.counts.other)
        )
        heats = first.counts.by_pair(first.counts.meetings).astype(int).tolist()
        met = Counter(dict(zip(zip(one, other, strict=True), heats, strict=True)))
        for record in self.queued:
            if record.heat.purpose == "rated":
                met.update(combinations(sorted(number_of[id] for id in record.heat.entries), 2))
        return met


class Matchmaker:
    """A league's matchmaker; all it knows is in the store, so another may take over any time."""

    def __init__(self, store: Store, *, same_owner: bool = False) -> None:
        """Plan for a league, in which entries of one owner meet or (the default) do not."""
        self._store, self._same_owner = store, same_owner
        self._latest = _Round()

    def plan(self) -> int:
        """Plan what is due of the next round and of cups; return how many heats are new."""
        return cups.advance(self._store) + self._plan_round()

    def _plan_round(self) -> int:
        """Plan the next round if it is due, and move entries; return how many heats are new."""
        rules = self._store.settings.ruleset
        if self._still_early(rules.hash):
            return 0
        latest = self._find_latest(rules.hash)
        if latest.earlier_open:
            return 0
        if latest.number and (heats := self._next_round(rules, latest, latest.first)):
            return self._store.plan(heats)
        if latest.open:
            return 0
        return self._store.plan(self._next_round(rules, latest, None))

    def _still_early(self, ruleset: str) -> bool:
        """Return whether a heat before the latest known round is open, so that no round is due.

        This is checked after every heat, and nearly always true: it reads one heat, where the
        rounds in the queue are hundreds of heats in a large league.
        """
        first = _season_heats(self._store.heats(("planned", "claimed"), limit=1), ruleset)
        return bool(first) and first[0].number < self._latest.first

    def _find_latest(self, ruleset: str) -> _Round:
        """Return the newest round; what is known of it from last time saves reading."""
        since = self._latest.first - 1
        if not self._latest.number:
            since = max(0, sum(self._store.counts().values()) - LOOK_BACK)
        heats = _season_heats(self._store.heats(since=since), ruleset)
        if not heats and since > 0 and not self._latest.number:
            heats = _season_heats(self._store.heats(), ruleset)
        if not heats:
            return _Round()
        number = max(_round(record) for record in heats)
        first = min(record.number for record in heats if _round(record) == number)
        waiting = self._store.heats(("planned", "claimed"))
        rounds = [_round(record) for record in _season_heats(waiting, ruleset)]
        self._latest = _Round(number, first, bool(rounds), any(one < number for one in rounds))
        return self._latest

    def _next_round(self, rules: Ruleset, latest: _Round, before: int | None) -> list[Heat]:
        """Return the round after the latest one, and move entries to where they stand by now."""
        queued = self._store.heats(since=before - 1) if before else []
        within = scope(self._store, rules.hash)
        season_heats = _season_heats(queued, rules.hash)
        races = within.races if before is None else within.races.where(within.races.heat < before)
        past = _Past(races, within.carried, before, season_heats)
        number = latest.number + 1
        generator = np.random.default_rng([number, int(rules.hash[:12], 16)])
        entries = self._store.entries()
        validations = {
            entry.number: _validations(self._store, entry, rules.hash)
            for entry in entries
            if entry.state in ("pending", "validating")
        }
        roster = _Roster.of(entries, past, validations)
        self._move(entries, roster)
        over = within.season is not None and within.season.until is not None
        if within.season is not None and not over:
            self._move_divisions(within.season, past, roster, number)
        plans: list[HeatPlan] = []
        for newcomer in roster.newcomers:
            plans += schedule.validation_heats(newcomer, roster.contenders, rules, generator)
        rated = [one for one in roster.contenders if one.state in RATED]
        size = min(max(LEAST_ROUND, len(rated) // 2), ROUND // 2)
        # A new league's first entries need not wait for its anchors to be sure; and a season that
        # is over has no more heats.
        if over or (roster.undecided and all(one.anchor for one in rated)):
            size = 0
        plans = plans[: ROUND // 2]
        id_of = {entry.number: entry.id for entry in entries}
        line_up = _line_up(rules, past, roster, entries)
        meetings = past.meetings({id: number for number, id in id_of.items()})
        plans += schedule.next_heats(
            rated, meetings, rules, generator, heats=size, same_owner=self._same_owner
        )
        return [
            _heat(plan, rules.hash, number * ROUND + index, id_of, line_up)
            for index, plan in enumerate(plans)
        ]

    def _move_divisions(self, season: Season, past: _Past, roster: _Roster, round: int) -> None:
        """Promote and relegate, by what the round is planned from."""
        if roster.fitted is None:
            return
        moves = divisions.next_moves(
            divisions.assigned(self._store.division_moves(season.number)),
            roster.fitted,
            {one.entry for one in roster.contenders if one.state in RATED and not one.anchor},
            safety.of(self._store, season.ruleset, before=past.before),
            SeasonSettings.of(season),
            round=round,
            heat=int(past.races.heat.max(initial=season.after)),
        )
        self._store.move_divisions(season.number, moves)

    def _move(self, entries: Sequence[LeagueEntry], roster: _Roster) -> None:
        """Write into the store where entries stand, one lawful step at a time."""
        for entry in entries:
            state, reason = roster.states[entry.number]
            if entry.state == state:
                continue
            if entry.state == "pending":
                self._store.move({entry.id: "validating"})
            if state in RATED and entry.state in ("pending", "validating"):
                self._store.move({entry.id: "placement"})
            self._store.move({entry.id: state}, reason=reason)


@dataclass
class _Roster:
    """All entries as pairing sees them, by the past alone."""

    contenders: list[Contender] = field(default_factory=list)  # entries that may race
    newcomers: list[Contender] = field(default_factory=list)  # those that need validation heats
    states: dict[int, tuple[EntryState, str]] = field(default_factory=dict)
    """Where each entry stands, and why it was refused."""
    fitted: Ratings | None = None  # the ratings; None without an entry to rate
    undecided: int = 0  # entries of which it is not known yet whether they pass

    @classmethod
    def of(
        cls, entries: Sequence[LeagueEntry], past: _Past, validations: dict[int, list[HeatRecord]]
    ) -> _Roster:
        """Return where every entry stands."""
        roster = cls()
        results = standings.results_of(past.races)
        passed = {number for number, heats in validations.items() if past.passed(heats)}
        found = standings.rated(results, entries, passed, past.carried)
        fitted = roster.fitted = found[1] if found else None
        for entry in entries:
            state, reason = entry.state, entry.reason
            heats = validations.get(entry.number, [])
            if any(record.state == "quarantined" for record in heats):
                state, reason = "refused", "the same race went two ways: it is not deterministic"
            elif entry.number in passed:
                state = "placement"
            elif heats:
                state = "validating"
                roster.undecided += not all(past.counts(record.number) for record in heats)
            line: dict[str, Any] = {}
            if state in RATED and fitted is not None:
                line = fitted.line(fitted.index(entry.number), "elo", "sd", "races")
                state = schedule.rated_state(line["sd"])
            roster.states[entry.number] = (state, reason)
            if state in ("retired", "refused"):
                continue
            owner = "" if entry.anchor else entry.owner
            one = Contender(entry.number, state, owner, anchor=entry.anchor, **line)
            roster.contenders.append(one)
            if state == "pending":
                roster.newcomers.append(one)
                roster.undecided += 1
        return roster


def _line_up(
    rules: Ruleset, past: _Past, roster: _Roster, entries: Sequence[LeagueEntry]
) -> LineUp | None:
    """Return what the grid is sorted by, the smallest first; None where races swap their grids.

    In a reverse grid the entry rated best starts last. In a qualifying format whoever has the best
    lap of all earlier races on the track starts first, and one without a lap last.
    """
    if rules.format == "reverse":
        elo = {one.entry: one.elo for one in roster.contenders}
        return lambda entry, track: elo[entry]
    if rules.format == "qualifying":
        laps = standings.Runs.of(past.races, rules.tracks, entries).laps_ms[0]
        return lambda entry, track: float(laps[rules.tracks.index(track), entry])
    return None


def _heat(
    plan: HeatPlan, ruleset: str, draw: int, id_of: dict[int, str], line_up: LineUp | None
) -> Heat:
    """Return the heat of a plan; without a line-up every second race has the grid reversed."""
    halves = []
    for number, track in enumerate(plan.tracks):
        grid = plan.grid[::-1] if number % 2 and line_up is None else plan.grid
        if line_up is not None:
            grid = sorted(grid, key=lambda entry: line_up(entry, track))
        halves.append(Half(track, tuple(id_of[entry] for entry in grid)))
    return Heat(ruleset, tuple(halves), draw, "rated" if plan.rated else "validation")


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
