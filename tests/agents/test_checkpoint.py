"""A checkpoint on disk: the same content, the same bytes, the same name; nothing lost."""

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
import torch

from league.agents import checkpoint
from league.agents.checkpoint import Checkpoint
from league.agents.network import NetworkConfig
from league.agents.policy import Policy
from league.envs.actions import grid
from league.errors import PolicyError
from league.sim.config import CameraConfig, CarConfig, SensorConfig
from tests.agents.trained import SENSES, make_card, make_checkpoint, readings


def tensors(made: Checkpoint) -> dict[str, torch.Tensor]:
    """Return the weights as torch would save them."""
    return {name: torch.from_numpy(weight) for name, weight in made.weights.items()}


@pytest.mark.parametrize("senses", SENSES)
def test_what_is_loaded_is_what_was_saved(tmp_path, senses):
    made = make_checkpoint(senses, action_space=grid(5, 30, 2, 3), tracks=("peanut",))
    checkpoint.save(tmp_path / "a.pt", made)
    again = checkpoint.load(tmp_path / "a.pt")
    assert again.card == made.card
    assert again.weights.keys() == made.weights.keys()
    assert all(np.array_equal(again.weights[name], made.weights[name]) for name in made.weights)
    groups = readings(made.card, 3)
    one, other = (Policy(each, CarConfig()).outputs(groups) for each in (made, again))
    assert np.array_equal(one, other)


def test_the_same_content_gives_the_same_bytes_and_digest(tmp_path):
    for name in ("a.pt", "another name.pt"):
        checkpoint.save(tmp_path / name, make_checkpoint())
    assert (tmp_path / "a.pt").read_bytes() == (tmp_path / "another name.pt").read_bytes()
    assert checkpoint.load(tmp_path / "a.pt").digest == make_checkpoint().digest
    checkpoint.save(tmp_path / "again.pt", checkpoint.load(tmp_path / "a.pt"))
    assert (tmp_path / "again.pt").read_bytes() == (tmp_path / "a.pt").read_bytes()


def test_any_change_of_content_changes_the_digest():
    found = {make_checkpoint().digest, make_checkpoint(seed=1).digest}
    found.add(make_checkpoint(name="other").digest)
    nudged = make_checkpoint()
    bias = nudged.weights["mlp.2.bias"]
    bias[0] = np.nextafter(bias[0], np.float32(2.0))
    found.add(nudged.digest)
    assert len(found) == 4


def test_the_digest_does_not_depend_on_how_the_file_was_packed(tmp_path):
    made = make_checkpoint()
    checkpoint.save(tmp_path / "a.pt", made)
    spaced = json.dumps(json.loads(made.text), indent=2)
    backwards = dict(reversed(list(tensors(made).items())))
    torch.save({"weights": backwards, "card": spaced}, tmp_path / "by_hand.pt")
    assert checkpoint.load(tmp_path / "by_hand.pt").digest == made.digest


def test_a_card_of_an_earlier_version_keeps_its_digest(tmp_path):
    # Fields added later get their defaults; the name of the entry is made of the text as it was.
    made = make_checkpoint()
    found = json.loads(made.text)
    del found["command"], found["sensors"]["camera"]["baseline"]
    text = json.dumps(found, sort_keys=True, separators=(",", ":"))
    torch.save({"card": text, "weights": tensors(made)}, tmp_path / "old.pt")
    again = checkpoint.load(tmp_path / "old.pt")
    assert again.card == made.card
    assert again.text == text
    assert again.digest != made.digest
    checkpoint.save(tmp_path / "kept.pt", again)
    assert checkpoint.load(tmp_path / "kept.pt").digest == again.digest


def test_torch_reads_it_too_and_the_card_is_plain_json(tmp_path):
    made = make_checkpoint()
    checkpoint.save(tmp_path / "a.pt", made)
    found = torch.load(tmp_path / "a.pt", weights_only=True)
    assert set(found) == {"card", "weights"}
    assert json.loads(found["card"])["name"] == "rookie"
    assert np.array_equal(found["weights"]["mlp.0.bias"].numpy(), made.weights["mlp.0.bias"])


def test_a_stock_zip_of_the_same_members_is_read(tmp_path):
    checkpoint.save(tmp_path / "a.pt", make_checkpoint())
    buffer = io.BytesIO()
    with zipfile.ZipFile(tmp_path / "a.pt") as old, zipfile.ZipFile(buffer, "w") as new:
        for name in old.namelist():
            new.writestr(name, old.read(name))
    (tmp_path / "b.pt").write_bytes(buffer.getvalue())
    assert checkpoint.load(tmp_path / "b.pt").digest == checkpoint.load(tmp_path / "a.pt").digest


def test_the_default_network_takes_at_most_two_megabytes(tmp_path):
    for width, height, limit in ((64, 48, 300_000), (160, 120, 2_000_000)):
        sensors = SensorConfig(camera=CameraConfig(width=width, height=height))
        made = make_checkpoint(sensors=sensors, network=NetworkConfig())
        checkpoint.save(tmp_path / "a.pt", made)
        assert (tmp_path / "a.pt").stat().st_size <= limit


def test_weights_that_share_memory_are_saved_apart(tmp_path):
    made = make_checkpoint("blind")
    numbers = np.arange(256, dtype=np.float32)
    weights = {**made.weights, "mlp.0.bias": numbers[:128], "mlp.2.bias": numbers[:2]}
    checkpoint.save(tmp_path / "a.pt", Checkpoint(made.card, weights))
    again = checkpoint.load(tmp_path / "a.pt")
    assert again.weights["mlp.2.bias"].tolist() == [0.0, 1.0]


@pytest.mark.parametrize(
    ("name", "value", "reason"),
    [
        ("mlp.0.bias", None, "lacks the weight 'mlp.0.bias'"),
        ("extra", np.zeros(1, np.float32), "has the weight 'extra'"),
        ("mlp.2.bias", np.zeros(3, np.float32), r"shape \(3,\), its card asks \(2,\)"),
        ("mlp.2.bias", np.array([0.0, np.nan], np.float32), "NaN"),
        ("mlp.2.bias", np.array([0.0, 1e5], np.float32), "beyond 10000"),
        ("mlp.2.bias", np.zeros(2), "not a contiguous float32"),
        ("mlp.2.bias", torch.zeros(2), "not a contiguous float32"),
        ("mlp.2.bias", np.zeros(4, np.float32)[::2], "not a contiguous float32"),
    ],
)
def test_weights_that_are_not_sound_make_no_checkpoint(name, value, reason):
    made = make_checkpoint("blind")
    weights = {**made.weights, name: value}
    if value is None:
        del weights[name]
    with pytest.raises(PolicyError, match=reason):
        Checkpoint(made.card, weights)


def test_a_failed_write_leaves_what_was_there(tmp_path, monkeypatch):
    checkpoint.save(tmp_path / "a.pt", make_checkpoint())
    before = (tmp_path / "a.pt").read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(PolicyError, match="No space left"):
        checkpoint.save(tmp_path / "a.pt", make_checkpoint(seed=1))
    assert (tmp_path / "a.pt").read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["a.pt"]


def test_a_card_that_asks_for_more_than_the_limits_makes_no_checkpoint():
    with pytest.raises(PolicyError, match=r"'rookie' is refused: the network has .* parameters"):
        Checkpoint(make_card(network=NetworkConfig(strides=(1, 1, 1), hidden=(1024,))), {})
