"""The ONNX file answers what the policy answers, in degrees and metres per second."""

import json
import math
from typing import get_args

import numpy as np
import onnx
import onnxruntime
import pytest

from league.agents.checkpoint import Card
from league.agents.export import input_notes, to_onnx
from league.agents.network import Activation, NetworkConfig
from league.agents.policy import Policy
from league.envs.actions import ContinuousActions, grid
from league.envs.observations import MOTION_FIELDS
from league.errors import PolicyError
from league.sim.camera.scene import LUMA
from league.sim.config import CameraConfig, CarConfig, LidarConfig, SensorConfig
from tests.agents.trained import SENSES, make_card, make_checkpoint, readings


def answers(path, groups) -> list[np.ndarray]:
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return session.run(["actions", "outputs"], groups)


def check(trained, path) -> None:
    to_onnx(trained, path)
    for rows in (1, 7):
        groups = readings(trained.card, rows)
        actions, outputs = answers(path, groups)
        expected = Policy(trained, CarConfig()).outputs(groups)
        np.testing.assert_allclose(outputs, expected, rtol=0, atol=1e-5)
        asked = np.stack(trained.card.action_space.controls(expected), axis=1)
        np.testing.assert_allclose(actions, asked, rtol=0, atol=1e-4)


@pytest.mark.parametrize("senses", SENSES)
@pytest.mark.parametrize("space", [ContinuousActions(-20, 25, 0.5, 3), grid(5, 30, 2, 3)])
def test_onnxruntime_answers_what_the_policy_answers(tmp_path, senses, space):
    check(make_checkpoint(senses, action_space=space), tmp_path / "a.onnx")


@pytest.mark.parametrize("activation", get_args(Activation))
def test_every_activation_is_exported(tmp_path, activation):
    network = NetworkConfig(hidden=(32, 16), activation=activation)
    check(make_checkpoint("stereo", network=network), tmp_path / "a.onnx")


def test_an_answer_beyond_the_range_is_cut_off(tmp_path):
    trained = make_checkpoint("blind", action_space=ContinuousActions(-20, 20, 1, 3))
    trained.weights["mlp.2.weight"][:] = 0.0
    trained.weights["mlp.2.bias"][:] = -7.0, 0.5
    to_onnx(trained, tmp_path / "a.onnx")
    actions, outputs = answers(tmp_path / "a.onnx", readings(trained.card, 1))
    assert outputs.tolist() == [[-7.0, 0.5]]
    assert actions.tolist() == [[-20.0, 2.5]]  # 1 + 1.5 / 2 * (3 - 1)


def test_inputs_are_what_sensors_deliver_and_the_card_goes_with_them(tmp_path):
    trained = make_checkpoint("all")
    to_onnx(trained, tmp_path / "a.onnx")
    model = onnx.load(str(tmp_path / "a.onnx"))
    kinds = {one.name: one.type.tensor_type.elem_type for one in model.graph.input}
    float32, uint8 = onnx.TensorProto.FLOAT, onnx.TensorProto.UINT8
    assert kinds == {"stereo": uint8, "lidar": float32, "motion": float32}
    about = {one.key: one.value for one in model.metadata_props}
    assert Card.model_validate_json(about["card"]) == trained.card
    assert about["digest"] == trained.digest
    assert "deg" in json.loads(about["units"])["actions"]


def notes_of(path) -> dict:
    about = {one.key: one.value for one in onnx.load(str(path)).metadata_props}
    assert about["rate_hz"] == "15"
    return json.loads(about["inputs"])


@pytest.mark.parametrize("senses", SENSES)
def test_the_metadata_tell_name_type_shape_and_range_of_each_input(tmp_path, senses):
    trained = make_checkpoint(senses)
    to_onnx(trained, tmp_path / "a.onnx")
    session = onnxruntime.InferenceSession(
        str(tmp_path / "a.onnx"), providers=["CPUExecutionProvider"]
    )
    notes = notes_of(tmp_path / "a.onnx")
    kinds = {"uint8": "tensor(uint8)", "float32": "tensor(float)"}
    asked = {one.name: (one.type, one.shape) for one in session.get_inputs()}
    assert {name: (kinds[one["dtype"]], one["shape"]) for name, one in notes.items()} == asked
    assert all(one["range"][0] < one["range"][1] for one in notes.values())
    if "stereo" in notes:
        earlier = ["left gray, 3 steps before", "right gray, 3 steps before"]
        kept = earlier if senses == "remembering" else []
        assert notes["stereo"]["channels"] == ["left gray", "right gray", *kept]
        assert all(str(share) in notes["stereo"]["gray"] for share in LUMA)
        assert notes["stereo"]["field_of_view_deg"] == 64.74


def test_a_memory_is_described_in_the_metadata():
    notes = input_notes(make_card("remembering"))
    history = notes["history"]
    assert (history["range"], history["readings"]) == ([-1, 12.0], 2)
    assert history["each"] == ["motion", "lidar"]
    assert history["shape"][1] == 2 * sum(notes[name]["shape"][1] for name in history["each"])


def test_colours_and_coarse_scans_are_described_in_the_metadata():
    camera = CameraConfig(width=48, height=36, colour=True, eyes="mono")
    card = make_card(sensors=SensorConfig(camera=camera, lidar=LidarConfig(form="sectors")))
    notes = input_notes(card)
    assert notes["stereo"]["channels"] == ["mono red", "mono green", "mono blue"]
    assert "gray" not in notes["stereo"]
    assert (notes["lidar"]["range"], notes["lidar"]["form"]) == ([0, 1], "sectors")


def test_the_scales_in_the_metadata_make_what_a_car_observes(race_env):
    # Who follows them on a car of his own tells the network what the simulator would tell it.
    fields = input_notes(make_card("blind"))["motion"]["fields"]
    assert [one["name"] for one in fields] == list(MOTION_FIELDS)
    env = race_env()
    assert env.reset(seed=1)[0]["motion"][0, 3:].tolist() == [0.0, -1.0]
    for _ in range(8):
        motion = (
            env.step(np.array([[[0.4, 0.1]]], np.float32)).observations[0]["motion"][0].tolist()
        )
    car = env.world.cars[0, 0]
    measured = [
        math.hypot(car["velocity_x"], car["velocity_y"]),
        float(car["yaw_rate"]),
        math.degrees(car["steering"]),
    ]
    answered = [0.4 * 30.0, 0.1 + (0.1 + 1) / 2 * (4.0 - 0.1)]  # [deg], [m/s]
    made = [
        (value - one["offset"]) / one["scale"]
        for value, one in zip(measured + answered, fields, strict=True)
    ]
    assert made[0] == pytest.approx(motion[0], rel=0.02)  # it slides a little to the side
    assert made[1:] == pytest.approx(motion[1:], abs=1e-5)
    assert min(made[:3]) > 0.1


def test_the_same_checkpoint_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        to_onnx(make_checkpoint(), tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_place_that_cannot_be_written_is_reported_in_one_sentence(tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(PolicyError, match="ONNX file cannot be written"):
        to_onnx(make_checkpoint("blind"), tmp_path / "file" / "a.onnx")
