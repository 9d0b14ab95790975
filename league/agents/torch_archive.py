"""Read what torch.save writes, a zip with a pickle of plain data, without running any of it.

Both readers are strict, because the usual ones open whatever can be opened. Zip libraries inflate,
tolerate overlaps and duplicates, and two of them may see two different archives. A pickle is a
program: `read` knows the few opcodes of a dict of text and tensors, looks up no global and calls
nothing; the standard library only splits the opcodes.
"""

import pickletools
import re
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

MAX_MEMBERS = 80  # 64 tensors and what torch adds
MAX_PHRASE = 300  # characters of the reason for which a file is refused
MAX_PICKLE = 1 << 20  # bytes of the pickle
MAX_OPCODES = 20_000  # 64 tensors need about 3,000
_CENTRAL = struct.Struct("<4s6H3I5H2I")
_LOCAL = struct.Struct("<4s5H3I2H")
_END = struct.Struct("<4s4H2IH")
_END64 = struct.Struct("<4sQ2H2I4Q")
_LOCATOR = struct.Struct("<4sIQI")
_ALLOWED_FLAGS = 0x0808  # sizes after the content, and names in UTF-8; no encryption
_NAME = re.compile(
    rb"([^/\\\x00-\x1f]{1,100})/(data\.pkl|version|byteorder|\.format_version|\.storage_alignment"
    rb"|\.data/serialization_id|data/[0-9]{1,4})"
)


class RefusedError(ValueError):
    """What is wrong with a file, as a phrase for an error message.

    A phrase may quote the file, and is one short line of printable ASCII whatever stands there: a
    stranger's control characters reach no terminal.
    """

    def __init__(self, phrase: str) -> None:
        line = "".join(one if " " <= one <= "~" else ascii(one)[1:-1] for one in phrase)
        super().__init__(line if len(line) <= MAX_PHRASE else f"{line[: MAX_PHRASE - 3]}...")


@dataclass(frozen=True)
class Tensor:
    """A tensor as the file describes it; no array has been made of it."""

    member: str  # number of the member under data/ that holds its numbers
    count: int  # numbers in that member
    offset: int  # first number of the tensor in that member
    shape: tuple[int, ...]
    stride: tuple[int, ...]


@dataclass(frozen=True)
class Archive:
    """A file of torch.save, its structure checked."""

    content: object  # what was saved: dicts, tuples, texts, whole numbers and Tensor descriptions
    _members: dict[str, memoryview]

    def check_members(self, tensors: list[Tensor]) -> None:
        """Refuse numbers that two of these tensors share, and numbers that none of them uses."""
        used = [tensor.member for tensor in tensors]
        if len(set(used)) < len(used):
            raise RefusedError("two weights share their numbers")
        stored = {name for name in self._members if name.startswith("data/")}
        if {f"data/{member}" for member in used} != stored:
            raise RefusedError("it holds numbers that no weight uses, or lacks some")

    def numbers(self, name: str, tensor: Tensor) -> np.ndarray:
        """Return the numbers of a tensor, which must be packed, as float32 of its shape."""
        shape, count, packed = tensor.shape, 1, []
        for size in reversed(shape):
            packed.insert(0, count)
            count *= size
        if tensor.stride != tuple(packed) or tensor.offset or tensor.count != count:
            raise RefusedError(f"the numbers of {name!r} do not lie one after the other")
        stored = self._members[f"data/{tensor.member}"]
        if len(stored) != 4 * count:
            raise RefusedError(
                f"the weight {name!r} has {len(stored)} bytes, its shape {4 * count}"
            )
        return np.frombuffer(bytearray(stored), "<f4").astype(np.float32, copy=False).reshape(shape)


def read(content: bytes) -> Archive:
    """Return the content of a file of torch.save; RefusedError if it holds anything unexpected."""
    members = _members(content)
    if "data.pkl" not in members:
        raise RefusedError("it lacks its head, data.pkl")
    if bytes(members.get("byteorder", b"little")) != b"little":
        raise RefusedError("its numbers have their bytes the other way round")
    head = members["data.pkl"]
    if len(head) > MAX_PICKLE:
        raise RefusedError(f"its head takes {len(head)} bytes, at most {MAX_PICKLE} are allowed")
    return Archive(_unpickled(bytes(head)), members)


def _members(content: bytes) -> dict[str, memoryview]:
    """Return the content of each member by its name below the archive's folder, without copies."""
    count, start, size = _directory(content)
    members: dict[str, memoryview] = {}
    spans: list[tuple[int, int]] = []
    folders: set[bytes] = set()
    for folder, name, begin, data_at, end, crc in _entries(content, count, start, size):
        if name in members:
            raise RefusedError(f"it holds {name} twice")
        folders.add(folder)
        spans.append((begin, end))
        members[name] = memoryview(content)[data_at:end]
        if zlib.crc32(members[name]) != crc:
            raise RefusedError(f"the content of {name} does not match its check sum")
    spans.sort()
    for (_, end), (begin, _) in pairwise(spans):
        if begin < end:
            raise RefusedError("its members overlap")
    if len(folders) != 1 or folders & {b".", b".."}:
        raise RefusedError("its members do not lie in one folder")
    return members


def _directory(content: bytes) -> tuple[int, int, int]:
    """Return number of members, and offset and size of their directory."""
    end_at = len(content) - _END.size
    if end_at < 0 or content[:4] != b"PK\x03\x04":
        raise RefusedError("it is no checkpoint, but something else")
    mark, disk, disk_too, here, count, size, start, comment = _END.unpack_from(content, end_at)
    if mark != b"PK\x05\x06" or comment or disk or disk_too or here != count:
        raise RefusedError("its end is missing or damaged")
    if not 1 <= count <= MAX_MEMBERS:
        raise RefusedError(f"it holds {count} members, at most {MAX_MEMBERS} are allowed")
    # torch always writes the records for archives beyond 4 GiB, too; they must say the same.
    gap = end_at - (start + size)
    if gap == _END64.size + _LOCATOR.size:
        end64 = _END64.unpack_from(content, start + size)
        locator = _LOCATOR.unpack_from(content, start + size + _END64.size)
        same = end64[0] == b"PK\x06\x06" and end64[6:] == (count, count, size, start)
        if not same or locator != (b"PK\x06\x07", 0, start + size, 1):
            raise RefusedError("its two directories differ")
    elif gap != 0:
        raise RefusedError("its directory is not where it should be")
    return count, start, size


def _entries(
    content: bytes, count: int, start: int, size: int
) -> Iterator[tuple[bytes, str, int, int, int, int]]:
    """Yield folder, name, begin, begin and end of the content, and check sum of each member."""
    at, stop = start, start + size
    for _ in range(count):
        if at + _CENTRAL.size > stop:
            raise RefusedError("its directory is cut short")
        central = _CENTRAL.unpack_from(content, at)
        flags, method, crc, packed, unpacked = *central[3:5], *central[7:10]
        name_size, extra_size, note_size, begin = *central[10:13], central[16]
        name = content[at + _CENTRAL.size : at + _CENTRAL.size + name_size]
        at += _CENTRAL.size + name_size + extra_size + note_size
        if central[0] != b"PK\x01\x02" or at > stop or extra_size or note_size:
            raise RefusedError("its directory is damaged")
        match = _NAME.fullmatch(name)
        if match is None:
            raise RefusedError(f"it holds {name[:60]!r}, which no checkpoint does")
        if method != 0 or packed != unpacked:
            raise RefusedError("its members are compressed: they must be stored as they are")
        if flags & ~_ALLOWED_FLAGS:
            raise RefusedError("its members are encrypted or patched")
        data_at = _content_at(content, begin, name, start)
        end = data_at + unpacked
        if end > start:
            raise RefusedError("a member reaches beyond its place")
        yield match[1], match[2].decode("ascii"), begin, data_at, end, crc
    if at != stop:
        raise RefusedError("its directory holds more than its members")


def _content_at(content: bytes, begin: int, name: bytes, stop: int) -> int:
    """Return where the content of a member begins, after its own header."""
    if begin + _LOCAL.size > stop:
        raise RefusedError("a member reaches beyond its place")
    local = _LOCAL.unpack_from(content, begin)
    name_at = begin + _LOCAL.size
    name_size, extra_size = local[9], local[10]
    same = content[name_at : name_at + name_size] == name
    if local[0] != b"PK\x03\x04" or local[3] != 0 or not same or local[2] & ~_ALLOWED_FLAGS:
        raise RefusedError("a member is not what the directory says")
    return name_at + name_size + extra_size


_MARK = object()
_GLOBALS = {
    "torch._utils _rebuild_tensor_v2": "rebuild",
    "torch FloatStorage": "float32",
    "collections OrderedDict": "dict",
}


@dataclass(frozen=True)
class _Global:
    name: str


@dataclass(frozen=True)
class _Storage:
    member: str
    count: int


def _unpickled(content: bytes) -> object:
    if content[:2] != b"\x80\x02":
        raise RefusedError("its head is no pickle of protocol 2, which torch.save writes")
    try:
        return _run(content)
    except RefusedError:
        raise
    except (ValueError, IndexError, KeyError, TypeError) as error:
        raise RefusedError("its head is damaged") from error


def _run(content: bytes) -> object:
    """Run the opcodes that build plain data on a stack; no opcode calls anything."""
    stack: list[Any] = []
    memo: dict[int, object] = {}
    for number, (opcode, argument, place) in enumerate(pickletools.genops(content)):
        if number == MAX_OPCODES:
            raise RefusedError(f"its head has more than {MAX_OPCODES} opcodes")
        match opcode.name:
            case "PROTO" if number == 0:
                pass
            case "EMPTY_DICT":
                stack.append({})
            case "EMPTY_TUPLE":
                stack.append(())
            case "MARK":
                stack.append(_MARK)
            case "NEWFALSE":
                stack.append(False)
            case "BINUNICODE" | "BININT" | "BININT1" | "BININT2":
                stack.append(argument)
            case "GLOBAL":
                stack.append(_global(str(argument)))
            case "BINPUT" | "LONG_BINPUT":
                memo[int(argument or 0)] = stack[-1]
            case "BINGET" | "LONG_BINGET":
                stack.append(memo[int(argument or 0)])
            case "TUPLE":
                stack.append(tuple(_popped_to_mark(stack)))
            case "TUPLE1" | "TUPLE2" | "TUPLE3":
                stack.append(tuple(_popped(stack, int(opcode.name[-1]))))
            case "SETITEM":
                _set_items(_popped(stack, 2), stack[-1])
            case "SETITEMS":
                _set_items(_popped_to_mark(stack), stack[-1])
            case "BINPERSID":
                stack.append(_storage(stack.pop()))
            case "REDUCE":
                stack.append(_built(*_popped(stack, 2)))
            case "STOP":
                (result,) = stack
                if place != len(content) - 1:
                    raise RefusedError("its head is damaged")
                return result
            case name:
                raise RefusedError(f"its head asks for opcode {name}, which no checkpoint needs")
    raise RefusedError("its head is cut short")


def _popped(stack: list[Any], count: int) -> list[Any]:
    if len(stack) < count:
        raise RefusedError("its head is damaged")
    values = stack[-count:]
    del stack[-count:]
    return values


def _popped_to_mark(stack: list[Any]) -> list[Any]:
    depth = stack[::-1].index(_MARK)
    return _popped(stack, depth + 1)[1:]


def _set_items(pairs: list[Any], target: object) -> None:
    if not isinstance(target, dict):
        raise RefusedError("its head is damaged")
    for key, value in zip(pairs[::2], pairs[1::2], strict=True):
        if not isinstance(key, str) or key in target:
            raise RefusedError("a name in its head is no text, or is given twice")
        target[key] = value


def _global(name: str) -> _Global:
    if name in _GLOBALS:
        return _Global(_GLOBALS[name])
    if name.startswith("torch ") and name.endswith("Storage"):
        raise RefusedError(f"it holds numbers of kind {name[6:60]}: all must be float32")
    raise RefusedError(f"it names {name.replace(' ', '.')[:80]!r}, and a checkpoint runs nothing")


def _storage(description: object) -> _Storage:
    match description:
        case ("storage", _Global("float32"), str(member), "cpu", int(count)):
            return _Storage(member, count)
        case ("storage", _Global("float32"), _, str(device), _):
            raise RefusedError(f"a tensor lies on device {device[:20]!r}: it must lie on the cpu")
    raise RefusedError("a tensor's storage is not what torch.save writes")


def _built(function: object, arguments: object) -> object:
    """Return the result of one of the two calls that a checkpoint asks for; neither is made."""
    match function, arguments:
        case (_Global("dict"), ()):
            return {}
        case (_Global("rebuild"), (_Storage() as held, *rest)):
            return _tensor(held, rest)
    raise RefusedError("its head asks for a call that no checkpoint needs")


def _tensor(held: _Storage, rest: list[object]) -> Tensor:
    match rest:
        case [int(offset), tuple(shape), tuple(stride), False, dict(hooks)] if not hooks:
            sizes = (offset, held.count, *shape, *stride)
            if len(shape) == len(stride) <= 8 and all(type(size) is int for size in sizes):
                return Tensor(held.member, held.count, offset, shape, stride)
    raise RefusedError("a tensor is not described as torch.save does, or wants a gradient")
