"""Grids of rated heats, one after the other: who begins, and who is put beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from league.errors import ConfigError
from league.matchmaking.pairing.plans import Lane, PairCounts, PairingSettings, Standing

UNIT = 400.0 / np.log(10.0)
"""Elo in one natural unit of strength, in which a duel's odds are e to the gap."""
GAPS, GAP_SHARES = np.polynomial.hermite_e.hermegauss(9)
"""Points and shares that stand for a normal distribution."""


@dataclass
class Grids:
    """The field while a round is planned, and its grids; what is planned counts at once."""

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
    group: np.ndarray
    """Number of the group; between two groups there is no chain of races, run or planned."""
    home: int
    """Group of the pinned anchor; without anchors the largest."""
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
    ) -> Grids:
        """Return the field as it stands before the round."""
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
        group = _groups([s.entry for s in standings], counts)
        anchors = [s.entry for s in standings if s.anchor]
        home = group[place[min(anchors)]] if anchors else np.bincount(group).argmax()
        return cls(
            entries=np.array([s.entry for s in standings]),
            elo=np.array([s.elo for s in standings], dtype=float),
            sd=np.array([s.sd for s in standings], dtype=float),
            races=np.array([s.races for s in standings], dtype=float),
            anchor=np.array([s.anchor for s in standings]),
            owner=np.array(owner),
            met=met,
            cap=settings.pair_cap * max(1.0, float(np.median(seen)) if seen else 1.0),
            group=group,
            home=int(home),
            planned=np.zeros(len(standings)),
            settings=settings,
            generator=generator,
        )

    def joining(self) -> list[int] | None:
        """Return a field that ties somebody to the pinned anchor; None if all are, or none can.

        People's entries come before the other anchors: it is for them that the league is raced.
        """
        apart = self.group != self.home
        order = np.lexsort((self.generator.random(len(apart)), self.anchor))
        for first in order[apart[order]]:
            candidates = np.flatnonzero(self._free([first]) & ~apart)
            if len(candidates):
                chosen = [int(first), self._most_telling(int(first), candidates)]
                break
        else:
            return None
        while len(chosen) < self.settings.field_size:
            free = self._free(chosen)
            free = free & apart if (free & apart).any() else free
            if not free.any():
                break
            chosen.append(int(self.generator.choice(np.flatnonzero(free))))
        return [int(index) for index in self.generator.permutation(chosen)]

    def grid(self, lane: Lane, anchored: bool) -> list[int] | None:
        """Return a field in grid order, or None if the one chosen first may meet nobody."""
        first = self._first(lane)
        # Where one believes the strengths to be, drawn anew for each heat (Thompson): close
        # neighbours are likely opponents, and so is anyone who may turn out to be one.
        drawn = self.elo + self.sd * self.generator.standard_normal(len(self.elo))
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
            elif lane == "coverage":
                chosen.append(self._most_telling(first, candidates))
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
        joined = np.isin(self.group, self.group[grid])
        self.group[joined] = self.home if self.home in self.group[joined] else self.group[grid[0]]

    def _most_telling(self, first: int, candidates: np.ndarray) -> int:
        """Return the opponent whose next duel tells most about somebody.

        A duel tells w = E[p (1 - p)], over what the gap may be. But n duels against an opponent
        of variance v tell no more than 1 / (1 / (n w) + v) in all, so the next one adds
        w / (1 + n w v)^2: opponents who are sure, and not always the same ones.
        """
        variance = (self.sd[candidates] / UNIT) ** 2
        spread = np.sqrt(variance + (self.sd[first] / UNIT) ** 2)
        gaps = (self.elo[candidates] - self.elo[first]) / UNIT + np.outer(GAPS, spread)
        tells = GAP_SHARES @ (0.25 / np.cosh(0.5 * gaps) ** 2) / GAP_SHARES.sum()
        duels = 2.0 * np.array([self.met[first].get(int(index), 0) for index in candidates])
        adds = tells / (1.0 + duels * tells * variance) ** 2
        # Equals are told apart by chance, or the same ones would always be asked first.
        adds *= 1.0 + 1e-6 * self.generator.random(len(adds))
        return int(candidates[adds.argmax()])

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


def _groups(entries: Sequence[int], counts: PairCounts) -> np.ndarray:
    """Return the group of each entry; chains may lead over entries that have left."""
    known = np.unique([*entries, *(entry for pair in counts for entry in pair)])
    pairs = np.array([pair for pair, count in counts.items() if count > 0], dtype=np.int64)
    one, other = np.searchsorted(known, pairs.reshape(-1, 2)).T
    graph = sparse.coo_array((np.ones(len(one)), (one, other)), shape=(len(known), len(known)))
    group = csgraph.connected_components(graph, directed=False)[1]
    return group[np.searchsorted(known, entries)]
