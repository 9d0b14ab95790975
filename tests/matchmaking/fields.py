"""Simulated fields of known strength, and seasons of them."""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from league.matchmaking.pairing.schedule import Contender, HeatPlan
from league.matchmaking.ratings import Ratings, Results, fit

UNIT = np.log(10) / 400
"""Natural units of strength in one Elo."""
NOISE = {
    "gumbel": lambda generator, shape: generator.gumbel(size=shape),
    "gauss": lambda generator, shape: generator.normal(0, 1.702 / np.sqrt(2), shape),
}
"""What luck adds to a car's strength in a race.

Gumbel luck makes the odds of a duel exactly those of the Elo scale. Gaussian luck of this size
makes them so within 0.01 (Birnbaum's 1.702), so that the strengths are Elo in both.
"""


class Race(NamedTuple):
    """The finishing order of one race."""

    heat: Hashable
    entries: tuple[int, ...]
    """In grid order."""
    places: tuple[int, ...]
    """Of each of them; equal places are ties."""


def results_of(races: Sequence[Race]) -> Results:
    """Return races as tables; smaller fields leave the last slots empty."""
    slots = max((len(race.entries) for race in races), default=2)
    number: dict[Hashable, int] = {}
    heats = [number.setdefault(race.heat, len(number)) for race in races]

    def table(rows: Iterable[tuple[int, ...]], empty: int) -> np.ndarray:
        padded = [row + (empty,) * (slots - len(row)) for row in rows]
        return np.array(padded, dtype=np.int64).reshape(-1, slots)

    entries, places = (race.entries for race in races), (race.places for race in races)
    return Results(np.array(heats, dtype=np.int64), table(entries, -1), table(places, 0))


def raced(generator, strengths, grids, *, noise="gumbel", front=0.0) -> Results:
    """Return heats of two races on these grids (heats, cars) and on their reverse.

    `front` is the worth of the first slot over the last [Elo]; slots between lie evenly.
    """
    grids = np.asarray(grids)
    heats, cars = grids.shape
    entries = np.stack([grids, grids[:, ::-1]], axis=1).reshape(-1, cars)
    shown = (strengths[entries] + np.linspace(front, 0, cars)) * UNIT
    shown = shown + NOISE[noise](generator, entries.shape)
    places = 1 + np.argsort(np.argsort(-shown, axis=1), axis=1)
    return Results(np.repeat(np.arange(heats), 2), entries, places)


def random_grids(generator, entries: int, cars: int, heats: int) -> np.ndarray:
    """Return fields drawn from all entries, (heats, cars)."""
    return np.argsort(generator.random((heats, entries)), axis=1)[:, :cars]


def misses(ratings: Ratings, strengths) -> np.ndarray:
    """Return how far each rating is off, both sides taken from their means [Elo]."""
    return (ratings.elo - ratings.elo.mean()) - (strengths - strengths.mean())


def covered(ratings: Ratings, strengths) -> np.ndarray:
    """Return which intervals hold the truth: an entry's lead over the average of all others."""
    size = len(strengths)
    return np.abs(misses(ratings, strengths)) * size / (size - 1) <= 1.96 * ratings.sd


class Season:
    """A league with races drawn from known strengths."""

    def __init__(self, generator, strengths):
        self.generator, self.strengths = generator, strengths
        self.races: list[Race] = []
        self.counts: dict[tuple[int, int], int] = {}
        self.ratings = fit(results_of([]), entries=range(len(strengths)))
        self._heat = 0

    def race(self, plans: list[HeatPlan]) -> None:
        """Run some heats and refit."""
        for plan in plans:
            for grid in (plan.grid, plan.grid[::-1]):
                shown = self.strengths[list(grid)] * UNIT + self.generator.gumbel(size=len(grid))
                places = 1 + np.argsort(np.argsort(-shown))
                self.races.append(Race(self._heat, grid, tuple(places.tolist())))
            for pair in [(a, b) for a in plan.grid for b in plan.grid if a < b]:
                self.counts[pair] = self.counts.get(pair, 0) + 1
            self._heat += 1
        self.ratings = fit(results_of(self.races), entries=range(len(self.strengths)))

    def contenders(self) -> list[Contender]:
        """Return what pairing needs to know."""
        rated = self.ratings
        return [
            Contender(
                index, "provisional", f"owner {index}", rated.elo[index], rated.sd[index],
                int(rated.races[index]),
            )
            for index in range(len(self.strengths))
        ]  # fmt: skip
