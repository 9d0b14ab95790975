"""Fixed races in both solvers, and decisions, hashed field by field; a program that prints them."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from league.agents import checkpoint
from league.agents.policy import Policy
from league.envs import step as stages
from league.envs.config import EnvConfig, Scenarios
from league.envs.race_env import RaceEnv
from league.envs.state import INDEX
from league.portable_math import f32
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.sim import config, rng
from league.sim.records import World
from league.track import files
from league.track.track import TrackSet

_STEERING, _SPEED = 1, 2
_HELD = 5
"""Control steps for which a draw is held."""
_SHORT = config.RaceRules(laps=1, off_track_penalty_s=0.4, crash_penalty_s=0.6, max_time_s=14.0)
ORIGINAL = replace(
    config.RULES["deepracer"],
    **{name: getattr(_SHORT, name) for name in ("laps", "max_time_s")},
    **{name: getattr(_SHORT, name) for name in ("off_track_penalty_s", "crash_penalty_s")},
)
"""The same under the rules of older versions."""
_SPREAD = config.DynamicsRandomization(
    grip=0.3, mass=0.3, latency_s=0.06, steering_offset=0.03, camera_position=0.01, camera_angle=0.1
)
_SENSORS = (config.SensorConfig(lidar=config.LidarConfig()),)
_SEEING = (config.SensorConfig.full(64, 48),)
_SCRIPTED = ("centerline", "cautious", "racing_line", "blocker")
"""The faster ones begin behind, so they pass; with this seed two of them hit another in Bullet."""
_SEED = 9
_COLOUR = (config.SensorConfig(camera=config.CameraConfig(width=48, height=36, colour=True)),)


def _sim(cars: int = 1, **settings) -> config.SimConfig:
    kind = "head_to_head" if cars > 1 else "obstacle_avoidance"
    return config.SimConfig(kind=kind, num_cars=cars, **settings)


def races(rules: config.RaceRules = _SHORT) -> dict[str, tuple[EnvConfig, int, int]]:
    """Return the settings of each race, its worlds and its steps."""
    boxes, bots = config.ObstacleConfig(), config.ObstacleConfig(kind="bot", speed=1.0)
    scenarios = Scenarios(shortest=2.0)
    meeting = {"mode": "training", "episode_s": 4.0, "scenarios": scenarios}
    return {
        "race": (EnvConfig(sim=_sim(4, rules=rules, spread=_SPREAD), sensors=_SENSORS), 6, 240),
        "boxes": (EnvConfig(sim=_sim(rules=rules, obstacles=boxes), sensors=_SEEING), 6, 240),
        "bots": (EnvConfig(sim=_sim(rules=rules, obstacles=bots), sensors=_COLOUR), 6, 240),
        "meeting": (EnvConfig(sim=_sim(3, rules=rules, spread=_SPREAD), **meeting), 6, 200),
        # So many cars that threads share them.
        "crowd": (EnvConfig(sim=_sim(8, rules=rules)), 128, 30),
    }


def drive(cfg: EnvConfig, num_worlds: int, num_steps: int) -> Iterator[RaceEnv]:
    """Yield an environment after each step."""
    tracks = TrackSet(*(files.load(name) for name in ("reinvent_2018", "comet", "needle_pass")))
    env = RaceEnv(tracks, cfg, num_worlds=num_worlds)
    env.reset(seeds=np.arange(1, num_worlds + 1))
    for step in range(num_steps):
        env.step(_actions(env, step // _HELD))
        yield env


def _actions(env: RaceEnv, number: int) -> np.ndarray:
    """Return actions that follow the road and swerve; cars that have finished only swerve.

    Nothing but sums and products, which are the same on every machine.
    """
    worlds, cars = np.arange(env.num_worlds)[:, None], np.arange(env.num_cars)[None, :]
    state = np.stack([seen["state"] for seen in env.observations], axis=1)
    lateral, heading, bend = (
        state[..., INDEX[name]] for name in ("lateral", "heading_error", "curvature_0.25m")
    )
    follow = (bend - f32(1.5) * lateral - f32(2.5) * heading) * f32(0.3)
    swerve = rng.uniform(worlds, _STEERING, number, cars) - f32(0.5)
    steering = np.where(np.isinf(env.world.cars["finish_s"]), follow, f32(0.0)) + swerve
    speed = rng.uniform(worlds, _SPEED, number, cars) - f32(0.6)
    return np.stack([steering.clip(-1, 1), speed], axis=-1)


def raced(name: str, rules: config.RaceRules = _SHORT) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name and the numbers of each field, step by step."""
    for env in drive(*races(rules)[name]):
        tables = {
            "cars": env.world.cars,
            "obstacles": env.world.obstacles,
            "worlds": env.world.worlds,
            "verdicts": env._verdicts,
            "outcomes": env._outcomes,
        }
        for table, records in tables.items():
            for field in records.dtype.names or ():
                yield f"{name} {table} {field}", records[field]
        for group in env.observations[0]:
            seen = [observations[group] for observations in env.observations]
            yield f"{name} observations {group}", np.stack(seen)


def contests() -> dict[str, RaceSpec]:
    """Return races of drivers, which `race.run` runs as `league race` does."""

    def spec(*names: str, **settings) -> RaceSpec:
        entries = tuple(Entry(name=name) for name in names)
        return RaceSpec(entries=entries, laps=1, seed=_SEED, variation=1.0, **settings)

    with_bullet = {"scripted_bullet": spec(*_SCRIPTED)} if find_spec("pybullet") else {}
    return {
        **with_bullet,
        "scripted_planar": spec(*_SCRIPTED, solver="planar"),
        "policies": spec("duelist", "racer", solver="planar"),
    }


def contested(name: str) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name and the numbers of each field of a race of drivers, frame by frame.

    At its end come the replay's columns, among them the drivers' actions, and the classification.
    """
    frames: list[World] = []
    finished = race.run(contests()[name], watch=lambda world: frames.append(world.copy()))
    for world in frames:
        for table in ("cars", "worlds"):
            records = getattr(world, table)
            for field in records.dtype.names or ():
                yield f"{name} {table} {field}", records[field]
    assert finished.replay is not None
    for field, numbers in vars(finished.replay.columns).items():
        yield f"{name} replay {field}", numbers
    result = finished.result.model_dump_json(exclude={"spec"}).encode()
    yield f"{name} result", np.frombuffer(result, np.uint8)


def decided() -> np.ndarray:
    """Return what a trained policy answers to made-up pictures and motions."""
    trained = checkpoint.load(Path(__file__).parents[1] / "garage" / "dodger.pt")
    rows = np.arange(16)
    groups: dict[str, np.ndarray] = {}
    for group, shape in trained.card.group_shapes.items():
        place = np.arange(int(np.prod(shape)))
        numbers = rng.uniform(rows[:, None], len(shape), place[None, :]).reshape(-1, *shape)
        groups[group] = (numbers * f32(255)).astype(np.uint8) if len(shape) == 3 else numbers
    return Policy(trained, config.CarConfig()).outputs(groups)


def digests() -> dict[str, str]:
    """Return a hash of all that each field was, by race, table and field."""
    found: dict[str, hashlib._Hash] = {}
    runs = *map(raced, races()), *map(contested, contests())
    for run in runs:
        for field, numbers in run:
            found.setdefault(field, hashlib.sha256()).update(numbers.tobytes())
    found["policy outputs"] = hashlib.sha256(decided().tobytes())
    return {name: seen.hexdigest() for name, seen in found.items()}


def by_race(fields: dict[str, str]) -> dict[str, str]:
    """Return a short hash of each race over the hashes of its fields, in the order of their names."""
    parts: dict[str, hashlib._Hash] = {}
    for field, seen in sorted(fields.items()):
        parts.setdefault(field.split()[0], hashlib.sha256()).update(seen.encode())
    return {name: part.hexdigest()[:16] for name, part in parts.items()}


def target() -> tuple[str, str]:
    """Return the processor and its features that code is compiled for."""
    _, name, features = stages.step.targetctx.codegen().magic_tuple()  # pyright: ignore[reportFunctionMemberAccess]
    return name, features


if __name__ == "__main__":
    found = digests()
    print(json.dumps({"target": target(), "races": by_race(found), "digests": found}))
