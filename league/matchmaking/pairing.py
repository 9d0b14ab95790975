"""Who races whom next: a pure function of the standings, the history and a generator.

Three lanes share the heats. Coverage begins with whoever is least sure, so that newcomers are
rated soon. Informed asks the closest questions. Random ties the whole field together: without it a
field raced only among neighbours becomes a chain whose ends drift apart.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from league.errors import ConfigError

State = Literal["pending", "validating", "placement", "provisional", "ranked", "retired"]
"""An entry's way: handed in, racing itself and an anchor, then rated ever more surely."""
Lane = Literal["coverage", "informed", "random", "validation"]

RATED_STATES: tuple[State, ...] = ("placement", "provisional", "ranked")
"""States in which an entry is paired for rated heats."""
MOST_CARS = 8
"""Cars on the largest grid."""


@dataclass(frozen=True)
class PairingSettings:
    """A league's choices about its heats."""

    field_size: int = 2
    """Cars in a race, 2 to 8; fewer if the field has not so many owners."""
    tracks: tuple[str, ...] = ("reinvent_2018",)
    """Tracks to race on."""
    coverage_share: float = 0.4
    """Share of heats that begin with the entry least sure."""
    informed_share: float = 0.3
    """Share of heats between entries that may well be equal; the rest is random."""
    anchor_share: float = 0.1
    """Share of heats with an anchor in them."""
    pair_cap: float = 3.0
    """No pair meets more often than this many times the median pair."""
    same_owner: bool = False
    """Whether entries of one owner may meet; a league of one person needs it."""
    other_track_from: int = 4
    """Tracks from which on a heat's second half is driven on another one."""
    placement_sd: float = 75.0
    """Until an entry is this sure it is in placement [Elo]."""
    provisional_sd: float = 50.0
    """Until an entry is this sure it is provisional [Elo]."""
    settled_sd: float = 25.0
    """An entry this sure is no longer the first choice for a heat, only an opponent [Elo]."""

    def __post_init__(self) -> None:
        """Check sizes and shares."""
        if not 2 <= self.field_size <= MOST_CARS:
            raise ConfigError(f"field_size is {self.field_size}: races have 2 to {MOST_CARS} cars")
        if not self.tracks:
            raise ConfigError("there are no tracks to race on: name one or more")
        shares = self.coverage_share, self.informed_share, self.anchor_share
        if min(shares) < 0 or self.coverage_share + self.informed_share > 1 or shares[2] > 1:
            raise ConfigError(
                f"the shares of coverage, informed and anchors are {shares}: give numbers from 0, "
                "the first two at most 1 together, the last at most 1"
            )
        if self.pair_cap < 1:
            raise ConfigError(f"pair_cap is {self.pair_cap}: give 1 or more")


@dataclass(frozen=True)
class Standing:
    """What pairing knows of one entry."""

    entry: int
    """Its number."""
    state: State
    """Where it is on its way."""
    owner: str = ""
    """Whose it is; entries of nobody ("") may meet anyone."""
    elo: float = 1000.0
    """Strength [Elo]."""
    sd: float = 200.0
    """Standard deviation of the strength [Elo]."""
    races: int = 0
    """Races started or planned."""
    anchor: bool = False
    """Whether it is one of the league's own drivers, there to tie the scale."""


@dataclass(frozen=True)
class RacePlan:
    """One race to be run."""

    track: str
    """Name of the track."""
    entries: tuple[int, ...]
    """Entry numbers in grid order."""


@dataclass(frozen=True)
class HeatPlan:
    """Races that belong together: two with the grid reversed; one for a validation."""

    lane: Lane
    """Why it is run."""
    races: tuple[RacePlan, ...]
    """The races."""
    rated: bool = True
    """Whether it counts for ratings."""

    @property
    def entries(self) -> tuple[int, ...]:
        """The field, in the grid order of the first race."""
        return self.races[0].entries


PairCounts = Mapping[tuple[int, int], int]
"""Heats of each pair that met or is to meet, by entry numbers, the smaller one first."""


def next_state(
    state: State, sd: float, *, validated: bool = False, settings: PairingSettings
) -> State:
    """Return where an entry stands after a refit.

    Args:
        state: where it stood.
        sd: standard deviation of its rating [Elo].
        validated: whether its validation heats went well.
        settings: the limits.
    """
    if state in ("pending", "retired"):
        return state
    if state == "validating" and not validated:
        return state
    if sd > settings.placement_sd:
        return "placement"
    return "provisional" if sd > settings.provisional_sd else "ranked"


def validation_heats(
    standing: Standing,
    standings: Sequence[Standing],
    settings: PairingSettings,
    generator: np.random.Generator,
) -> list[HeatPlan]:
    """Plan an entry's way in: a race against itself, and one against an anchor if there is one."""
    tracks = generator.choice(settings.tracks, size=2)
    own = RacePlan(str(tracks[0]), (standing.entry, standing.entry))
    heats = [HeatPlan("validation", (own,), rated=False)]
    anchors = [s.entry for s in standings if s.anchor and s.entry != standing.entry]
    if anchors:
        anchor = int(generator.choice(anchors))
        race = RacePlan(str(tracks[1]), (standing.entry, anchor))
        heats.append(HeatPlan("validation", (race,), rated=False))
    return heats


def next_heats(
    standings: Sequence[Standing],
    counts: PairCounts,
    settings: PairingSettings,
    generator: np.random.Generator,
    *,
    heats: int | None = None,
) -> list[HeatPlan]:
    """Plan a round of rated heats.

    Args:
        standings: all entries; those not in a rated state are left out.
        counts: how often pairs have met, planned heats included.
        settings: the league's choices.
        generator: where chance comes from.
        heats: how many; by default half as many as there are entries, so that workers do not
            wait for a refit and no plan is older than a round.

    Returns:
        Fewer heats than asked for, none at worst, if nobody is left whom the rules let meet.
    """
    field_ = [s for s in standings if s.state in RATED_STATES]
    if len(field_) < 2:
        return []
    table = _Round.of(field_, counts, settings, generator)
    wanted = max(1, len(field_) // 2) if heats is None else heats
    plans = []
    lanes = _lanes(wanted, settings, generator)
    with_anchor = _quota(wanted, settings.anchor_share, generator)
    for lane, anchored in zip(lanes, with_anchor, strict=True):
        grid = table.grid(lane, bool(anchored))
        if grid is None:
            continue
        table.note(grid)
        entries = tuple(int(table.entries[index]) for index in grid)
        plans.append(HeatPlan(lane, _halves(entries, settings, generator)))
    return plans


def _quota(wanted: int, share: float, generator: np.random.Generator) -> np.ndarray:
    """Return which of some heats have a trait: a share of them to within one, in random order."""
    whole, rest = divmod(wanted * share, 1.0)
    marked = np.zeros(wanted, dtype=bool)
    marked[: int(whole) + int(generator.random() < rest)] = True
    return generator.permutation(marked)


def _lanes(wanted: int, settings: PairingSettings, generator: np.random.Generator) -> list[Lane]:
    """Return the lane of each heat; the shares are kept to within one heat."""
    ends = np.cumsum([settings.coverage_share, settings.informed_share])
    # One random shift of evenly spaced points keeps every share as even as it can be.
    points = (np.arange(wanted) + generator.random()) / max(wanted, 1)
    which = np.searchsorted(ends, generator.permutation(points), side="right")
    names: tuple[Lane, ...] = ("coverage", "informed", "random")
    return [names[int(place)] for place in which]


def _halves(
    entries: tuple[int, ...], settings: PairingSettings, generator: np.random.Generator
) -> tuple[RacePlan, ...]:
    """Return a heat's two races: the grid reversed, and another track if there are enough."""
    second_too = len(settings.tracks) >= settings.other_track_from
    tracks = generator.choice(settings.tracks, size=1 + second_too, replace=False)
    return (
        RacePlan(str(tracks[0]), entries),
        RacePlan(str(tracks[-1]), entries[::-1]),
    )


@dataclass
class _Round:
    """The field while a round is planned; what is planned counts at once."""

    entries: np.ndarray
    elo: np.ndarray
    sd: np.ndarray
    races: np.ndarray
    anchor: np.ndarray
    owner: np.ndarray
    """Number of the owner, a number of its own for entries of nobody."""
    met: dict[int, dict[int, int]]
    """Heats of each pair, both ways."""
    cap: float
    """Heats at which a pair has met often enough."""
    planned: np.ndarray
    """Races planned in this round."""
    settings: PairingSettings
    generator: np.random.Generator

    @classmethod
    def of(
        cls,
        standings: list[Standing],
        counts: PairCounts,
        settings: PairingSettings,
        generator: np.random.Generator,
    ) -> _Round:
        place = {s.entry: index for index, s in enumerate(standings)}
        if len(place) != len(standings):
            raise ConfigError("an entry stands twice in the standings: give each once")
        owners: dict[str, int] = {}
        owner = [
            owners.setdefault(s.owner, len(owners)) if s.owner and not settings.same_owner
            else -1 - index
            for index, s in enumerate(standings)
        ]  # fmt: skip
        met: dict[int, dict[int, int]] = {index: {} for index in range(len(standings))}
        for (one, other), count in counts.items():
            if one in place and other in place and count > 0:
                a, b = place[one], place[other]
                met[a][b] = met[b][a] = count
        seen = [count for row in met.values() for count in row.values()]
        return cls(
            entries=np.array([s.entry for s in standings]),
            elo=np.array([s.elo for s in standings], dtype=float),
            sd=np.array([s.sd for s in standings], dtype=float),
            races=np.array([s.races for s in standings], dtype=float),
            anchor=np.array([s.anchor for s in standings]),
            owner=np.array(owner),
            met=met,
            cap=settings.pair_cap * max(1.0, float(np.median(seen)) if seen else 1.0),
            planned=np.zeros(len(standings)),
            settings=settings,
            generator=generator,
        )

    def grid(self, lane: Lane, anchored: bool) -> list[int] | None:
        """Return a field in grid order, or None if the one chosen first may meet nobody."""
        first = self._first(lane)
        # Where one believes the strengths to be, drawn anew for each heat (Thompson): close
        # neighbours are likely opponents, and so is anyone who may turn out to be one.
        drawn = self.elo + self.sd * self.generator.standard_normal(len(self.elo))
        if lane == "coverage" and self.sd[first] > 1.5 * np.median(self.sd):
            drawn[first] = self.elo[first]  # a newcomer learns most from the middle of its range
        chosen = [first]
        for _ in range(self.settings.field_size - 1):
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
            else:
                gaps = np.abs(drawn[candidates] - drawn[first])
                chosen.append(int(candidates[gaps.argmin()]))
        if len(chosen) < 2:
            return None
        return [int(index) for index in self.generator.permutation(chosen)]

    def note(self, grid: list[int]) -> None:
        """Count a planned heat."""
        for a in grid:
            self.races[a] += 2
            self.planned[a] += 2
            for b in grid:
                if a != b:
                    self.met[a][b] = self.met[a].get(b, 0) + 1

    def _first(self, lane: Lane) -> int:
        """Return whom a heat is for."""
        own = np.flatnonzero(~self.anchor)
        pool = own if len(own) else np.arange(len(self.entries))
        open_ = pool[self.sd[pool] > self.settings.settled_sd]
        if lane == "random" or not len(open_):
            return int(self.generator.choice(pool))
        if lane == "informed":
            return int(self.generator.choice(open_))
        # A planned race makes the entry surer, though nobody knows yet what of: 1 / sd^2 grows by
        # about 1 / 347^2 with each duel (0.25 (ln 10 / 400)^2).
        sure = 1.0 / self.sd[open_] ** 2 + self.planned[open_] / 347.0**2
        order = np.lexsort((self.generator.random(len(open_)), self.races[open_], sure))
        return int(open_[order[0]])

    def _free(self, chosen: list[int]) -> np.ndarray:
        """Return who may join those chosen; the cap gives way before a heat fails for it."""
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
