"""Schedule of rated heats: a pure function of ratings, past meetings and a generator.

Connection comes first: an entry without a chain of races to the pinned anchor gets one. Three
lanes share the other heats. Coverage begins with the entry least sure, so that newcomers are rated
soon. Informed asks the closest questions. Random ties the whole field together: without it a field
raced only among near equals becomes a chain with ends that drift apart.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from league.matchmaking.pairing.heat_spec import Ruleset
from league.matchmaking.ratings.pair_counts import ELO, groups
from league.matchmaking.ratings.table import PROVISIONAL_SD
from league.matchmaking.store.records import RATED, EntryState

Lane = Literal["connection", "coverage", "informed", "random", "validation"]
Meetings = Mapping[tuple[int, int], int]
"""Heats of each pair that met or is to meet, by entry numbers, the smaller one first."""

PAIR_CAP = 3.0  # no pair meets more often than this many times the median pair
OTHER_TRACK_FROM = 4  # tracks from which on a heat's second race is driven on another one
PLACEMENT_SD = 75.0
"""Until an entry is this sure it is in placement [Elo]; then provisional until PROVISIONAL_SD."""
SETTLED_SD = 25.0
"""An entry this sure is no longer the first choice for a heat, only an opponent [Elo]."""
COVERAGE = 0.4  # share of heats that begin with the entry least sure
INFORMED = 0.3  # share of heats between entries that may well be equal; the rest is random
ANCHORED = 0.1  # share of heats with an anchor in them
GAPS, GAP_SHARES = np.polynomial.hermite_e.hermegauss(9)
"""Points and shares that stand for a normal distribution."""


@dataclass(frozen=True)
class Contender:
    """What pairing knows of one entry."""

    entry: int  # its number
    state: EntryState
    owner: str = ""  # its owner; entries without one ("") may meet any entry
    elo: float = 1000.0  # strength [Elo]
    sd: float = 200.0  # standard deviation of the strength [Elo]
    races: int = 0  # races started or planned
    anchor: bool = False  # whether it is one of the league's own drivers, there to tie the scale


@dataclass(frozen=True)
class HeatPlan:
    """Races that belong together: two; one for a validation."""

    lane: Lane  # why it is run
    grid: tuple[int, ...]  # entry numbers in random order
    tracks: tuple[str, ...]
    rated: bool = True  # whether it counts for ratings


def rated_state(sd: float) -> EntryState:
    """Return the state of a rated entry from the standard deviation of its rating [Elo]."""
    if sd > PLACEMENT_SD:
        return "placement"
    return "provisional" if sd > PROVISIONAL_SD else "ranked"


def validation_heats(
    newcomer: Contender, field: Sequence[Contender], rules: Ruleset, generator: np.random.Generator
) -> list[HeatPlan]:
    """Plan a newcomer's race against itself, and one against an anchor if there is one."""
    own, other = (str(track) for track in generator.choice(rules.tracks, size=2))
    heats = [HeatPlan("validation", (newcomer.entry, newcomer.entry), (own,), rated=False)]
    anchors = [one.entry for one in field if one.anchor and one.entry != newcomer.entry]
    if anchors:
        grid = (newcomer.entry, int(generator.choice(anchors)))
        heats.append(HeatPlan("validation", grid, (other,), rated=False))
    return heats


def next_heats(
    field: Sequence[Contender],
    meetings: Meetings,
    rules: Ruleset,
    generator: np.random.Generator,
    *,
    heats: int | None = None,
    same_owner: bool = False,
) -> list[HeatPlan]:
    """Plan a round of rated heats; fewer than asked for, possibly none, if no more may meet.

    By default there are half as many as entries, so that workers do not wait for a refit and no
    plan is older than a round. Entries that are not in a rated state are left out. A race has fewer
    cars than the rules say if the field has not so many owners; entries of one owner may meet
    (`same_owner`) in a league of one person.
    """
    field = [one for one in field if one.state in RATED]
    if min(len(field), rules.cars) < 2:
        return []
    grids = _Grids(field, meetings, rules, generator, same_owner=same_owner)
    number = max(1, len(field) // 2) if heats is None else heats
    lanes = _lanes(number, generator)
    anchored = _quota(number, ANCHORED, generator)
    plans = []
    for lane, with_anchor in zip(lanes, anchored, strict=True):
        grid = grids.joining()
        if grid is not None:
            lane = "connection"
        else:
            grid = grids.grid(lane, bool(with_anchor))
        if grid is None:
            continue
        grids.note(grid)
        second_too = len(rules.tracks) >= OTHER_TRACK_FROM
        tracks = generator.choice(rules.tracks, size=1 + second_too, replace=False)
        entries = tuple(grids.entries[grid].tolist())
        plans.append(HeatPlan(lane, entries, (str(tracks[0]), str(tracks[-1]))))
    return plans


def _quota(number: int, share: float, generator: np.random.Generator) -> np.ndarray:
    """Return which of some heats have a trait: a share of them to within one, in random order."""
    whole, rest = divmod(number * share, 1.0)
    marked = np.zeros(number, dtype=bool)
    marked[: int(whole) + int(generator.random() < rest)] = True
    return generator.permutation(marked)


def _lanes(number: int, generator: np.random.Generator) -> list[Lane]:
    """Return the lane of each heat; the shares are kept to within one heat."""
    ends = np.cumsum([COVERAGE, INFORMED])
    # One random shift of evenly spaced points keeps every share as even as it can be.
    points = (np.arange(number) + generator.random()) / max(number, 1)
    which = np.searchsorted(ends, generator.permutation(points), side="right")
    names: tuple[Lane, ...] = ("coverage", "informed", "random")
    return [names[int(place)] for place in which]


class _Grids:
    """The field while a round is planned, and its grids; what is planned counts at once."""

    def __init__(
        self,
        field: Sequence[Contender],
        meetings: Meetings,
        rules: Ruleset,
        generator: np.random.Generator,
        *,
        same_owner: bool,
    ) -> None:
        place = {one.entry: index for index, one in enumerate(field)}
        self.cars, self.generator = rules.cars, generator
        self.entries = np.array([one.entry for one in field])
        numbers = np.array([(one.elo, one.sd, one.races) for one in field], dtype=float)
        self.elo, self.sd, self.races = numbers.T
        self.planned = np.zeros(len(field))  # races planned in this round
        self.anchor = np.array([one.anchor for one in field])
        owners: dict[str, int] = {}  # an entry without an owner gets a number of its own
        self.owner = np.array([
            owners.setdefault(one.owner, len(owners)) if one.owner and not same_owner
            else -1 - index
            for index, one in enumerate(field)
        ])  # fmt: skip
        self.met: dict[int, dict[int, int]] = {index: {} for index in range(len(field))}
        for (one, other), count in meetings.items():
            if one in place and other in place and count > 0:
                a, b = place[one], place[other]
                self.met[a][b] = self.met[b][a] = count
        counts = [count for row in self.met.values() for count in row.values()]
        self.cap = PAIR_CAP * max(1.0, float(np.median(counts)) if counts else 1.0)
        self.group = _groups(self.entries, meetings)
        anchors = [one.entry for one in field if one.anchor]
        home = self.group[place[min(anchors)]] if anchors else np.bincount(self.group).argmax()
        self.home = int(home)

    def joining(self) -> list[int] | None:
        """Return a field that ties an entry to the pinned anchor; None if all are, or none can.

        People's entries come before the other anchors: it is for them that the league is raced.
        """
        apart = self.group != self.home
        order = np.lexsort((self.generator.random(len(apart)), self.anchor))
        for first in order[apart[order]]:
            candidates = np.flatnonzero(self._free([first]) & ~apart)
            if len(candidates):
                chosen = [int(first), self._most_informative(int(first), candidates)]
                break
        else:
            return None
        while len(chosen) < self.cars:
            free = self._free(chosen)
            free = free & apart if (free & apart).any() else free
            if not free.any():
                break
            chosen.append(int(self.generator.choice(np.flatnonzero(free))))
        return self.generator.permutation(chosen).tolist()

    def grid(self, lane: Lane, anchored: bool) -> list[int] | None:
        """Return a field in grid order, or None if the first entry may meet no other."""
        first = self._first(lane)
        # Strengths as they may be, drawn for each heat (Thompson): near equals are likely
        # opponents, and so is any entry that may turn out to be one.
        drawn = self.elo + self.sd * self.generator.standard_normal(len(self.elo))
        chosen = [first]
        for _ in range(self.cars - 1):
            free = self._free(chosen)
            if anchored and len(chosen) == 1 and (free & self.anchor).any():
                free &= self.anchor
            elif (free & ~self.anchor).any():
                free &= ~self.anchor  # anchors race in their own share of heats, or in need
            candidates = np.flatnonzero(free)
            if not len(candidates):
                break
            if lane == "random":
                chosen.append(int(self.generator.choice(candidates)))
            elif lane == "coverage":
                chosen.append(self._most_informative(first, candidates))
            else:
                gaps = np.abs(drawn[candidates] - drawn[first])
                chosen.append(int(candidates[gaps.argmin()]))
        if len(chosen) < 2:
            return None
        return self.generator.permutation(chosen).tolist()

    def note(self, grid: list[int]) -> None:
        """Count a planned heat."""
        for a in grid:
            self.races[a] += 2
            self.planned[a] += 2
            for b in grid:
                if a != b:
                    self.met[a][b] = self.met[a].get(b, 0) + 1
        joined = np.isin(self.group, self.group[grid])
        self.group[joined] = self.home if self.home in self.group[joined] else self.group[grid[0]]

    def _most_informative(self, first: int, candidates: np.ndarray) -> int:
        """Return the opponent in the next duel that is most informative about an entry.

        A duel's information is w = E[p (1 - p)], over what the gap may be. But n duels against an
        opponent of variance v give no more than 1 / (1 / (n w) + v) in all, so the next one adds
        w / (1 + n w v)^2: opponents who are sure, and not always the same ones.
        """
        variance = (self.sd[candidates] / ELO) ** 2
        spread = np.sqrt(variance + (self.sd[first] / ELO) ** 2)
        gaps = (self.elo[candidates] - self.elo[first]) / ELO + np.outer(GAPS, spread)
        information = GAP_SHARES @ (0.25 / np.cosh(0.5 * gaps) ** 2) / GAP_SHARES.sum()
        duels = 2.0 * np.array([self.met[first].get(int(index), 0) for index in candidates])
        adds = information / (1.0 + duels * information * variance) ** 2
        # Chance decides between equals, or the same ones would always be asked first.
        adds *= 1.0 + 1e-6 * self.generator.random(len(adds))
        return int(candidates[adds.argmax()])

    def _first(self, lane: Lane) -> int:
        """Return the entry that a heat is for."""
        own = np.flatnonzero(~self.anchor)
        pool = own if len(own) else np.arange(len(self.entries))
        unsettled = pool[self.sd[pool] > SETTLED_SD]
        if lane == "random" or not len(unsettled):
            return int(self.generator.choice(pool))
        if lane == "informed":
            return int(self.generator.choice(unsettled))
        # A planned race makes the entry surer, though its result is not known yet: 1 / sd^2 grows
        # by about 1 / 347^2 with each duel (0.25 (ln 10 / 400)^2).
        sure = 1.0 / self.sd[unsettled] ** 2 + self.planned[unsettled] / 347.0**2
        chance = self.generator.random(len(unsettled))
        return int(unsettled[np.lexsort((chance, self.races[unsettled], sure))[0]])

    def _free(self, chosen: list[int]) -> np.ndarray:
        """Return which entries may join those chosen; the cap gives way before a heat fails."""
        free = ~np.isin(self.owner, self.owner[chosen])
        free[chosen] = False
        worn = np.zeros(len(free))
        for index in chosen:
            for other, count in self.met[index].items():
                worn[other] = max(worn[other], count)
        fresh = free & (worn < self.cap)
        if fresh.any() or not free.any():
            return fresh
        return free & (worn == worn[free].min())


def _groups(entries: np.ndarray, meetings: Meetings) -> np.ndarray:
    """Return the group of each entry; chains may lead over entries that have left."""
    known = np.unique([*entries, *(entry for pair in meetings for entry in pair)])
    pairs = np.array([pair for pair, count in meetings.items() if count > 0], dtype=np.int64)
    one, other = np.searchsorted(known, pairs.reshape(-1, 2)).T
    return groups(one, other, len(known))[np.searchsorted(known, entries)]
