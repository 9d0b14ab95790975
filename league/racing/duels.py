"""Duels: how fast a rival a driver can pass, and how fast a one it can keep behind.

As in the Indy Autonomous Challenge, the defender's pace changes until half of the attacks succeed.
An attacker starts one place of the grid behind a defender that is held to a top speed; pace is that
of a flying lap alone under this top speed, as a share of the attacker's own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from league.agents.rollout import DriverPool, Rollout
from league.envs.config import EnvConfig
from league.envs.driver import Driver
from league.envs.race_env import RaceEnv
from league.envs.rewards import NEAR
from league.errors import ConfigError
from league.racing.race import dynamics
from league.sim import rng
from league.sim.config import DynamicsRandomization, RaceRules, SimConfig, SolverName
from league.track.track import Track, TrackSet

LAPS = 3
LEAST, MOST = 0.5, 1.0
"""Top speeds of a defender, as shares of the car's, between which a threshold is looked for."""
RESOLUTION = 0.01
VARIATION = 3.0
"""How far cars differ, as a multiple of a league's heats: grip and mass by 6 %, the steering's zero
by 0.015 rad; and they start at up to 0.5 m/s. With less, 200 races are a few."""
_SEED = 501
_START_S = 3.0  # until when hits are those of the start


@dataclass(frozen=True)
class DuelConfig:
    """Where and how often duels are driven."""

    track: Track
    races: int = 200
    solver: SolverName = "planar"
    seed: int = 0


@dataclass(frozen=True)
class Duels:
    """Results of many races of an attacker, which mostly starts behind a defender."""

    races: int  # races driven
    passed: float  # share of races in which the attacker finished ahead of all
    given: float  # share in which it did, and another car left the road
    clean: float  # share in which it did, without a contact to blame for or leaving the road
    held: float  # share in which the defender finished ahead, without a contact to blame for
    places: float  # mean number of places that the attacker gained
    near_km: float  # distance the attacker drove within 1.5 m of another car [km]
    contacts: int  # contacts the attacker was to blame for
    hard_contacts: int  # those hard enough for a penalty: from 0.3 m/s of closing speed on
    hard_at_start: int  # those of them in the first three seconds
    off_tracks: int  # how often the attacker left the road
    finished: float  # share of cars that finished; 0 unless races were driven to the end


@dataclass(frozen=True)
class Threshold:
    """The pace at which half of the attacks succeed."""

    pace: float
    """Fastest pace of a defender that is passed cleanly in at least half of the races; 0: none."""
    hold: float
    """Fastest pace of an attacker, as a share of the defender's, that is kept behind in at least
    half of the races; 0: none."""
    duels: dict[float, Duels]  # results by the defender's pace

    @property
    def contacts_per_km(self) -> float:
        """Contacts to blame for per km driven near the other car, at all paces."""
        return self._sum("contacts") / max(self._sum("near_km"), 1e-9)

    @property
    def hard_contacts_per_km(self) -> float:
        """Those of them that are hard enough for a penalty, per km."""
        return self._sum("hard_contacts") / max(self._sum("near_km"), 1e-9)

    @property
    def hard_at_start(self) -> float:
        """Share of the hard contacts in the first three seconds."""
        return self._sum("hard_at_start") / max(self._sum("hard_contacts"), 1.0)

    @property
    def off_tracks_per_pass(self) -> float:
        """How often the attacker left the road for each race in which it passed."""
        passes = sum(one.passed * one.races for one in self.duels.values())
        return self._sum("off_tracks") / max(passes, 1.0)

    def _sum(self, name: str) -> float:
        return float(sum(getattr(one, name) for one in self.duels.values()))


def from_behind(cfg: DuelConfig, field: Sequence[Driver], top_speeds: Sequence[float]) -> Duels:
    """Race the last of the grid, as `from_place`, until it or all others are home."""
    return from_place(cfg, field, top_speeds, len(field) - 1, to_the_end=False)


def from_place(
    cfg: DuelConfig,
    field: Sequence[Driver],
    top_speeds: Sequence[float],
    place: int,
    *,
    to_the_end: bool = True,
) -> Duels:
    """Race a driver from a place of the grid.

    Args:
        cfg: track, number of races, solver and seed.
        field: the drivers in the order of the grid, each another object; the first one of the
            attacker's rivals defends.
        top_speeds: of their cars, as shares of what the car can be asked for.
        place: of the attacker, from 0.
        to_the_end: drive on until all cars are home; what happens once the attacker, or all others,
            are home counts for `finished` only.
    """
    env = make_env(cfg, field, cfg.races)
    rollout = Rollout(env, DriverPool([field] * cfg.races, strict=True), seeds(cfg).tolist())
    cars, rivals = env.world.cars, np.arange(len(field)) != place
    cars["top_speed"] = np.array(top_speeds, np.float32) * env.cfg.sim.car.max_speed
    over, home, near_m = np.zeros(cfg.races, np.bool_), np.zeros(cars.shape, np.bool_), 0.0
    contacts, hard, early, off = (np.zeros(cars.shape, np.int64) for _ in range(4))
    touching = np.zeros(cars.shape, np.bool_)
    end = env.world.worlds["last_step"].max()
    while not (home if to_the_end else over).all() and env.world.worlds["step"].max() < end:
        step = rollout.step()
        seen, going = step.verdicts, ~over[:, None]
        contacts += seen["to_blame"] & ~touching & going
        hard += seen["crashed"] & going
        early += seen["crashed"] & going & (env.time_s <= _START_S)[:, None]
        off += (seen["off_track"] | seen["pushed_off"]) & going
        touching = seen["to_blame"].copy()
        gaps = env.tracks.signed_gap(env.world.track, cars["s"][:, rivals], cars["s"][:, [place]])
        near = (np.abs(gaps) < NEAR).any(axis=1) & ~over
        near_m += float(seen["advance"][near, place].clip(min=0.0).sum())
        # The race is decided when the attacker, or all others, have finished.
        home = step.terminated
        over |= home[:, place] | home[:, rivals].all(axis=1)
    merit = np.where(np.isfinite(cars["finish_s"]), 1e6 - cars["finish_s"], cars["distance"])
    ahead = merit[:, [place]] > merit[:, rivals]
    clean = (contacts[:, place] == 0) & (off[:, place] == 0)
    finished = np.isfinite(cars["finish_s"]).mean() if to_the_end else 0.0
    env.close()
    return Duels(
        races=cfg.races,
        passed=float(ahead.all(axis=1).mean()),
        given=float((ahead.all(axis=1) & (off[:, rivals] > 0).any(axis=1)).mean()),
        clean=float((ahead.all(axis=1) & clean).mean()),
        held=float((~ahead[:, 0] & (contacts[:, rivals][:, 0] == 0)).mean()),
        places=float(ahead.sum(axis=1).mean()) - (len(field) - 1 - place),
        near_km=near_m / 1000.0,
        contacts=int(contacts[:, place].sum()),
        hard_contacts=int(hard[:, place].sum()),
        hard_at_start=int(early[:, place].sum()),
        off_tracks=int(off[:, place].sum()),
        finished=float(finished),
    )


def solo_lap(cfg: DuelConfig, driver: Driver, top_speed: float = 1.0) -> float:
    """Return the time of a flying lap alone, without variation [s]; infinite: none.

    The best of LAPS - 1 laps after the first; on an open track, which has one lap, that lap.
    """
    env = make_env(cfg, (driver,), 1)
    rollout = Rollout(env, DriverPool([(driver,)], strict=True), [cfg.seed])
    env.world.cars["top_speed"] = top_speed * env.cfg.sim.car.max_speed
    best, laps = np.inf, 0
    for _ in range(int(env.world.worlds["last_step"][0])):
        step = rollout.step()
        if step.verdicts["lap"][0, 0]:
            laps += 1
            if laps > 1 or not cfg.track.closed:
                best = min(best, float(env.world.cars["last_lap_s"][0, 0]))
        if step.terminated.all():
            break
    env.close()
    return best


def threshold(cfg: DuelConfig, attacker: Driver, defender: Driver) -> Threshold:
    """Find the fastest defender that is passed in half of the races, and the fastest that holds.

    Raises:
        ConfigError: the attacker drives no complete lap alone.
    """
    own = solo_lap(cfg, attacker)
    if not np.isfinite(own):
        raise ConfigError(
            f"{attacker.name} drives no complete lap alone on {cfg.track.name}: "
            "give a driver that does"
        )
    results: dict[float, Duels] = {}
    low, high, best = LEAST, MOST, 0.0
    while high - low > RESOLUTION:
        share = 0.5 * (low + high)
        pace = own / solo_lap(cfg, defender, share)
        results[pace] = found = from_behind(cfg, (defender, attacker), (share, 1.0))
        if found.clean >= 0.5:
            low, best = share, max(best, pace)
        else:
            high = share
    holding = [1.0 / pace for pace, found in results.items() if found.held >= 0.5 and pace > 0.0]
    return Threshold(pace=best, hold=max(holding, default=0.0), duels=dict(sorted(results.items())))


def seeds(cfg: DuelConfig) -> np.ndarray:
    """Return the seed of each race, int64 (races,)."""
    return rng.bits(cfg.seed, _SEED, np.arange(cfg.races)) & rng.SEED_MASK


def make_env(cfg: DuelConfig, drivers: Sequence[Driver], worlds: int) -> RaceEnv:
    """Return worlds in which these drivers race, in the order of the grid, or one drives alone."""
    spread = dynamics(VARIATION, 0.5) if len(drivers) > 1 else DynamicsRandomization()
    sim = SimConfig(
        kind="head_to_head" if len(drivers) > 1 else "time_trial",
        num_cars=len(drivers),
        rules=RaceRules(laps=LAPS, max_time_s=20.0 + LAPS * cfg.track.length),
        spread=spread,
    )
    return RaceEnv(
        TrackSet(cfg.track),
        EnvConfig(sim=sim, solver=cfg.solver, sensors=tuple(one.sensors for one in drivers)),
        num_worlds=worlds,
        seed=cfg.seed,
    )
