"""Recordings for the tests of replays: tiny ones made by hand, short ones really raced."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache

from league.race_spec import CarResult, Entry, Event, RaceResult, RaceSpec
from league.racing import race
from league.replay import Recorder, Replay
from league.sim.config import ObstacleConfig, SimConfig
from league.sim.records import World
from league.track import files
from league.track.track import TrackSet
from tests.scenes import start

Change = Callable[[World, int], World]


@lru_cache(maxsize=4)
def raced(solver: str = "planar", drivers: tuple[str, ...] = ("racing_line", "cautious"), **asked):
    """Return a real race of one lap with its replay."""
    entries = tuple(Entry(name=name) for name in drivers)
    return race.run(RaceSpec(entries=entries, laps=1, solver=solver, seed=3, **asked)).replay


def by_hand(frames: int, change: Change = lambda world, _: world, cars: int = 2) -> Replay:
    """Return a recording in which cars stand on the grid but for what `change` does each step."""
    return finish(recorder_of(frames, change, cars), frames, cars)


def recorder_of(frames: int, change: Change = lambda world, _: world, cars: int = 2) -> Recorder:
    """Return a recorder of such a race, not yet finished."""
    tracks = TrackSet(files.load("reinvent_2018"))
    world = first_world(tracks, cars)
    recorder = Recorder(spec(cars), tracks)
    for number in range(frames):
        now = change(world, number).copy()
        now.worlds["step"] = number
        now.cars["action_steering"] = now.cars["action_speed"] = 0.25 if number else 0.0
        recorder.add(now)
    return recorder


def _boxes(cars: int) -> int:
    return 3 if cars == 1 else 0


def first_world(tracks: TrackSet, cars: int = 2) -> World:
    """Return one world on the grid."""
    kind = "head_to_head" if cars > 1 else "obstacle_avoidance"
    sim = SimConfig(kind=kind, num_cars=cars, obstacles=ObstacleConfig(count=_boxes(cars)))
    return start(tracks, sim, [5])


def spec(cars: int = 2) -> RaceSpec:
    """Return what such a race was asked to be."""
    kind = "head_to_head" if cars > 1 else "obstacle_avoidance"
    entries = tuple(Entry(name=f"driver_{slot}") for slot in range(cars))
    return RaceSpec(kind=kind, laps=2, entries=entries, obstacles=_boxes(cars))


def finish(recorder: Recorder, frames: int, cars: int = 2) -> Replay:
    """Return the replay, with a made-up classification in grid order."""
    order = tuple(
        CarResult(
            car=slot,
            name=f"driver_{slot}",
            place=slot + 1,
            finished=False,
            laps=0,
            total_s=(frames - 1) / 15,
            lap_times_s=(),
            distance=-0.75 * slot,
            off_tracks=0,
            crashes=0,
            contacts_taken=0,
            immobilised=0,
            reversed=0,
            penalty_s=0.0,
            overtakes=0,
        )
        for slot in range(cars)
    )
    return recorder.finish(
        RaceResult(
            spec=spec(cars),
            order=order,
            steps=frames - 1,
            race_s=(frames - 1) / 15,
            lead_changes=0,
            events=(Event(time_s=0.0, kind="start", car=0),),
        )
    )


def moved(world: World, **columns: list[float]) -> World:
    """Return the world with these columns of motion replaced, one number for each car."""
    world = world.copy()
    for name, values in columns.items():
        world.cars[name] = values
    return world
