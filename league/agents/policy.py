"""A trained driver: its sensors' readings go through the network of a checkpoint.

The compiled forward pass gives the same bits on every machine. The innermost loops run over output
channels, each with a sum of its own, in a fixed order: they are vectorised without reordering any
sum, so a decision has the same bits alone and in a batch, and on processors with and without vector
units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from league.agents.network import NORMALISER_EPS, NetworkConfig, Shapes, convolutions
from league.envs.actions import to_actions
from league.errors import PolicyError
from league.jit import compiled, inner
from league.portable_math import exp, f32
from league.sim.config import CarConfig

if TYPE_CHECKING:
    from league.agents.checkpoint import Checkpoint

_ACTIVATIONS = ("elu", "selu", "relu", "lrelu", "tanh", "gelu", "swish", "mish")
(_ELU, _SELU, _RELU, _LRELU, _TANH, _GELU, _SWISH, _MISH) = range(8)
_NONE = -1
_CONVOLUTION, _LINEAR = 0, 1
LAYER = np.dtype(
    [
        ("kind", np.int64),  # convolution or fully connected
        ("first", np.int64),  # where its weights begin; the biases follow them
        ("activation", np.int64),
        ("inputs", np.int64),  # numbers, or channels of a picture
        ("outputs", np.int64),
        ("kernel", np.int64),  # side of the window [px]
        ("stride", np.int64),
        ("height", np.int64),  # of the picture that goes in [px]
        ("width", np.int64),
    ]
)
"""One layer of a network."""

_SELU_SCALE, _SELU_ALPHA = f32(1.0507009873554805), f32(1.6732632423543772)
_LEAK = f32(0.01)
_HALF_ROOT = f32(0.7071067811865476)
# erf by Abramowitz and Stegun, Handbook of Mathematical Functions, 7.1.26; within 1.5e-7.
_ERF_T = f32(0.3275911)
_ERF_1, _ERF_2, _ERF_3 = f32(0.254829592), f32(-0.284496736), f32(1.421413741)
_ERF_4, _ERF_5 = f32(-1.453152027), f32(1.061405429)
_LARGE = f32(20.0)
_ZERO, _HALF, _ONE, _TWO, _WHITE = f32(0.0), f32(0.5), f32(1.0), f32(2.0), f32(255.0)


@dataclass(frozen=True, eq=False)
class Network:
    """A network's layers and weights as tables; picture first, then fully connected."""

    layers: np.ndarray  # LAYER records, the convolutions first
    weights: np.ndarray  # of all layers, inputs by outputs, each followed by its biases, float32
    mean: np.ndarray  # of the flat groups, in the order of the network, float32 (num_flat,)
    deviation: np.ndarray  # of the same, never 0

    @classmethod
    def of(cls, cfg: NetworkConfig, shapes: Shapes, weights: Mapping[str, np.ndarray]) -> Network:
        """Put weights by the names of `network.weight_shapes` into tables; shapes are of a row."""
        activation = _ACTIVATIONS.index(cfg.activation)
        flat = sum(shape[0] for shape in shapes.values() if len(shape) == 1)
        layers: list[tuple[int, ...]] = []
        tables: list[np.ndarray] = []
        first = 0

        def add(kind: int, last: bool, table: np.ndarray, bias: np.ndarray, *sizes: int) -> None:
            nonlocal first
            layers.append((kind, first, _NONE if last else activation, *sizes))
            tables.extend((np.ascontiguousarray(table, np.float32).ravel(), bias))
            first += table.size + bias.size

        pixels = None
        for one in convolutions(cfg, shapes):
            # Window lines, columns, channels in, channels out: the order of the loops.
            table = weights[f"{one.name}.weight"].transpose(2, 3, 1, 0)
            sizes = (one.channels, one.made, one.kernel, one.stride, *one.size)
            add(_CONVOLUTION, False, table, weights[f"{one.name}.bias"], *sizes)
            pixels = (one.made, *one.out)
        sizes_out = [weights[f"mlp.{2 * k}.bias"].size for k in range(len(cfg.hidden) + 1)]
        for number, size in enumerate(sizes_out):
            table = weights[f"mlp.{2 * number}.weight"]
            if number == 0 and pixels is not None:
                # Pictures are kept with their channels last; the learner has them first.
                seen = table[:, flat:].reshape(size, *pixels).transpose(0, 2, 3, 1)
                table = np.concatenate([table[:, :flat], seen.reshape(size, -1)], axis=1)
            last, bias = number == len(sizes_out) - 1, weights[f"mlp.{2 * number}.bias"]
            add(_LINEAR, last, table.T, bias, table.shape[1], size, 0, 0, 0, 0)
        mean, deviation = np.zeros(flat, np.float32), np.ones(flat, np.float32)
        if "obs_normalizer._mean" in weights:
            mean = weights["obs_normalizer._mean"].reshape(-1).astype(np.float32)
            spread = weights["obs_normalizer._std"].reshape(-1).astype(np.float32)
            deviation = spread + f32(NORMALISER_EPS)
        return cls(np.array(layers, LAYER), _aligned(np.concatenate(tables)), mean, deviation)

    def outputs(self, flat: np.ndarray, pictures: np.ndarray) -> np.ndarray:
        """Return what the network answers, float32 (num_rows, num_outputs).

        Args:
            flat: the flat groups side by side, float32 (num_rows, num_flat).
            pictures: uint8 (num_rows, channels, height, width); without a camera (num_rows, 0, 0,
                0).
        """
        out = np.empty((len(flat), int(self.layers[-1]["outputs"])), np.float32)
        _decide(self.layers, self.weights, self.mean, self.deviation, flat, pictures, out)
        return out


def _aligned(numbers: np.ndarray) -> np.ndarray:
    """Return a copy that begins at a multiple of 64 bytes: loads of it take a tenth less time."""
    room = np.empty(numbers.nbytes + 64, np.uint8)
    first = -room.ctypes.data % 64
    copy = room[first : first + numbers.nbytes].view(numbers.dtype)
    copy[:] = numbers
    return copy


@compiled(allocates=True)
def _decide(layers, weights, mean, deviation, flat, pictures, out):
    most = 0
    for layer in layers:
        positions = _side(layer.height, layer) * _side(layer.width, layer)
        most = max(most, layer.outputs * max(positions, 1))
        most = max(most, layer.inputs * max(layer.height * layer.width, 1))
    now, after = np.empty(most, np.float32), np.empty(most, np.float32)
    num_flat, num_channels, height, width = flat.shape[1], *pictures.shape[1:]
    for row in range(len(flat)):
        for channel in range(num_channels):
            for y in range(height):
                for x in range(width):
                    value = f32(pictures[row, channel, y, x]) / _WHITE
                    now[(y * width + x) * num_channels + channel] = value
        size = num_channels * height * width
        joined = False
        for layer in layers:
            if layer.kind == _CONVOLUTION:
                size = _convolve(layer, weights, now, after)
            else:
                if not joined:
                    # Flat groups come first, then the picture.
                    for k in range(size - 1, -1, -1):
                        now[num_flat + k] = now[k]
                    for k in range(num_flat):
                        now[k] = (flat[row, k] - mean[k]) / deviation[k]
                    joined = True
                size = _connect(layer, weights, now, after)
            _activate(layer.activation, after, size)
            now, after = after, now
        for k in range(out.shape[1]):
            out[row, k] = now[k]


@inner
def _side(length, layer):
    """Return how many windows of a layer fit side by side."""
    return (length - layer.kernel) // layer.stride + 1 if layer.kernel else 0


@inner
def _convolve(layer, weights, picture, out):
    """Write a convolution of a picture, channels last; return how many numbers it makes."""
    kernel, stride, made = layer.kernel, layer.stride, layer.outputs
    line, run = layer.width * layer.inputs, kernel * layer.inputs
    lines, columns = _side(layer.height, layer), _side(layer.width, layer)
    taps = weights[layer.first : layer.first + kernel * run * made]
    bias = weights[layer.first + taps.size : layer.first + taps.size + made]
    for y in range(lines):
        for x in range(columns):
            sums = out[(y * columns + x) * made : (y * columns + x + 1) * made]
            for k in range(made):
                sums[k] = bias[k]
            for dy in range(kernel):
                start = (y * stride + dy) * line + x * stride * layer.inputs
                window = picture[start : start + run]
                rows = taps[dy * run * made : (dy + 1) * run * made]
                _add_all(window, rows, sums)
    return lines * columns * made


@inner
def _connect(layer, weights, values, out):
    """Write a fully connected layer of values; return how many numbers it makes."""
    made = layer.outputs
    bias_at = layer.first + layer.inputs * made
    sums = out[:made]
    for k in range(made):
        sums[k] = weights[bias_at + k]
    _add_all(values[: layer.inputs], weights[layer.first : bias_at], sums)
    return made


@inner
def _add_all(values, rows, sums):
    """Add each value times its row of weights to the sums of all outputs, in the order of rows."""
    made, j = len(sums), 0
    # Four rows a turn: the sums stay in registers, and get the same additions in the same order.
    while j + 4 <= len(values):
        one, two, three, four = values[j], values[j + 1], values[j + 2], values[j + 3]
        first, second = rows[j * made : (j + 1) * made], rows[(j + 1) * made : (j + 2) * made]
        third, fourth = rows[(j + 2) * made : (j + 3) * made], rows[(j + 3) * made : (j + 4) * made]
        for k in range(made):
            total = sums[k] + one * first[k] + two * second[k]
            sums[k] = total + three * third[k] + four * fourth[k]
        j += 4
    while j < len(values):
        value, row = values[j], rows[j * made : (j + 1) * made]
        for k in range(made):
            sums[k] += value * row[k]
        j += 1


@inner
def _activate(kind, values, size):
    for k in range(size):
        x = values[k]
        if kind == _ELU:
            values[k] = x if x > _ZERO else exp(x) - _ONE
        elif kind == _RELU:
            values[k] = max(x, _ZERO)
        elif kind == _LRELU:
            values[k] = x if x > _ZERO else _LEAK * x
        elif kind == _SELU:
            values[k] = _SELU_SCALE * (x if x > _ZERO else _SELU_ALPHA * (exp(x) - _ONE))
        elif kind == _TANH:
            values[k] = _tanh(x)
        elif kind == _GELU:
            values[k] = _HALF * x * (_ONE + _erf(x * _HALF_ROOT))
        elif kind == _SWISH:
            values[k] = x / (_ONE + exp(-x))
        elif kind == _MISH and x <= _LARGE:
            # tanh(log(1 + e^x)), written without the logarithm.
            e = exp(x)
            values[k] = x * (e * (e + _TWO)) / (e * (e + _TWO) + _TWO)


@inner
def _tanh(x):
    e = exp(-_TWO * abs(x))
    size = (_ONE - e) / (_ONE + e)
    return -size if x < _ZERO else size


@inner
def _erf(x):
    size = abs(x)
    t = _ONE / (_ONE + _ERF_T * size)
    series = ((((_ERF_5 * t + _ERF_4) * t + _ERF_3) * t + _ERF_2) * t + _ERF_1) * t
    value = _ONE - series * exp(-size * size)
    return -value if x < _ZERO else value


class Policy:
    """A Driver with a network; it decides by the mean, or the best score, and remembers nothing.

    A row's decision has the same bits alone and in a batch, on every machine.
    """

    def __init__(self, checkpoint: Checkpoint, car: CarConfig, *, name: str | None = None) -> None:
        """Build the network; without `name` the policy is called as its card says."""
        self.name = name or checkpoint.card.name
        self.sensors = checkpoint.card.sensors
        self.card = checkpoint.card
        self.digest = checkpoint.digest
        self._car, self._space = car, checkpoint.card.action_space
        self._shapes = checkpoint.card.group_shapes
        self._network = Network.of(checkpoint.card.network, self._shapes, checkpoint.weights)

    def reset(self, rows: np.ndarray | None) -> None:
        """Do nothing: there is no memory to lose."""

    def act(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return actions in [-1, 1], float32 (num_rows, 2); PolicyError if a group does not fit."""
        return to_actions(self._space, self.outputs(observations), self._car)

    def outputs(self, observations: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return what the network answers, means or scores, float32 (num_rows, space.size)."""
        groups = {name: self._group(observations, name) for name in self._shapes}
        pictures = groups.pop("stereo", np.empty((0, 0, 0, 0), np.uint8))
        flat = np.concatenate(list(groups.values()), axis=1, dtype=np.float32)
        return self._network.outputs(flat, pictures)

    def _group(self, observations: Mapping[str, np.ndarray], name: str) -> np.ndarray:
        group = observations.get(name)
        array = None if group is None else np.ascontiguousarray(group)
        picture, expected = name == "stereo", self._shapes[name]
        if array is None or array.shape[1:] != expected or (picture != (array.dtype == np.uint8)):
            given = (
                "nothing" if array is None else f"{array.dtype} {name} of shape {array.shape[1:]}"
            )
            raise PolicyError(
                f"{self.name!r} was given {given}, but needs {'uint8 ' * picture}{name} of shape "
                f"{expected} in each row: give its car the sensors of its card"
            )
        return array
