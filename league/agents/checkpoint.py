"""A checkpoint on disk: one file that torch.load can read, too; docs/checkpoint.md describes it."""

from __future__ import annotations

import hashlib
import json
import os
import re
import stat
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path

import numpy as np
from pydantic import ValidationError

from league.agents.card import FORMAT, Card
from league.agents.checkpoint import archive, pickled, soundness
from league.agents.checkpoint.archive import RefusedError
from league.agents.checkpoint.pickled import Stored
from league.atomic_file import replacing
from league.errors import ConfigError, PolicyError, brief

MAX_SIZE = 8 << 20
"""Bytes of a file without a camera."""
MAX_SIZE_CAMERA = 16 << 20
"""Bytes of a file with a camera."""
MAX_CARD = 64 << 10
"""Bytes of a card's text."""


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """A trained actor: its card, and weights that are exactly what the card asks for.

    Whoever holds one may use it: names, shapes, dtypes and numbers have been checked.
    """

    card: Card
    """What it is."""
    weights: Mapping[str, np.ndarray]
    """Weights by name, float32."""
    text: str = field(default="")
    """The card as JSON with sorted keys; made of the card unless it was read from a file."""

    def __post_init__(self) -> None:
        try:
            soundness.check(self.card, self.weights)
        except RefusedError as refusal:
            raise PolicyError(
                f"the checkpoint {self.card.name!r} is refused: {refusal}; "
                "give weights of the card's own network"
            ) from refusal
        if not self.text:
            object.__setattr__(self, "text", _canonical(self.card.model_dump_json()))
        if len(self.text) > MAX_CARD:
            raise PolicyError(
                f"the card of {self.card.name!r} takes {len(self.text)} bytes: "
                f"shorten it to at most {MAX_CARD}"
            )

    @property
    def digest(self) -> str:
        """SHA-256 of the content: the card's text, then name, shape and numbers of each weight."""
        found = hashlib.sha256(b"league checkpoint 1\n")
        found.update(struct.pack("<Q", len(self.text)) + self.text.encode("ascii"))
        for name in sorted(self.weights):
            weight = self.weights[name]
            head = json.dumps([name, list(weight.shape)]).encode("ascii")
            found.update(struct.pack("<Q", len(head)) + head)
            found.update(_bytes(weight))
        return found.hexdigest()


def save(path: str | os.PathLike[str], checkpoint: Checkpoint) -> None:
    """Write a checkpoint, whole or not at all; the same content gives the same bytes.

    Raises:
        PolicyError: the file cannot be written, or would be too large.
    """
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
    """Read a checkpoint from a stranger: nothing in it is executed, and all of it is checked.

    Raises:
        PolicyError: it is no checkpoint, or not a sound one.
    """
    try:
        return _parsed(_content(Path(path)))
    except RefusedError as refusal:
        raise PolicyError(
            f"{_named(path)} is refused: {refusal}; give a .pt file as `league train` writes it"
        ) from refusal


def digest(given: str | os.PathLike[str] | Checkpoint) -> str:
    """Return the SHA-256 of a checkpoint's content, which names it in a league.

    Raises:
        PolicyError: the file is not a sound checkpoint.
    """
    return (given if isinstance(given, Checkpoint) else load(given)).digest


def _content(path: Path) -> bytes:
    """Return the bytes of a file that is a plain one and not too large."""
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise RefusedError("it is no file, but a folder or a device")
        with path.open("rb") as file:
            content = file.read(min(found.st_size, MAX_SIZE_CAMERA) + 1)
    except (OSError, ValueError) as error:
        if isinstance(error, RefusedError):
            raise
        raise RefusedError(
            f"it cannot be read ({getattr(error, 'strerror', None) or error})"
        ) from error
    if not content:
        raise RefusedError("it is empty")
    if len(content) > MAX_SIZE_CAMERA:
        raise RefusedError(f"it is larger than {MAX_SIZE_CAMERA} bytes")
    return content


def _parsed(content: bytes) -> Checkpoint:
    members = archive.members(content)
    if "data.pkl" not in members:
        raise RefusedError("it lacks its head, data.pkl")
    if bytes(members.get("byteorder", b"little")) != b"little":
        raise RefusedError("its numbers have their bytes the other way round")
    match pickled.read(bytes(members["data.pkl"][: pickled.MAX_SIZE + 1])):
        case {"card": str(text), "weights": dict(stored), **rest} if not rest:
            card, canonical = read_card(text)
        case _:
            raise RefusedError("it does not hold a card and weights, and nothing else")
    if len(content) > _limit(card):
        raise RefusedError(
            f"it takes {len(content)} bytes, at most {_limit(card)} without a camera"
        )
    expected = soundness.wanted(card)
    soundness.check_names(set(stored), expected)
    held = [value.member for value in stored.values() if isinstance(value, Stored)]
    if len(set(held)) < len(held):
        raise RefusedError("two weights share their numbers")
    if {f"data/{member}" for member in held} != {name for name in members if name[:5] == "data/"}:
        raise RefusedError("it holds numbers that no weight uses, or lacks some")
    weights = {
        name: _weight(name, stored[name], members, shape) for name, shape in expected.items()
    }
    try:
        return Checkpoint(card, weights, canonical)
    except PolicyError as error:
        raise error.__cause__ if isinstance(error.__cause__, RefusedError) else error from None


def _weight(
    name: str, stored: object, members: Mapping[str, memoryview], shape: tuple[int, ...]
) -> np.ndarray:
    """Return the weight that the file describes, once it is known to be what is expected."""
    if not isinstance(stored, Stored):
        raise RefusedError(f"the weight {name!r} is no tensor")
    soundness.check_shape(name, stored.shape, shape)
    count = 1
    for size in shape:
        count *= size
    if stored.stride != soundness.packed(shape) or stored.offset or stored.count != count:
        raise RefusedError(f"the numbers of {name!r} do not lie one after the other")
    numbers = members[f"data/{stored.member}"]
    if len(numbers) != 4 * count:
        raise RefusedError(f"the weight {name!r} has {len(numbers)} bytes, its shape {4 * count}")
    return np.frombuffer(bytearray(numbers), "<f4").astype(np.float32, copy=False).reshape(shape)


def read_card(text: str) -> tuple[Card, str]:
    """Return a stranger's card and its text with sorted keys.

    Raises:
        RefusedError: it is no card, or one that this version does not read.
    """
    if len(text.encode("utf-8")) > MAX_CARD:
        raise RefusedError(f"its card is longer than {MAX_CARD} bytes")
    try:
        canonical = _canonical(text)
        found = json.loads(canonical)
    except (ValueError, RecursionError) as error:
        raise RefusedError("its card is no JSON, or nested too deep") from error
    if len(canonical) > MAX_CARD:
        raise RefusedError(f"its card is longer than {MAX_CARD} bytes in ASCII")
    version = found.get("format") if isinstance(found, dict) else None
    if version != FORMAT or isinstance(version, bool):
        raise RefusedError(f"its card is of format {_quoted(version)}, this version reads {FORMAT}")
    try:
        return Card.model_validate_json(canonical, strict=True), canonical
    except ConfigError as error:
        raise RefusedError(f"its card is wrong: {error}") from error
    except ValidationError as error:
        first = error.errors(include_url=False, include_context=False)[0]
    where = ".".join(_part(part) for part in first["loc"]) or "it"
    raise RefusedError(
        f"its card is wrong: {where} is {_quoted(first['input'])}: {first['msg'][:150]}"
    )


def _quoted(given: object) -> str:
    """Return what was given in at most 80 signs of ASCII."""
    line = brief(given).encode("ascii", "backslashreplace").decode("ascii")
    return line if len(line) <= 80 else f"{line[:77]}..."


def _part(of: str | int) -> str:
    """Return a part of a place in a card: as it is if it is a name, else quoted and cut."""
    text = str(of)
    return text if re.fullmatch(r"[A-Za-z0-9_]{1,40}", text) else ascii(text[:20])


def _canonical(text: str) -> str:
    """Return JSON with sorted keys and no spaces, in ASCII."""
    return json.dumps(json.loads(text), sort_keys=True, separators=(",", ":"))


def _named(path: str | os.PathLike[str]) -> str:
    """Return a path as it fits into a sentence."""
    name = repr(os.fspath(path))
    return name if len(name) <= 200 else f"{name[:60]}...{name[-137:]}"


def _limit(card: Card) -> int:
    return MAX_SIZE if card.sensors.camera is None else MAX_SIZE_CAMERA


def _bytes(weight: np.ndarray) -> bytes:
    """Return the numbers as float32, lowest byte first."""
    return weight.astype("<f4").tobytes()
