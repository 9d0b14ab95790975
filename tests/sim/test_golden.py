"""Drives, contacts and rules as the torch simulator of commit 728ba3f had them; see tests/data."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from league.envs import step as stages
from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv
from league.sim import config, referee
from league.track import files
from league.track.track import TrackSet
from tests.scenes import go_to, make_ring, make_straight, put_cars, touch
from tests.sim import golden

MOTION, RULES, RACES = (
    dict(np.load(golden.DATA / f"{name}.npz")) for name in ("motion", "rules", "races")
)
DESCRIBED = golden.described()
CLASSES = {
    "rules": partial(replace, config.RULES["deepracer"]),
    "spread": config.DynamicsRandomization,
    "obstacles": config.ObstacleConfig,
}
SHAPES = {
    "ring": make_ring,
    "straight": make_straight,
    "hairpin": lambda: make_ring(points=60, width=0.6),
}
FULL = np.float32(64)
"""Actions are recorded as integers, 64 for 1."""
ROUNDING = {"scenes": 1e-6, "races": 1e-4}
"""How far places [m] and times [s] may differ."""


def course(*names: str) -> TrackSet:
    return TrackSet(*(SHAPES[name]() if name in SHAPES else files.load(name) for name in names))


def sim_of(scene: dict) -> config.SimConfig:
    settings = {"rules": {}, **golden.sim_settings(scene)}
    made = {key: CLASSES[key](**v) if key in CLASSES else v for key, v in settings.items()}
    return config.SimConfig(**made)


def begun(name: str, tracks: TrackSet, sim: config.SimConfig) -> tuple[RaceEnv, np.ndarray]:
    """Return an environment with cars that begin as recorded, and the recorded moments."""
    start, seen = MOTION[f"{name}.start"], MOTION[f"{name}.seen"]
    seeds = MOTION[f"{name}.seeds"] if f"{name}.seeds" in MOTION else np.arange(1, len(start) + 1)
    env = RaceEnv(tracks, EnvConfig(sim=sim), num_worlds=len(start))
    env.reset(seeds=seeds, track_index=start["track"][:, 0])
    for field in (*golden.MOTION, "s", "lateral"):
        env.world.cars[field] = start[field]
    env.world.cars["distance"] = env.world.cars["best_distance"] = start["s"]
    return env, seen


def judged(env: RaceEnv, actions: np.ndarray) -> None:
    """Drive a step and judge it, but apply no penalties: a car off the track drives on."""
    env._run(stages.PREPARE | stages.PHYSICS | stages.JUDGE, actions / FULL)


def snapshot(kind: np.dtype, env: RaceEnv) -> np.ndarray:
    """Return this moment of all cars as records of the kind that is recorded."""
    world, verdicts = env.world, env._verdicts
    stopped = world.obstacles["stopped_s"]
    special = {
        "leader": world.worlds["leader"][:, None],
        "lead_changes": world.worlds["lead_changes"][:, None],
        "place": referee.running_order(world.cars, False),
        "stopped_s": stopped.max(axis=1, keepdims=True) if stopped.size else 0.0,
        "wall": verdicts["wall"],
    }
    out = np.zeros(world.cars.shape, kind)
    owner = verdicts if kind == golden.VERDICT else world.cars
    for name in out.dtype.names or ():
        out[name] = special[name] if name in special else owner[name]
    return out


def turned(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Return how far headings are apart [rad]."""
    return np.abs(np.remainder(one["yaw"] - other["yaw"] + np.pi, 2 * np.pi) - np.pi)


def commanded(
    env: RaceEnv, places: list[tuple[float, float] | None], extra: dict, *, penalties: bool
) -> None:
    """Have a scene's command stand for the physics of a step, and judge it."""
    nothing = np.zeros((1, env.num_cars, 2), np.float32)
    env._run(stages.PREPARE, nothing)
    gone = go_to(env.tracks, env.world, [place or (0.0, 0.0) for place in places]).cars
    for car, place in enumerate(places):
        if place is not None:
            for field in ("x", "y", "yaw", "velocity_x", "velocity_y"):
                env.world.cars[field][0, car] = gone[field][0, car]
    env._contacts[:] = touch(env.world, *extra.get("touch", ()), obstacles=extra.get("things", ()))
    env._contacts["wall"][:, extra.get("wall", [])] = True
    env._run(stages.JUDGE | stages.SETTLE * penalties, nothing)


def assert_agree(now: np.ndarray, then: np.ndarray, most: float, where: str) -> None:
    """Fail unless flags, counts and names agree exactly, and places and times nearly."""
    for name in now.dtype.names or ():
        one, other = now[name], then[name]
        if one.dtype == np.float32:
            np.testing.assert_allclose(one, other, rtol=0, atol=most, err_msg=f"{where} {name}")
        else:
            np.testing.assert_array_equal(one, other, err_msg=f"{where} {name}")


@pytest.mark.parametrize(
    ("name", "spread"),
    [
        ("drives", config.DynamicsRandomization()),
        (
            "drives_of_different_cars",
            config.DynamicsRandomization(
                grip=0.3, mass=0.3, latency_s=1 / 15, steering_offset=0.05
            ),
        ),
    ],
)
def test_drives_of_two_seconds_agree_within_a_tenth_of_a_millimetre(name, spread):
    tracks = course(*MOTION[f"{name}.names"].tolist())
    env, seen = begun(name, tracks, config.SimConfig(spread=spread))
    for step, asked in enumerate(MOTION[f"{name}.actions"]):
        judged(env, asked)
        if step % 2 == 0:
            continue
        now, then = snapshot(golden.DRIVEN, env), seen[step // 2]
        assert np.hypot(now["x"] - then["x"], now["y"] - then["y"]).max() < 1e-4
        assert turned(now, then).max() < math.radians(0.01)
        for field, most in (("velocity_x", 5e-4), ("velocity_y", 5e-4), ("yaw_rate", 5e-3)):
            np.testing.assert_allclose(now[field], then[field], rtol=0, atol=most)
        # Where cars are far off the road the search along it has not quite converged.
        for field in ("s", "lateral", "distance"):
            np.testing.assert_allclose(now[field], then[field], rtol=0, atol=1e-3)
    assert np.hypot(env.world.cars["velocity_x"], env.world.cars["velocity_y"]).max() > 2


@pytest.mark.parametrize("name", golden.CONTACTS)
def test_contacts_agree_within_hundredths_of_a_millimetre_per_second(name):
    number = MOTION[f"{name}.start"].shape[1]
    thing = [name, 0.5, 1.0] if name in ("box", "bot") else None
    env, seen = begun(name, course("ring"), sim_of({"cars": number, "things": thing}))
    for asked, then in zip(MOTION[f"{name}.actions"], seen, strict=True):
        judged(env, asked)
        now = snapshot(golden.BUMPED, env)
        for field in ("touching_cars", "touching_obstacles", "wall"):
            np.testing.assert_array_equal(now[field], then[field])
        for field in ("x", "y", "velocity_x", "velocity_y"):
            np.testing.assert_allclose(now[field], then[field], rtol=0, atol=1e-5)
        assert turned(now, then).max() < 1e-5
        np.testing.assert_allclose(now["yaw_rate"], then["yaw_rate"], rtol=0, atol=1e-4)


@pytest.mark.parametrize("scene", DESCRIBED["scenes"], ids=lambda scene: scene["name"])
def test_referee_rules_as_before(scene):
    tracks, sim = course(scene.get("track", "ring")), sim_of(scene)
    env = RaceEnv(tracks, EnvConfig(sim=sim))
    start = put_cars(tracks, sim, scene["start"], step=scene.get("step", 0))
    env.world.cars[:], env.world.worlds[:] = start.cars, start.worlds
    env.world.obstacles[:] = start.obstacles
    for step, (places, extra) in enumerate(golden.commands(scene)):
        if scene.get("retire", [None])[0] == step:
            env.retire(scene["retire"][1])
        commanded(env, places, extra, penalties=scene.get("mode") != "judge")
        for kind, table in ((golden.VERDICT, "verdicts"), (golden.BOOK, "books")):
            then = RULES[f"{scene['name']}.{table}"][step]
            assert_agree(snapshot(kind, env)[0], then, ROUNDING["scenes"], f"step {step}")


# How cars were placed to meet has changed since: tests/envs/test_scenarios.py.
RACED = [about for about in DESCRIBED["races"] if "meeting" not in about.get("env", {})]


@pytest.mark.parametrize("about", RACED, ids=lambda about: about["name"])
def test_races_and_training_as_before(about):
    settings, name = dict(about.get("env", {})), about["name"]
    cfg = EnvConfig(sim=sim_of(about), **settings)
    env = RaceEnv(course(*about["tracks"]), cfg, num_worlds=about["worlds"])
    env.reset(seeds=np.arange(1, about["worlds"] + 1))
    for step, asked in enumerate(RACES[f"{name}.actions"]):
        done = env.step(asked / FULL)
        for kind, table in ((golden.VERDICT, "verdicts"), (golden.BOOK, "books")):
            then = RACES[f"{name}.{table}"][step]
            assert_agree(snapshot(kind, env), then, ROUNDING["races"], f"step {step}")
        for end in golden.ENDS.names or ():
            then = RACES[f"{name}.ends"][end][step]
            np.testing.assert_array_equal(getattr(done, end), then, err_msg=f"step {step} {end}")
