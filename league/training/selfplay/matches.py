"""Mirrored races of two deterministic drivers, many at once, under race rules."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import astuple, dataclass

import numpy as np

from league.agents.driver import Driver
from league.agents.policy import Policy
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv, Step
from league.sim import rng
from league.sim.config import CarConfig, RaceRules, SensorConfig, SimConfig, SolverName
from league.sim.world import World
from league.track.track import TrackSet
from league.training.selfplay.opponents import MixedDriver
from league.training.selfplay.settings import MatchConfig

_RACE_SEED = 401
_FIRST_TRACK = 402


@dataclass(frozen=True)
class Score:
    """One driver's results over its races against another."""

    races: int = 0
    """Races driven."""
    wins: float = 0.0
    """Races won; a draw is half of one."""
    crashes: int = 0
    """Contacts it was to blame for."""
    off_tracks: int = 0
    """How often it left the road."""
    metres: float = 0.0
    """Distance it drove [m]."""
    laps_s: tuple[float, ...] = ()
    """Times of its flying laps without a mistake or a contact [s]."""

    def __add__(self, other: Score) -> Score:
        """Return the score over both sets of races."""
        return Score(*(a + b for a, b in zip(astuple(self), astuple(other), strict=True)))

    @property
    def win_rate(self) -> float:
        """Share of races won, 0 to 1; one half before any race."""
        return self.wins / self.races if self.races else 0.5

    @property
    def contacts_per_km(self) -> float:
        """Contacts it was to blame for, per kilometre driven."""
        return 1000.0 * self.crashes / self.metres if self.metres > 0 else 0.0

    @property
    def off_tracks_per_km(self) -> float:
        """How often it left the road, per kilometre driven."""
        return 1000.0 * self.off_tracks / self.metres if self.metres > 0 else 0.0

    @property
    def clean_lap_s(self) -> float | None:
        """Median of its clean flying laps [s]; None if it drove none."""
        return float(np.median(self.laps_s)) if self.laps_s else None


@dataclass(frozen=True)
class _Race:
    pair: tuple[int, int]
    seed: int
    swapped: bool

    @property
    def grid(self) -> tuple[int, int]:
        """The drivers in grid order."""
        first, second = self.pair
        return (second, first) if self.swapped else (first, second)


def race_pairs(
    tracks: TrackSet,
    car: CarConfig,
    drivers: Sequence[Driver],
    pairs: Sequence[tuple[int, int]],
    cfg: MatchConfig,
    *,
    races: int,
    seed: int = 0,
    solver: SolverName = "planar",
) -> dict[tuple[int, int], tuple[Score, Score]]:
    """Race pairs of drivers; return for each pair both drivers' scores.

    Each seed is raced twice, with the drivers' slots, and with them their cars, swapped.

    Args:
        tracks: the courses, which the races' seeds take in turn, from one that `seed` draws.
        car: the cars.
        drivers: all drivers; a car carries the sensors of all of them.
        pairs: indices into `drivers`.
        cfg: length of the races and how the cars differ.
        races: races of each pair, even.
        seed: makes the races' seeds; equal ones for all pairs.
        solver: physics.
    """
    asked = [
        _Race(pair, number, swapped)
        for pair in pairs
        for number in range(races // 2)
        for swapped in (False, True)
    ]
    scores = {pair: (Score(), Score()) for pair in pairs}
    for start in range(0, len(asked), cfg.at_once):
        batch = asked[start : start + cfg.at_once]
        results = _drive(tracks, car, drivers, batch, cfg, seed, solver)
        for race, (first, second) in zip(batch, results, strict=True):
            if race.swapped:
                first, second = second, first
            before = scores[race.pair]
            scores[race.pair] = (before[0] + first, before[1] + second)
    return scores


def _drive(
    tracks: TrackSet,
    car: CarConfig,
    drivers: Sequence[Driver],
    races: Sequence[_Race],
    cfg: MatchConfig,
    seed: int,
    solver: SolverName,
) -> list[tuple[Score, Score]]:
    sensors = {driver.sensors for driver in drivers} - {SensorConfig()}
    if len(sensors) > 1:
        raise ValueError("these drivers cannot share a car: their sensors differ")
    carried = sensors.pop() if sensors else SensorConfig()
    longest = float(tracks.length.max())
    rules = RaceRules(laps=cfg.laps, max_time_s=cfg.grace_s + cfg.laps * longest / cfg.slowest)
    sim = SimConfig(kind="head_to_head", num_cars=2, car=car, rules=rules, spread=cfg.spread)
    number = np.array([race.seed for race in races])
    first = int(rng.bits(seed, _FIRST_TRACK)[0]) % len(tracks.tracks)
    env = RaceEnv(
        tracks,
        EnvConfig(sim=sim, solver=solver, sensors=(carried,)),
        num_worlds=len(races),
        track_index=(number + first) % len(tracks.tracks),
    )
    observations = env.reset(seeds=rng.bits(seed, _RACE_SEED, number) & rng.SEED_MASK)
    slots = []
    for slot in (0, 1):
        # A scripted driver remembers its car, and in the other slot it has another one.
        own = [one if isinstance(one, Policy) else copy.deepcopy(one) for one in drivers]
        mixed = MixedDriver(f"slot {slot}", carried, own)
        mixed.reset(None)
        mixed.driver_of_row = np.array([race.grid[slot] for race in races])
        slots.append(mixed)
    log = _MatchLog(len(races))
    while not log.over.all():
        actions = [mixed.act(observations[slot]) for slot, mixed in enumerate(slots)]
        log.add(env.world, env.step(np.stack(actions, axis=1)))
    env.close()
    return log.scores()


class _MatchLog:
    """The referee's verdicts until each race is decided."""

    def __init__(self, num_races: int) -> None:
        shape = num_races, 2
        self.over = np.zeros(num_races, np.bool_)
        self._wins, self._metres = np.full(shape, 0.5), np.zeros(shape)
        self._crashes, self._off_tracks = np.zeros(shape, np.int64), np.zeros(shape, np.int64)
        self._dirty = np.ones(shape, np.bool_)  # lap 1 is no flying one
        self._laps: list[tuple[list[float], list[float]]] = [([], []) for _ in range(num_races)]

    def add(self, world: World, step: Step) -> None:
        """Add a step of the races that were not decided before it."""
        verdicts, going = step.verdicts, ~self.over[:, None]
        self._crashes += verdicts["crashed"] & going
        self._off_tracks += verdicts["off_track"] & going
        self._metres += np.where(going, verdicts["advance"].clip(min=0.0), 0.0)
        self._dirty |= verdicts["mistake"] | verdicts["was_hit"] | verdicts["released"]
        for race, car in np.argwhere(verdicts["lap"] & going & ~self._dirty).tolist():
            self._laps[race][car].append(float(world.cars["last_lap_s"][race, car]))
        self._dirty &= ~verdicts["lap"]
        finished = np.any(step.terminated, axis=1)
        decided = (finished | step.truncated.any(axis=1)) & ~self.over
        for race in np.flatnonzero(decided):
            # The first to finish wins; without a finish, the one that drove farther.
            if finished[race]:
                first, second = -world.cars["finish_s"][race].astype(float)
            else:
                first, second = world.cars["distance"][race]
            share = 0.5 + 0.5 * float(np.sign(first - second))
            self._wins[race] = share, 1.0 - share
        self.over |= decided

    def scores(self) -> list[tuple[Score, Score]]:
        """Return both drivers' scores of each race, in grid order."""
        return [(self._score(race, 0), self._score(race, 1)) for race in range(len(self._laps))]

    def _score(self, race: int, car: int) -> Score:
        return Score(
            races=1,
            wins=float(self._wins[race, car]),
            crashes=int(self._crashes[race, car]),
            off_tracks=int(self._off_tracks[race, car]),
            metres=float(self._metres[race, car]),
            laps_s=tuple(self._laps[race][car]),
        )
