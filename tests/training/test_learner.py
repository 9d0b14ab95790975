from __future__ import annotations

import dataclasses
import errno
from pathlib import Path

import numpy as np
import pytest
import torch

from league.agents.network import from_learner
from league.envs.actions import ContinuousActions
from league.errors import PolicyError
from league.sim.config import SensorConfig
from league.training.ppo.learner import Learner
from league.training.ppo.models import CONTRAST, FIRST, with_contrast
from tests.training.learners import CHOICES, LIDAR, algorithm, learner, same, settings


def everything(made: Learner) -> dict[str, torch.Tensor]:
    """Return all that is learnt: the actor, the critic and the optimiser's memory."""
    saved = algorithm(made).save()
    found = {}
    for part in ("actor_state_dict", "critic_state_dict"):
        found |= {f"{part}.{name}": value for name, value in saved[part].items()}
    for number, memory in saved["optimizer_state_dict"]["state"].items():
        found |= {f"{number}.{name}": torch.as_tensor(value) for name, value in memory.items()}
    return found


@pytest.mark.parametrize("space", [ContinuousActions(), CHOICES], ids=["continuous", "discrete"])
def test_gradients_flow_to_every_weight_of_the_actor(space):
    made = learner(space=space)
    before = made.weights()
    assert any(name.startswith("cnns.") for name in before)
    made.update(0.0)
    for name, weight in made.weights().items():
        assert not np.array_equal(weight, before[name]), name
    for name, parameter in algorithm(made).get_policy().named_parameters():
        # The spread of exploration is set by a schedule.
        if "log_std" not in name:
            assert parameter.grad is not None, name
            assert float(parameter.grad.abs().sum()) > 0, name


@pytest.mark.parametrize("space", [ContinuousActions(), CHOICES], ids=["continuous", "discrete"])
def test_the_same_seed_brings_the_same_weights(space):
    found = []
    for seed in (5, 5, 6):
        made = learner(seed=seed, space=space)
        for share in (0.0, 0.5):
            made.update(share)
        found.append(everything(made))
    assert same(found[0], found[1])
    assert not same(found[0], found[2])


@pytest.mark.parametrize(
    ("space", "normalise", "save_every"),
    [(ContinuousActions(), True, 2), (CHOICES, False, 1)],
    ids=["continuous", "discrete"],
)
def test_a_resumed_run_ends_as_one_that_was_never_interrupted(
    tmp_path, space, normalise, save_every
):
    cfg = settings(space=space, normalise=normalise, save_every=save_every)
    whole = learner(cfg)
    for number in range(4):
        row = whole.update(number / 4)
        if number == 1:
            assert whole.at_save_point
            whole.save(tmp_path / "state.pt", {"spent_s": 3.0, "best": [1.0, 2.0]})
    torch.manual_seed(12345)  # whatever else the program has drawn meanwhile
    later = learner(cfg)
    assert later.restore(tmp_path / "state.pt") == {"spent_s": 3.0, "best": [1.0, 2.0]}
    assert (later.updates, later.samples) == (2, 64)  # 2 updates of 4 worlds x 8 steps
    for number in (2, 3):
        again = later.update(number / 4)
    assert same(everything(whole), everything(later))
    assert (again.reward, again.losses, again.log) == (row.reward, row.losses, row.log)
    assert again.samples == row.samples == 128


def test_weights_are_averaged_over_a_tenth_of_the_updates(tmp_path):
    made = learner(save_every=1)
    expected, path = made.weights(), tmp_path / "state.pt"
    for number in range(1, 16):
        made.update(0.0)
        newest = from_learner(algorithm(made).get_policy().state_dict())
        newest = with_contrast(newest, CONTRAST)  # as a checkpoint has them
        share = 1 / max(number / 10, 1)
        expected = {key: old + share * (newest[key] - old) for key, old in expected.items()}
        assert same(made.weights(), newest) == (number <= 10)
        if number == 12:  # goes on with the same average
            made.save(path, {})
            made = learner(save_every=1)
            made.restore(path)
    for key, weight in made.weights().items():
        assert weight == pytest.approx(expected[key], abs=1e-6)


@pytest.mark.parametrize("save_every", [1, 2])
def test_saving_does_not_change_what_is_learnt(tmp_path, save_every):
    found = []
    for path in (tmp_path / "state.pt", None):
        made = learner(save_every=save_every)
        for number in range(3):
            made.update(number / 3)
            if path is not None:
                made.save(path, {})
        found.append(everything(made))
    assert same(*found)


def test_a_choice_from_a_list_is_learnt():
    made = learner(space=CHOICES, sensors=SensorConfig(lidar=LIDAR), symmetry=False)
    before = made.weights()
    row = made.update(0.0)
    assert row.losses["entropy"] > 0
    assert not same(before, made.weights())
    obs = made.env.get_observations()
    with torch.no_grad():
        chosen = algorithm(made).get_policy()(obs, stochastic_output=True)
    assert chosen.shape == (4, 4)
    assert chosen.sum(dim=1).tolist() == [1.0] * 4
    assert set(chosen.reshape(-1).tolist()) == {0.0, 1.0}


def test_mirroring_changes_what_is_learnt():
    plain, mirrored = learner(symmetry=False), learner(symmetry=True)
    assert same(plain.weights(), mirrored.weights())
    plain.update(0.0)
    mirrored.update(0.0)
    assert not same(plain.weights(), mirrored.weights())


@pytest.mark.parametrize("bootstrap", [False, True])
def test_a_forgiven_mistake_costs_its_price_alone(bootstrap):
    made = learner(settings().with_ppo(bootstrap_on_failure=bootstrap))
    step, first = made.env.step, algorithm(made).storage

    def mistaken(actions):
        """Pay 0 for a mistake of each row, none of which the clock has cut off."""
        observations, rewards, dones, extras = step(actions)
        never = torch.zeros_like(extras["time_outs"])
        ones = torch.ones_like(dones)
        return observations, torch.zeros_like(rewards), ones, extras | {"time_outs": never}

    made.env.step = mistaken
    made._schedule(0.0)
    made._collect()
    gamma = made.cfg.ppo.gamma if bootstrap else 0.0
    assert first.values.abs().sum() > 0
    # The reward is the price, 0, and what would have been earned from there.
    assert torch.allclose(first.rewards, gamma * first.values)


def test_exploration_and_step_size_fall_with_the_share_of_the_budget():
    made = learner(settings().with_ppo(learning_rate=(1e-3, 1e-5), noise=(0.9, 0.1)))
    found = []
    for share in (0.0, 0.5, 1.0, 2.0):
        made.update(share)
        spread = algorithm(made).get_policy().distribution.log_std_param.exp()  # pyright: ignore
        found.append((algorithm(made).optimizer.param_groups[0]["lr"], float(spread[0])))
    assert found[0] == (pytest.approx(1e-3), pytest.approx(0.9))
    # Half way down a geometric fall: sqrt(1e-3 x 1e-5) and sqrt(0.9 x 0.1).
    assert found[1] == (pytest.approx(1e-4), pytest.approx(0.3))
    assert found[2] == found[3] == (pytest.approx(1e-5), pytest.approx(0.1))


def test_a_policy_can_be_begun_from_another_ones_weights():
    one, other = learner(seed=1), learner(seed=2)
    one.load_weights(other.weights())
    assert same(one.weights(), other.weights())


def test_a_checkpoint_has_weights_for_pictures_from_0_to_1():
    made = learner()
    learnt = from_learner(algorithm(made).get_policy().state_dict())
    kept = made.weights()
    assert np.array_equal(kept[FIRST], CONTRAST * learnt[FIRST])
    assert same({**kept, FIRST: learnt[FIRST]}, learnt)


def test_a_state_of_pictures_from_0_to_1_is_rescaled(tmp_path):
    one, other, path = learner(save_every=1), learner(save_every=1), tmp_path / "state.pt"
    one.update(0.0)
    one.save(path, {})
    state = torch.load(path, weights_only=True)
    del state["contrast"]  # as an older version wrote it
    names = [name for name, _ in algorithm(one).get_policy().named_parameters()]
    moments = state["optimizer_state_dict"]["state"][names.index(FIRST)]
    for weights in (state["actor_state_dict"], state["average"]):
        weights[FIRST] *= CONTRAST
    moments["exp_avg"] /= CONTRAST
    moments["exp_avg_sq"] /= CONTRAST**2
    torch.save(state, path)
    other.restore(path)
    one.restart_rows()
    for made in (one, other):
        torch.manual_seed(3)
        made.update(0.5)
    assert same(everything(one), everything(other))
    assert same(one.weights(), other.weights())


def test_a_state_of_pictures_from_0_to_1_may_be_of_a_policy_that_has_not_begun(tmp_path):
    one, other, path = learner(), learner(), tmp_path / "state.pt"
    one.save(path, {})  # as while a teacher learns
    state = torch.load(path, weights_only=True)
    del state["contrast"]
    for weights in (state["actor_state_dict"], state["average"]):
        weights[FIRST] *= CONTRAST
    torch.save(state, path)
    other.restore(path)
    assert same(one.weights(), other.weights())
    other.update(0.0)


def test_weights_of_another_shape_are_refused():
    with pytest.raises(PolicyError, match="other layers, sensors or actions"):
        learner().load_weights(learner(sensors=SensorConfig(lidar=LIDAR)).weights())


def test_a_state_of_other_layers_is_refused_and_says_so(tmp_path):
    made = learner()
    made.update(0.0)
    made.save(tmp_path / "state.pt", {})
    with pytest.raises(PolicyError, match="settings it was started with"):
        learner(sensors=SensorConfig(lidar=LIDAR)).restore(tmp_path / "state.pt")


@pytest.mark.parametrize("content", [b"", b"no state", None], ids=["empty", "foreign", "missing"])
def test_a_file_that_is_no_state_is_refused(tmp_path, content):
    path = tmp_path / "state.pt"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PolicyError, match="cannot be resumed"):
        learner().restore(path)


@pytest.mark.parametrize("who", ["torch", "the disk"])
def test_a_full_disk_leaves_the_old_state_as_it_was(tmp_path, monkeypatch, who):
    path, made = tmp_path / "state.pt", learner()
    made.save(path, {"spent_s": 1.0})
    before = path.read_bytes()

    def refuses(*given: object) -> None:
        if who == "torch":
            raise RuntimeError("[enforce fail at inline_container.cc] . unexpected pos 64 vs 0")
        raise OSError(errno.ENOSPC, "No space left on device")

    if who == "torch":
        monkeypatch.setattr(torch, "save", refuses)
    else:
        monkeypatch.setattr(Path, "write_bytes", refuses)
    with pytest.raises(PolicyError, match=r"state cannot be written to .*state\.pt \(.* has room"):
        made.save(path, {"spent_s": 2.0})
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


class Card:
    """A card's generator, where there is no card; what else would lie there lies on the CPU."""

    def __init__(self, monkeypatch) -> None:
        self.state = torch.arange(16, dtype=torch.uint8)
        monkeypatch.setattr(torch.cuda, "get_rng_state", lambda device: self.state.clone())
        monkeypatch.setattr(torch.cuda, "set_rng_state", self._set)

    def _set(self, state: torch.Tensor, device: str) -> None:
        assert (device, state.device.type) == ("cuda", "cpu")
        if state.shape != self.state.shape:
            raise RuntimeError("RNG state is wrong size")
        self.state = state

    def learner(self) -> Learner:
        made = learner()
        made.cfg = dataclasses.replace(made.cfg, device="cuda")
        return made


def test_on_a_card_its_generator_is_kept_too(tmp_path, monkeypatch):
    card = Card(monkeypatch)
    card.learner().save(tmp_path / "state.pt", {})
    kept, card.state = card.state, torch.zeros_like(card.state)
    card.learner().restore(tmp_path / "state.pt")
    assert torch.equal(card.state, kept)


@pytest.mark.parametrize("wrong", [torch.zeros(3, dtype=torch.uint8), "none"])
def test_what_is_no_generator_of_a_card_is_refused(tmp_path, monkeypatch, wrong):
    card, path = Card(monkeypatch), tmp_path / "state.pt"
    card.learner().save(path, {})
    torch.save({**torch.load(path), "card_generator": wrong}, path)
    with pytest.raises(PolicyError, match="cannot be resumed"):
        card.learner().restore(path)


def test_a_state_from_before_cards_were_kept_can_be_gone_on_from(tmp_path, monkeypatch):
    learner().save(tmp_path / "state.pt", {"spent_s": 1.0})  # as a CPU's, it has none
    card = Card(monkeypatch)
    before = card.state
    assert card.learner().restore(tmp_path / "state.pt") == {"spent_s": 1.0}
    assert card.state is before


def test_on_a_card_convolutions_learn_the_same_each_time_and_in_full_precision(monkeypatch):
    cudnn = torch.backends.cudnn
    monkeypatch.setattr(cudnn, "deterministic", False)
    monkeypatch.setattr(cudnn, "allow_tf32", True)
    learner()
    assert (cudnn.deterministic, cudnn.allow_tf32) == (False, True)
    monkeypatch.setattr(Learner, "_on_gpu", property(lambda _: True))
    learner()
    assert (cudnn.deterministic, cudnn.allow_tf32) == (True, False)


def test_an_update_tells_what_charts_of_rsl_rl_show():
    made = learner(settings().with_ppo(learning_rate=(1e-3, 1e-5), noise=(0.9, 0.1)))
    row = made.update(0.5)
    # Half way down a geometric fall: sqrt(1e-3 x 1e-5) and sqrt(0.9 x 0.1).
    assert row.learning_rate == pytest.approx(1e-4)
    assert row.mean_std == pytest.approx(0.3)
    assert row.episode_steps == made._episodes.steps


def test_an_update_tells_completion_in_percent():
    made = learner()
    assert made.update(0.0).completion is None
    rows = made.env.num_envs
    made._episodes.add(torch.full((rows,), 5.0), torch.ones(rows), torch.full((rows,), 0.3))
    row = made.update(0.0)
    assert made._episodes.completion is not None
    assert row.completion == 100.0 * made._episodes.completion > 20.0
    assert row.earned == made._episodes.earned is not None


def test_chances_of_choices_tell_their_spread():
    row = learner(space=CHOICES).update(0.0)
    # Four choices of nearly equal chance: sqrt(1/4 x 3/4) = 0.433.
    assert row.mean_std == pytest.approx(0.433, abs=0.03)


def test_an_update_tells_what_it_brought():
    made = learner(num_worlds=6)
    row = made.update(0.0)
    assert (row.number, row.samples) == (1, 48)  # 6 worlds x 8 steps
    assert {"value", "surrogate", "entropy"} <= row.losses.keys()
    assert "/drive/speed" in row.log
    paid = sum(value for name, value in row.log.items() if name.startswith("/reward/"))
    assert row.reward == pytest.approx(paid, abs=1e-5)


def test_weights_taken_out_are_copies():
    made = learner()
    kept = made.weights()
    before = {name: weight.copy() for name, weight in kept.items()}
    made.update(0.0)
    assert same(kept, before)
