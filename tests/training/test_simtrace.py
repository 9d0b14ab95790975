"""The simtrace layout: what `league train --simtrace` and `evaluate --trace FOLDER` leave."""

import csv
import re
import shutil
from itertools import groupby, pairwise

import numpy as np
import pytest

from league.deepracer import hyperparameters, model_metadata
from league.envs.actions import DiscreteActions
from league.racing.trace import COLUMNS, EPISODES
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from tests.training import small

STATUSES = {"in_progress", "off_track", "time_up", "lap_complete", "immobilized", "reversed"}


def rows_of(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def files_of(folder):
    paths = (folder / "simtrace" / "training-simtrace").glob("*-iteration.csv")
    return sorted(paths, key=lambda path: int(path.name.partition("-")[0]))


def traced_run(folder, updates, **changes):
    """Return a run that is judged hardly ever."""
    train = small.train(save_every=10)
    return small.run(folder, small.cfg(updates, **{"simtrace": True, "train": train, **changes}))


def traced(folder, updates, **changes):
    traced_run(folder, updates, **changes).learn()
    return [row for path in files_of(folder) for row in rows_of(path)]


@pytest.fixture(scope="module")
def long_run(tmp_path_factory):
    """Return the folder of a run of 60 updates."""
    folder = tmp_path_factory.mktemp("long")
    traced(folder, 60)
    return folder


def test_every_step_of_training_is_in_an_episode_of_the_files(long_run):
    rows = [row for path in files_of(long_run) for row in rows_of(path)]
    assert tuple(rows[0]) == COLUMNS
    assert len(rows) == 60 * small.SAMPLES
    assert {row["episode_status"] for row in rows} <= STATUSES
    episodes = [list(group) for _, group in groupby(rows, key=lambda row: row["episode"])]
    assert [int(each[0]["episode"]) for each in episodes] == list(range(len(episodes)))
    for each in episodes:
        assert [int(row["steps"]) for row in each] == list(range(1, len(each) + 1))
        assert [row["done"] for row in each] == ["False"] * (len(each) - 1) + ["True"]
        assert each[-1]["episode_status"] != "in_progress"
        gaps = [float(b["tstamp"]) - float(a["tstamp"]) for a, b in pairwise(each)]
        assert gaps == pytest.approx([1 / 15] * len(gaps), abs=1e-5)


def test_every_file_but_the_last_has_as_many_episodes(long_run):
    counts = [len({row["episode"] for row in rows_of(path)}) for path in files_of(long_run)]
    assert len(counts) > 1
    assert counts[:-1] == [EPISODES] * (len(counts) - 1)
    assert 1 <= counts[-1] <= EPISODES
    assert [path.name for path in files_of(long_run)] == [
        f"{number}-iteration.csv" for number in range(len(counts))
    ]


def test_reward_is_the_one_that_is_learnt_from_and_the_run_is_the_same(tmp_path):
    rows = traced(tmp_path / "traced", 4)
    traced_run(tmp_path / "plain", 4, simtrace=False).learn()
    one, other = (small.weights(tmp_path / name / "last.pt") for name in ("traced", "plain"))
    assert all(np.array_equal(one[name], other[name]) for name in one)
    assert {float(row["reward"]) for row in rows} <= {0.001, 0.1, 0.5, 1.0}  # centerline's bands


def test_resumed_run_goes_on_in_the_same_files(tmp_path):
    whole = traced(tmp_path / "whole", 40)

    def stop(update):
        if update.number == 30:
            raise KeyboardInterrupt

    parted = traced_run(tmp_path / "parted", 40)
    with pytest.raises(KeyboardInterrupt):
        parted.learn([small.CallbackRecorder(after=stop)])
    resumed = traced_run(tmp_path / "parted", 40)
    resumed.resume()
    resumed.learn()
    rows = [row for path in files_of(tmp_path / "parted") for row in rows_of(path)]
    for row in (*rows, *whole):
        row.pop("wall_clock")
    assert rows == whole


def test_metadata_is_what_the_policy_has(tmp_path):
    choices = DiscreteActions(((-30.0, 0.5), (0.0, 1.0), (30.0, 0.5)))
    traced(tmp_path, 2, train=small.train(action_space=choices, sensors=small.CAMERA))
    folder = tmp_path / "simtrace"
    metadata = model_metadata.read(folder / "model" / "model_metadata.json")
    assert metadata.action_space == choices
    assert metadata.sensors.camera.eyes == small.CAMERA.camera.eyes
    read = hyperparameters.read(folder / "ip" / "hyperparameters.json")
    assert (read.batch_size, read.num_episodes_between_training) == (16, EPISODES)


@pytest.mark.parametrize("eyes", ["mono", "left", "stereo"])
@pytest.mark.parametrize("form", ["ranges", "sectors", "discretised"])
def test_sensors_are_named_as_the_original_names_them(eyes, form):
    sensors = SensorConfig(camera=CameraConfig(eyes=eyes), lidar=LidarConfig(form=form))
    read = model_metadata.parse(
        model_metadata.content(DiscreteActions(((0.0, 1.0), (5.0, 1.0))), sensors)
    )
    assert (read.sensors.camera.eyes, read.sensors.lidar.form) == (eyes, form)


def test_bins_of_the_lidar_are_written_as_the_original_has_them():
    lidar = LidarConfig(form="discretised", sectors=16, bins=4, clip=1.5)
    sensors = SensorConfig(camera=CameraConfig(), lidar=lidar)
    space = DiscreteActions(((0.0, 1.0), (5.0, 1.0)))
    assert model_metadata.parse(model_metadata.content(space, sensors)).sensors.lidar == lidar


def test_evaluations_are_added_to_the_folder(league, tmp_path):
    command = ("evaluate", "centerline", "--laps", "1", "--solver", "planar")
    code, out, _ = league(*command, "--trace", "model", "--track", "reinvent_2018", "peanut")
    assert code == 0
    assert out.count("Trace: model/evaluation-") == 2
    folders = sorted(path.name for path in (tmp_path / "model").glob("evaluation-*"))
    assert len(folders) == 2
    assert all(re.fullmatch(r"evaluation-\d{14}", name) for name in folders)
    rows = rows_of(tmp_path / "model" / folders[0] / "evaluation-simtrace" / "0-iteration.csv")
    assert rows[-1]["episode_status"] == "lap_complete"
    assert (tmp_path / "model" / "model" / "model_metadata.json").exists()
    assert (tmp_path / "model" / "ip" / "hyperparameters.json").exists()


def test_new_run_removes_the_files_of_the_one_before(long_run, tmp_path):
    folder = shutil.copytree(long_run, tmp_path / "again")
    traced(folder, 4)
    assert 1 <= len(files_of(folder)) < len(files_of(long_run))
