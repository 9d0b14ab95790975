"""What torch.save pickles, read by hand: a closed list of opcodes that build plain data only.

A pickle is a program. This reader knows the few opcodes of a dict of text and tensors, looks up no
global, calls nothing and imports no pickle; a tensor becomes a `Stored`, which says where its
numbers lie. Anything else is refused.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from league.agents.checkpoint.archive import RefusedError

MAX_SIZE = 1 << 20
"""Bytes of the pickle."""
MAX_OPCODES = 20_000
"""64 tensors need about 3,000."""
_GLOBALS = {
    "torch._utils _rebuild_tensor_v2": "rebuild",
    "torch FloatStorage": "float32",
    "collections OrderedDict": "dict",
}


@dataclass(frozen=True)
class Stored:
    """A tensor as the file describes it; nothing has been made of it."""

    member: str
    """Number of the member under data/ that holds its numbers."""
    count: int
    """Numbers in that member."""
    offset: int
    """Where it begins in that member."""
    shape: tuple[int, ...]
    """Its shape."""
    stride: tuple[int, ...]
    """Its strides."""


@dataclass(frozen=True)
class _Global:
    name: str


@dataclass(frozen=True)
class _Storage:
    member: str
    count: int


class _Mark:
    pass


_MARK = _Mark()


def read(content: bytes) -> object:
    """Return the dicts, tuples, texts, whole numbers and Stored tensors of a pickle.

    Raises:
        RefusedError: it holds more than that.
    """
    if len(content) > MAX_SIZE:
        raise RefusedError(f"its head takes {len(content)} bytes, at most {MAX_SIZE} are allowed")
    reader = _Reader(content)
    try:
        return reader.run()
    except (IndexError, struct.error, UnicodeDecodeError, KeyError, TypeError) as error:
        raise RefusedError("its head is damaged") from error


class _Reader:
    """A stack machine without calls."""

    def __init__(self, content: bytes) -> None:
        self._content, self._at = content, 0
        self._stack: list[object] = []
        self._memo: dict[int, object] = {}

    def run(self) -> object:
        if self._take(2) != b"\x80\x02":
            raise RefusedError("its head is no pickle of protocol 2, which torch.save writes")
        for _ in range(MAX_OPCODES):
            opcode = self._take(1)
            if opcode == b".":
                if len(self._stack) != 1 or self._at != len(self._content):
                    raise RefusedError("its head is damaged")
                return self._stack[0]
            act = _OPCODES.get(opcode)
            if act is None:
                raise RefusedError(
                    f"its head asks for opcode {opcode!r}, which no checkpoint needs"
                )
            act(self)
        raise RefusedError(f"its head has more than {MAX_OPCODES} opcodes")

    def _take(self, size: int) -> bytes:
        taken = self._content[self._at : self._at + size]
        if len(taken) != size:
            raise RefusedError("its head is cut short")
        self._at += size
        return taken

    def _number(self, form: str) -> int:
        return struct.unpack(form, self._take(struct.calcsize(form)))[0]

    def _push(self, value: object) -> None:
        self._stack.append(value)

    def _line(self) -> str:
        end = self._content.find(b"\n", self._at, self._at + 200)
        if end < 0:
            raise RefusedError("its head is cut short")
        return self._take(end + 1 - self._at)[:-1].decode("ascii")

    def _since_mark(self) -> list[object]:
        for place in range(len(self._stack) - 1, -1, -1):
            if self._stack[place] is _MARK:
                values = self._stack[place + 1 :]
                del self._stack[place:]
                return values
        raise RefusedError("its head is damaged")

    def _last(self, count: int) -> tuple[object, ...]:
        if len(self._stack) < count:
            raise RefusedError("its head is damaged")
        values = tuple(self._stack[len(self._stack) - count :])
        del self._stack[len(self._stack) - count :]
        return values

    def text(self) -> None:
        self._push(self._take(self._number("<I")).decode("utf-8"))

    def named(self) -> None:
        name = f"{self._line()} {self._line()}"
        if name.startswith("torch ") and name.endswith("Storage") and name not in _GLOBALS:
            raise RefusedError(f"it holds numbers of kind {name[6:60]}: all must be float32")
        if name not in _GLOBALS:
            raise RefusedError(
                f"it names {name.replace(' ', '.')[:80]!r}, and a checkpoint runs nothing"
            )
        self._push(_Global(_GLOBALS[name]))

    def keep(self, form: str) -> None:
        self._memo[self._number(form)] = self._stack[-1]

    def fetch(self, form: str) -> None:
        self._push(self._memo[self._number(form)])

    def items(self, pairs: list[object]) -> None:
        target = self._stack[-1]
        if not isinstance(target, dict) or len(pairs) % 2:
            raise RefusedError("its head is damaged")
        for key, value in zip(pairs[::2], pairs[1::2], strict=True):
            if not isinstance(key, str) or key in target:
                raise RefusedError("a name in its head is no text, or is given twice")
            target[key] = value

    def storage(self) -> None:
        match self._stack.pop():
            case ("storage", _Global("float32"), str(member), "cpu", int(count)):
                self._push(_Storage(member, count))
            case ("storage", _Global("float32"), _, str(device), _):
                raise RefusedError(
                    f"a tensor lies on device {device[:20]!r}: it must lie on the cpu"
                )
            case _:
                raise RefusedError("a tensor's storage is not what torch.save writes")

    def build(self) -> None:
        """Stand in for the two calls that a checkpoint asks for; neither is made."""
        match self._last(2):
            case (_Global("dict"), ()):
                self._push({})
            case (_Global("rebuild"), (_Storage() as held, *rest)):
                self._push(_tensor(held, rest))
            case _:
                raise RefusedError("its head asks for a call that no checkpoint needs")


def _tensor(held: _Storage, rest: list[object]) -> Stored:
    match rest:
        case [int(offset), tuple(shape), tuple(stride), False, dict(hooks)] if not hooks:
            sizes = (offset, held.count, *shape, *stride)
            if len(shape) == len(stride) <= 8 and all(type(size) is int for size in sizes):
                return Stored(held.member, held.count, offset, shape, stride)  # type: ignore
    raise RefusedError("a tensor is not described as torch.save does, or wants a gradient")


_OPCODES: dict[bytes, Callable[[_Reader], None]] = {
    b"}": lambda r: r._push({}),
    b")": lambda r: r._push(()),
    b"(": lambda r: r._push(_MARK),
    b"\x89": lambda r: r._push(False),
    b"X": _Reader.text,
    b"c": _Reader.named,
    b"J": lambda r: r._push(r._number("<i")),
    b"K": lambda r: r._push(r._number("<B")),
    b"M": lambda r: r._push(r._number("<H")),
    b"q": lambda r: r.keep("<B"),
    b"r": lambda r: r.keep("<I"),
    b"h": lambda r: r.fetch("<B"),
    b"j": lambda r: r.fetch("<I"),
    b"t": lambda r: r._push(tuple(r._since_mark())),
    b"\x85": lambda r: r._push(r._last(1)),
    b"\x86": lambda r: r._push(r._last(2)),
    b"\x87": lambda r: r._push(r._last(3)),
    b"s": lambda r: r.items(list(r._last(2))),
    b"u": lambda r: r.items(r._since_mark()),
    b"Q": _Reader.storage,
    b"R": _Reader.build,
}
