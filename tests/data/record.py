"""Record the outcomes in this folder with the torch simulator of commit 728ba3f; see README.md."""
# pyright: basic, reportMissingImports=false, reportAttributeAccessIssue=false, reportCallIssue=false

from dataclasses import replace

import golden
import numpy as np
import torch
from league.sim.meeting_config import Meeting
from league.sim.world import Motion, select
from scenes import go_to, make_ring, make_straight, put_cars, touch

from league.envs.config import EnvConfig
from league.envs.race_env import RaceEnv, decode
from league.sim import config, obstacles, referee
from league.track import files
from league.track.track import TrackSet

CLASSES = {
    "rules": config.RaceRules,
    "spread": config.DynamicsRandomization,
    "obstacles": config.ObstacleConfig,
}
HAIRPIN = make_ring(points=60, width=0.6)
SHAPES = {"ring": make_ring(), "straight": make_straight(), "hairpin": HAIRPIN}
FULL = np.float32(64)


def course(names):
    return TrackSet.of(*(SHAPES[name] if name in SHAPES else files.load(name) for name in names))


def sim_of(scene):
    settings = golden.sim_settings(scene)
    made = {key: CLASSES[key](**v) if key in CLASSES else v for key, v in settings.items()}
    return config.SimConfig(**made)


def fill(kind, world, found=None):
    """Return one moment as records (num_worlds, num_cars); `found`: the verdict or the contacts."""
    out, book = np.zeros(tuple(world.motion.x.shape), kind), world.standing
    retired, stopped = torch.isinf(book.penalty_s), world.obstacles.stopped_s
    special = {
        "penalty_s": torch.where(retired, 0.0, book.penalty_s),
        "retired": retired,
        "leader": book.leader[:, None],
        "lead_changes": book.lead_changes[:, None],
        "place": referee.places(book),
        "stopped_s": stopped.amax(dim=1, keepdim=True) if stopped.numel() else torch.zeros(1, 1),
    }
    if kind == golden.BUMPED:
        special["wall"] = found.walls
    if kind == golden.VERDICT:
        special["lead_changed"] = found.lead_changed[:, None]
    for name in kind.names:
        value = special.get(name)
        if value is None:
            owner = next(o for o in (found, world.motion, book) if hasattr(o, name))
            value = getattr(owner, name)
        out[name] = golden.masked(value.numpy()) if value.dim() == 3 else value.numpy()
    return out


def judged(env, before, after, contacts):
    verdict, book = referee.judge(env.tracks, env.cfg.sim, before, after, contacts)
    return verdict, referee.stop_bots(env.cfg.sim, replace(after, standing=book), verdict)


def motion(table, name):
    """Return what drives or contacts bring from their starts and actions, without penalties."""
    start, asked = table[f"{name}.start"], table[f"{name}.actions"]
    spread = {"grip": 0.3, "mass": 0.3, "latency_s": 1 / 15, "steering_offset": 0.05}
    thing = [name, 0.5, 1.0] if name in ("box", "bot") else None
    scene = {"cars": start.shape[1], "things": thing}
    scene["sim"] = {"spread": spread} if name == "drives_of_different_cars" else {}
    drives = f"{name}.names" in table
    tracks = course(table[f"{name}.names"].tolist() if drives else ["ring"])
    env = RaceEnv(tracks, EnvConfig(sim=sim_of(scene)), num_worlds=len(start))
    seeds = torch.from_numpy(table.get(f"{name}.seeds", np.arange(1, len(start) + 1)))
    env.reset(seeds=seeds, track_index=torch.from_numpy(start["track"][:, 0].copy()))
    given = {field: torch.from_numpy(start[field].copy()) for field in start.dtype.names}
    book = replace(env.world.standing, s=given["s"], lateral=given["lateral"], distance=given["s"])
    world = replace(env.world, standing=replace(book, best_distance=given["s"]))
    world = replace(world, motion=Motion(**{field: given[field] for field in golden.MOTION}))
    seen = []
    for actions in asked:
        moving, arrived = obstacles.aimed(tracks, env.cfg.sim, world)
        control = decode(env.cfg.sim, torch.from_numpy(actions / FULL))
        done = env._solver.step(replace(world, obstacles=moving), control)
        after = replace(world, step=world.step + 1, motion=done.motion, control=control)
        _, world = judged(env, world, replace(after, obstacles=arrived), done.contacts)
        seen.append(fill(golden.DRIVEN if drives else golden.BUMPED, world, done.contacts))
    return seen[1::2] if drives else seen


def rules(scene):
    """Return a scene's verdicts and books, (num_steps, num_cars)."""
    tracks, sim = course([scene.get("track", "ring")]), sim_of(scene)
    env = RaceEnv(tracks, EnvConfig(sim=sim))
    env._world = put_cars(tracks, sim, scene["start"], step=scene.get("step", 0))
    seen = []
    for number, (places, extra) in enumerate(golden.commands(scene)):
        if scene.get("retire", [None])[0] == number:
            env.retire(scene["retire"][1])
        world = env.world
        _, arrived = obstacles.aimed(tracks, sim, world)
        moved = torch.tensor([[place is not None for place in places]])
        gone = go_to(tracks, world, [place or [0.0, 0.0] for place in places])
        after = replace(world, motion=select(moved, gone.motion, world.motion))
        after = replace(after, step=world.step + 1, obstacles=arrived)
        contacts = touch(after, *extra.get("touch", []), obstacles=extra.get("things", []))
        contacts.walls[:, extra.get("wall", [])] = True
        verdict, world = judged(env, world, after, contacts)
        if scene.get("mode") != "judge":
            world = referee.penalise(tracks, sim, world, verdict)
        env._world = world
        seen.append((fill(golden.VERDICT, world, verdict)[0], fill(golden.BOOK, world)[0]))
    return {"verdicts": [one for one, _ in seen], "books": [one for _, one in seen]}


def race(about, asked):
    """Return a race's verdicts, books and ends, (num_steps, num_worlds, num_cars)."""
    given = dict(about.get("env", {}))
    if "meeting" in given:
        given["meeting"] = Meeting(**given["meeting"])
    cfg, worlds = EnvConfig(sim=sim_of(about), **given), about["worlds"]
    env, seen = RaceEnv(course(about["tracks"]), cfg, num_worlds=worlds), []
    env.reset(seeds=torch.arange(1, worlds + 1))
    for actions in asked:
        step, ends = (
            env.step(torch.from_numpy(actions / FULL)),
            np.zeros(actions.shape[:2], golden.ENDS),
        )
        for name in golden.ENDS.names:
            ends[name] = getattr(step, name).numpy()
        verdict = fill(golden.VERDICT, env.world, step.verdict)
        seen.append((verdict, fill(golden.BOOK, env.world), ends))
    return {name: [now[k] for now in seen] for k, name in enumerate(("verdicts", "books", "ends"))}


described = golden.described()
table = dict(np.load(golden.DATA / "motion.npz"))
for name in golden.DRIVES + golden.CONTACTS:
    table[f"{name}.seen"] = np.stack(motion(table, name))
np.savez_compressed(golden.DATA / "motion.npz", **table)
table = {f"{s['name']}.{part}": v for s in described["scenes"] for part, v in rules(s).items()}
np.savez_compressed(golden.DATA / "rules.npz", **table)
table = dict(np.load(golden.DATA / "races.npz"))
for about in described["races"]:
    made = race(about, table[f"{about['name']}.actions"])
    table |= {f"{about['name']}.{part}": np.stack(value) for part, value in made.items()}
np.savez_compressed(golden.DATA / "races.npz", **table)
