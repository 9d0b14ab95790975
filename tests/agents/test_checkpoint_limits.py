"""The limits of a stranger's checkpoint: what lies on them is read, what lies beyond is refused."""

from __future__ import annotations

import io
import json
import math
import pickle
import re
import zipfile

import pytest
import torch
from pydantic import ValidationError

from league.agents import checkpoint, torch_archive
from league.agents.checkpoint import Card
from league.agents.torch_archive import Archive, RefusedError, Tensor
from league.errors import PolicyError
from league.sim.config import CameraConfig, LidarConfig, SensorConfig
from tests.agents.trained import make_checkpoint


def camera(**changes: float) -> SensorConfig:
    return SensorConfig(camera=CameraConfig(**changes))


def lidar(**changes: float) -> SensorConfig:
    return SensorConfig(lidar=LidarConfig(**changes))


def packed(card: str) -> bytes:
    """Return the file of a checkpoint without sensors, with this text as its card."""
    made = make_checkpoint("blind")
    weights = {name: torch.from_numpy(weight) for name, weight in made.weights.items()}
    buffer = io.BytesIO()
    torch.save({"card": card, "weights": weights}, buffer)
    return buffer.getvalue()


def carded(**changes: object) -> bytes:
    return packed(json.dumps({**json.loads(make_checkpoint("blind").text), **changes}))


def refusal(tmp_path, content: bytes) -> str:
    """Return why a file with this content is refused."""
    (tmp_path / "a.pt").write_bytes(content)
    with pytest.raises(PolicyError) as error:
        checkpoint.load(tmp_path / "a.pt")
    return str(error.value)


@pytest.mark.parametrize(
    ("allowed", "refused"),
    [
        (camera(width=640, height=480), camera(width=640, height=481)),
        (camera(forward=-0.2), camera(forward=-0.201)),
        (camera(up=0.3), camera(up=0.301)),
        (camera(baseline=0.2), camera(baseline=0.201)),
        (camera(pitch=math.pi / 2), None),
        (lidar(forward=0.2), lidar(forward=0.201)),
        (lidar(up=0.3), lidar(up=0.301)),
        (lidar(max_range=100.0), lidar(max_range=100.1)),
        (lidar(clip=100.0), lidar(clip=100.1)),
        (lidar(noise=1.0), lidar(noise=1.01)),
        (lidar(sectors=256), lidar(sectors=257)),
        (lidar(bins=64), lidar(bins=65)),
        (lidar(sectors=1, bins=1), None),
    ],
)
def test_sensors_are_those_that_a_car_can_carry(allowed, refused):
    assert Card(name="a", sensors=allowed).sensors == allowed
    if refused is not None:
        with pytest.raises(ValidationError):
            Card(name="a", sensors=refused)


def test_a_file_may_have_16_mib_and_no_more(tmp_path):
    assert checkpoint.MAX_SIZE_CAMERA == 16 * 1024**2 == 2 * checkpoint.MAX_SIZE
    assert "it is no checkpoint" in refusal(tmp_path, bytes(16 * 1024**2))
    assert "it is larger than 16777216 bytes" in refusal(tmp_path, bytes(16 * 1024**2 + 1))


def test_a_card_may_have_64_kib_and_no_more(tmp_path):
    text = make_checkpoint("blind").text
    (tmp_path / "a.pt").write_bytes(packed(text.ljust(64 * 1024)))
    assert checkpoint.load(tmp_path / "a.pt").text == text
    assert "card is longer than 65536 bytes" in refusal(tmp_path, packed(text.ljust(64 * 1024 + 1)))


def test_a_head_may_have_1_mib_and_no_more():
    def saved(length: int) -> bytes:
        buffer = io.BytesIO()
        torch.save({"text": "x" * length}, buffer)
        return buffer.getvalue()

    most = 1024**2 - len(pickle.dumps({"text": ""}, protocol=2))
    assert torch_archive.read(saved(most)).content == {"text": "x" * most}
    with pytest.raises(RefusedError, match="its head takes 1048577 bytes, at most 1048576"):
        torch_archive.read(saved(most + 1))


def test_one_member_is_enough_and_texts_may_lie_in_several_dicts():
    content = {"a": {"b": {"c": "d"}}, "e": {}}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr("a/data.pkl", pickle.dumps(content, protocol=2))
    assert torch_archive.read(buffer.getvalue()).content == content


def test_what_is_too_short_for_an_archive_is_something_else():
    for length in (0, 21):
        with pytest.raises(RefusedError, match="it is no checkpoint, but something else"):
            torch_archive.read(b"PK\x03\x04".ljust(21)[:length])


def test_a_weight_with_too_few_bytes_is_refused_with_both_numbers():
    archive = Archive({}, {"data/0": memoryview(b"four")})
    with pytest.raises(RefusedError, match="the weight 'w' has 4 bytes, its shape 8"):
        archive.numbers("w", Tensor("0", 2, 0, (2,), (1,)))


def test_a_card_is_typed_strictly(tmp_path):
    assert "steps is '5'" in refusal(tmp_path, carded(steps="5"))
    assert "train_s is '1'" in refusal(tmp_path, carded(train_s="1"))


def test_counts_of_a_card_are_not_negative(tmp_path):
    (tmp_path / "a.pt").write_bytes(carded(steps=0, seed=0))
    assert checkpoint.load(tmp_path / "a.pt").card.steps == 0
    assert "steps is -1" in refusal(tmp_path, carded(steps=-1))
    assert "seed is -1" in refusal(tmp_path, carded(seed=-1))


def test_long_values_and_keys_are_cut_in_the_message(tmp_path):
    said = refusal(tmp_path, carded(licence="\u00e9" * 500))
    value = re.search(r"licence is (.*?): String", said)
    assert value is not None and len(value[1]) == 80 and value[1].endswith("...")
    assert f"its card is wrong: '{'y' * 5} {'y' * 14}' is" in refusal(
        tmp_path, carded(**{f"{'y' * 5} {'y' * 50}": 1})
    )
    assert f"its card is wrong: {'z' * 40} is" in refusal(tmp_path, carded(**{"z" * 40: 1}))


def test_a_long_path_is_cut_in_the_message():
    for length, shown in (
        (198, f"'{'x' * 198}'"),
        (199, f"'{'x' * 59}...{'x' * 136}'"),
    ):
        with pytest.raises(PolicyError) as error:
            checkpoint.load("x" * length)
        assert str(error.value).startswith(f"{shown} is refused: it cannot be read (No such file")


def test_strangers_control_characters_are_spelled_out():
    assert str(RefusedError("a\x1b[1m\u00e9")) == r"a\x1b[1m\xe9"
    assert str(RefusedError("x" * 300)) == "x" * 300
    assert str(RefusedError("x" * 301)) == "x" * 297 + "..."
