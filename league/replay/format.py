"""The replay file: written whole or not at all, read with every size checked (docs/replay.md)."""

import math
import os
import struct
import zlib
from pathlib import Path

import numpy as np
from pydantic import Field, ValidationError, model_validator

from league.atomic_file import read_plain, replacing
from league.errors import ReplayError, TrackError, first_problem
from league.race_spec import FrozenModel, RaceResult, of_older_version
from league.replay.replay import GRAINS, PARAMETERS, Columns, Grain, Replay, from_whole, to_whole
from league.sim.config import MAX_CARS
from league.track import files

MAGIC = b"\x89RACE\r\n\x1a"
"""Like PNG's: a text transfer breaks the line end, `type` stops at the last byte."""
VERSION = 2
"""Version 2 adds height, roll, pitch and the version of the physics; version 1 is read too."""
PREFIX = struct.Struct("<8sHHIII")
"""Magic, version, zero, bytes of header, bytes of body, CRC-32 of header and body."""

MAX_FILE = 64 * 2**20  # largest file read [bytes]; the longest race allowed takes about 50 MB
MAX_HEADER = 16 * 2**20  # largest header, unpacked [bytes]
MAX_BODY = 256 * 2**20  # largest body, unpacked [bytes]; 8 cars for 10 hours take 207 MB
MAX_FRAMES = 36_000 * 15 + 1  # most frames: the longest race a spec may ask for, at 15 Hz
MIN_BYTES_PER_FRAME = 3
"""Every frame carries a checksum, which does not compress, so a smaller body is a bomb."""


class _Header(FrozenModel):
    """All but the columns."""

    frames: int = Field(ge=1, le=MAX_FRAMES)
    cars: int = Field(ge=1, le=MAX_CARS)
    obstacles: int = Field(ge=0, le=32)
    obstacle_frames: int = Field(ge=1, le=MAX_FRAMES)
    step_hz: int = Field(ge=1, le=1000)
    names: tuple[str, ...] = Field(max_length=MAX_CARS)
    track: str = Field(min_length=1, max_length=2**20)
    league: str = Field(default="", max_length=40)
    physics: str = Field(default="", max_length=40)
    result: RaceResult

    @model_validator(mode="before")
    @classmethod
    def _with_rules(cls, header: object) -> object:
        """Read the spec of an older version, which names no rules, as it was meant."""
        match header:
            case {"result": {"spec": {**spec}, **result}, **others} if "rules" not in spec:
                return {**others, "result": {**result, "spec": of_older_version(spec)}}
        return header

    def problem(self) -> str | None:
        """Return a contradiction, or None."""
        if self.obstacle_frames not in (1, self.frames):
            return f"{self.obstacle_frames} frames of obstacles, but 1 or {self.frames} fit"
        if not len(self.names) == len(self.result.spec.entries) == self.cars:
            return f"{self.cars} cars, but {len(self.names)} names"
        if sorted(car.car for car in self.result.order) != list(range(self.cars)):
            return f"{self.cars} cars, but a classification of others"
        if not all(0 <= event.car < self.cars for event in self.result.events):
            return f"{self.cars} cars, but events of others"
        return None


def encode(replay: Replay) -> bytes:
    """Return the bytes of a replay's file."""
    columns = replay.columns
    header = _Header(
        frames=replay.num_frames,
        cars=replay.num_cars,
        obstacles=columns.num_obstacles,
        obstacle_frames=len(columns.obstacle_x),
        step_hz=replay.step_hz,
        names=replay.names,
        track=files.dump(replay.track),
        league=replay.league_version,
        physics=replay.physics,
        result=replay.result,
    )
    packed_header = zlib.compress(header.model_dump_json().encode(), 9)
    parts = [_pack(name, grain, getattr(columns, name)) for name, grain in GRAINS.items()]
    floats = replay.parameters, replay.obstacle_sizes
    parts += [numbers.astype("<f4").tobytes() for numbers in floats]
    parts.append(columns.checksum.astype("<u4").tobytes())
    packed_body = zlib.compress(b"".join(parts), 9)
    crc = zlib.crc32(packed_body, zlib.crc32(packed_header))
    prefix = PREFIX.pack(MAGIC, VERSION, 0, len(packed_header), len(packed_body), crc)
    return prefix + packed_header + packed_body


def write(replay: Replay, path: str | os.PathLike[str]) -> Path:
    """Write a replay to a file, whole or not at all, and return the path."""
    content = encode(replay)
    with replacing(path, "the replay", ReplayError) as file:
        file.write_bytes(content)
    return Path(path)


def read(path: str | os.PathLike[str]) -> Replay:
    """Read a replay from a file; anything but a sound replay raises ReplayError."""
    content = read_plain(path, MAX_FILE, ReplayError, "a replay")
    try:
        return decode(content)
    except ReplayError as error:
        raise ReplayError(f"{os.fspath(path)} {error}") from error


def decode(content: bytes) -> Replay:
    """Return the replay that these bytes are; the error's text begins with a verb."""
    version, packed_header, packed_body = _split(content)
    raw_header = _unpack(packed_header, MAX_HEADER, "header")
    try:
        header = _Header.model_validate_json(raw_header)
    except ValidationError as error:
        first, where, _ = first_problem(error, "its text")
        reason = f"{where}: {first['msg']}"
        raise _broken(f"has a header that does not describe a race ({reason})") from error
    if problem := header.problem():
        raise _broken(f"contradicts itself ({problem})")
    columns = sum(_size(grain, header) for grain in GRAINS.values() if grain.since <= version)
    size = columns + 4 * (header.cars * len(PARAMETERS) + 2 * header.obstacles + header.frames)
    if size > MAX_BODY or len(packed_body) < MIN_BYTES_PER_FRAME * header.frames:
        raise ReplayError(
            f"declares {header.frames} frames of {header.cars} cars in {len(packed_body)} bytes, "
            "which no race fills: it was not written by this league"
        )
    body = _unpack(packed_body, size, "body")
    if len(body) != size:
        raise _broken(f"holds {len(body)} bytes of columns where its header declares {size}")
    return _assemble(header, version, body)


def _broken(fault: str) -> ReplayError:
    """Return the error of a file that is not as it was written."""
    return ReplayError(f"{fault}: copy the whole file again from where the race was run")


def _split(content: bytes) -> tuple[int, bytes, bytes]:
    """Check everything outside the two packed parts; return the version and the two."""
    if len(content) > MAX_FILE:
        raise ReplayError(
            f"is larger than {MAX_FILE >> 20} MiB, as no replay is: give another file"
        )
    if not content:
        raise _broken("is empty")
    if not MAGIC.startswith(content[: len(MAGIC)]):
        raise ReplayError("is not a replay: give a file that `league race` wrote")
    if len(content) < PREFIX.size:
        raise _broken("ends after a few bytes")
    _, version, zero, header_size, body_size, crc = PREFIX.unpack_from(content)
    if not 1 <= version <= VERSION or zero != 0:
        raise ReplayError(
            f"is of version {version}, and this league reads versions 1 to {VERSION}: "
            "read it with the league that wrote it"
        )
    whole = PREFIX.size + header_size + body_size
    if len(content) < whole:
        raise _broken(f"ends after {len(content)} of {whole} bytes")
    if len(content) > whole:
        raise _broken(f"goes on for {len(content) - whole} bytes after its end")
    if zlib.crc32(content[PREFIX.size :]) != crc:
        raise _broken("is damaged (its checksum differs)")
    middle = PREFIX.size + header_size
    return version, content[PREFIX.size : middle], content[middle:]


def _unpack(packed: bytes, limit: int, what: str) -> bytes:
    """Decompress, never holding more than one byte beyond the limit."""
    unpacker = zlib.decompressobj()
    try:
        raw = unpacker.decompress(packed, limit + 1)
    except zlib.error as error:
        raise _broken(f"has a {what} that cannot be unpacked") from error
    if len(raw) > limit:
        raise _broken(f"has a {what} of more than the {limit} bytes allowed")
    if not unpacker.eof or unpacker.unused_data:
        raise _broken(f"has a {what} of another length than declared")
    return raw


def _rows(grain: Grain, header: _Header) -> tuple[int, ...]:
    """Return the shape of a column."""
    if grain.axis == "obstacles":
        return (header.obstacle_frames, header.obstacles)
    if grain.axis == "actions":
        return (header.frames, header.cars, 2)
    return (header.frames, header.cars)


def _size(grain: Grain, header: _Header) -> int:
    return math.prod(_rows(grain, header)) * (2 if grain.wraps else 4)


def _pack(name: str, grain: Grain, column: np.ndarray) -> bytes:
    """Return whole numbers' differences, cars first, the low bytes of all before the high bytes."""
    whole = to_whole(grain, column)
    kind = np.dtype("<i2" if grain.wraps else "<i4")
    if whole.size and not np.iinfo(kind).min <= whole.min() <= whole.max() <= np.iinfo(kind).max:
        raise ReplayError(f"the race's column {name} is too large to be kept in {kind}")
    steps = whole.astype(kind)
    for _ in range(grain.order):
        # Differences wrap around like the sums that undo them, so none can overflow.
        steps = np.diff(steps, axis=0, prepend=np.zeros_like(steps[:1]))
    steps = np.ascontiguousarray(np.moveaxis(steps, 0, -1), dtype=kind)
    return steps.reshape(-1, 1).view(np.uint8).T.tobytes()


def _unfold(grain: Grain, raw: bytes, shape: tuple[int, ...]) -> np.ndarray:
    """Undo `_pack`."""
    kind = np.dtype("<i2" if grain.wraps else "<i4")
    planes = np.frombuffer(raw, dtype=np.uint8).reshape(kind.itemsize, -1)
    steps = np.ascontiguousarray(planes.T).view(kind).reshape(*shape[1:], shape[0])
    whole = np.moveaxis(steps, -1, 0)
    for _ in range(grain.order):
        whole = np.cumsum(whole, axis=0, dtype=kind)
    return from_whole(grain, whole.astype(np.int64))


def _assemble(header: _Header, version: int, body: bytes) -> Replay:
    at = 0
    kept: dict[str, np.ndarray] = {}
    for name, grain in GRAINS.items():
        if grain.since > version:
            kept[name] = np.zeros(_rows(grain, header))
            continue
        size = _size(grain, header)
        kept[name] = _unfold(grain, body[at : at + size], _rows(grain, header))
        at += size
    floats = np.frombuffer(body, "<f4", header.cars * len(PARAMETERS) + 2 * header.obstacles, at)
    checksum = np.frombuffer(body, "<u4", header.frames, at + floats.nbytes)
    if not np.isfinite(floats).all():
        raise _broken("holds parameters that are not numbers")
    split = header.cars * len(PARAMETERS)
    try:
        track = files.parse(header.track)
    except TrackError as error:
        raise _broken(f"carries a broken track ({error})") from error
    return Replay(
        result=header.result,
        track=track,
        names=header.names,
        step_hz=header.step_hz,
        parameters=floats[:split].reshape(header.cars, len(PARAMETERS)).astype(np.float32),
        obstacle_sizes=floats[split:].reshape(header.obstacles, 2).astype(np.float32),
        columns=Columns(checksum=checksum.astype(np.uint32), **kept),
        league_version=header.league,
        physics=header.physics,
    )
