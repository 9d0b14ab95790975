"""What pays: the Reward protocol, and the built-in one, a weighted sum of small compiled terms."""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from typing import Protocol

import numpy as np

from league.envs.config import RewardConfig
from league.errors import ConfigError, nearest_names
from league.jit import compiled, inner
from league.portable_math import f32
from league.sim.grid import is_racing
from league.sim.world import World
from league.track.projection import frame_at, signed_gap
from league.track.track import TrackSet

PRESETS = {
    "centerline": RewardConfig(progress=0.0, centerline=1.0, off_track=0.0, crash=0.0),
    "progress": RewardConfig(progress=3.0, off_track=-3.0, crash=-3.0),
    "race": RewardConfig(progress=1.0, overtake=10.0, gain=4.0, off_track=-1.0, crash=-2.0),
}
"""Ready weights by name: of order 1 for a step (4 m/s are 0.27 m, or 0.8), so that a learner
that discounts by 0.99 sees returns of some tens; a mistake costs what a second of racing earns. In
`race` little is paid for progress: a mistake ends the episode and with it all that would have been
earned, and where that is more than a pass earns nobody tries one (docs/self_play.md)."""

TERMS = tuple(item.name for item in fields(RewardConfig))
"""Names of the built-in terms, in order."""
NEAR = f32(1.5)
"""Distance along the track within which gaining on another car pays [m]."""
_ZERO, _ONE, _HALF, _QUARTER, _TENTH = f32(0.0), f32(1.0), f32(0.5), f32(0.25), f32(0.1)
_LEAST_BAND = f32(0.001)


class Reward(Protocol):
    """Pays each car for each step, in Python; it may remember, so it learns of each new episode."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names under which it logs, the same on every step."""
        ...

    def __call__(
        self,
        tracks: TrackSet,
        before: World,
        world: World,
        actions: np.ndarray,
        verdicts: np.ndarray,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return what each car earns and each term of it by name, all (num_worlds, num_cars).

        Args:
            tracks: the courses.
            before: the worlds before the step; only its cars are of then.
            world: the worlds after it, before any penalty or restart moved a car.
            actions: what was asked for, in [-1, 1], (num_worlds, num_cars, 2).
            verdicts: what happened in the step, VERDICT records (num_worlds, num_cars).
        """
        ...

    def restart(self, world: World, who: np.ndarray) -> None:
        """Learn which cars begin an episode in this world, bool, (num_worlds, num_cars)."""
        ...


def preset(name: str, others: Sequence[str] = ()) -> RewardConfig:
    """Return ready weights: `centerline`, `progress` or `race`.

    Args:
        name: which.
        others: more names that would have been understood.

    Raises:
        ConfigError: there are none of this name.
    """
    if name not in PRESETS:
        raise ConfigError(
            f"there is no built-in reward {name!r}; nearest: "
            f"{nearest_names(name, [*PRESETS, *others])}; "
            "or give the path of a reward file that ends in .py"
        )
    return PRESETS[name]


def weights(cfg: RewardConfig) -> np.ndarray:
    """Return the weights in the order of TERMS, float32 (num_terms,)."""
    return np.array([getattr(cfg, name) for name in TERMS], np.float32)


class BuiltIn:
    """The built-in reward as Python sees it, for rewards that add to it."""

    def __init__(self, cfg: RewardConfig) -> None:
        """Keep the weights."""
        self.terms = cfg.terms
        self._weight = weights(cfg)

    def __call__(
        self,
        tracks: TrackSet,
        before: World,
        world: World,
        actions: np.ndarray,
        verdicts: np.ndarray,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Return the weighted sum and each weighted term; see Reward."""
        found = np.empty((*world.cars.shape, len(TERMS)), np.float32)
        _pay_all(
            world.cars, world.worlds, verdicts, found, self._weight, tracks.points, tracks.courses
        )
        terms = {name: found[..., TERMS.index(name)] for name in self.terms}
        paid = np.zeros(world.cars.shape, np.float32)
        for value in terms.values():
            paid += value
        return paid, terms

    def restart(self, world: World, who: np.ndarray) -> None:
        """Nothing is remembered, so nothing is forgotten."""


@compiled
def _pay_all(cars, worlds, verdicts, terms, weight, points, courses):
    for w in range(len(worlds)):
        pay(cars[w], verdicts[w], terms[w], weight, points, courses[worlds[w].track])


@inner
def pay(cars, verdicts, terms, weight, points, course):
    """Write each weighted term of each car of one world.

    Args:
        cars: CAR records (num_cars,) after the step, before any penalty or restart.
        verdicts: VERDICT records (num_cars,).
        terms: float32 (num_cars, num_terms), in the order of TERMS; overwritten.
        weight: of `weights`; terms of weight 0 are not worked out.
        points: of the TrackSet.
        course: COURSE record of the world's track.
    """
    for c in range(len(cars)):
        seen = verdicts[c]
        terms[c, 0] = weight[0] * seen.advance
        terms[c, 1] = weight[1] * _centerline(cars[c], points, course) if weight[1] else _ZERO
        terms[c, 2] = weight[2] if seen.lap else _ZERO
        terms[c, 3] = weight[3] * _overtake(c, verdicts) if weight[3] else _ZERO
        terms[c, 4] = weight[4] * _gain(c, cars, verdicts, course) if weight[4] else _ZERO
        terms[c, 5] = weight[5] if seen.off_track else _ZERO
        terms[c, 6] = weight[6] if seen.crashed else _ZERO
        terms[c, 7] = weight[7] if seen.was_hit else _ZERO


@inner
def _centerline(car, points, course):
    """Return the classic three bands: 1 within 10 % of the width of the centre, .5 in 25, .1 in 50.

    After the first example of the DeepRacer developer guide.
    """
    frame = frame_at(points, course, car.s)
    share = abs(car.lateral) / (frame.left + frame.right)
    if share <= _TENTH:
        return _ONE
    if share <= _QUARTER:
        return _HALF
    return _TENTH if share <= _HALF else _LEAST_BAND


@inner
def _overtake(c, verdicts):
    """Return the cars passed on the road, minus cars that passed."""
    won = 0
    for other in range(len(verdicts)):
        won += (verdicts[c].overtook >> other) & 1
        won -= (verdicts[other].overtook >> c) & 1
    return f32(won)


@inner
def _gain(c, cars, verdicts, course):
    """Return the metres gained in this step on each car within NEAR, summed over them.

    A pass that pays only once it is done is hardly ever found by chance; this pays on the way to
    it. After Fuchs et al., "Super-Human Performance in Gran Turismo Sport" (2021), and Song et al.,
    "Autonomous Overtaking in Gran Turismo Sport" (2021), section IV.
    """
    total = _ZERO
    if verdicts[c].released or not is_racing(cars[c]):
        return total
    for other in range(len(cars)):
        if other == c or verdicts[other].released or not is_racing(cars[other]):
            continue
        if abs(signed_gap(course, cars[c].s, cars[other].s)) < NEAR:
            total += verdicts[c].advance - verdicts[other].advance
    return total
