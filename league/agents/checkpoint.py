"""A policy as a file: its card, which says what it needs and where it is from, and its weights."""

import hashlib
import json
import math
import os
import re
import struct
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from io import BytesIO
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, ValidationError

from league.agents import torch_archive
from league.agents.network import NetworkConfig, group_shapes, weight_shapes
from league.agents.torch_archive import RefusedError, Tensor
from league.atomic_file import replacing
from league.envs.actions import ContinuousActions, DiscreteActions
from league.errors import ConfigError, PolicyError, brief
from league.race_spec import FrozenModel, printable
from league.sim.config import RaceKind, SensorConfig

FORMAT = 1
MAX_PIXELS = 640 * 480
MOUNTS = {"forward": 0.2, "up": 0.3, "baseline": 0.2, "pitch": math.pi / 2}
"""Largest distance [m] and tilt [rad], to either side, at which a sensor may be mounted."""


def _reasonable(sensors: SensorConfig) -> SensorConfig:
    for carried in (sensors.camera, sensors.lidar):
        for name, largest in MOUNTS.items():
            value = getattr(carried, name, 0.0)
            if not abs(value) <= largest:
                raise ValueError(f"{name} is {value}: give at most {largest:g} to either side")
    camera, lidar = sensors.camera, sensors.lidar
    if camera is not None and camera.width * camera.height > MAX_PIXELS:
        raise ValueError(
            f"pictures are {camera.width}x{camera.height}: give at most {MAX_PIXELS} pixels"
        )
    if lidar is None:
        return sensors
    if not (lidar.max_range <= 100 and lidar.clip <= 100 and lidar.noise <= 1):
        raise ValueError("a range of the lidar is beyond 100 m, or its noise beyond 1 m")
    if not (lidar.sectors <= 256 and lidar.bins <= 64):
        raise ValueError("the lidar has more than 256 sectors, or more than 64 bins in each")
    return sensors


Label = Annotated[str, Field(min_length=1, max_length=80), AfterValidator(printable)]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
Count = Annotated[int, Field(ge=0, lt=2**63)]


class RewardCard(FrozenModel):
    """The reward a policy was trained with."""

    name: Label  # name of a built-in reward, or of the user's file
    sha256: Digest | Literal[""] = ""  # of the user's file; empty for built-in rewards


class Card(FrozenModel):
    """Everything about a checkpoint but its weights."""

    format: Literal[1] = FORMAT  # version of the checkpoint format
    name: Label  # what a person calls the policy
    sensors: Annotated[SensorConfig, AfterValidator(_reasonable)]  # what its car carries
    action_space: ContinuousActions | DiscreteActions = ContinuousActions()  # what its outputs mean
    network: NetworkConfig = NetworkConfig()  # its layers
    tracks: Annotated[tuple[Label, ...], Field(max_length=256)] = ()  # tracks it was trained on
    kind: RaceKind = "time_trial"  # kind of race it was trained for
    reward: RewardCard | None = None  # the reward it was trained with; None: unknown
    steps: Count = 0  # decisions it learnt from, those of its parents not counted
    train_s: Annotated[float, Field(ge=0, le=1e9)] = 0.0  # time spent on training it [s]
    seed: Count = 0  # seed of the training
    # digests of the checkpoints it was trained from
    parents: Annotated[tuple[Digest, ...], Field(max_length=64)] = ()
    licence: Label = "CC-BY-4.0"  # under which the weights may be used; an SPDX name
    # day it was made, UTC
    created: Annotated[str, Field(pattern=r"^\d{4}-\d\d-\d\d$")] = Field(
        default_factory=lambda: datetime.now(tz=UTC).date().isoformat()
    )
    # version of the league that made it
    league_version: Annotated[str, Field(max_length=40), AfterValidator(printable)] = ""
    # figures of its last evaluation, by name; None: there was none
    results: dict[Label, float | None] = Field(default_factory=dict, max_length=64)
    # the command line that made it
    command: Annotated[str, Field(max_length=2000), AfterValidator(printable)] = ""

    @property
    def group_shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each group that its network reads, in order."""
        return group_shapes(self.sensors)

    @property
    def weight_shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every weight its network has; ConfigError if it cannot be built."""
        return weight_shapes(self.network, self.group_shapes, self.action_space.size)


MAX_SIZE = 8 << 20  # bytes of a file without a camera
MAX_SIZE_CAMERA = 16 << 20  # bytes of a file with a camera
MAX_CARD = 64 << 10  # bytes of a card's text
MAX_TENSORS = 64
MAX_WEIGHT = 1e4  # largest weight, to either side


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained actor: its card, and weights that are exactly what the card asks for.

    Names, shapes, dtypes and numbers have been checked.
    """

    card: Card  # what it is
    weights: Mapping[str, np.ndarray]  # weights by name, float32
    # the card as JSON with sorted keys; made of the card unless it was read from a file
    text: str = ""

    def __post_init__(self) -> None:
        with refusing(
            f"the checkpoint {self.card.name!r}", "give weights of the card's own network"
        ):
            check_weights(self.card, self.weights)
        if not self.text:
            object.__setattr__(self, "text", _canonical(self.card.model_dump_json()))
        if len(self.text) > MAX_CARD:
            raise PolicyError(
                f"the card of {self.card.name!r} takes {len(self.text)} bytes: "
                f"shorten it to at most {MAX_CARD}"
            )

    @property
    def digest(self) -> str:
        """SHA-256 of the card's text, then of name, shape and numbers of each weight."""
        content = hashlib.sha256(b"league checkpoint 1\n")
        content.update(struct.pack("<Q", len(self.text)) + self.text.encode("ascii"))
        for name in sorted(self.weights):
            weight = self.weights[name]
            head = json.dumps([name, list(weight.shape)]).encode("ascii")
            content.update(struct.pack("<Q", len(head)) + head)
            content.update(weight.astype("<f4").tobytes())
        return content.hexdigest()


def save(path: str | os.PathLike[str], checkpoint: Checkpoint) -> None:
    """Write a checkpoint, always to the same bytes; PolicyError if it cannot be or is too large."""
    import torch

    # Copies, so that each tensor's storage holds its own numbers and no others.
    weights = {
        name: torch.from_numpy(checkpoint.weights[name].copy())
        for name in sorted(checkpoint.weights)
    }
    buffer = BytesIO()
    torch.save({"card": checkpoint.text, "weights": weights}, buffer)
    content = buffer.getvalue()
    if len(content) > _limit(checkpoint.card):
        raise PolicyError(
            f"the checkpoint {checkpoint.card.name!r} takes {len(content)} bytes: at most "
            f"{_limit(checkpoint.card)} are allowed, make its network smaller"
        )
    with replacing(path, "the checkpoint", PolicyError) as file:
        file.write_bytes(content)


def load(path: str | os.PathLike[str]) -> Checkpoint:
    """Read a stranger's checkpoint: all is checked, nothing executed; PolicyError if not sound."""
    name = repr(os.fspath(path))
    what = name if len(name) <= 200 else f"{name[:60]}...{name[-137:]}"
    with refusing(what, "give a .pt file as `league train` writes it"):
        return _parsed(_content(Path(path)))


@contextmanager
def refusing(what: str, advice: str) -> Generator[None]:
    """Turn a RefusedError into a PolicyError: `what` is refused, `advice` says what to give."""
    try:
        yield
    except RefusedError as refusal:
        raise PolicyError(f"{what} is refused: {refusal}; {advice}") from refusal


def _content(path: Path) -> bytes:
    """Return the bytes of a file that is a plain one and not too large."""
    if os.path.exists(path) and not os.path.isfile(path):
        raise RefusedError("it is no file, but a folder or a device")
    try:
        with path.open("rb") as file:
            content = file.read(MAX_SIZE_CAMERA + 1)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise RefusedError(f"it cannot be read ({reason})") from error
    if not content:
        raise RefusedError("it is empty")
    if len(content) > MAX_SIZE_CAMERA:
        raise RefusedError(f"it is larger than {MAX_SIZE_CAMERA} bytes")
    return content


def _parsed(content: bytes) -> Checkpoint:
    archive = torch_archive.read(content)
    match archive.content:
        case {"card": str(text), "weights": dict(tensors), **rest} if not rest:
            card, canonical = read_card(text, len(content))
        case _:
            raise RefusedError("it does not hold a card and weights, and nothing else")
    for name, tensor in tensors.items():
        if not isinstance(tensor, Tensor):
            raise RefusedError(f"the weight {name!r} is no tensor")
    check_shapes(card, {name: tensor.shape for name, tensor in tensors.items()})
    archive.check_members(list(tensors.values()))
    weights = {name: archive.numbers(name, tensor) for name, tensor in tensors.items()}
    check_weights(card, weights)
    return Checkpoint(card, weights, canonical)


def check_shapes(card: Card, shapes: Mapping[str, tuple[int, ...]]) -> None:
    """Refuse weights of other names or shapes than the card's network has, by RefusedError."""
    try:
        expected = card.weight_shapes
    except ConfigError as error:
        raise RefusedError(str(error)) from error
    if len(expected) > MAX_TENSORS:
        raise RefusedError(
            f"its network has {len(expected)} tensors, at most {MAX_TENSORS} are allowed"
        )
    for missing in sorted(expected.keys() - shapes.keys()):
        raise RefusedError(f"it lacks the weight {missing!r} that the network of its card has")
    for extra in sorted(shapes.keys() - expected.keys()):
        raise RefusedError(
            f"it has the weight {extra[:60]!r}, which the network of its card has not"
        )
    for name, shape in expected.items():
        if shapes[name] != shape:
            raise RefusedError(
                f"the weight {name!r} has shape {str(shapes[name])[:60]}, its card asks {shape}"
            )


def check_weights(card: Card, weights: Mapping[str, np.ndarray]) -> None:
    """Refuse other names, shapes, dtypes, NaN and huge numbers, by RefusedError."""
    check_shapes(card, {name: tuple(weight.shape) for name, weight in weights.items()})
    for name, weight in weights.items():
        is_float32 = type(weight) is np.ndarray and weight.dtype == np.float32
        if not is_float32 or not weight.flags.c_contiguous:
            raise RefusedError(f"the weight {name!r} is not a contiguous float32 NumPy array")
        if not bool((np.abs(weight) <= MAX_WEIGHT).all()):  # False for NaN
            raise RefusedError(f"the weight {name!r} holds NaN or a number beyond {MAX_WEIGHT:g}")
        if name == "obs_normalizer._std" and bool(np.any(weight < 0)):
            raise RefusedError("the normaliser's deviations are negative")


def read_card(text: str, size: int) -> tuple[Card, str]:
    """Return a card and its text with sorted keys; RefusedError if it, or `size`, is not sound."""
    card, canonical = _card(text)
    if size > _limit(card):
        raise RefusedError(f"it takes {size} bytes, at most {_limit(card)} without a camera")
    return card, canonical


def _card(text: str) -> tuple[Card, str]:
    if len(text.encode("utf-8", "surrogatepass")) > MAX_CARD:
        raise RefusedError(f"its card is longer than {MAX_CARD} bytes")
    try:
        canonical = _canonical(text)
        data = json.loads(canonical)
    except (ValueError, RecursionError) as error:
        raise RefusedError("its card is no JSON, or nested too deep") from error
    if len(canonical) > MAX_CARD:
        raise RefusedError(f"its card is longer than {MAX_CARD} bytes in ASCII")
    version = data.get("format") if isinstance(data, dict) else None
    if version != FORMAT or isinstance(version, bool):
        raise RefusedError(f"its card is of format {_quoted(version)}, this version reads {FORMAT}")
    try:
        return Card.model_validate_json(canonical, strict=True), canonical
    except ConfigError as error:
        raise RefusedError(f"its card is wrong: {error}") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(_quoted_key(key) for key in first["loc"]) or "it"
    raise RefusedError(
        f"its card is wrong: {where} is {_quoted(first['input'])}: {first['msg'][:150]}"
    )


def _quoted(value: object) -> str:
    """Return a value in at most 80 characters of ASCII."""
    line = brief(value).encode("ascii", "backslashreplace").decode("ascii")
    return line if len(line) <= 80 else f"{line[:77]}..."


def _quoted_key(key: str | int) -> str:
    """Return a key of a card: as it is if it is a name, else quoted and cut."""
    text = str(key)
    return text if re.fullmatch(r"[A-Za-z0-9_]{1,40}", text) else ascii(text[:20])


def _canonical(text: str) -> str:
    """Return JSON with sorted keys and no spaces, in ASCII."""
    return json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))


def _limit(card: Card) -> int:
    return MAX_SIZE if card.sensors.camera is None else MAX_SIZE_CAMERA
