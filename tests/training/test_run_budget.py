"""A run that is given more time, and the folder in which it lies."""

from dataclasses import replace

import pytest

from league.agents import checkpoint
from league.errors import ConfigError, PolicyError
from league.training import config, run_folder
from league.training.config import RunConfig, TrainConfig
from league.training.monitor import history
from league.training.run import Run
from tests.training import small
from tests.training.learners import algorithm


def gone_on(folder, updates: int) -> Run:
    """Return a resumed run with a budget of so many updates in all."""
    cfg = replace(config.read(folder), steps=updates * small.SAMPLES)
    run = small.run(folder, cfg)
    run.resume()
    return run


def test_finished_run_that_is_given_more_steps_goes_on(tmp_path):
    small.run(tmp_path, small.cfg(updates=2)).learn()
    run = gone_on(tmp_path, 4)
    assert run.over == ""
    assert run.learn().samples == 4 * small.SAMPLES
    rows = [r for r in history.read(tmp_path / "history.jsonl") if isinstance(r, history.UpdateRow)]
    assert [row.number for row in rows] == [1, 2, 3, 4]


def test_schedules_follow_the_whole_of_a_larger_budget(tmp_path):
    first, last = small.train().ppo.learning_rate
    small.run(tmp_path, small.cfg(updates=4)).learn()
    run = gone_on(tmp_path, 8)
    rates = []
    run.learn(
        [small.CallbackRecorder(after=lambda _: rates.append(algorithm(run.learner).learning_rate))]
    )
    # The fifth of eight updates begins with half of the decisions driven.
    assert rates[0] == pytest.approx((first * last) ** 0.5)
    assert rates[-1] == pytest.approx(first * (last / first) ** (7 / 8))


def test_larger_budget_is_kept_for_the_next_resume(tmp_path):
    small.run(tmp_path, small.cfg(updates=2)).learn()
    run = gone_on(tmp_path, 6)
    run.close()  # as good as a kill: nothing was saved since
    assert config.read(tmp_path).steps == 6 * small.SAMPLES


def test_finished_run_learns_nothing_more(tmp_path):
    small.run(tmp_path, small.cfg(updates=3)).learn()
    before = small.weights(tmp_path / "last.pt")
    run = small.run(tmp_path, small.cfg(updates=3))
    run.resume()
    assert run.over == "the steps were driven"
    onlooker = small.CallbackRecorder()
    assert run.learn([onlooker]).samples == 3 * small.SAMPLES
    assert onlooker.updates == []
    after = small.weights(tmp_path / "last.pt")
    assert all(bool((before[name] == after[name]).all()) for name in before)


def test_run_killed_while_its_last_policy_is_judged_ends_as_if_it_had_not_been(tmp_path):
    class Impatient(small.CallbackRecorder):
        def evaluated(self, history, evaluation) -> None:
            if history.updates[-1].number == 4:
                raise KeyboardInterrupt

    small.run(tmp_path / "whole", small.cfg(updates=4)).learn()
    with pytest.raises(KeyboardInterrupt):
        small.run(tmp_path / "parts", small.cfg(updates=4)).learn([Impatient()])
    again = small.run(tmp_path / "parts", small.cfg(updates=4))
    again.resume()
    assert again.learn().samples == 4 * small.SAMPLES
    for name in ("last.pt", "best.pt"):
        assert small.equal(tmp_path / "whole" / name, tmp_path / "parts" / name)


def test_complete_laps_are_counted_anew_where_more_time_is_given(tmp_path):
    asked = small.cfg(updates=2, stop_when_complete=1)
    run = small.run(tmp_path, asked)
    run.learn()
    run._complete = 1  # as if the last evaluation had been complete
    run._save()
    same = small.run(tmp_path, asked)
    same.resume()
    assert same.over == "every lap was complete"
    same.close()
    longer = gone_on(tmp_path, 4)
    assert longer.over == ""
    longer.close()


STORED = RunConfig(minutes=5.0, steps=1000)


@pytest.mark.parametrize(
    "larger", [{}, {"minutes": 10.0}, {"steps": 2000}, {"minutes": 0.0}, {"steps": 0}]
)
def test_budget_may_grow(larger, tmp_path):
    config.check_resumed(replace(STORED, **larger), STORED, tmp_path)


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"minutes": 4.0}, "--minutes is 4, and the run was started with 5: give more"),
        ({"steps": 999}, "--steps is 999, and the run was started with 1000: give more"),
        ({"minutes": -1.0}, "give one of them, more than 0"),
        ({"minutes": float("nan")}, "give one of them, more than 0"),
        ({"minutes": 0.0, "steps": 0}, "give one of them, more than 0"),
        ({"train": TrainConfig(num_cars=2)}, "started with another --cars"),
        ({"tracks": ("peanut",), "eval_laps": 1}, "started with another --track: omit"),
    ],
)
def test_budget_may_not_shrink_nor_what_is_learnt_change(changes, said, tmp_path):
    with pytest.raises(ConfigError, match=said):
        config.check_resumed(replace(STORED, **changes), STORED, tmp_path)


def test_run_that_stopped_before_its_first_save_point_says_so(tmp_path):
    config.write(small.cfg(), tmp_path)
    assert not run_folder.is_taken(tmp_path)
    run = small.run(tmp_path)
    with pytest.raises(
        PolicyError, match=r"stopped before its first save point, so start a new one"
    ):
        run.resume()
    run.close()


def test_new_run_removes_what_the_old_one_left_and_nothing_else(tmp_path):
    old = ("training.png", "win_matrix.png", "pool/000032.pt", "pool/pool.json")
    old += ("tensorboard/events.out.tfevents.1.host.2.0",)
    mine = ("notes.txt", "pool/notes.txt", "steps.csv")
    for name in (*old, *mine):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text("old")
    small.run(tmp_path, small.cfg(updates=1)).learn()
    assert not [name for name in old if (tmp_path / name).exists()]
    assert [name for name in mine if (tmp_path / name).read_text() == "old"] == list(mine)


def test_how_far_a_run_has_come_is_said_in_a_phrase(tmp_path):
    assert run_folder.summary(tmp_path) == "a run"
    small.run(tmp_path, small.cfg(updates=2)).learn()
    assert run_folder.summary(tmp_path).startswith("a run of 64 decisions and ")
    assert run_folder.is_taken(tmp_path)
    assert checkpoint.load(tmp_path / "last.pt").card.steps == 64
