"""A checkpoint as ONNX, for a physical car or any other runtime: bytes in, degrees and m/s out."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from league.agents.checkpoint import Card, Checkpoint
from league.agents.network import NORMALISER_EPS
from league.atomic_file import replacing
from league.envs.actions import ContinuousActions
from league.envs.observations import MOTION_FIELDS, MOTION_SCALE
from league.errors import PolicyError
from league.sim.config import FRAME_STEPS, CameraConfig, SimConfig

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto

OPSET = 20  # the first that knows every activation
IR_VERSION = 9  # the format that goes with that opset, for runtimes since 2024

LUMA = "0.299 R + 0.587 G + 0.114 B (Rec. 601)"
"""How a camera's colours become the gray of its pictures, as league/sim/camera does it."""

_ACTIVATIONS: dict[str, tuple[str, dict[str, float]]] = {
    "elu": ("Elu", {"alpha": 1.0}),
    "selu": ("Selu", {}),
    "relu": ("Relu", {}),
    "lrelu": ("LeakyRelu", {"alpha": 0.01}),
    "tanh": ("Tanh", {}),
    "gelu": ("Gelu", {}),
    "mish": ("Mish", {}),
}


def to_onnx(checkpoint: Checkpoint, path: str | os.PathLike[str]) -> None:
    """Write the actor as an ONNX file.

    Inputs are named as the groups, with any number of rows: `stereo` uint8 as cameras deliver it,
    `lidar` and `motion` float32. Output `actions`, float32 (rows, 2): steering [deg], positive to
    the left, and speed [m/s]. Output `outputs`: the network's means or scores. The
    metadata are `card`, `digest`, `units`, `rate_hz`, and `inputs`, which says what to feed.

    The graph is built node by node: torch's exporters are slow, and one of them is deprecated.

    Raises:
        PolicyError: the file cannot be written, or the onnx package is missing.
    """
    try:
        model = _model(checkpoint)
    except ModuleNotFoundError as error:
        raise PolicyError(
            f"ONNX files cannot be written without the package {error.name}: pip install onnx"
        ) from error
    with replacing(path, "the ONNX file", PolicyError) as file:
        file.write_bytes(model.SerializeToString())


def _model(checkpoint: Checkpoint) -> ModelProto:
    from onnx import TensorProto, checker, helper

    card = checkpoint.card
    graph = _Graph(checkpoint)
    graph.actions(graph.actor())

    def port(name: str, *shape: int) -> Any:  # noqa: ANN401
        kind = TensorProto.UINT8 if len(shape) == 3 else TensorProto.FLOAT
        return helper.make_tensor_value_info(name, kind, ["rows", *shape])

    inputs = [port(name, *shape) for name, shape in card.group_shapes.items()]
    answers = [port("actions", 2), port("outputs", card.action_space.size)]
    made = helper.make_graph(graph.nodes, "actor", inputs, answers, graph.constants)
    model = helper.make_model(
        made,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="racing-league",
        doc_string=f"{card.name}: sensors of a 1/18-scale car to steering [deg] and speed [m/s]",
    )
    units = {"actions": "steering [deg], positive to the left; speed [m/s]"}
    about = {
        "card": checkpoint.text,
        "digest": checkpoint.digest,
        "units": json.dumps(units),
        "rate_hz": str(SimConfig().step_hz),
        "inputs": json.dumps(input_notes(card)),
    }
    helper.set_model_props(model, about)
    checker.check_model(model, full_check=True)
    return model


def input_notes(card: Card) -> dict[str, dict[str, Any]]:
    """Return type, shape, range and preparation of each input, for JSON."""
    notes: dict[str, dict[str, Any]] = {}
    for name, shape in card.group_shapes.items():
        dtype = "uint8" if len(shape) == 3 else "float32"
        notes[name] = {"dtype": dtype, "shape": ["rows", *shape]}
    camera, lidar = card.sensors.camera, card.sensors.lidar
    if camera is not None:
        notes["stereo"] |= _picture_notes(camera, card.sensors.frames)
    if lidar is not None:
        ranges = lidar.form == "ranges"
        notes["lidar"] |= {
            "range": [lidar.min_range, lidar.max_range] if ranges else [0, 1],
            "unit": "m" if ranges else "1",
            "form": lidar.form,
            "rate_hz": lidar.rate_hz,
        }
    notes["motion"] |= {
        "range": [-1, 1],  # beyond it only when a car is hit
        "told": "(value - offset) / scale",
        "fields": _motion_notes(),
    }
    if card.sensors.history:
        read = [name for name in ("motion", "lidar") if name in notes]
        notes["history"] |= {
            "range": [-1, max(notes[name]["range"][1] for name in read)],
            "readings": card.sensors.history,
            "each": read,
            "order": "of the last control steps, newest first; at first what is read now",
        }
    return notes


def _picture_notes(camera: CameraConfig, frames: int) -> dict[str, Any]:
    eyes = ("left", "right") if camera.eyes == "stereo" else (camera.eyes,)
    colours = ("red", "green", "blue") if camera.colour else ("gray",)
    ages = ("", *(f", {FRAME_STEPS * frame} steps before" for frame in range(1, frames)))
    return {
        "range": [0, 255],
        "channels": [f"{eye} {colour}{age}" for age in ages for eye in eyes for colour in colours],
        **({} if camera.colour else {"gray": LUMA}),
        "first_row": "top",
        "field_of_view_deg": round(math.degrees(camera.field_of_view), 2),
        "pitch_down_deg": round(math.degrees(camera.pitch), 2),
        "above_ground_m": camera.up,
        "ahead_of_base_m": camera.forward,
        "baseline_m": camera.baseline if camera.eyes == "stereo" else 0.0,
        "rate_hz": camera.rate_hz,
    }


def _motion_notes() -> list[dict[str, Any]]:
    """Return the parts of `motion`; the last two are the actions of the step before."""
    car = SimConfig().car
    widest = round(math.degrees(car.max_steering), 6)
    middle, half = (car.max_speed + car.min_speed) / 2, (car.max_speed - car.min_speed) / 2
    speed, yaw_rate, steering = MOTION_SCALE
    parts = (
        (0.0, speed, "m/s", "own speed, ahead"),
        (0.0, yaw_rate, "rad/s", "own yaw rate, counter-clockwise"),
        (0.0, round(math.degrees(steering), 3), "deg", "angle of the front wheels, to the left"),
        (0.0, widest, "deg", "actions[0] of the step before; 0 at first"),
        (middle, half, "m/s", "actions[1] of the step before; -1 at first"),
    )
    return [
        {"name": name, "offset": offset, "scale": scale, "unit": unit, "what": what}
        for name, (offset, scale, unit, what) in zip(MOTION_FIELDS, parts, strict=True)
    ]


class _Graph:
    def __init__(self, checkpoint: Checkpoint) -> None:
        self.nodes: list[NodeProto] = []
        self.constants: list[Any] = []
        self._card, self._weights = checkpoint.card, checkpoint.weights
        for name, weight in self._weights.items():
            if not name.startswith("obs_normalizer"):
                self.constant(name, weight)

    def constant(self, name: str, value: np.ndarray) -> str:
        from onnx import numpy_helper

        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def add(self, kind: str, inputs: Sequence[str], name: str, **settings: Any) -> str:  # noqa: ANN401
        from onnx import helper

        self.nodes.append(helper.make_node(kind, list(inputs), [name], name=name, **settings))
        return name

    def activate(self, values: str, name: str) -> str:
        if self._card.network.activation == "swish":
            return self.add("Mul", [values, self.add("Sigmoid", [values], f"{name}.gate")], name)
        kind, settings = _ACTIVATIONS[self._card.network.activation]
        return self.add(kind, [values], name, **settings)

    def actor(self) -> str:
        """Add the network; return the name of its outputs."""
        shapes = self._card.group_shapes
        flat = [name for name, shape in shapes.items() if len(shape) == 1]
        parts = [self.normalised(self.add("Concat", flat, "flat", axis=1))]
        parts += [self.picture(name) for name, shape in shapes.items() if len(shape) == 3]
        layer_input = self.add("Concat", parts, "latent", axis=1)
        last = 2 * len(self._card.network.hidden)
        for layer in range(0, last + 1, 2):
            name = "outputs" if layer == last else f"mlp.{layer}"
            weights = [f"mlp.{layer}.weight", f"mlp.{layer}.bias"]
            layer_input = self.add("Gemm", [layer_input, *weights], name, transB=1)
            if layer < last:
                layer_input = self.activate(layer_input, f"mlp.{layer + 1}")
        return layer_input

    def normalised(self, flat: str) -> str:
        mean = self._weights.get("obs_normalizer._mean")
        if mean is None:
            return flat
        spread = self._weights["obs_normalizer._std"] + NORMALISER_EPS
        shifted = self.add("Sub", [flat, self.constant("mean", mean)], "flat.shifted")
        return self.add("Div", [shifted, self.constant("spread", spread)], "flat.scaled")

    def picture(self, group: str) -> str:
        from onnx import TensorProto

        image = self.add("Cast", [group], f"{group}.float", to=TensorProto.FLOAT)
        white = self.constant(f"{group}.white", np.array([255.0], np.float32))
        image = self.add("Div", [image, white], f"{group}.scaled")
        for layer, stride in enumerate(self._card.network.strides):
            name = f"cnns.{group}.{2 * layer}"
            weights = [f"{name}.weight", f"{name}.bias"]
            image = self.add("Conv", [image, *weights], name, strides=[stride, stride])
            image = self.activate(image, f"cnns.{group}.{2 * layer + 1}")
        return self.add("Flatten", [image], f"{group}.latent", axis=1)

    def actions(self, outputs: str) -> None:
        """Add the conversion of outputs to steering [deg] and speed [m/s]."""
        space = self._card.action_space
        if not isinstance(space, ContinuousActions):
            chosen = self.add("ArgMax", [outputs], "chosen", axis=1, keepdims=0)
            table = self.constant("choices", np.asarray(space.choices, np.float32))
            self.add("Gather", [table, chosen], "actions", axis=0)
            return
        low = np.array([space.steering_low, space.speed_low], np.float32)
        high = np.array([space.steering_high, space.speed_high], np.float32)
        least, most = np.array(-1.0, np.float32), np.array(1.0, np.float32)
        limits = [self.constant("least", least), self.constant("most", most)]
        clipped = self.add("Clip", [outputs, *limits], "clipped")
        # low + (clipped + 1) / 2 * (high - low)
        share = self.add("Add", [clipped, limits[1]], "share")
        half = self.constant("half_range", (high - low) / np.float32(2))
        scaled = self.add("Mul", [share, half], "scaled")
        self.add("Add", [scaled, self.constant("low", low)], "actions")
