from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import torch
from rerun.chunk import RrdReader

from league.rerun_view import layout, live
from league.rerun_view.live import MOST_CARS, ShownCars, TrainingStream
from league.rerun_view.viewer import HOST
from league.sim.config import SensorConfig
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.monitor.history import TrainingHistory
from league.training.monitor.sinks import LiveView
from league.training.ppo import make_env
from tests.recordings import rows_of
from tests.scenes import assert_same, make_ring, make_square
from tests.training.metrics import evaluation, update


def made(num_worlds: int, *tracks, **settings: object):
    cfg = TrainConfig(num_worlds=num_worlds, sensors=SensorConfig(), **settings)  # pyright: ignore
    field = {car: "centerline" for car in range(1, cfg.num_cars)}
    return make_env.make(TrackSet(*(tracks or (make_ring(),))), cfg, opponents=field)


def shown(path: Path, env, steps: int, step_s: float) -> tuple[TrainingStream, list[float]]:
    """Watch some steps of `step_s` each; return the driving shown after each [s]."""
    now = [0.0]
    recording = rr.RecordingStream("test")
    recording.save(path)
    race = env.race_env
    look = TrainingStream(
        recording,
        race.tracks.tracks[0],
        ShownCars.of(race.world),
        step_hz=15,
        clock=lambda: now[0],
    )
    env.watch = look.add
    found = []
    for _ in range(steps):
        now[0] += step_s
        env.step(torch.zeros(env.num_envs, env.num_actions))
        found.append(look.shown_s)
    look.send()
    recording.flush()
    recording.disconnect()
    env.watch = None
    return look, found


def test_every_step_is_shown_where_worlds_are_no_faster_than_time(tmp_path):
    shown(tmp_path / "a.rrd", made(3), 40, 1 / 15)
    rows = rows_of(tmp_path / "a.rrd")
    for slot in range(3):
        assert rows[layout.car(slot)] == 40
        assert rows[layout.trail(slot)] == 40
        assert rows[layout.car(slot, "wheels", "front_left")] == 40
        assert rows[layout.car(slot, "wheels", "rear_left")] == 40
    assert rows[layout.PLOT_SPEED] == 40
    assert layout.car(3) not in rows


def test_steps_are_sent_as_columns_once_a_second(tmp_path):
    shown(tmp_path / "a.rrd", made(1), 45, 1 / 15)
    chunks = [
        chunk.num_rows
        for chunk in RrdReader(tmp_path / "a.rrd").stream().to_chunks()
        if chunk.entity_path.lstrip("/") == layout.car(0) and not chunk.is_static
    ]
    assert sum(chunks) == 45
    assert len(chunks) <= 4  # 3 s


def test_what_is_shown_keeps_to_the_clock(tmp_path):
    # Ten times as fast as time: 150 steps are 10 s of driving in 1 s.
    _, found = shown(tmp_path / "a.rrd", made(1), 150, 1 / 150)
    ahead = [driven - (number + 1) / 150 for number, driven in enumerate(found)]
    assert max(ahead) < live.AHEAD_S + 0.1
    # Stretches without a gap, not single steps: it stops once, and goes on when the clock is there.
    stopped = [after - before < 1e-9 for before, after in pairwise(found)]
    changes = sum(one != other for one, other in pairwise(stopped))
    assert 1 <= changes <= 3


def test_the_worlds_are_not_touched(tmp_path):
    watched, alone = made(2), made(2)
    shown(tmp_path / "a.rrd", watched, 20, 0.1)
    for _ in range(20):
        alone.step(torch.zeros(2, 2))
    assert_same(watched.race_env.world, alone.race_env.world)


def test_a_car_that_was_put_elsewhere_leaves_no_line(tmp_path):
    # Full steering to the left leaves the road; the car is put back somewhere else.
    env = made(1)
    recording = rr.RecordingStream("test")
    recording.save(tmp_path / "a.rrd")
    look = TrainingStream(recording, make_ring(), ShownCars.of(env.race_env.world), step_hz=15)
    env.watch = look.add
    ended = 0
    for _ in range(60):
        _, _, dones, _ = env.step(torch.tensor([[1.0, 1.0]]))
        ended += int(dones.sum())
    look.send()
    recording.flush()
    recording.disconnect()
    assert ended > 0
    longest = 0.0
    for chunk in RrdReader(tmp_path / "a.rrd").stream().to_chunks():
        if chunk.entity_path.lstrip("/") == layout.trail(0) and not chunk.is_static:
            batch = chunk.to_record_batch()
            (column,) = [name for name in batch.schema.names if "strips" in name]
            for ((first, last),) in batch.column(column).to_pylist():
                longest = max(longest, sum((a - b) ** 2 for a, b in zip(first, last, strict=True)))
    assert 0 < longest**0.5 < 0.5  # at most 4 m/s for 1/15 s


def test_cars_that_learn_alone_are_laid_over_each_other():
    found = ShownCars.of(made(9).race_env.world)
    assert found.worlds == tuple(range(MOST_CARS))
    assert found.cars == (0,)
    assert found.names[1] == "world 1"


def test_only_worlds_on_the_same_track_are_shown():
    found = ShownCars.of(made(6, make_ring(), make_square()).race_env.world)
    assert found.worlds == (0, 2, 4)


def test_of_races_one_world_is_shown_with_its_whole_field():
    found = ShownCars.of(made(4, kind="head_to_head", num_cars=3).race_env.world)
    assert (found.worlds, found.cars) == ((0,), (0, 1, 2))
    assert found.names == ("learner", "car 1", "car 2")


def test_obstacles_are_shown_where_they_stand(tmp_path):
    env = made(3, kind="obstacle_avoidance", obstacles=4)
    places, step = [], env.step

    def noted(actions: torch.Tensor):
        found = step(actions)
        places.append(env.race_env.world.obstacles["x"][0].copy())
        return found

    env.step = noted
    shown(tmp_path / "a.rrd", env, 30, 1 / 15)
    rows = rows_of(tmp_path / "a.rrd")
    assert layout.car(1) not in rows
    # They stand, and are drawn again with an episode.
    moves = sum(not np.array_equal(one, other) for one, other in pairwise(places))
    assert moves < 5
    for index in range(4):
        assert rows[layout.obstacle(index)] == 1 + moves
    assert layout.obstacle(4) not in rows


def test_the_live_view_serves_this_machine_alone_and_lets_go_of_the_worlds():
    env = made(2)
    view = LiveView(env, window=False)
    try:
        assert view.address.startswith(f"http://{HOST}:")
        run = TrainingHistory()
        for number in (1, 2):
            env.step(torch.zeros(2, 2))
            run.add_update(update(number, 0.5, 2.0))
            view.update(run, update(number))
        run.add_evaluation(
            evaluation(7.0), run.updates[-1].number, time_s=3.0, took_s=0.5, best=True
        )
        view.evaluated(run, evaluation(7.0))
        assert env.watch is not None
    finally:
        view.close()
    assert env.watch is None
    view.update(run, update(2))  # it has been closed
    view.close()


def test_a_tutors_worlds_are_watched_too():
    env, other = made(2), made(2)
    view = LiveView(env, other, window=False)
    assert env.watch == other.watch is not None
    other.step(torch.zeros(2, 2))
    view.close()
    assert (env.watch, other.watch) == (None, None)


def test_learning_goes_on_where_the_viewer_has_been_closed():
    env = made(1)
    view = LiveView(env, window=False)
    assert view._stream is not None
    view._stream._child.kill()
    view._stream._child.wait()
    run = TrainingHistory()
    run.add_update(update(1, 0.5, 2.0))
    env.step(torch.zeros(1, 2))
    view.update(run, update(1))
    assert env.watch is None
    env.step(torch.zeros(1, 2))
    view.close()


@pytest.mark.parametrize("limit", ["--memory-limit", "--server-memory-limit"])
def test_the_viewers_memory_is_bounded(limit):
    from league.rerun_view import viewer

    for window in (True, False):
        command = viewer._command(1234, window)
        assert command[command.index(limit) + 1] == viewer.MEMORY
        assert command[command.index("--bind") + 1] == HOST
