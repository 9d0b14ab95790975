"""Same spec, same result: bit-equal in fresh processes; keeping a record changes nothing."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from league.race_spec import Entry, RaceSpec
from league.racing import race
from tests.scenes import assert_same

PROGRAM = """
import hashlib, json, sys
import numpy as np
from league.racing import race
from league.envs.state import INDEX
from league.race_spec import Entry, RaceSpec
from league.sim.config import CameraConfig, LidarConfig, SensorConfig

class Seeing:
    "Steers by the noise of its lidar and the pixels of its camera, a little."
    name, sensors = "seeing", SensorConfig(CameraConfig(width=24, height=16), LidarConfig())

    def reset(self, rows):
        pass

    def act(self, observations):
        state = observations["state"]
        error = 1.5 * state[:, INDEX["lateral"]] + 2.5 * state[:, INDEX["heading_error"]]
        steering = np.arctan(0.164 * (state[:, INDEX["curvature_0.25m"]] - error)) / 0.5236
        seen = observations["lidar"][:, 7] * 1e-2 + observations["stereo"][:, 0, 8, 12] * 1e-4
        return np.stack([(steering + seen).clip(-1, 1), np.full_like(steering, 0.3)], axis=1)

def digest(spec, drivers):
    seen = hashlib.sha256()
    def watch(world):
        for records in (world.worlds, world.cars, world.obstacles):
            for name in records.dtype.names:
                seen.update(records[name].tobytes())
    result = race.run(spec, drivers=drivers, record=False, watch=watch).result
    seen.update(result.model_dump_json().encode())
    return seen.hexdigest()

jobs = []
for solver in ("planar", "bullet"):
    fast = {"solver": solver, "max_time_s": 5.0, "seed": 3}
    two = tuple(Entry(name=name) for name in ("centerline", "cautious"))
    one = (Entry(name="seeing"),)
    pair = (Entry(name="seeing"), Entry(name="seeing"))
    jobs += [
        (RaceSpec(entries=two, **fast), None),
        (RaceSpec(entries=pair, **fast), [Seeing(), Seeing()]),
        (RaceSpec(entries=one, kind="obstacle_avoidance", **fast), [Seeing()]),
        (RaceSpec(entries=one, kind="obstacle_avoidance", obstacle_kind="bot", **fast), [Seeing()]),
    ]
if sys.argv[1] == "backwards":
    jobs.reverse()
digests = {spec.model_dump_json(): digest(spec, drivers) for spec, drivers in jobs}
print(json.dumps(digests, sort_keys=True))
"""


def fresh_process(order: str, hash_seed: str) -> subprocess.Popen[str]:
    settings = {**os.environ, "PYTHONHASHSEED": hash_seed, "OMP_NUM_THREADS": "1"}
    return subprocess.Popen(
        [sys.executable, "-c", PROGRAM, order],
        stdout=subprocess.PIPE,
        text=True,
        env=settings,
        cwd=Path(__file__).parents[1],
    )


def test_same_spec_gives_the_same_bits_in_fresh_processes_and_in_any_order():
    runs = [fresh_process("forwards", "1"), fresh_process("backwards", "2")]
    outputs = []
    for run in runs:
        out, _ = run.communicate(timeout=300)
        assert run.returncode == 0
        outputs.append(json.loads(out.splitlines()[-1]))
    assert outputs[0] == outputs[1]
    assert len(set(outputs[0].values())) == len(outputs[0]) == 8


def watched(spec: RaceSpec, *, record: bool):
    worlds = []
    finished = race.run(spec, record=record, watch=lambda world: worlds.append(world.copy()))
    assert (finished.replay is not None) == record
    return finished.result, worlds


@pytest.mark.parametrize("solver", ["planar", "bullet"])
def test_keeping_a_record_changes_nothing(solver):
    entries = tuple(Entry(name=name) for name in ("centerline", "cautious"))
    spec = RaceSpec(entries=entries, solver=solver, max_time_s=4.0)
    result, worlds = watched(spec, record=True)
    other, others = watched(spec, record=False)
    assert result == other
    assert_same(worlds, others)


def test_seed_of_a_race_decides_where_obstacles_stand():
    def first_world(seed: int):
        spec = RaceSpec(
            kind="obstacle_avoidance",
            entries=(Entry(name="centerline"),),
            seed=seed,
            max_time_s=0.1,
            solver="planar",
        )
        return watched(spec, record=False)[1][0].obstacles["s"].tolist()

    assert first_world(1) == first_world(1) != first_world(2)
