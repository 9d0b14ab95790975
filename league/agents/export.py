"""A checkpoint as ONNX, for a physical car or any other runtime: bytes in, degrees and m/s out."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from league.agents.card import Card
from league.agents.checkpoint import Checkpoint
from league.agents.network import NORMALISER_EPS
from league.envs.action_space import ContinuousActions
from league.errors import PolicyError
from league.whole_file import replacing

if TYPE_CHECKING:
    from onnx import ModelProto, NodeProto

OPSET = 20
"""The first that knows every activation."""
IR_VERSION = 9
"""The format that goes with that opset, for runtimes since 2024."""

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
    the left, and speed [m/s]. Output `outputs`: what the network answers, means or scores. The
    card is the metadata `card`, as JSON.

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
    graph = _Graph()
    for name, weight in checkpoint.weights.items():
        if not name.startswith("obs_normalizer"):
            graph.constant(name, weight.numpy())
    outputs = graph.actor(card, checkpoint)
    graph.actions(card, outputs)
    inputs = [
        helper.make_tensor_value_info(
            name, TensorProto.UINT8 if len(shape) == 3 else TensorProto.FLOAT, ["rows", *shape]
        )
        for name, shape in card.group_shapes.items()
    ]
    answers = [
        helper.make_tensor_value_info("actions", TensorProto.FLOAT, ["rows", 2]),
        helper.make_tensor_value_info("outputs", TensorProto.FLOAT, ["rows", card.space.size]),
    ]
    made = helper.make_graph(graph.nodes, "actor", inputs, answers, graph.constants)
    model = helper.make_model(
        made,
        opset_imports=[helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="racing-league",
        doc_string=f"{card.name}: sensors of a 1/18-scale car to steering [deg] and speed [m/s]",
    )
    units = {"actions": "steering [deg], positive to the left; speed [m/s]"}
    about = {"card": checkpoint.text, "digest": checkpoint.digest, "units": json.dumps(units)}
    helper.set_model_props(model, about)
    checker.check_model(model, full_check=True)
    return model


class _Graph:
    """Nodes and constants under construction."""

    def __init__(self) -> None:
        self.nodes: list[NodeProto] = []
        self.constants: list = []

    def constant(self, name: str, value: np.ndarray) -> str:
        from onnx import numpy_helper

        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def add(self, kind: str, inputs: Sequence[str], name: str, **settings: Any) -> str:  # noqa: ANN401
        from onnx import helper

        self.nodes.append(helper.make_node(kind, list(inputs), [name], name=name, **settings))
        return name

    def activate(self, card: Card, given: str, name: str) -> str:
        if card.network.activation == "swish":
            return self.add("Mul", [given, self.add("Sigmoid", [given], f"{name}.gate")], name)
        kind, settings = _ACTIVATIONS[card.network.activation]
        return self.add(kind, [given], name, **settings)

    def actor(self, card: Card, checkpoint: Checkpoint) -> str:
        """Add the network; return the name of what it answers."""
        shapes = card.group_shapes
        flat = [name for name, shape in shapes.items() if len(shape) == 1]
        parts = [self.normalised(self.add("Concat", flat, "flat", axis=1), checkpoint)]
        parts += [self.picture(card, name) for name, shape in shapes.items() if len(shape) == 3]
        told = self.add("Concat", parts, "latent", axis=1)
        last = 2 * len(card.network.hidden)
        for layer in range(0, last + 1, 2):
            name = "outputs" if layer == last else f"mlp.{layer}"
            weights = [f"mlp.{layer}.weight", f"mlp.{layer}.bias"]
            told = self.add("Gemm", [told, *weights], name, transB=1)
            if layer < last:
                told = self.activate(card, told, f"mlp.{layer + 1}")
        return told

    def normalised(self, flat: str, checkpoint: Checkpoint) -> str:
        mean = checkpoint.weights.get("obs_normalizer._mean")
        if mean is None:
            return flat
        spread = checkpoint.weights["obs_normalizer._std"] + NORMALISER_EPS
        shifted = self.add("Sub", [flat, self.constant("mean", mean.numpy())], "flat.shifted")
        return self.add("Div", [shifted, self.constant("spread", spread.numpy())], "flat.scaled")

    def picture(self, card: Card, group: str) -> str:
        from onnx import TensorProto

        told = self.add("Cast", [group], f"{group}.float", to=TensorProto.FLOAT)
        white = self.constant(f"{group}.white", np.array([255.0], np.float32))
        told = self.add("Div", [told, white], f"{group}.scaled")
        for layer, stride in enumerate(card.network.strides):
            name = f"cnns.{group}.{2 * layer}"
            weights = [f"{name}.weight", f"{name}.bias"]
            told = self.add("Conv", [told, *weights], name, strides=[stride, stride])
            told = self.activate(card, told, f"cnns.{group}.{2 * layer + 1}")
        return self.add("Flatten", [told], f"{group}.latent", axis=1)

    def actions(self, card: Card, outputs: str) -> None:
        """Add what turns the answer into steering [deg] and speed [m/s]."""
        space = card.space
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
