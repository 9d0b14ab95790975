"""Mirrored races of two deterministic drivers, many at once, under race rules."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from league.agents.driver import Driver
from league.agents.policy import Policy
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv, Step
from league.sim import rng
from league.sim.config import CarConfig, RaceRules, SensorConfig, SimConfig, SolverName
from league.sim.world import World
from league.track.track import TrackSet
from league.training.selfplay.settings import DuelConfig
from league.training.selfplay.snapshot_opponents import Seats

_RACE_SEED = 401
_FIRST_TRACK = 402


@dataclass(frozen=True)
class Score:
    """What became of one driver over the races against one other."""

    races: int = 0
    """Races driven."""
    wins: float = 0.0
    """Races won; a draw is half of one."""
    crashes: int = 0
    """Contacts it was to blame for."""
    hits: int = 0
    """Contacts the other was to blame for."""
    off_tracks: int = 0
    """How often it left the road."""
    metres: float = 0.0
    """Distance it drove [m]."""
    laps_s: tuple[float, ...] = ()
    """Times of its flying laps without a mistake or a contact [s]."""

    def __add__(self, other: Score) -> Score:
        """Return the score over both sets of races."""
        return Score(
            self.races + other.races,
            self.wins + other.wins,
            self.crashes + other.crashes,
            self.hits + other.hits,
            self.off_tracks + other.off_tracks,
            self.metres + other.metres,
            self.laps_s + other.laps_s,
        )

    @property
    def win_rate(self) -> float:
        """Share of races won, 0 to 1; one half before any race."""
        return self.wins / self.races if self.races else 0.5

    @property
    def contacts_per_km(self) -> float:
        """Contacts it was to blame for, for each kilometre driven."""
        return 1000.0 * self.crashes / self.metres if self.metres > 0 else 0.0

    @property
    def off_tracks_per_km(self) -> float:
        """How often it left the road, for each kilometre driven."""
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
    def slots(self) -> tuple[int, int]:
        """Who starts first and who second."""
        first, second = self.pair
        return (second, first) if self.swapped else (first, second)


def meet(
    tracks: TrackSet,
    car: CarConfig,
    drivers: Sequence[Driver],
    pairs: Sequence[tuple[int, int]],
    cfg: DuelConfig,
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
        drivers: who races; a car carries the sensors of all of them.
        pairs: who against whom, indices into `drivers`.
        cfg: length of the races and how the cars differ.
        races: races of each pair, even.
        seed: makes the races' seeds; equal ones for all pairs.
        solver: physics.
    """
    heats = [
        _Race(pair, number, swapped)
        for pair in pairs
        for number in range(races // 2)
        for swapped in (False, True)
    ]
    found = {pair: (Score(), Score()) for pair in pairs}
    for start in range(0, len(heats), cfg.at_once):
        batch = heats[start : start + cfg.at_once]
        scores = _drive(tracks, car, drivers, batch, cfg, seed, solver)
        for race, (one, two) in zip(batch, scores, strict=True):
            if race.swapped:
                one, two = two, one
            before = found[race.pair]
            found[race.pair] = (before[0] + one, before[1] + two)
    return found


def rules(tracks: TrackSet, cfg: DuelConfig) -> RaceRules:
    """Return the rules of a measuring race."""
    longest = float(tracks.length.max())
    return RaceRules(laps=cfg.laps, max_time_s=cfg.grace_s + cfg.laps * longest / cfg.slowest)


def sensors_for(drivers: Sequence[Driver]) -> SensorConfig:
    """Return what a car carries that any of these may drive.

    Raises:
        ValueError: two of them need different sensors.
    """
    wanted = {driver.sensors for driver in drivers} - {SensorConfig()}
    if len(wanted) > 1:
        raise ValueError("these drivers cannot share a seat: their sensors differ")
    return wanted.pop() if wanted else SensorConfig()


def _drive(
    tracks: TrackSet,
    car: CarConfig,
    drivers: Sequence[Driver],
    races: Sequence[_Race],
    cfg: DuelConfig,
    seed: int,
    solver: SolverName,
) -> list[tuple[Score, Score]]:
    sim = SimConfig(
        kind="head_to_head", num_cars=2, car=car, rules=rules(tracks, cfg), spread=cfg.spread
    )
    number = np.array([race.seed for race in races])
    seeds = rng.bits(seed, _RACE_SEED, number) & rng.SEED_MASK
    first = int(rng.bits(seed, _FIRST_TRACK)[0]) % len(tracks.tracks)
    carried = sensors_for(drivers)
    env = RaceEnv(
        tracks,
        EnvConfig(sim=sim, solver=solver, sensors=(carried,)),
        num_worlds=len(races),
        track_index=(number + first) % len(tracks.tracks),
    )
    told = env.reset(seeds=seeds)
    book = _Book(len(races))
    seats = [
        _seated(drivers, np.array([race.slots[slot] for race in races]), slot) for slot in (0, 1)
    ]
    while not book.over.all():
        actions = np.stack([seat.act(told[slot]) for slot, seat in enumerate(seats)], axis=1)
        book.note(env.world, env.step(actions))
    env.close()
    return book.scores()


def _seated(drivers: Sequence[Driver], who: np.ndarray, slot: int) -> Seats:
    """Return one slot of all races, with drivers of its own that have forgotten everything."""
    # A scripted driver remembers its car, and in the other slot it has another one.
    own = [one if isinstance(one, Policy) else copy.deepcopy(one) for one in drivers]
    seats = Seats(f"slot {slot}", sensors_for(drivers), own)
    seats.reset(None)
    seats.sit(who)
    return seats


class _Book:
    """What the referee found, until each race is decided."""

    def __init__(self, num_races: int) -> None:
        self._metres = np.zeros((num_races, 2))
        self._wins = np.full_like(self._metres, 0.5)
        counted = ("crashed", "was_hit", "off_track")
        self._count = {name: np.zeros((num_races, 2), np.int64) for name in counted}
        self._dirty = np.ones((num_races, 2), np.bool_)  # lap 1 is no flying one
        self.over = np.zeros(num_races, np.bool_)
        self._laps: list[tuple[list[float], list[float]]] = [([], []) for _ in range(num_races)]

    def note(self, world: World, step: Step) -> None:
        """Take a step into account, in races that were not decided before it."""
        seen, going = step.verdicts, ~self.over[:, None]
        for name, count in self._count.items():
            count += seen[name] & going
        self._metres += np.where(going, seen["advance"].clip(min=0.0), 0.0)
        self._dirty |= seen["mistake"] | seen["was_hit"] | seen["released"]
        for race, car in np.argwhere(seen["lap"] & going & ~self._dirty).tolist():
            self._laps[race][car].append(float(world.cars["last_lap_s"][race, car]))
        self._dirty &= ~seen["lap"]
        home = np.any(step.terminated, axis=1)
        decided = (home | step.truncated.any(axis=1)) & ~self.over
        for race in np.flatnonzero(decided):
            finish = world.cars["finish_s"][race].tolist()
            distance = world.cars["distance"][race].tolist()
            # Who is home first has won; if nobody is when time is up, who came farther.
            lead = np.where(home[race], finish[1] - finish[0], distance[0] - distance[1])
            first = 0.5 + 0.5 * float(np.sign(lead))
            self._wins[race] = first, 1.0 - first
        self.over |= decided

    def scores(self) -> list[tuple[Score, Score]]:
        """Return both drivers' scores of each race, by slot."""
        return [(self._score(race, 0), self._score(race, 1)) for race in range(len(self._laps))]

    def _score(self, race: int, car: int) -> Score:
        counts = {name: int(count[race, car]) for name, count in self._count.items()}
        return Score(
            races=1,
            wins=float(self._wins[race, car]),
            crashes=counts["crashed"],
            hits=counts["was_hit"],
            off_tracks=counts["off_track"],
            metres=float(self._metres[race, car]),
            laps_s=tuple(self._laps[race][car]),
        )
