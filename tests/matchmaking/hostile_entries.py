"""One sound submission, and what strangers might send instead."""

from __future__ import annotations

import json
import pickle
import struct
import zipfile
from io import BytesIO

from league.agents.network import NetworkConfig
from league.matchmaking import submission
from tests.agents.trained import make_checkpoint

GIVEN = make_checkpoint("lidar", network=NetworkConfig(hidden=(8,)))
"""A sound policy, and below what its owner sends."""
SOUND = submission.pack(GIVEN)


def split(content: bytes) -> tuple[dict, bytes]:
    (size,) = struct.unpack("<Q", content[:8])
    return json.loads(content[8 : 8 + size]), content[8 + size :]


def joined(header: object, numbers: bytes, *, size: int | None = None) -> bytes:
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if size is None else size) + text + numbers


def changed(**weights: object) -> bytes:
    """Return the sound entry with other tellings of its first weight."""
    header, numbers = split(SOUND)
    header["mlp.0.weight"] = {**header["mlp.0.weight"], **weights}
    return joined(header, numbers)


def with_card(**fields: object) -> bytes:
    header, numbers = split(SOUND)
    card = {**json.loads(header["__metadata__"]["card"]), **fields}
    return joined({**header, "__metadata__": {"card": json.dumps(card)}}, numbers)


def with_number(value: float) -> bytes:
    return SOUND[:-4] + struct.pack("<f", value)


class Gadget:
    def __reduce__(self):
        return (print, ("executed",))


def zipped() -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("../../evil/data.pkl", b"\0" * 4_000_000)
    return buffer.getvalue()


HEADER, NUMBERS = split(SOUND)
FIRST = HEADER["mlp.0.weight"]
HUGE = [10**6, 10**6]
HOSTILE = {
    "a pickle that runs code": pickle.dumps(Gadget()),
    "a deflate bomb with a traversing name": zipped(),
    "nothing": b"",
    "a header that is too short": SOUND[:9],
    "a header of 2^63 bytes": joined(HEADER, NUMBERS, size=2**63),
    "a header longer than the file": joined(HEADER, b"", size=60_000),
    "a header longer than allowed": joined(HEADER, b" " * 70_000, size=66_000),
    "a header that is no JSON": joined(b"{" * 900, NUMBERS),
    "a header nested too deep": joined(b"[" * 60_000, NUMBERS),
    "a header that is a list": joined([HEADER], NUMBERS),
    "a header with a key twice": joined(b'{"a":1,"a":2}', NUMBERS),
    "a thousand tensors": joined({**HEADER, **{f"t{n}": FIRST for n in range(400)}}, NUMBERS),
    "no card": joined({k: v for k, v in HEADER.items() if k != "__metadata__"}, NUMBERS),
    "a card and something else": joined(
        {**HEADER, "__metadata__": {**HEADER["__metadata__"], "run": "me"}}, NUMBERS
    ),
    "a card of another format": with_card(format=2),
    "a card with an unknown field": with_card(module="os:system"),
    "a card with lone surrogates": joined(
        {**HEADER, "__metadata__": {"card": '"\ud800"'}}, NUMBERS
    ),
    "a card with too large a network": with_card(
        network={**json.loads(HEADER["__metadata__"]["card"])["network"], "hidden": [1024] * 9}
    ),
    "10^12 numbers": changed(shape=HUGE, data_offsets=[0, 4 * 10**12]),
    "another dtype": changed(dtype="F64"),
    "another shape": changed(shape=FIRST["shape"][::-1]),
    "a shape of halves": changed(shape=[float(size) for size in FIRST["shape"]]),
    "a shape of truths": changed(shape=[True, *FIRST["shape"][1:]]),
    "negative offsets": changed(data_offsets=[-8, 0]),
    "offsets beyond the file": changed(data_offsets=[10**15, 10**15 + 4 * 8 * 71]),
    "two weights on the same numbers": changed(
        data_offsets=HEADER["mlp.2.weight"]["data_offsets"]
    ),
    "a weight given as a text": joined({**HEADER, "mlp.0.weight": "F32"}, NUMBERS),
    "a weight too few": joined({k: v for k, v in HEADER.items() if k != "mlp.2.bias"}, NUMBERS),
    "a weight of another name": joined(
        {("evil" if k == "mlp.2.bias" else k): v for k, v in HEADER.items()}, NUMBERS
    ),
    "bytes left over": SOUND + b"\0" * 64,
    "bytes missing": SOUND[:-4],
    "a hole in the numbers": joined(HEADER, b"\0\0\0\0" + NUMBERS),
    "NaN": with_number(float("nan")),
    "infinity": with_number(float("inf")),
    "a huge weight": with_number(1.5e4),
    "more than 8 MiB without a camera": SOUND + b"\0" * (8 << 20),
    "more than 16 MiB": b"\0" * ((16 << 20) + 1),
}  # fmt: skip
