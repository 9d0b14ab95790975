"""Track files: load by name or path, parse, write."""

from __future__ import annotations

import os
import stat
from dataclasses import asdict
from functools import lru_cache
from pathlib import Path

import numpy as np

from league.atomic_file import replacing
from league.errors import TrackError, nearest_names
from league.track import build, schema
from league.track.track import Colours, Track

_PACKAGE = Path(__file__).resolve().parents[1]


def folder() -> Path:
    """Return where the shipped tracks lie: in the wheel, or in a checkout beside the package."""
    inside = _PACKAGE / "_tracks"
    return inside if inside.is_dir() else _PACKAGE.parent / "tracks"


def names() -> list[str]:
    """Return the names of the shipped tracks, sorted."""
    return sorted(path.stem for path in folder().glob("*.yaml"))


def load(name_or_path: str | os.PathLike[str]) -> Track:
    """Load a shipped track by its name, or any track by the path of its .yaml file."""
    given = os.fspath(name_or_path)
    if _looks_like_path(given):
        return parse(_read_text(given), given)
    if given not in names():
        raise TrackError(
            f"there is no track {given!r}; nearest: {nearest_names(given, names())}; "
            "or give the path of a .yaml file"
        )
    return _shipped(given)


@lru_cache(maxsize=64)
def _shipped(name: str) -> Track:
    path = folder() / f"{name}.yaml"
    track = parse(_read_text(str(path)), str(path))
    if track.name != name:
        raise TrackError(f"{path}: name is {track.name!r}; name it as the file, {name!r}")
    return track


def parse(text: str, where: str = "the track") -> Track:
    """Build the track that YAML text describes; the same text gives the same bits.

    Args:
        text: content of a track file.
        where: how to call it in an error message, such as its path.
    """
    return build.track(schema.read(text, where), text, where)


def dump(track: Track) -> str:
    """Return the YAML text that gives the track again."""
    if track.text:
        return track.text
    left = np.linalg.norm(track.left - track.center, axis=1)
    right = np.linalg.norm(track.right - track.center, axis=1)
    even = np.ptp(np.concatenate([left, right])) < 2e-3
    default = asdict(Colours())
    colours = {k: list(v) for k, v in asdict(track.colours).items() if tuple(v) != default[k]}
    return schema.write(
        schema.TrackFile(
            name=track.name,
            title=track.title,
            direction=track.direction,
            width=round(track.width, 4),
            line="inside" if track.line_inside else "outside",
            line_width=track.line_width,
            colours=schema.ColoursFile(**colours),
            origin=track.origin,
            points=rounded(track.center, 4),
            left=None if even else rounded(track.left, 4),
            right=None if even else rounded(track.right, 4),
            waypoints=None if track.waypoints is None else track.waypoints.tolist(),
        )
    )


def rounded(points: np.ndarray, decimals: int) -> list[list[float]]:
    """Return points as lists of rounded numbers, ready for a track file."""
    # Adding zero turns -0.0 into 0.0.
    return (np.round(points, decimals) + 0.0).tolist()


def save(track: Track | str, path: str | os.PathLike[str]) -> None:
    """Write a track or its YAML text to a file, whole or not at all."""
    text = dump(track) if isinstance(track, Track) else track
    parse(text, "the track to be saved")
    with replacing(path, "the track", TrackError) as file:
        file.write_bytes(text.encode())


def report(track: Track) -> dict[str, str | float | int]:
    """Return the figures of a track for a listing; lengths in metres, a straight's radius inf."""
    return {
        "name": track.name,
        "title": track.title,
        "length": round(track.length, 2),
        "width": round(track.width, 3),
        "direction": track.direction,
        "min_radius": round(track.min_radius, 2) if track.min_radius < 1000 else float("inf"),
        "points": len(track.center),
    }


def _looks_like_path(given: str) -> bool:
    separators = {os.sep, os.altsep or os.sep}
    return given.endswith((".yaml", ".yml")) or any(mark in given for mark in separators)


def _read_text(path: str) -> str:
    try:
        content = _read_bytes(path)
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise TrackError(
            f"{path} is not text: byte {error.start} is not UTF-8; a track file is YAML "
            "(for .npy arrays use `league tracks import`)"
        ) from None
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise TrackError(f"cannot read {path}: {reason}; give the path of a .yaml file") from None


def _read_bytes(path: str) -> bytes:
    # Looked at before it is opened: opening a pipe would wait for ever.
    state = os.stat(path)
    if stat.S_ISDIR(state.st_mode):
        raise TrackError(f"{path} is a folder; give the path of a .yaml file in it")
    if not stat.S_ISREG(state.st_mode):
        raise TrackError(f"{path} is not a file; give the path of a .yaml file")
    with open(path, "rb") as file:
        content = file.read(schema.MAX_BYTES + 1)
    if len(content) > schema.MAX_BYTES:
        raise TrackError(
            f"{path} has {max(state.st_size, len(content)):,} bytes and a track file has at most "
            f"{schema.MAX_BYTES:,}; thin out its points"
        )
    return content
