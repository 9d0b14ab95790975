"""A training run: what ends it, what it leaves behind, and how it goes on."""

import hashlib
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from league.agents import checkpoint
from league.errors import ConfigError, PolicyError, RewardError
from league.racing.duels import Duels, Threshold
from league.racing.evaluate import evaluate
from league.training import evaluator
from league.training import run as run_room
from league.training.config import RunConfig, TrainConfig, read
from league.training.evaluator import merit_of
from league.training.monitor import history
from league.training.monitor.history import TEACHING
from league.training.ppo.learner import Learner
from league.training.ppo.self_play import RacingLearner
from league.training.run import Run
from tests.training import small
from tests.training.learners import CHOICES

EXAMPLES = Path(__file__).parents[2] / "examples"
CHEERFUL = "def reward_function(params):\n    return 1.0\n"
GIVES_UP = """count = 0
def reward_function(params):
    global count
    count += 1
    if count > 40:
        raise ValueError("enough")
    return 1.0
"""


def interrupt_after(number: int):
    def after(update) -> None:
        if update.number == number:
            raise KeyboardInterrupt

    return after


def test_run_ends_when_its_steps_are_driven(tmp_path):
    outcome = small.run(tmp_path, small.cfg(updates=3)).learn()
    assert outcome.samples == 3 * small.SAMPLES
    assert outcome.why == "the steps were driven"


def test_run_ends_when_its_time_is_up(tmp_path):
    outcome = small.run(tmp_path, small.cfg(steps=0, minutes=1e-5)).learn()
    assert outcome.why == "the time was up"
    assert outcome.samples == small.SAMPLES  # 0.6 ms are over after one update


def passed(exam, found):
    """A scripted driver takes the exam, so that a lap is complete before anything is learnt."""
    return evaluate("centerline", exam.tracks[0], laps=1, mode="episode", solver="planar")


def racing(**changes):
    """Return settings of a run of self-play so small that it takes a second."""
    train = small.train(kind="head_to_head", num_cars=2, **changes)
    return small.cfg(9, train=train, reward="race", self_play=True)


@pytest.fixture
def small_racer(monkeypatch):
    """Learning on the true state in four worlds, eight steps at a time."""
    on_truth = TrainConfig.on_truth

    def smaller(self):
        cfg = on_truth(self)
        ppo = replace(cfg.ppo, rollout=8, epochs=1, mini_batches=2)
        return replace(cfg, num_worlds=4, save_every=2, ppo=ppo)

    monkeypatch.setattr(TrainConfig, "on_truth", smaller)
    monkeypatch.setattr(run_room, "_DUELS", 2)


def test_in_self_play_the_newest_is_best_of_those_that_come_as_far(
    tmp_path, monkeypatch, small_racer
):
    exams = []

    def sat(exam, found):
        exams.append(len(exams))
        return passed(exam, found) if exams[-1] != 1 else judged(exam, found)

    judged = evaluator.evaluate_policy
    monkeypatch.setattr(evaluator, "evaluate_policy", sat)
    run, onlooker = small.run(tmp_path, racing()), small.CallbackRecorder()
    seen = Duels(
        races=10, passed=0.5, given=0.0, clean=0.5, held=0.5, places=0.5, near_km=2.0, contacts=3,
        hard_contacts=1, hard_at_start=0, off_tracks=2, finished=0.0,
    )  # fmt: skip
    monkeypatch.setattr(run_room.duels, "threshold", lambda *_: Threshold(0.9, 1.0, {0.9: seen}))
    outcome = run.learn([onlooker])
    # The second leaves the road; the third laps as the first did.
    assert [row.complete_laps for row in run.history.evaluations] == [1, 0, 1]
    assert [row.best for row in run.history.evaluations] == [True, False, True]
    assert outcome.duels is not None
    assert onlooker.races[-1] == "racing it against itself, slowed, for the policy's card"
    card = checkpoint.load(tmp_path / "best.pt").card
    assert (card.results["pass_pace"], card.results["hold_pace"]) == (0.9, 1.0)
    rates = (card.results[f"{name}_per_km"] for name in ("contacts", "hard_contacts"))
    assert [*rates, card.results["off_tracks_per_pass"]] == [1.5, 0.5, 0.4]


def test_self_play_goes_from_the_true_state_to_its_own_sensors(tmp_path, small_racer):
    run = small.run(tmp_path, racing(sensors=small.CAMERA, teacher=0.5))
    outcome = run.learn()
    taught = [TEACHING in row.log for row in run.history.updates]
    assert any(taught) and not all(taught)
    assert checkpoint.load(outcome.best).card.sensors == small.CAMERA
    assert checkpoint.load(tmp_path / "truth.pt").card.sensors.privileged == ("ahead",)
    # All cars learn in either stage.
    learner = run.learner
    assert isinstance(learner, RacingLearner)
    assert learner.env.learners == learner.teacher.env.learners == (0, 1)


def test_a_reward_file_pays_all_cars_in_self_play(tmp_path, small_racer):
    file = tmp_path / "one.py"
    file.write_text("def reward_function(params):\n    return 1.0\n")
    cfg = replace(racing(sensors=small.CAMERA, teacher=0.5), reward=str(file))
    run = small.run(tmp_path, cfg)
    run.learn()
    # All but cars that stand for a penalty.
    assert 0.8 < run.history.updates[-1].reward <= 1.0


def test_who_learns_to_race_others_is_judged_by_racing_them(tmp_path, monkeypatch):
    cfg = small.cfg(
        2, train=small.train(kind="head_to_head", num_cars=2), opponents=("centerline",)
    )
    run = small.run(tmp_path, cfg)
    evaluation = run.learn().evaluation
    assert evaluation is not None
    assert (evaluation.kind, len(evaluation.places)) == ("head_to_head", 1)
    assert merit_of(evaluation.model_copy(update={"places": (1, 2)}))[0] == -1.5
    # With a complete lap it is raced against itself, too.
    monkeypatch.setattr(evaluator, "evaluate_policy", passed)
    monkeypatch.setattr(run_room.duels, "threshold", lambda *_: Threshold(0.8, 1.1, {}))
    small.run(tmp_path / "faster", cfg).learn()
    assert checkpoint.load(tmp_path / "faster" / "best.pt").card.results["hold_pace"] == 1.1
    # Who drives no lap in the plane has no thresholds.
    monkeypatch.undo()
    monkeypatch.setattr(evaluator, "evaluate_policy", passed)
    outcome = small.run(tmp_path / "slower", cfg).learn()
    assert outcome.evaluation is not None and outcome.duels is None


def test_a_parent_that_is_only_watched_yet_is_not_judged(tmp_path):
    first = small.run(tmp_path / "first", small.cfg(2))
    first.learn()
    cfg = small.cfg(6, init_from=str(tmp_path / "first" / "last.pt"))
    run = small.run(tmp_path / "second", cfg)
    run.learn()
    # Save points come every 2 updates; the actor begins to learn with the fifth.
    assert [row.number for row in run.history.evaluations] == [6]


@pytest.mark.skipif(sys.platform == "win32", reason="folders are locked by flock")
def test_two_runs_do_not_learn_in_one_folder(tmp_path):
    def intrude(update) -> None:
        other = small.run(tmp_path, small.cfg(4))
        with pytest.raises(ConfigError, match=r"another run is learning in .*: wait for its end"):
            other.learn()
        other = small.run(tmp_path, small.cfg(4))
        with pytest.raises(ConfigError, match="another run is learning"):
            other.resume()
        other.close()

    run = small.run(tmp_path, small.cfg(4))
    outcome = run.learn(
        [small.CallbackRecorder(after=lambda u: intrude(u) if u.number == 3 else None)]
    )
    assert outcome.samples == 4 * small.SAMPLES
    again = small.run(tmp_path, small.cfg(6))
    again.resume()  # nothing learns there any more
    again.close()


def test_a_resumed_run_tells_of_its_best_though_nothing_better_came(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluator, "evaluate_policy", passed)
    cfg = small.cfg(8)
    run = small.run(tmp_path, cfg)
    with pytest.raises(KeyboardInterrupt):
        run.learn([small.CallbackRecorder(after=interrupt_after(5))])
    monkeypatch.undo()
    again = small.run(tmp_path, cfg)
    again.resume()
    assert again.learn().evaluation is not None


def test_run_ends_after_evaluations_with_every_lap_complete(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluator, "evaluate_policy", passed)
    onlooker = small.CallbackRecorder()
    run = small.run(tmp_path, small.cfg(updates=100, stop_when_complete=2))
    outcome = run.learn([onlooker])
    assert outcome.why == "every lap was complete"
    assert onlooker.updates == [1, 2, 3, 4]  # a save point every 2 updates, twice
    assert len(onlooker.evaluations) == 2
    assert outcome.evaluation is not None
    assert outcome.evaluation.all_complete


def late(run: Run, number: int) -> small.CallbackRecorder:
    """Have what the judge is handed judged only after an update; return who says so."""
    kept, hand = [], run._evaluator.submit
    run._evaluator.submit = lambda *given: kept.append(given)

    def after(update) -> None:
        if update.number == number:
            run._evaluator.submit = hand
            hand(*kept[0])

    return small.CallbackRecorder(after)


def test_judgement_that_ends_the_run_does_not_wait_for_a_save_point(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluator, "evaluate_policy", passed)
    asked = small.cfg(updates=100, stop_when_complete=1, train=small.train(save_every=4))
    run = small.run(tmp_path, asked)
    onlooker = late(run, 5)
    assert run.learn([onlooker]).why == "every lap was complete"
    assert onlooker.updates == [1, 2, 3, 4, 5]
    best = checkpoint.load(tmp_path / "best.pt").card
    assert best.results["updates"] == 4.0 and best.results["completion"] == 100.0
    again = small.run(tmp_path, asked)
    again.resume()
    assert again.over == "every lap was complete"
    again.close()


def test_judgement_that_does_not_end_the_run_waits_for_a_save_point(tmp_path):
    asked = small.cfg(updates=8, stop_when_complete=1, train=small.train(save_every=4))
    run = small.run(tmp_path, asked)
    run.learn([late(run, 5)])
    rows = [type(row).__name__ for row in history.read(tmp_path / "history.jsonl")]
    assert rows[:8] == ["UpdateRow"] * 8 and rows[8] == "EvaluationRow"


def test_folder_holds_best_last_state_settings_and_history(tmp_path):
    small.run(tmp_path).learn()
    assert {path.name for path in tmp_path.iterdir()} == {
        "best.pt",
        "last.pt",
        "state.pt",
        "settings.json",
        "history.jsonl",
    }
    rows = history.read(tmp_path / "history.jsonl")
    kinds = [(type(row).__name__, row.number) for row in rows]
    assert kinds == [
        ("UpdateRow", 1),
        ("UpdateRow", 2),
        ("EvaluationRow", 2),
        ("UpdateRow", 3),
        ("UpdateRow", 4),
        ("EvaluationRow", 4),  # once, although the run ends on a save point
    ]


def test_card_tells_where_a_policy_comes_from(tmp_path):
    file = tmp_path / "cheerful.py"
    file.write_text(CHEERFUL)
    small.run(tmp_path / "one", small.cfg(reward=str(file))).learn()
    last = checkpoint.load(tmp_path / "one" / "last.pt")
    assert last.card.reward is not None
    assert last.card.reward.name == "cheerful"
    assert last.card.reward.sha256 == hashlib.sha256(CHEERFUL.encode()).hexdigest()
    assert last.card.steps == 4 * small.SAMPLES
    assert last.card.command == "league train --out tiny.pt"
    assert last.card.tracks == ("reinvent_2018",)
    assert last.card.parents == ()
    best = checkpoint.load(tmp_path / "one" / "best.pt")
    assert best.card.results["updates"] in (2.0, 4.0)
    assert "completion" in best.card.results


def test_child_names_its_parents_and_begins_with_their_weights(tmp_path):
    small.run(tmp_path / "one").learn()
    parent = tmp_path / "one" / "last.pt"
    run = small.run(tmp_path / "two", small.cfg(init_from=str(parent), updates=1))
    begun = run.learner.weights()
    assert all(np.array_equal(begun[name], value) for name, value in small.weights(parent).items())
    run.learn()
    child = tmp_path / "two" / "last.pt"
    assert checkpoint.load(child).card.parents == (checkpoint.load(parent).digest,)
    small.run(tmp_path / "three", small.cfg(init_from=str(child), updates=1)).learn()
    grandchild = checkpoint.load(tmp_path / "three" / "last.pt").card
    assert grandchild.parents == (checkpoint.load(child).digest, checkpoint.load(parent).digest)


def test_parent_of_another_shape_is_refused(tmp_path):
    small.run(tmp_path / "one", small.cfg(updates=1)).learn()
    sees = small.cfg(
        train=small.train(sensors=small.CAMERA), init_from=str(tmp_path / "one" / "last.pt")
    )
    with pytest.raises(PolicyError, match="other layers, sensors or actions than this run: give"):
        small.run(tmp_path / "two", sees)


def test_card_says_how_many_of_twenty_runs_are_clean(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluator, "evaluate_policy", passed)
    callback = small.CallbackRecorder()
    small.run(tmp_path, small.cfg(updates=2)).learn([callback])
    assert checkpoint.load(tmp_path / "best.pt").card.results["clean_share"] == 1.0


def test_run_that_stops_at_the_first_laps_is_over_without_twenty_more(tmp_path, monkeypatch):
    monkeypatch.setattr(evaluator, "evaluate_policy", passed)
    outcome = small.run(tmp_path, small.cfg(updates=9, stop_when_complete=1)).learn()
    assert outcome.why == "every lap was complete"
    assert "clean_share" not in checkpoint.load(tmp_path / "best.pt").card.results


def test_card_says_no_share_where_no_lap_was_complete(tmp_path):
    small.run(tmp_path, small.cfg(updates=2)).learn()
    assert "clean_share" not in checkpoint.load(tmp_path / "best.pt").card.results


def test_policy_sees_what_its_card_says(tmp_path):
    small.run(tmp_path, small.cfg(updates=2, train=small.train(sensors=small.CAMERA))).learn()
    card = checkpoint.load(tmp_path / "best.pt").card
    assert card.sensors == small.CAMERA
    found = evaluate(str(tmp_path / "best.pt"), "reinvent_2018", laps=1, solver="planar")
    assert found.asked == 1


def test_stop_by_hand_saves_what_was_learnt(tmp_path):
    onlooker = small.CallbackRecorder(after=interrupt_after(3))
    run = small.run(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        run.learn([onlooker])
    assert onlooker.closed == 1
    assert checkpoint.load(tmp_path / "last.pt").card.steps == 3 * small.SAMPLES
    again = small.run(tmp_path)
    again.resume()
    assert again.learner.samples == 3 * small.SAMPLES
    assert again.learn().samples == 4 * small.SAMPLES


def test_a_full_card_stops_training_in_a_sentence_and_the_checkpoint_is_kept(tmp_path, monkeypatch):
    run, update = small.run(tmp_path, small.cfg(updates=4)), Learner.update

    def full(learner, share):
        if learner.updates == 2:
            raise torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 20 GiB.")
        return update(learner, share)

    monkeypatch.setattr(Learner, "update", full)
    with pytest.raises(
        ConfigError, match=r"memory is full \('CUDA out of memory'\): start a new run"
    ):
        run.learn()
    assert checkpoint.load(tmp_path / "last.pt").card.steps == 2 * small.SAMPLES


def test_reward_function_that_raises_stops_training_and_the_checkpoint_is_kept(tmp_path):
    file = tmp_path / "gives_up.py"
    file.write_text(GIVES_UP)
    # Each of 4 cars has a count of its own, 8 steps an update: the sixth update ends it.
    run = small.run(tmp_path / "run", small.cfg(reward=str(file), updates=100))
    with pytest.raises(RewardError, match=r"gives_up.py.*line 6"):
        run.learn()
    assert checkpoint.load(tmp_path / "run" / "last.pt").card.steps == 5 * small.SAMPLES


def test_reward_function_that_raises_at_once_leaves_no_checkpoint(tmp_path):
    file = tmp_path / "never.py"
    file.write_text("def reward_function(params):\n    return 1 / 0\n")
    with pytest.raises(RewardError, match=r"never.py"):
        small.run(tmp_path / "run", small.cfg(reward=str(file))).learn()
    assert not (tmp_path / "run" / "last.pt").exists()


def eight(reward: str = "centerline", **changes) -> RunConfig:
    """Return settings of a run of eight updates."""
    return small.cfg(updates=8, reward=reward, train=small.train(**changes))


@pytest.mark.parametrize(
    "asked",
    [
        eight(),
        eight(sensors=small.CAMERA),
        # Killed while it learns from its teacher, and while the teacher learns.
        eight(sensors=small.CAMERA, teacher=0.3),
        eight("racing_line", sensors=small.CAMERA, teacher=0.6),
        eight(str(EXAMPLES / "reward_centerline.py"), teacher=0.3, action_space=CHOICES),
        # Self-play, in which seven cars learn: while it learns from the racer, and while the racer
        # learns, which has save points of its own.
        replace(racing(sensors=small.CAMERA, teacher=0.3), steps=8 * 7 * 8),
        replace(racing(sensors=small.CAMERA, teacher=0.8, save_every=1), steps=8 * 7 * 8),
    ],
)
def test_resumed_run_equals_an_uninterrupted_one(tmp_path, small_racer, asked):
    small.run(tmp_path / "whole", asked).learn()
    # Killed after the fifth update: what the fourth left on the disk is all there is.
    killed = small.run(tmp_path / "parts", asked)
    left: dict[str, bytes] = {}

    def after(update) -> None:
        if update.number == 5:
            left.update({p.name: p.read_bytes() for p in (tmp_path / "parts").iterdir()})
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        killed.learn([small.CallbackRecorder(after=after)])
    for name, content in left.items():
        (tmp_path / "parts" / name).write_bytes(content)
    again = Run(read(tmp_path / "parts"), tmp_path / "parts", background=False)
    again.resume()
    assert again.learner.updates == 4
    outcome = again.learn()
    assert outcome.samples == asked.steps
    for name in ("last.pt", "best.pt"):
        assert small.equal(tmp_path / "whole" / name, tmp_path / "parts" / name)
    histories = [history.read(tmp_path / part / "history.jsonl") for part in ("whole", "parts")]
    rewards = [
        [(row.number, row.reward) for row in rows if isinstance(row, history.UpdateRow)]
        for rows in histories
    ]
    assert rewards[0] == rewards[1]
    completion = [
        [(row.number, row.completion) for row in rows if isinstance(row, history.EvaluationRow)]
        for rows in histories
    ]
    assert completion[0] == completion[1]


def test_same_seed_same_weights_and_another_seed_others(tmp_path):
    for name, seed in (("one", 3), ("two", 3), ("other", 4)):
        small.run(tmp_path / name, small.cfg(updates=2, train=small.train(seed=seed))).learn()
    last = {name: tmp_path / name / "last.pt" for name in ("one", "two", "other")}
    assert small.equal(last["one"], last["two"])
    assert not small.equal(last["one"], last["other"])


def test_resumed_run_remembers_which_policy_was_best(tmp_path):
    run = small.run(tmp_path, small.cfg(updates=6))
    with pytest.raises(KeyboardInterrupt):
        run.learn([small.CallbackRecorder(after=interrupt_after(5))])
    merit = run._best
    assert merit is not None
    again = small.run(tmp_path, small.cfg(updates=6))
    again.resume()
    again.history.close()
    assert again._best == merit
    assert again.history.best == run.history.best


def test_settings_are_read_back_as_they_were(tmp_path):
    from league.envs.actions import grid

    asked = small.cfg(
        updates=1,
        train=small.train(
            sensors=small.CAMERA,
            action_space=grid(5, 30.0, 2, 1.0),
            visual_randomization=True,
            dynamics_randomization=0.5,
        ),
        tracks=("peanut", "reinvent_2018"),
    )
    run = small.run(tmp_path, asked)
    run.learn()
    assert read(tmp_path) == asked


@pytest.mark.parametrize(
    "content",
    [None, b"", b"{", b"[]", b'{"minutes": 0}', b'{"minutes": -1}', b'{"train": {"seed": "x"}}'],
)
def test_folder_without_a_runs_settings_is_refused_in_one_sentence(tmp_path, content):
    if content is not None:
        (tmp_path / "settings.json").write_bytes(content)
    with pytest.raises(PolicyError, match=r"settings.json holds no settings of a run .*: give"):
        read(tmp_path)


def test_state_of_another_run_is_refused(tmp_path):
    small.run(tmp_path, small.cfg(updates=2)).learn()
    before = (tmp_path / "state.pt").read_bytes()
    wider = small.cfg(train=small.train(critic_hidden=(24,)))
    other = small.run(tmp_path, wider)
    with pytest.raises(PolicyError, match=r"state.pt cannot be resumed .*: give the run the"):
        other.resume()
    assert (tmp_path / "state.pt").read_bytes() == before


@pytest.mark.parametrize("content", [None, b"", b"garbage", b"PK\x03\x04"])
def test_state_that_is_none_is_refused(tmp_path, content):
    if content is not None:
        (tmp_path / "state.pt").write_bytes(content)
    with pytest.raises(PolicyError, match=r"state.pt cannot be resumed"):
        small.run(tmp_path).resume()


def test_state_that_was_cut_off_is_refused(tmp_path):
    small.run(tmp_path, small.cfg(updates=1)).learn()
    whole = (tmp_path / "state.pt").read_bytes()
    for part in (1000, len(whole) // 2, len(whole) - 1):
        (tmp_path / "state.pt").write_bytes(whole[:part])
        with pytest.raises(PolicyError, match=r"state.pt cannot be resumed"):
            small.run(tmp_path).resume()


def test_new_run_in_the_folder_of_an_old_one_begins_with_nothing(tmp_path):
    small.run(tmp_path, small.cfg(updates=4)).learn()
    run = small.run(tmp_path, small.cfg(updates=1))
    run.learn()
    assert checkpoint.load(tmp_path / "last.pt").card.steps == small.SAMPLES
    assert [row.number for row in run.history.updates] == [1]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"licence": ""}, "licence"),
        ({"name": "n" * 81}, "name"),
        ({"name": "two\nlines"}, "name"),
        ({"train": "tiny picture"}, "picture"),
        ({"train": "huge picture"}, "pixels"),
    ],
)
def test_what_no_checkpoint_could_tell_is_refused_before_anything_is_learnt(tmp_path, wrong, said):
    from dataclasses import replace

    from league.agents.network import NetworkConfig
    from league.sim.config import CameraConfig, SensorConfig

    sizes = {"tiny picture": (8, 8), "huge picture": (1920, 1080)}
    if "train" in wrong:
        sensors = SensorConfig(camera=CameraConfig(*sizes[wrong["train"]]))
        wrong = {"train": small.train(sensors=sensors, network=NetworkConfig())}
    with pytest.raises(ConfigError, match=said):
        small.run(tmp_path / "run", replace(small.cfg(), **wrong))
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("limit", [(0, 0), (-1, 5), (5, -1), (float("nan"), 0), (float("inf"), 9)])
def test_run_without_an_end_is_refused(limit, tmp_path):
    minutes, steps = limit
    with pytest.raises(ConfigError, match="give one of them, more than 0"):
        small.run(tmp_path, small.cfg(minutes=minutes, steps=steps))


def test_folder_that_cannot_be_made_gets_one_sentence(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(PolicyError, match=r"cannot be made .*: give --out a place"):
        small.run(tmp_path / "file" / "run").learn()


def test_history_holds_numbers_of_the_learner(tmp_path):
    small.run(tmp_path, small.cfg(updates=1)).learn()
    lines = (tmp_path / "history.jsonl").read_text().splitlines()
    row = json.loads(lines[1])
    assert row["samples"] == small.SAMPLES
    assert 0 < row["reward"] <= 1.0  # the centre-line reward of a step
