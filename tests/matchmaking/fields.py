"""Simulated fields of known strength, and seasons of them."""

from __future__ import annotations

import numpy as np

from league.matchmaking.pairing.schedule import HeatPlan, PairingSettings, Standing
from league.matchmaking.ratings import Finish, Ratings, Results, fit

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
    """A league whose races are drawn from known strengths."""

    def __init__(self, generator, strengths, settings: PairingSettings):
        self.generator, self.strengths, self.settings = generator, strengths, settings
        self.finishes: list[Finish] = []
        self.counts: dict[tuple[int, int], int] = {}
        self.ratings = fit(Results.of([]), entries=range(len(strengths)))
        self._heat = 0

    def race(self, plans: list[HeatPlan]) -> None:
        """Run some heats and refit."""
        for plan in plans:
            for race in plan.races:
                cars = np.array(race.entries)
                shown = self.strengths[cars] * UNIT + self.generator.gumbel(size=len(cars))
                places = 1 + np.argsort(np.argsort(-shown))
                self.finishes.append(Finish(self._heat, race.entries, tuple(places.tolist())))
            pairs = [(a, b) for a in plan.entries for b in plan.entries if a < b]
            for pair in pairs:
                self.counts[pair] = self.counts.get(pair, 0) + 1
            self._heat += 1
        self.ratings = fit(Results.of(self.finishes), entries=range(len(self.strengths)))

    def standings(self) -> list[Standing]:
        """Return what pairing needs to know."""
        told = self.ratings
        return [
            Standing(
                index, "provisional", f"owner {index}", told.elo[index], told.sd[index],
                int(told.races[index]),
            )
            for index in range(len(self.strengths))
        ]  # fmt: skip
