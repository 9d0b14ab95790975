"""The members of the zip that torch.save writes, read by hand: stored, named, checked, no other.

A strict reader of our own, because the usual ones are made to open whatever can be opened: they
inflate, they tolerate overlaps and duplicates, and two of them may see two different archives.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from itertools import pairwise

MAX_MEMBERS = 80
"""64 tensors and what torch adds."""
MAX_PHRASE = 300
"""Signs of what is told about a refused file."""
_CENTRAL = struct.Struct("<4s6H3I5H2I")
_LOCAL = struct.Struct("<4s5H3I2H")
_END = struct.Struct("<4s4H2IH")
_END64 = struct.Struct("<4sQ2H2I4Q")
_LOCATOR = struct.Struct("<4sIQI")
_ALLOWED_FLAGS = 0x0808
"""Sizes after the content, and names in UTF-8; no encryption."""
_NAME = re.compile(
    rb"([^/\\\x00-\x1f]{1,100})/(data\.pkl|version|byteorder|\.format_version|\.storage_alignment"
    rb"|\.data/serialization_id|data/[0-9]{1,4})"
)


class RefusedError(ValueError):
    """What is wrong with a file, as a phrase for the sentence that the user is told.

    A phrase may quote the file. Whatever stands there, the phrase is one short line of printable
    ASCII: no sign of a stranger reaches somebody's terminal as it is.
    """

    def __init__(self, phrase: str) -> None:
        """Spell what is not printable ASCII, and cut what is too long."""
        line = "".join(one if " " <= one <= "~" else ascii(one)[1:-1] for one in phrase)
        super().__init__(line if len(line) <= MAX_PHRASE else f"{line[: MAX_PHRASE - 3]}...")


def members(content: bytes) -> dict[str, memoryview]:
    """Return the content of each member by its name below the archive's folder; nothing is copied.

    Raises:
        RefusedError: this is not the zip that torch.save writes.
    """
    count, start, size = _directory(content)
    found: dict[str, memoryview] = {}
    spans: list[tuple[int, int]] = []
    folders: set[bytes] = set()
    for folder, name, begin, data_at, end, crc in _entries(content, count, start, size):
        if name in found:
            raise RefusedError(f"it holds {name} twice")
        folders.add(folder)
        spans.append((begin, end))
        found[name] = memoryview(content)[data_at:end]
        if zlib.crc32(found[name]) != crc:
            raise RefusedError(f"the content of {name} does not match its check sum")
    spans.sort()
    for (_, end), (begin, _) in pairwise(spans):
        if begin < end:
            raise RefusedError("its members overlap")
    if len(folders) != 1 or folders & {b".", b".."}:
        raise RefusedError("its members do not lie in one folder")
    return found


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
