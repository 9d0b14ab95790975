"""Rewards: the protocol, the weighted sum of compiled terms, and the racing-line reward."""

from dataclasses import fields
from typing import Protocol

import numpy as np
from numpy import ndarray

from league.envs.config import RewardConfig
from league.errors import ConfigError, nearest_names
from league.jit import compiled, inner
from league.portable_math import f32
from league.sim.config import CarConfig
from league.sim.grid import is_racing
from league.sim.records import World
from league.track.projection import frame_at, signed_gap
from league.track.track import Track, TrackSet

PRESETS = {
    "centerline": RewardConfig(progress=0.0, centerline=1.0, off_track=0.0, crash=0.0),
    "progress": RewardConfig(progress=3.0, off_track=-3.0, crash=-3.0),
    "race": RewardConfig(
        progress=1.0,
        gain=3.0,
        overtake=4.0,
        off_track=-12.0,
        crash=-2.0,
        touch=-0.5,
        closing=-6.0,
        contact=-4.0,
    ),
}
"""Ready weights by name. `progress` is of order 1 for a step (4 m/s are 0.27 m, or 0.8), and a
mistake costs what a second of racing earns. In `race` a metre gained on a rival nearby is worth
three of the own way, a pass two seconds of racing, and leaving the road more than any pass;
touching costs little and running into another car much, or passing is never learnt. Being hit costs
what a pass earns, so that cars leave room (docs/self_play.md)."""

TERMS = tuple(item.name for item in fields(RewardConfig))  # names of the built-in terms, in order
NEAR = f32(1.5)
"""Distance along the track within which another car is near, and gaining on it pays [m]."""
RACING_LINE = "racing_line"  # name of the reward that is no preset, and of its term
MOST_TRACKS = 64  # most tracks of which the racing line is computed
FAR = 0.7  # distance to the racing line at which its term becomes 0 [m]
SLOW = 1.4  # difference to the racing line's speed at which its term becomes 0 [m/s]
ROWS = 1024  # rows of a line's table
_ZERO, _ONE, _HALF, _QUARTER, _TENTH = f32(0.0), f32(1.0), f32(0.5), f32(0.25), f32(0.1)
_LEAST_BAND = f32(0.001)

Paid = tuple[ndarray, dict[str, ndarray]]  # what a Reward returns for a step


class Reward(Protocol):
    """Rewards each car for each step, in Python; it may keep state between `restart`s."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names under which it logs, the same on every step."""
        ...

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: ndarray, verdicts: ndarray
    ) -> Paid:
        """Return each car's reward and each term of it by name, all (num_worlds, num_cars).

        Args:
            tracks: the courses.
            before: the worlds before the step; only its cars are of then.
            world: the worlds after it, before any penalty or restart moved a car.
            actions: in [-1, 1], (num_worlds, num_cars, 2).
            verdicts: what happened in the step, VERDICT records (num_worlds, num_cars).
        """
        ...

    def restart(self, world: World, begun: ndarray, /) -> None:
        """Note which cars begin an episode in this world, bool, (num_worlds, num_cars)."""
        ...


def preset(name: str) -> RewardConfig:
    """Return the weights of `centerline`, `progress` or `race`; ConfigError for others."""
    if name not in PRESETS:
        raise ConfigError(
            f"there is no built-in reward {name!r}; "
            f"{nearest_names(name, [*PRESETS, RACING_LINE])}; "
            "or give the path of a reward file that ends in .py"
        )
    return PRESETS[name]


def check_name(name: str, num_tracks: int) -> None:
    """Check that a built-in reward is for so many tracks; ConfigError says why not."""
    if name != RACING_LINE:
        preset(name)
    elif num_tracks > MOST_TRACKS:
        raise ConfigError(
            f"the reward racing_line computes a line on each of {num_tracks} tracks (each "
            "direction counts), a tenth of a second each: "
            f"give at most {MOST_TRACKS}, or the reward progress"
        )


def built_in(name: str, tracks: TrackSet, car: CarConfig) -> Reward:
    """Return a preset, or `racing_line`, as a Reward; ConfigError as `check_name`."""
    return RacingLineReward(tracks, car) if name == RACING_LINE else BuiltIn(preset(name))


def weights(cfg: RewardConfig) -> ndarray:
    """Return the weights in the order of TERMS, float32 (num_terms,)."""
    return np.array([getattr(cfg, name) for name in TERMS], np.float32)


class BuiltIn:
    """The built-in terms as a Reward in Python, for rewards that add to them."""

    def __init__(self, cfg: RewardConfig) -> None:
        self.terms = self._summed = cfg.terms
        self._weight = weights(cfg)

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: ndarray, verdicts: ndarray
    ) -> Paid:
        """Return the weighted sum and each weighted term; see Reward."""
        cars, columns = world.cars, np.empty((*world.cars.shape, len(TERMS)), np.float32)
        courses = tracks.points, tracks.courses
        _pay_all(cars, world.worlds, verdicts, columns, self._weight, *courses)
        terms = {name: columns[..., TERMS.index(name)] for name in self._summed}
        total = np.zeros(cars.shape, np.float32)
        for value in terms.values():
            total += value
        return total, terms

    def restart(self, world: World, begun: ndarray) -> None:
        """Nothing: it keeps no state."""


class RacingLineReward(BuiltIn):
    """`progress`, and up to 1 in each step for being on the racing line at its speed.

    Without it, a driver that brakes too late learns of it only by its lap time, a second later. The
    line is the quasi-steady one of racing_line.py: its car uses all its grip and may have two
    wheels off the road. The car itself can be faster than that, so the line is a guide and
    `progress` decides (docs/training.md says what that is worth). A car that stands, or drives the
    wrong way, earns nothing for the line.
    """

    def __init__(self, tracks: TrackSet, car: CarConfig) -> None:
        """Compute the line of each track; ConfigError for too many tracks."""
        check_name(RACING_LINE, len(tracks.tracks))
        super().__init__(PRESETS["progress"])
        self.terms = (*self.terms, RACING_LINE)
        table = np.stack([_line_table(track, car) for track in tracks.tracks])
        self._table = table.astype(np.float32)

    def __call__(
        self, tracks: TrackSet, before: World, world: World, actions: ndarray, verdicts: ndarray
    ) -> Paid:
        """Return each car's reward and each term of it; see Reward."""
        total, terms = super().__call__(tracks, before, world, actions, verdicts)
        cars, index = world.cars, world.track[:, None]
        lateral, line_speed = self.line_at(index, cars["s"] / tracks.length[index])
        aside = (cars["lateral"] - lateral) / np.float32(FAR)
        speed = np.sqrt(cars["velocity_x"] ** 2 + cars["velocity_y"] ** 2)
        slower = (speed - line_speed) / np.float32(SLOW)
        near = np.maximum(1.0 - aside * aside - slower * slower, np.float32(0.0))
        near = np.where(verdicts["advance"] > 0, near, np.float32(0.0))
        return total + near, terms | {RACING_LINE: near}

    def line_at(self, index: ndarray, share: ndarray) -> tuple[ndarray, ndarray]:
        """Return lateral place [m] and speed [m/s] of a track's line at a share of the lap."""
        place = (share * np.float32(ROWS)).clip(0.0, ROWS - 1e-3)
        low = place.astype(np.int64)
        part = (place - low.astype(np.float32))[..., None]
        first = self._table[index, low]
        row = first + (self._table[index, low + 1] - first) * part
        return row[..., 0], row[..., 1]


def _line_table(track: Track, car: CarConfig) -> ndarray:
    """Return the line's place and speed at ROWS + 1 places from start to end, (ROWS + 1, 2)."""
    from league.racing_line.racing_line import optimal_line  # late: SciPy takes a while

    line = optimal_line(track, car, -car.wheel_track / 2)
    places = np.linspace(0.0, track.length, ROWS + 1)
    period = track.length if track.closed else None
    columns = [np.interp(places, line.s, one, period=period) for one in (line.lateral, line.speed)]
    return np.stack(columns, axis=1)


@compiled
def _pay_all(cars, worlds, verdicts, terms, weight, points, courses):
    for w in range(len(worlds)):
        pay(cars[w], verdicts[w], terms[w], weight, points, courses[worlds[w].track])


@inner
def pay(cars, verdicts, terms, weight, points, course):
    """Write each weighted term of each car of one world.

    Cars are those after the step, before any penalty or restart; `terms` is float32 (num_cars,
    num_terms), in the order of TERMS. Terms of weight 0 are not computed.
    """
    for c in range(len(cars)):
        seen = verdicts[c]
        terms[c, 0] = weight[0] * seen.advance
        terms[c, 1] = weight[1] * _centerline(cars[c], points, course) if weight[1] else _ZERO
        terms[c, 2] = weight[2] if seen.lap else _ZERO
        terms[c, 3] = weight[3] * _overtake(c, cars, verdicts) if weight[3] else _ZERO
        terms[c, 4] = weight[4] * _gain(c, cars, verdicts, course) if weight[4] else _ZERO
        terms[c, 5] = weight[5] if seen.off_track else _ZERO
        terms[c, 6] = weight[6] if seen.crashed or seen.pushed_off else _ZERO
        terms[c, 7] = weight[7] if seen.was_hit else _ZERO
        terms[c, 8] = weight[8] if seen.to_blame else _ZERO
        terms[c, 9] = weight[9] * seen.closing_speed * seen.closing_speed


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
def _counts(c, other, cars):
    """Return whether a rival counts for a car: one that is faster does not.

    Where being passed by a faster car costs something, cars learn to block, and within 30 million
    decisions no attack succeeds any more, even on cars of six tenths of the top speed.
    """
    return other != c and cars[other].top_speed <= cars[c].top_speed


@inner
def _overtake(c, cars, verdicts):
    """Return the rivals passed on the road, minus those that passed."""
    won = 0
    for other in range(len(verdicts)):
        if _counts(c, other, cars):
            won += (verdicts[c].overtook >> other) & 1
            won -= (verdicts[other].overtook >> c) & 1
    return f32(won)


@inner
def _gain(c, cars, verdicts, course):
    """Return the metres gained in this step on each rival within NEAR, summed over them.

    Exploration hardly ever finds a pass that pays only once it is complete; this pays on the way
    to it. After Fuchs et al., "Super-Human Performance in Gran Turismo Sport" (2021), and Song et
    al., "Autonomous Overtaking in Gran Turismo Sport" (2021), section IV.
    """
    total = _ZERO
    if verdicts[c].released or not is_racing(cars[c]):
        return total
    for other in range(len(cars)):
        if not _counts(c, other, cars) or verdicts[other].released or not is_racing(cars[other]):
            continue
        if abs(signed_gap(course, cars[c].s, cars[other].s)) < NEAR:
            total += verdicts[c].advance - verdicts[other].advance
    return total
