"""`league train` as a user meets it: a policy at the end, one sentence for every mistake."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from dataclasses import replace

import numpy as np
import pytest

from league.agents import checkpoint, roster
from league.cli import train
from league.cli.train import OLD_FLAGS, Train, parse
from league.cli.train_settings import parse_actions, parse_sensors
from league.envs.actions import ContinuousActions, DiscreteActions
from league.errors import ConfigError, LeagueError
from league.training.config import PpoConfig, RunConfig, read, write
from league.training.monitor import history

TINY = (
    *("--track", "reinvent_2018", "--reward", "centerline", "--action-space", "0.5-1"),
    *("--sensors", "stereo40x30", "--num-worlds", "4", "--rollout", "8", "--epochs", "1"),
    *("--mini-batches", "2", "--minutes", "0", "--threads", "1", "--plain", "--no-tensorboard"),
)


ROOKIE = ("--init-from", "rookie")


def config(*flags: str) -> RunConfig:
    """Return the settings that some flags ask for."""
    return parse(["--out", "no_such_policy.pt", *flags]).cfg


def test_help_tells_every_choice(league):
    code, out, _ = league("train", "--help")
    assert code == 0
    for flag in ("--track", "--kind", "--reward", "--minutes", "--out", "--action-space"):
        assert flag in out
    for flag in ("--sensors", "--opponents", "--resume", "--init-from", "--seed", "--device"):
        assert flag in out
    assert "--hyperparameters" in out
    assert "Train a driver with PPO" in out
    # Where a switch is on by default, its help is under the flag that switches it on.
    assert "--tensorboard, --no-tensorboard" in out
    assert "Train a driver with PPO" in league("--help")[1]


def test_training_leaves_a_policy_that_races(league, tmp_path):
    code, out, err = league("train", *TINY, "--steps", "64", "--out", "mine.pt")
    assert (code, err) == (0, "")
    assert "64 decisions in " in out
    assert "stopped because the steps were driven" in out
    assert "Best policy: mine.pt" in out
    card = checkpoint.load(tmp_path / "mine.pt").card
    assert card.name == "mine"
    assert card.command.startswith("league")
    kept = {path.name for path in (tmp_path / "mine.run").iterdir()}
    assert {"best.pt", "last.pt", "state.pt", "settings.json", "history.jsonl"} <= kept
    assert "training.png" in kept
    code, out, _ = league(
        *("race", "mine.pt", "centerline", "--laps", "1", "--solver", "planar", "--replay", "none")
    )
    assert code == 0, out
    assert "mine" in out


def test_who_asks_for_nothing_gets_what_the_experiments_have_chosen():
    assert replace(config(), command="", name="policy") == RunConfig()


@pytest.mark.parametrize(
    ("flags", "worlds"),
    [
        (("--minutes", "1"), 16),
        (("--minutes", "2", "--reward", "examples/reward_centerline.py"), 16),
        (("--steps", "65536"), 16),
        (("--minutes", "30", "--steps", "40000"), 16),
        (("--minutes", "2.5"), 64),
        (("--steps", "65537"), 64),
        (("--minutes", "1", "--num-worlds", "32"), 32),
        (("--minutes", "1", "--init-from", "rookie"), 64),
        (("--minutes", "1", "--kind", "head_to_head", "--opponents", "centerline"), 64),
    ],
)
def test_short_runs_have_few_worlds_for_many_updates(flags, worlds):
    train = config(*flags).train
    assert train.num_worlds == worlds
    assert (train.ppo.noise == PpoConfig().hurrying().noise) == (worlds <= 32)


def test_flags_reach_the_settings(league, tmp_path):
    flags = (
        *("--seed", "5", "--both-directions", "--dynamics-randomization", "1"),
        *("--visual-randomization", "--no-symmetry", "--bootstrap-on-failure"),
        *("--gamma", "0.9", "--lam", "0.8", "--learning-rate", "0.001", "0.0001"),
        *("--noise", "0.4", "0.1", "--licence", "CC0-1.0", "--reward", "progress"),
    )
    code, _, err = league("train", *TINY, "--steps", "32", "--out", "a.pt", *flags)
    assert (code, err) == (0, "")
    cfg = read(tmp_path / "a.run")
    assert (cfg.train.seed, cfg.train.both_directions, cfg.train.symmetry) == (5, True, False)
    assert (cfg.train.ppo.gamma, cfg.train.ppo.lam) == (0.9, 0.8)
    assert cfg.train.ppo.bootstrap_on_failure
    assert cfg.train.ppo.learning_rate == (0.001, 0.0001)
    assert cfg.train.ppo.noise == (0.4, 0.1)
    assert cfg.train.dynamics_randomization == 1.0
    assert cfg.train.visual_randomization
    assert checkpoint.load(tmp_path / "a.pt").card.licence == "CC0-1.0"


def test_flags_of_older_versions_mean_the_same():
    values = {"--tutor": ["0.3"], "--car-spread": ["0.5"], "--exam-every": ["3"]}
    values |= {"--exam-track": ["peanut"], "--exam-opponents": ["centerline"]}
    values |= {"--exam-trials": ["2"]}
    old = config(*(word for flag in OLD_FLAGS for word in (flag, *values.get(flag, []))))
    new = config(
        *("--eval-track", "peanut", "--eval-opponents", "centerline", "--eval-trials", "2"),
        *("--eval-every", "3", "--bootstrap-on-failure", "--teacher", "0.3"),
        *("--visual-randomization", "--dynamics-randomization", "0.5", "--no-symmetry"),
    )
    assert old == new
    assert config("--random-cars").train.dynamics_randomization == 1.0
    assert config("--car_spread=0.25").train.dynamics_randomization == 0.25


def test_model_metadata_sets_actions_and_sensors(league, tmp_path):
    (tmp_path / "model_metadata.json").write_text(
        json.dumps(
            {
                "action_space_type": "discrete",
                "action_space": [
                    {"steering_angle": -20, "speed": 0.8, "index": 0},
                    {"steering_angle": 0, "speed": 1.0, "index": 1},
                    {"steering_angle": 20, "speed": 0.8, "index": 2},
                ],
                "sensor": ["LEFT_CAMERA", "SECTOR_LIDAR"],
                "neural_network": "DEEP_CONVOLUTIONAL_NETWORK_SHALLOW",
                "version": "5",
            }
        )
    )
    asked = ("--action-space", "model_metadata.json", "--sensors", "model_metadata.json")
    code, _, err = league("train", *TINY, *asked, "--steps", "32", "--out", "d.pt")
    alone = config("--action-space", str(tmp_path / "model_metadata.json"))
    assert alone.train.sensors == checkpoint.load(tmp_path / "d.pt").card.sensors
    assert config().train.sensors == parse_sensors(("stereo64x48",))
    assert (code, err) == (0, "")
    card = checkpoint.load(tmp_path / "d.pt").card
    assert card.action_space == DiscreteActions(((-20.0, 0.8), (0.0, 1.0), (20.0, 0.8)))
    assert card.sensors.camera is not None
    assert card.sensors.camera.eyes == "left"
    assert card.sensors.lidar is not None
    assert card.sensors.lidar.form == "sectors"


def test_hyperparameters_by_deepracers_names_are_taken(league, tmp_path):
    (tmp_path / "h.json").write_text(
        json.dumps(
            {
                "batch_size": 8,
                "num_epochs": 3,
                "lr": 0.0004,
                "beta_entropy": 0.02,
                "discount_factor": 0.97,
                "loss_type": "huber",
            }
        )
    )
    code, _, err = league(
        *("train", "--reward", "centerline", "--sensors", "lidar", "--num-worlds", "4"),
        *("--rollout", "8", "--minutes", "0", "--steps", "32", "--plain", "--no-tensorboard"),
        *("--out", "h.pt", "--hyperparameters", "h.json", "--action-space", "3x1@1.0"),
    )
    assert code == 0
    assert "beta_entropy" not in err
    assert "loss_type" in err  # read, and said not to be used
    ppo = read(tmp_path / "h.run").train.ppo
    assert ppo.mini_batches == 4  # 4 worlds x 8 steps in batches of 8
    assert ppo.epochs == 3
    assert ppo.learning_rate == (0.0004, 0.0004)
    assert ppo.entropy == (0.02, 0.02)
    assert ppo.gamma == 0.97


def test_the_racing_line_is_a_reward_by_name(league, tmp_path):
    code, _, err = league(
        *("train", *TINY, "--steps", "64", "--reward", "racing_line", "--out", "mine.pt")
    )
    assert (code, err) == (0, "")
    assert checkpoint.load(tmp_path / "mine.pt").card.reward.name == "racing_line"
    update, *_ = history.read(tmp_path / "mine.run" / "history.jsonl")
    assert isinstance(update, history.UpdateRow)
    assert 0 <= update.log["/reward/racing_line"] < 1
    assert {"/reward/progress", "/reward/off_track"} <= update.log.keys()


def test_hyperparameters_that_mean_nothing_here_are_said_to(tmp_path, capsys):
    path = tmp_path / "h.json"
    path.write_text(json.dumps({"batch_size": 512, "beta_entropy": 0.02}))
    ppo = config("--hyperparameters", str(path), "--num-worlds", "4").train.ppo
    assert (ppo.mini_batches, ppo.entropy) == (1, PpoConfig().entropy)
    batch, entropy = capsys.readouterr().err.splitlines()
    assert "batch_size is 512, and a rollout has 256 decisions" in batch
    assert "beta_entropy not used here" in entropy


def test_sigterm_is_heard_as_ctrl_c_while_a_run_learns():
    before = signal.getsignal(signal.SIGTERM)
    with pytest.raises(KeyboardInterrupt), train._interrupted_by_sigterm():
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1.0)
    assert signal.getsignal(signal.SIGTERM) == before


def test_what_the_file_does_not_name_is_as_a_trained_policy_needs_it(league, tmp_path):
    (tmp_path / "h.json").write_text('{"discount_factor": 0.9}')
    league("train", *TINY, "--steps", "32", "--out", "a.pt")
    code, _, err = league(
        *("train", *TINY, "--steps", "32", "--out", "b.pt"),
        *("--init-from", "a.pt", "--hyperparameters", "h.json"),
    )
    assert (code, err) == (0, "")
    ppo = read(tmp_path / "b.run").train.ppo
    refined = PpoConfig().refining()
    assert (ppo.learning_rate, ppo.noise) == (refined.learning_rate, refined.noise)
    assert ppo.gamma == 0.9


def test_flag_beats_the_hyperparameters_file(league, tmp_path):
    (tmp_path / "h.json").write_text('{"discount_factor": 0.97, "num_epochs": 2}')
    code, _, err = league(
        *("train", *TINY, "--steps", "32", "--out", "h.pt"),
        *("--hyperparameters", "h.json", "--gamma", "0.5"),
    )
    assert (code, err) == (0, "")
    assert read(tmp_path / "h.run").train.ppo.gamma == 0.5


def test_last_line_after_a_run_without_a_complete_lap_says_how_to_go_on(league):
    code, out, _ = league("train", *TINY, "--steps", "32", "--out", "my car.pt")
    assert code == 0
    last = out.splitlines()[-1]
    assert last.endswith("twice the budget: league train --resume --out 'my car.pt' --steps 64")
    assert "league race" not in out


def test_what_it_says_is_more_than_a_whole_update_has_driven(league):
    code, out, _ = league("train", *TINY, "--steps", "10", "--out", "a.pt")
    assert code == 0 and "32 decisions in" in out
    assert out.splitlines()[-1].endswith("league train --resume --out a.pt --steps 64")


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--out", "policy.onnx"], "--out is policy.onnx: give the name of a checkpoint, NAME.pt"),
        (["--track", "peanutt"], "there is no track 'peanutt'; nearest: peanut"),
        (["--track", "generated:0"], "give generated:1 to generated:2000"),
        (["--track", "generated:40", "--both-directions", "--reward", "racing_line"], "80 tracks"),
        (["--eval-track", "nowhere"], "there is no track 'nowhere'"),
        (["--reward", "progess"], "there is no built-in reward 'progess'; nearest: progress"),
        (["--reward", "missing.py"], "missing.py"),
        (["--minutes", "-1"], "give one of them, more than 0"),
        (["--minutes", "nan"], "give one of them, more than 0"),
        (["--minutes", "0"], "give one of them, more than 0"),
        (["--steps", "-5"], "give one of them, more than 0"),
        (["--action-space", "fast"], "--action-space is 'fast': give speeds such as 0.5-4"),
        (["--action-space", "3-2"], "low must lie below high"),
        (["--action-space", "0.5-9"], "a speed is 9.0 m/s: give 0.1 to 4.0"),
        (["--action-space", "none.json"], "none.json"),
        (["--sensors", "sonar"], "there is no sensor 'sonar': give stereoWxH"),
        (["--sensors", "lidar", "sectors"], "two of a kind"),
        (["--sensors", "stereo4x4"], "camera width is 4"),
        (["--opponents", "centerline"], "--opponents means nothing without --kind head_to_head"),
        (["--self-play"], "--self-play means nothing without --kind head_to_head"),
        (["--kind", "head_to_head"], "give either --opponents NAME ... or --self-play"),
        (["--bots"], "--bots means nothing without --kind obstacle_avoidance"),
        (["--obstacles", "3"], "--obstacles means nothing without --kind obstacle_avoidance"),
        (["--cars", "3"], "--cars means nothing without --self-play"),
        (
            ["--kind", "head_to_head", "--self-play", "--reward", "progress"],
            "learns with the reward race, not progress: omit --reward",
        ),
        (["--kind", "head_to_head", "--self-play", "--cars", "9"], "--cars is 9: give 2 to 8"),
        (["--dynamics-randomization", "3"], "dynamics_randomization is 3.0: give 0, which is none"),
        (["--threads", "0"], "threads is 0: give 1 to 1024"),
        (["--sensors"], "--sensors names no sensor: give some, such as stereo64x48, or motion"),
        (["--stop-when-complete", "-1"], "stop_when_complete is -1: give 0, which is never"),
        (["--hyperparameters", "none.json"], "none.json"),
        (["--resume"], "settings.json holds no settings of a run"),
        (["--init-from", "none.pt"], "none.pt"),
        (["--init-from", "rokie"], "there is no driver 'rokie'; nearest: rookie"),
        (["--init-from", "blocker"], "'blocker' is a scripted driver, which has no checkpoint"),
        (["--hyperparameters", "."], "(Is a directory): give the path of a hyperparameters.json"),
        (["--eval-opponents", "nobody"], "there is no driver 'nobody'; there are"),
        (["--exam-trials", "100000"], "eval_trials is 100000: give 1 to 1000"),
        (["--seed", "-1"], "seed is -1: give 0 to 2147483647"),
        (["--device", "abacus"], "cannot compute on the device 'abacus': give cpu, or cuda"),
        (["--num-worlds", "0"], "num_worlds is 0: give 1 to 65536"),
        (["--obstacles", "-1", "--kind", "obstacle_avoidance"], "-1"),
        (["--learning-rate", "0", "0"], "learning rates are (0.0, 0.0): give 1e-8 to 0.1"),
        (["--noise", "0.5", "9"], "exploration noise is (0.5, 9.0): give 0.001 to 5"),
        (["--gamma", "1.5"], "gamma is 1.5: give 0 to 1"),
        (["--lam", "-1"], "lam is -1.0: give 0 to 1"),
        (["--bootstrap-on-failure", "--reward", "centerline"], "centerline takes nothing: omit it"),
        (["--teacher", "1"], "the teacher's share of the budget is 1"),
        (["--teacher", "0.2", "--init-from", "rookie"], "omit --teacher or --init-from"),
        (["--epochs", "0"], "epochs is 0: give at least 1"),
        (["--mini-batches", "99999"], "cannot be split into 99999 mini-batches"),
        (["--rollout", "0"], "rollout is 0: give at least 1"),
        (["--eval-trials", "0"], "an evaluation needs at least 1"),
        (["--eval-every", "0"], "an evaluation needs at least 1"),
        (["--licence", ""], "licence"),
        (["--scripted-share", "0.2"], "--scripted-share has been removed, because self-play"),
        (["--scripted_share=0.2"], "omit it, or give --opponents NAME ... instead of --self-play"),
        (["--no-handicap"], "--no-handicap has been removed, because the pace of the other cars"),
        (["--handicap"], "--handicap has been removed"),
    ],
)
def test_mistake_in_a_flag_gets_one_sentence(league, tmp_path, flags, said):
    code, _, err = league("train", "--plain", "--no-tensorboard", *flags)
    assert code == 2
    assert err.startswith("league: ")
    assert said in err
    assert err.count("\n") == 1
    assert "Traceback" not in err
    assert not list(tmp_path.iterdir())


def test_run_that_is_there_is_not_replaced_without_a_word(league, tmp_path):
    assert league("train", *TINY, "--steps", "32", "--out", "mine.pt")[0] == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    code, out, err = league("train", *TINY, "--steps", "64", "--out", "mine.pt")
    assert (code, out) == (2, "")
    assert "mine.run holds a run of 32 decisions and " in err
    assert "give --resume to go on with it, --overwrite to start a new run" in err
    assert err.count("\n") == 1
    after = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    assert after == before
    code, _, err = league("train", *TINY, "--steps", "64", "--out", "mine.pt", "--overwrite")
    assert (code, err) == (0, "")
    assert checkpoint.load(tmp_path / "mine.run" / "last.pt").card.steps == 64


def test_folder_in_the_checkpoints_place_is_refused_before_anything_is_learnt(league, tmp_path):
    (tmp_path / "mine.pt").mkdir()
    code, _, err = league("train", *TINY, "--steps", "32", "--out", "mine.pt", "--overwrite")
    assert (code, err) == (2, "league: --out is mine.pt, which is a folder: give a file, NAME.pt\n")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.pt"]


def test_checkpoint_that_is_there_is_not_replaced_without_a_word(league, tmp_path):
    (tmp_path / "mine.pt").write_bytes(b"precious")
    code, _, err = league("train", *TINY, "--steps", "32", "--out", "mine.pt")
    assert code == 2
    assert "mine.pt exists already: give --overwrite" in err
    assert [path.name for path in tmp_path.iterdir()] == ["mine.pt"]
    assert (tmp_path / "mine.pt").read_bytes() == b"precious"


def test_resume_with_more_steps_goes_on_and_says_so(league, tmp_path):
    assert league("train", *TINY, "--steps", "64", "--out", "mine.pt")[0] == 0
    # The same line with --resume is what a shell's history offers.
    code, out, err = league("train", *TINY, "--steps", "128", "--out", "mine.pt", "--resume")
    assert (code, err) == (0, "")
    assert "Going on after 64 decisions and " in out
    assert "to 128 decisions in all instead of 64 decisions; learning rate and noise" in out
    assert "128 decisions in " in out
    assert read(tmp_path / "mine.run").steps == 128


def test_resume_of_a_finished_run_asks_for_more_but_brings_a_lost_checkpoint_back(league, tmp_path):
    assert league("train", *TINY, "--steps", "32", "--out", "mine.pt")[0] == 0
    code, out, err = league("train", "--resume", "--plain", "--out", "mine.pt")
    assert (code, out) == (2, "")
    assert "the run in mine.run is finished (the steps were driven: 32 decisions" in err
    assert "give --minutes or --steps above that" in err
    (tmp_path / "mine.pt").unlink()
    code, _, err = league("train", "--resume", "--plain", "--no-tensorboard", "--out", "mine.pt")
    assert (code, err) == (0, "")
    assert checkpoint.load(tmp_path / "mine.pt").card.steps == 32


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--seed", "0"], "started with another --seed: omit what"),  # though it is the default
        (["--seed", "3", "--gamma", "0.5"], "started with another --seed, --gamma: omit what"),
        (["--track", "peanut"], "started with another --track"),
        (["--sensors", "lidar"], "started with another --sensors"),
        (["--reward", "centerline"], "started with another --reward: omit what"),
        (["--no-symmetry"], "started with another --symmetry"),
        (["--overwrite"], "--resume goes on and --overwrite starts a new run: give one of them"),
        (["--steps", "16"], "--steps is 16, and the run was started with 32: give more"),
        (["--steps", "-1"], "give one of them, more than 0"),
    ],
)
def test_what_contradicts_the_run_is_refused_beside_resume(league, tmp_path, flags, said):
    (tmp_path / "mine.run").mkdir()
    write(config("--minutes", "0", "--steps", "32", "--seed", "1"), tmp_path / "mine.run")
    code, _, err = league("train", "--resume", "--out", "mine.pt", *flags)
    assert code == 2
    assert said in err
    assert err.count("\n") == 1


def test_a_resume_may_change_the_budget_and_the_evaluations_alone(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mine.run").mkdir()
    begun = config("--steps", "32", "--both-directions", "--init-from", "rookie", "--seed", "2")
    write(begun, tmp_path / "mine.run")
    again = ("--out", "mine.pt", "--resume")
    assert parse([*again]).cfg == begun
    assert parse([*again, "--both-directions", "--init-from", "rookie", "--seed", "2"]).cfg == begun
    more = parse([*again, "--steps", "64", "--eval-track", "peanut", "--eval-every", "2"]).cfg
    assert more == replace(begun, steps=64, eval_tracks=("peanut",), eval_every=2)
    assert parse([*again, "--steps", "0", "--minutes", "2"]).cfg.budget == (2.0, 0)


def test_self_play_is_among_two_cars_or_as_many_as_are_asked_for():
    racing = ("--kind", "head_to_head")
    assert config(*racing, "--self-play").train.num_cars == 2
    assert config(*racing, "--self-play", "--cars", "4").train.num_cars == 4
    assert config(*racing, "--opponents", "centerline", "rookie").train.num_cars == 3


def test_self_play_has_as_many_learning_cars_as_other_runs_have_worlds():
    racing = ("--kind", "head_to_head", "--self-play")
    assert config(*racing).train.num_worlds == 32
    assert config(*racing, "--cars", "4").train.num_worlds == 16
    assert config(*racing, "--cars", "4", "--num-worlds", "8").train.num_worlds == 8
    assert config("--kind", "head_to_head", "--opponents", "rookie").train.num_worlds == 64


def test_racing_looks_farther_ahead_unless_asked_otherwise():
    racing = ("--kind", "head_to_head", "--self-play")
    assert config(*racing).train.ppo.gamma == 0.987
    assert config(*racing, "--gamma", "0.95").train.ppo.gamma == 0.95  # the default of others


def test_self_play_has_a_network_large_enough_to_place_other_cars():
    racing = ("--kind", "head_to_head", "--self-play")
    assert config(*racing).train.network.hidden == (256, 128)
    assert config(*racing, "--init-from", "rookie").train.network.hidden == (128,)  # its own


def test_self_play_begins_on_the_true_state_for_half_of_the_time():
    racing = ("--kind", "head_to_head", "--self-play")
    assert config(*racing).train.teacher == 0.5
    assert config(*racing).reward == "race"
    assert config(*racing, "--teacher", "0.3").train.teacher == 0.3
    assert config(*racing, "--init-from", "rookie").train.teacher == 0.0
    alone = config(*racing, "--sensors", "truth").train
    assert (alone.teacher, alone.sensors.truth, alone.num_worlds) == (0.0, True, 768)


def test_policy_to_begin_from_may_be_named_as_in_the_garage():
    assert config("--init-from", "rookie").init_from == str(roster.garage()["rookie"])
    path = str(roster.garage()["rookie"])
    assert config("--init-from", path).init_from == path


def test_what_is_not_asked_for_is_the_parents(capsys):
    rookie = checkpoint.load(roster.garage()["rookie"]).card
    cfg = config("--init-from", "rookie").train
    assert (cfg.action_space, cfg.sensors) == (rookie.action_space, rookie.sensors)
    assert cfg.network == rookie.network
    same = config(*ROOKIE, "--action-space", "0.5-1", "--sensors", "stereo64x48")
    assert same.train == cfg
    assert capsys.readouterr().err == ""
    # Cloned to go faster, as people do: possible, and said.
    faster = config(*ROOKIE, "--action-space", "0.5-2").train
    assert faster.action_space == ContinuousActions(-30.0, 30.0, 0.5, 2.0)
    assert "now means something else" in capsys.readouterr().err
    with pytest.raises(ConfigError, match="--sensors are not those of rookie"):
        config(*ROOKIE, "--sensors", "left64x48")
    with pytest.raises(ConfigError, match="--action-space is of another kind"):
        config(*ROOKIE, "--action-space", "5x2@1.0")


def test_save_points_come_as_often_as_the_work_allows(capsys):
    usual = config().train
    assert (usual.num_worlds * usual.ppo.rollout, usual.save_every) == (4096, 4)
    assert config("--num-worlds", "16").train.save_every == 8
    assert config("--epochs", "12").train.save_every == 2
    assert config("--sensors", "stereo160x120").train.save_every == 1
    assert capsys.readouterr().err == ""
    assert config("--num-worlds", "1024").train.save_every == 1
    # Rows restart at a save point, and a card is given more of them at once.
    assert config("--num-worlds", "1024", "--device", "cuda").train.save_every == 4
    assert "some 16 times the work of a usual one" in capsys.readouterr().err


def test_a_run_that_ends_early_leaves_its_best_under_the_name_asked_for(tmp_path):
    command, folder = Train(out=tmp_path / "m.pt"), tmp_path / "m.run"
    assert train._kept(command) == "Nothing was learnt yet."
    folder.mkdir()
    (folder / "state.pt").touch()
    of_a_teacher = (
        f"Kept: {folder / 'state.pt'}, with what the teacher has learnt; go on with --resume."
    )
    assert train._kept(command) == of_a_teacher
    (folder / "last.pt").touch()
    assert train._kept(command).startswith(f"Kept: {folder / 'last.pt'}; go on")
    (folder / "best.pt").write_bytes(b"weights")
    assert f"and the best so far as {tmp_path / 'm.pt'}; go on" in train._kept(command)
    assert (tmp_path / "m.pt").read_bytes() == b"weights"


def test_five_minutes_are_the_budget_unless_another_is_given():
    both = ("--steps", "9", "--minutes", "2")
    assert [config(*flags).budget for flags in ((), both[:2], both)] == [
        (5.0, 0),
        (0.0, 9),
        (2.0, 9),
    ]


def test_reward_file_that_fails_names_its_line_and_the_checkpoint_is_kept(league, tmp_path):
    (tmp_path / "mine.py").write_text(
        "count = 0\n\ndef reward_function(params):\n    global count\n    count += 1\n"
        "    print('call', count)\n"
        "    return 1.0 / (30 - count)\n"
    )
    code, _, err = league(
        *("train", *TINY, "--steps", "3200", "--out", "m.pt", "--reward", "mine.py"),
    )
    assert code == 2
    assert "mine.py" in err
    assert "line 7" in err
    assert err.splitlines()[-3] == "  call 30"
    kept = "Kept: m.run/last.pt; go on with --resume."
    assert err.splitlines()[-2] == kept
    assert len((tmp_path / "m.run" / "printed.txt").read_text().splitlines()) == 4 * 29 + 1
    # The 30th call of each car divides by nought: three updates of 8 steps were done.
    assert checkpoint.load(tmp_path / "m.run" / "last.pt").card.steps == 3 * 32


def test_parse_actions_reads_ranges_and_grids():
    assert parse_actions("0.5-4") == ContinuousActions(-30.0, 30.0, 0.5, 4.0)
    assert parse_actions("1-3.5@20") == ContinuousActions(-20.0, 20.0, 1.0, 3.5)
    # Angles 30, 0, -30 deg; speeds 0.5 and 1 m/s.
    assert parse_actions("3x2") == DiscreteActions(
        ((30.0, 0.5), (30.0, 1.0), (0.0, 0.5), (0.0, 1.0), (-30.0, 0.5), (-30.0, 1.0))
    )
    assert parse_actions("2x1@2.5") == DiscreteActions(((30.0, 2.5), (-30.0, 2.5)))


def test_parse_sensors_reads_cameras_and_lidars():
    both = parse_sensors(("stereo64x48", "lidar"))
    assert both.camera is not None
    assert (both.camera.width, both.camera.height, both.camera.eyes) == (64, 48, "stereo")
    assert both.lidar is not None
    assert both.lidar.form == "ranges"
    assert parse_sensors(("sectors",)).camera is None
    one = parse_sensors(("mono32x24",)).camera
    assert one is not None
    assert one.eyes == "mono"
    assert parse_sensors(()).camera is None
    assert parse_sensors(("motion",)).camera is None


def test_sac_is_refused_because_ppo_trains(tmp_path, capsys):
    file = tmp_path / "model_metadata.json"
    ranges = {"steering_angle": {"low": -20, "high": 20}, "speed": {"low": 1, "high": 2}}
    file.write_text(json.dumps({"action_space": ranges, "action_space_type": "continuous"}))
    assert parse_actions(str(file)) == ContinuousActions(-20.0, 20.0, 1.0, 2.0)
    assert capsys.readouterr().err == ""
    asked = json.loads(file.read_text()) | {"training_algorithm": "sac"}
    file.write_text(json.dumps(asked))
    parse_actions(str(file))
    assert capsys.readouterr().err == f"{file}: asks for sac; the league trains by clipped PPO\n"


def test_any_text_as_action_space_is_an_action_space_or_one_sentence():
    draw = random.Random(7)
    pieces = ["0.5", "4", "-", "@", "x", "30", "1e9", "nan", "inf", " ", "-1", "٣", "9" * 500, ""]
    given = ["".join(draw.choices(pieces, k=draw.randint(0, 6))) for _ in range(3000)]
    understood = 0
    for text in given:
        try:
            space = parse_actions(text)
        except LeagueError as error:
            said = str(error)
            assert "\n" not in said, text
            assert len(said) < 300, text
            continue
        understood += 1
        assert isinstance(space, ContinuousActions | DiscreteActions)
        steering, speed = space.controls(np.zeros((1, space.size), np.float32))
        assert np.isfinite(steering + speed).all(), text
    assert 5 < understood < 1000


@pytest.mark.parametrize("text", ["999x999@1", "256x2", "1x5", "5x0", "999999999x9"])
def test_grid_of_too_many_or_too_few_choices_is_refused(text):
    with pytest.raises(ConfigError, match=r"give"):
        parse_actions(text)


def started(folder, *flags: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", "league.cli", "train", *TINY, "--out", "long.pt", *flags],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        # A suite that runs in the background has its children ignore Ctrl-C.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )


def wait_for_updates(folder, number: int, process: subprocess.Popen) -> None:
    path = folder / "long.run" / "history.jsonl"
    until = time.monotonic() + 300
    while not (path.exists() and path.read_bytes().count(b'"row":"update"') >= number):
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.mark.slow
def test_killed_training_goes_on_from_its_last_save_point(league, tmp_path):
    process = started(tmp_path, "--steps", "100000")
    wait_for_updates(tmp_path, 12, process)
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=120)
    folder = tmp_path / "long.run"
    kept = checkpoint.load(folder / "last.pt").card.steps
    assert kept >= 8 * 32  # a save point every 8 updates
    # Not 100,000 decisions in a test: the settings are those of the run, so the test ends it.
    cfg = (folder / "settings.json").read_text().replace('"steps": 100000', '"steps": 640')
    (folder / "settings.json").write_text(cfg)
    code, out, err = league("train", *TINY, "--out", "long.pt", "--resume")
    assert code == 0, err
    assert "stopped because the steps were driven" in out
    rows = [r for r in history.read(folder / "history.jsonl") if isinstance(r, history.UpdateRow)]
    assert [row.number for row in rows] == list(range(1, len(rows) + 1))
    assert rows[-1].samples >= 640
    assert checkpoint.load(tmp_path / "long.pt").card.name == "long"


@pytest.mark.slow
def test_ctrl_c_saves_and_says_how_to_go_on(tmp_path):
    process = started(tmp_path, "--steps", "100000")
    wait_for_updates(tmp_path, 3, process)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=300)
    assert process.returncode == 130
    assert "Stopped. Kept: long.run/last.pt" in err
    assert err.endswith("; go on with --resume.\n")
    assert "Traceback" not in err
    assert checkpoint.load(tmp_path / "long.run" / "last.pt").card.steps >= 3 * 32
