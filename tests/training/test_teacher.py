"""The teacher learns first from the truth; then the policy explores and is drawn towards it."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from league.agents.network import group_shapes
from league.cli.train import Train, _kept
from league.envs import state
from league.envs.observations import MOTION_FIELDS
from league.errors import ConfigError, PolicyError, RewardError
from league.track.track import TrackSet
from league.training.config import TrainConfig
from league.training.monitor import history
from league.training.ppo import symmetry, teacher
from league.training.ppo.teacher import NOISE_SHARE, TaughtLearner, Teacher
from tests.scenes import make_ring
from tests.training import small
from tests.training.learners import (
    CHOICES,
    algorithm,
    learner,
    lesson_of,
    same,
    settings,
    teacher_of,
)


def tutored(cfg: TrainConfig | None = None) -> TaughtLearner:
    made = teacher.make_taught(TrackSet(make_ring()), cfg or replace(settings(), teacher=0.5))
    last = algorithm(teacher_of(made)).get_policy().mlp[-1]
    with torch.no_grad():  # untaught, it asks for next to nothing
        last.weight.mul_(100.0)
        last.bias.copy_(torch.linspace(-0.5, 0.3, len(last.bias)))
    return made


def batch(made: TaughtLearner):
    """Return a mini-batch as rsl-rl makes it, after a round of the policy's own."""
    return next(algorithm(made).storage.mini_batch_generator(1, 1))


def collected(made: TaughtLearner):
    """Have the policy drive a round, and return it with the policy's answers to it."""
    made._schedule(0.0)
    made._collect()
    found = batch(made)
    algorithm(made).get_policy()(found.observations, stochastic_output=True)
    return found, algorithm(made).get_policy()


def test_a_teacher_observes_the_truth_and_sees_nothing():
    made = teacher_of(tutored())
    assert "stereo" not in group_shapes(made.cfg.sensors)
    actor = algorithm(made).get_policy()
    assert actor.obs_groups == list(Teacher.groups)
    assert actor.obs_dim == state.SIZE + 5


def test_first_the_teacher_learns_and_then_the_policy_does():
    made = tutored()
    policy, taught = made.weights(), teacher_of(made).weights()
    first = made.update(0.0)
    assert same(made.weights(), policy)
    assert not same(teacher_of(made).weights(), taught)
    assert (made.has_learnt, first.number, first.samples) == (False, 1, 32)
    taught = teacher_of(made).weights()
    then = made.update(0.5)
    assert not same(made.weights(), policy)
    assert same(teacher_of(made).weights(), taught)
    assert (made.has_learnt, then.number, then.samples) == (True, 2, 64)
    assert "advice" in then.losses
    made.update(0.2)  # of a larger budget: what is taught is taught
    assert same(teacher_of(made).weights(), taught)


def test_schedules_run_once_for_each_of_them():
    made = tutored(replace(settings(), teacher=0.5).with_ppo(learning_rate=(1e-3, 1e-5)))
    made.update(0.25)
    rates = [algorithm(teacher_of(made)).optimizer.param_groups[0]["lr"]]
    for share in (0.5, 0.75, 1.0):
        made.update(share)
        rates.append(algorithm(made).optimizer.param_groups[0]["lr"])
    assert rates == pytest.approx([1e-4, 1e-3, 1e-4, 1e-5])


def test_advice_counts_less_and_less():
    made = tutored()
    found = []
    for share in (0.5, 0.75, 0.9, 1.0):
        made.update(share)
        found.append(lesson_of(made).weight)
    assert found == pytest.approx([1.0, 0.5, 0.2, 0.0])


@pytest.mark.parametrize(("noise", "calm"), [((0.4, 0.02), 0.4 * NOISE_SHARE), ((0.1, 0.08), 0.08)])
def test_the_policy_explores_less_than_its_teacher_did(noise, calm):
    made = tutored(replace(settings(), teacher=0.5).with_ppo(noise=noise))
    found = [made.update(share).mean_std for share in (0.0, 0.5, 1.0)]
    assert found == pytest.approx([noise[0], calm, noise[1]])


def test_the_loss_is_the_divergence_from_what_the_teacher_asks_for():
    made = tutored(replace(settings(symmetry=False), teacher=0.5).with_ppo(noise=(0.5, 0.5)))
    found, actor = collected(made)
    wanted = teacher_of(made).targets(found.observations.select(*Teacher.groups))
    assert wanted.abs().max() <= 1
    lesson_of(made).weight = 0.5
    loss = lesson_of(made).compute_loss(actor, found, 32)
    # KL of two Gaussians with one deviation, summed over steering and speed.
    by_hand = ((actor.output_mean - wanted) ** 2 / (2 * 0.5**2)).sum(dim=1).mean()
    assert loss.item() == pytest.approx(0.5 * by_hand.item(), rel=1e-4)
    assert loss.item() > 0
    loss.backward()
    assert any(p.grad is not None and p.grad.abs().sum() > 0 for p in actor.parameters())
    assert all(p.grad is None for p in algorithm(teacher_of(made)).get_policy().parameters())


def test_learning_from_advice_alone_comes_to_ask_for_the_same():
    made = tutored(replace(settings(symmetry=False), teacher=0.5).with_ppo(noise=(0.5, 0.5)))
    found, actor = collected(made)
    steps = torch.optim.Adam(actor.parameters(), 3e-3)
    losses = []
    for _ in range(200):
        actor(found.observations, stochastic_output=True)
        loss = lesson_of(made).compute_loss(actor, found, 32)
        steps.zero_grad()
        loss.backward()
        steps.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0]


def test_for_mirror_images_the_advice_is_mirrored():
    made = tutored()
    found, _ = collected(made)
    usual, seen = lesson_of(made).targets(found.observations), found.observations["motion"].clone()
    lesson_of(made).augment_batch(found, 32)
    assert torch.equal(found.observations["motion"], seen)  # the first is never mirrored
    lesson_of(made).augment_batch(found, 32)
    assert torch.equal(found.observations["motion"], symmetry.numbers(seen, MOTION_FIELDS))
    turned = lesson_of(made).targets(found.observations)
    assert torch.allclose(turned, made.cfg.action_space.mirror(usual), atol=1e-5)


def test_choices_are_advised_by_their_log_probabilities():
    made = tutored(replace(settings(space=CHOICES), teacher=0.5))
    found, actor = collected(made)
    wanted = teacher_of(made).targets(found.observations.select(*Teacher.groups))
    assert torch.allclose(wanted.exp().sum(dim=1), torch.ones(32), atol=1e-5)
    scores = actor.output_distribution_params[0]
    by_hand = (wanted.exp() * (wanted - scores)).sum(dim=1).mean()
    loss = lesson_of(made).compute_loss(actor, found, 32)
    assert loss.item() == pytest.approx(by_hand.item(), abs=1e-6)


def test_without_a_teacher_nothing_is_advised():
    made = learner()
    assert "advice" not in made.update(0.0).losses
    assert made.has_learnt


def test_what_both_have_learnt_is_kept_and_taken_up_again(tmp_path):
    made, other = tutored(), tutored(replace(settings(seed=1), teacher=0.5))
    made.update(0.0)
    made.update(0.5)
    made.save(tmp_path / "state.pt", {"of": "mine"})
    assert other.restore(tmp_path / "state.pt") == {"of": "mine"}
    assert same(made.weights(), other.weights())
    assert same(teacher_of(made).weights(), teacher_of(other).weights())
    assert (other.updates, other.samples, other.has_learnt) == (2, 64, True)


def test_while_the_teacher_learns_there_is_no_policy_to_judge_or_to_keep(tmp_path):
    made = small.run(tmp_path / "run", small.cfg(updates=8, train=small.train(teacher=0.5)))
    seen = []

    def after(update) -> None:
        seen.append((update.number, (tmp_path / "run" / "last.pt").exists()))

    made.learn([small.CallbackRecorder(after=after)])
    assert [number for number, kept in seen if not kept] == [1, 2, 3, 4, 5, 6]  # written after 6
    rows = history.read(tmp_path / "run" / "history.jsonl")
    judged = [row.number for row in rows if isinstance(row, history.EvaluationRow)]
    assert judged
    assert min(judged) > 4


def test_a_run_does_not_end_with_a_policy_that_has_learnt_nothing(tmp_path):
    outcome = small.run(
        tmp_path / "run", small.cfg(updates=1, train=small.train(teacher=0.5))
    ).learn()
    assert outcome.samples == 2 * small.SAMPLES  # the teacher's update takes all, and one is added
    assert (tmp_path / "run" / "last.pt").exists()


def test_a_reward_file_that_fails_while_the_teacher_learns_keeps_what_it_has_learnt(tmp_path):
    file = tmp_path / "soon.py"
    file.write_text(
        "calls = 0\n\ndef reward_function(params):\n    global calls\n    calls += 1\n"
        "    return 1.0 / (20 - calls)\n"
    )
    asked = small.cfg(updates=20, reward=str(file), train=small.train(teacher=0.5))
    with pytest.raises(RewardError, match=r"soon.py, line 6"):
        small.run(tmp_path / "taught.run", asked).learn()
    assert (tmp_path / "taught.run" / "state.pt").exists()
    assert not (tmp_path / "taught.run" / "last.pt").exists()
    kept = _kept(Train(out=tmp_path / "taught.pt"))
    assert "with what the teacher has learnt; go on with --resume" in kept


def test_a_state_without_a_teacher_is_that_of_another_run(tmp_path):
    plain = learner()
    plain.update(0.0)
    plain.save(tmp_path / "state.pt", {})
    with pytest.raises(PolicyError, match="cannot be resumed"):
        tutored().restore(tmp_path / "state.pt")


@pytest.mark.parametrize("share", [-0.1, 0.95, float("nan")])
def test_a_teacher_has_a_share_of_the_time(share):
    with pytest.raises(ConfigError, match="teacher's share of the budget is"):
        TrainConfig(teacher=share)
