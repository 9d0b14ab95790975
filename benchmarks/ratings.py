"""How fast a league is rated, how true its ratings are, and how soon newcomers are placed."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.report import figure, heading
from league.matchmaking.ratings import RatingData, RatingSettings, Results, fit
from league.matchmaking.ratings.goodness_of_fit import goodness_of_fit
from league.matchmaking.ratings.pair_counts import ELO

RACES = 1_000_000
"""Races of the league that is fitted again against the clock."""


def league_of(entries: int, cars: int = 2) -> tuple[Results, np.ndarray]:
    """Return a million races of a field, and its strengths."""
    from tests.matchmaking.fields import raced

    generator = np.random.default_rng(0)
    strengths = generator.normal(0, 200, entries)
    heats = RACES // 2
    one = generator.integers(0, entries, heats)
    # Offsets that differ within a heat: no entry is in it twice.
    steps = np.sort(generator.integers(0, entries - cars, (heats, cars - 1)), axis=1)
    grids = np.concatenate([np.zeros((heats, 1), int), 1 + steps + np.arange(cars - 1)], axis=1)
    return raced(generator, strengths, (one[:, None] + grids) % entries, front=150), strengths


def speed() -> None:
    """Print what a refit costs."""
    heading("Refit of a league")
    for entries, goal in ((100, None), (1000, 1.0), (5000, 2.0)):
        results, strengths = league_of(entries)
        start = time.process_time()
        fitted = fit(results, anchor=0)
        taken = time.process_time() - start
        figure(f"{entries:,} entries, {RACES:,} duels, processor time", taken, "s", goal, most=True)
        miss = (fitted.elo - fitted.elo.mean()) - (strengths - strengths.mean())
        inside = np.abs(miss) <= 1.96 * fitted.sd
        assert abs(inside.mean() - 0.95) < 0.08, "the intervals are not honest"
    results, _ = league_of(1000)
    fitted, start = fit(results), time.process_time()
    goodness_of_fit(RatingData.of(results), fitted)
    figure("1,000 entries, test of fit, processor time", time.process_time() - start, "s")


def truth() -> None:
    """Print how far ratings are from known strengths."""
    from tests.matchmaking.fields import NOISE, covered, misses, raced, random_grids

    heading("Simulated fields: 16 entries, spread 200 Elo, 100 starts each")
    equal = "gauss, variance of gumbel"
    NOISE[equal] = lambda generator, shape: generator.normal(0, np.pi / np.sqrt(6), shape)
    for cars, noise, front, goal, least in (
        (2, "gumbel", 0, 45, 0.92), (2, "gumbel", 200, None, 0.92), (2, "gumbel", 300, None, 0.92),
        (4, "gumbel", 0, 32, 0.90), (4, "gauss", 0, 32, 0.90), (4, equal, 0, 32, 0.90),
        (8, "gumbel", 0, None, 0.90), (8, "gauss", 0, None, 0.90),
    ):  # fmt: skip
        generator, squares, inside, bounds = np.random.default_rng(1), [], [], []
        for _ in range(150):
            strengths = generator.normal(0, 200, 16)
            grids = random_grids(generator, 16, cars, 800 // cars)
            results = raced(generator, strengths, grids, noise=noise, front=front)
            fitted = fit(results)
            squares.append((misses(fitted, strengths) ** 2).mean())
            inside.append(covered(fitted, strengths).mean())
            if cars == 2:
                bounds.append(least_square(results, strengths, front))
        name = f"{cars} cars, {noise}, front slot worth {front}"
        figure(f"{name}: miss", float(np.sqrt(np.mean(squares))), "Elo", goal, most=True)
        if bounds:
            figure(f"{name}: least miss possible", float(np.sqrt(np.mean(bounds))), "Elo")
        figure(f"{name}: coverage", float(np.mean(inside)), "", least)


def least_square(results: Results, strengths: np.ndarray, front: float) -> float:
    """Return the mean square [Elo^2] by which any rating misses these strengths at least.

    It is the bound of Cramer, Rao and van Trees: the inverse of the information of these duels at
    the truth, with a prior that knows the field's spread (200 Elo), sides taken from their means.
    """
    size = len(strengths)
    one, other = results.entries.T
    chance = 1 / (1 + np.exp(-(strengths[one] - strengths[other] + front) / ELO))
    turns = np.zeros((len(results), size + 1))
    turns[np.arange(len(results)), one] = 1.0
    turns[np.arange(len(results)), other] = -1.0
    turns[:, size] = 1.0  # the front slot's lead, with its prior of 300 Elo
    prior = np.diag([*[(ELO / 200) ** 2] * size, (ELO / 300) ** 2])
    information = (turns * (chance * (1 - chance))[:, None]).T @ turns
    inverse = np.linalg.inv(information + prior)[:size, :size]
    return float(ELO**2 * (np.trace(inverse) - inverse.sum() / size) / size)


def iterated() -> None:
    """Print how near the large fields' estimated variances are to exact ones."""
    results, _ = league_of(1000)
    some = Results(results.heats[:40_000], results.entries[:40_000], results.places[:40_000])
    exact, near = fit(some), fit(some, RatingSettings(dense_most=10))
    figure("estimated over exact sd, scatter", 100 * float((near.sd / exact.sd).std()), "%")


def seasons() -> None:
    """Print what the matchmaker makes of its heats."""
    from tests.matchmaking.test_pairing import dense_field, newcomer_races

    heading("Matchmaking")
    # Seeds that nothing was tuned on.
    races = [newcomer_races(3000 + seed)[0] for seed in range(30)]
    figure("newcomer to sd 50 against 20 rated: median", np.median(races), "duels", 54, most=True)
    figure("the slowest tenth of them", float(np.percentile(races, 90)), "duels")
    fields = [dense_field(3000 + seed) for seed in range(40)]
    miss = float(np.sqrt(np.mean([square for square, _ in fields])))
    figure("dense field (sd 120), 40 races each: miss", miss, "Elo", 55, most=True)
    figure("the dense field: coverage", float(np.mean([inside for _, inside in fields])), "", 0.92)


def main() -> None:
    """Print the figures."""
    heading("Ratings")
    speed()
    iterated()
    truth()
    seasons()


if __name__ == "__main__":
    main()
