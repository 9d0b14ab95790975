"""Situations recorded on the spot: short scripted drives of every race kind, to try rewards on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from league.deepracer.params import Params, Situations
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.envs.state import INDEX
from league.sim.config import ObstacleConfig, RaceKind, RaceRules, SimConfig
from league.sim.world import World
from league.track import files
from league.track.track import Track, TrackSet

_TRACK = "reinvent_2018"


@dataclass(frozen=True)
class Drive:
    """One scripted drive, as reward functions see it."""

    title: str
    """What it shows."""
    kind: RaceKind
    """Kind of race."""
    params: list[Params]
    """What a function is told, step by step."""


@dataclass
class _Listener:
    """A reward that pays nothing and keeps what others would be told."""

    situations: Situations
    kept: list[Params] = field(default_factory=list)
    terms: tuple[str, ...] = ()

    def restart(self, world: World, who: np.ndarray) -> None:
        self.situations.restart(who)

    def __call__(
        self,
        tracks: TrackSet,
        before: World,
        world: World,
        actions: np.ndarray,
        verdicts: np.ndarray,
    ) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        self.kept.extend(self.situations.rows(tracks, before, world, verdicts).params)
        return np.zeros(verdicts.shape, np.float32), {}


def drives() -> tuple[Drive, ...]:
    """Drive them all: about 700 steps, in a second or two."""
    track = files.load(_TRACK)
    other_way = track.mirrored()
    one_lap = RaceRules(laps=1)
    alone = SimConfig(rules=one_lap)
    boxes = SimConfig(
        kind="obstacle_avoidance",
        rules=one_lap,
        obstacles=ObstacleConfig(count=3, places=((0.15, 1.0), (0.3, -1.0), (0.5, 0.0))),
    )
    two = SimConfig(kind="head_to_head", num_cars=2, rules=one_lap)
    return (
        _drive("alone: a whole lap", track, alone, speeds=(2.0,)),
        _drive("alone: off the track", track, alone, speeds=(2.0,), straight_on=40),
        _drive("alone: a lap, clockwise", other_way, alone, speeds=(2.0,)),
        _drive("boxes: into one", track, boxes, speeds=(2.0,)),
        _drive("cars: into the one ahead", track, two, speeds=(1.2, 2.4)),
        _drive("cars: passing one", other_way, two, speeds=(1.6, 2.2), lanes=(0.19, -0.19)),
    )


def _drive(
    title: str,
    track: Track,
    sim: SimConfig,
    *,
    speeds: Sequence[float],
    lanes: Sequence[float] = (0.0, 0.0),
    straight_on: int | None = None,
) -> Drive:
    """Drive until an episode of the last car ends, or for 15 s.

    Args:
        title: what it shows.
        track: the course.
        sim: settings.
        speeds: of each car [m/s].
        lanes: of each car, to the left of the centreline [m].
        straight_on: step from which the steering is left alone, if any.
    """
    paid = sim.num_cars - 1
    listener = _Listener(Situations(sim, (paid,)))
    cfg = EnvConfig(sim=sim, mode="race")
    env = RaceEnv(TrackSet(track), cfg, seed=1, reward=listener)
    told = env.reset(seed=1)
    for number in range(15 * sim.step_hz):
        actions = np.stack(
            [
                _follow(groups["state"], speed, lane, sim)
                for groups, speed, lane in zip(told, speeds, lanes, strict=False)
            ],
            axis=1,
        )
        if straight_on is not None and number >= straight_on:
            actions[..., 0] = 0.0
        seen = env.step(actions).verdicts[0, paid]
        if seen["mistake"] or seen["finished"]:
            break
    env.close()
    return Drive(title=title, kind=sim.kind, params=listener.kept)


def _follow(state: np.ndarray, speed: float, lane: float, sim: SimConfig) -> np.ndarray:
    """Follow a line beside the centreline by two gains."""
    car = sim.car
    lateral, heading = state[:, INDEX["lateral"]] - lane, state[:, INDEX["heading_error"]]
    bend = state[:, INDEX["curvature_0.25m"]] - 1.5 * lateral - 2.5 * heading
    steering = np.arctan(car.wheelbase * bend) / car.max_steering
    share = np.full_like(steering, (speed - car.min_speed) / (car.max_speed - car.min_speed))
    return np.stack([steering, 2.0 * share - 1.0], axis=1).clip(-1.0, 1.0)
