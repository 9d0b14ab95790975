"""Track files: what they may say, how their YAML text is read and written, and load by name."""

import os
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from league.atomic_file import read_plain, replacing
from league.errors import TrackError, nearest_names
from league.track import build
from league.track.track import Colours, Track

MAX_BYTES = 1_000_000  # largest track file read [bytes]
MAX_POINTS = 2000  # most points in one list
MAX_COORDINATE = 1000.0  # largest coordinate [m]

_MAX_DEPTH = 4
_PACKAGE = Path(__file__).resolve().parents[1]

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Coordinate = Annotated[Number, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Point = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
Channel = Annotated[int, Field(strict=True, ge=0, le=255)]
Rgb = Annotated[list[Channel], Field(min_length=3, max_length=3)]
Part = Literal["road", "field", "line", "dash", "wall"]
Polyline = Annotated[list[Point], Field(min_length=2, max_length=MAX_POINTS)]


class TrackFile(BaseModel):
    """The content of a track file; lengths in metres, x to the east, y to the north."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_]{0,63}$")]
    # what a person calls it
    title: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")]
    # which way round it is driven, as the order of the points says; `open` does not return
    direction: Literal["counter-clockwise", "clockwise", "open"]
    width: Annotated[Number, Field(ge=0.3, le=4.0)]  # distance between the borders
    line: Literal["inside", "outside"]  # whether the white line lies inside the border, on the road
    line_width: Annotated[Number, Field(ge=0.0, le=0.3)] = 0.076
    start: Point | None = None  # where the start line crosses the centreline; None: points[0]
    colours: dict[Part, Rgb | None] = {}  # of the floor, sRGB 0-255; without: the default ones
    origin: Annotated[str, Field(max_length=2000)] = ""  # where the shape comes from
    # centreline in driving order; a smooth curve joins them, and a loop does not repeat the first
    points: Annotated[list[Point], Field(min_length=3, max_length=MAX_POINTS)]
    left: Polyline | None = None  # border on the driver's left; None: by points and width
    right: Polyline | None = None  # border on the driver's right
    # `waypoints` of reward functions, in driving order, of which a loop repeats the first as its
    # last; None: evenly spaced points of the centreline
    waypoints: Annotated[list[Point], Field(min_length=2, max_length=MAX_POINTS + 1)] | None = None

    @property
    def closed(self) -> bool:
        """Whether the track is a loop."""
        return self.direction != "open"


def folder() -> Path:
    """Return where the shipped tracks lie: in the wheel, or in a checkout next to the package."""
    inside = _PACKAGE / "_tracks"
    return inside if inside.is_dir() else _PACKAGE.parent / "tracks"


def names() -> list[str]:
    """Return the names of the shipped tracks, sorted."""
    return sorted(path.stem for path in folder().glob("*.yaml"))


def load(name_or_path: str | os.PathLike[str]) -> Track:
    """Load a shipped track by its name, or any track by the path of its .yaml file."""
    given = os.fspath(name_or_path)
    if given.endswith((".yaml", ".yml")) or os.sep in given or (os.altsep or os.sep) in given:
        return parse(_read_text(given), given)
    if given not in names():
        raise TrackError(
            f"there is no track {given!r}; {nearest_names(given, names())}; "
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

    `where` names it in error messages, such as its path.
    """
    return build.track(read(text, where), text, where)


def dump(track: Track) -> str:
    """Return the YAML text that gives the track again."""
    if track.text:
        return track.text
    left = np.linalg.norm(track.left - track.center, axis=1)
    right = np.linalg.norm(track.right - track.center, axis=1)
    even = np.ptp(np.concatenate([left, right])) < 2e-3
    usual = vars(Colours())
    colours: dict[Any, Any] = {
        part: list(rgb) for part, rgb in vars(track.colours).items() if tuple(rgb) != usual[part]
    }
    return write(
        TrackFile(
            name=track.name,
            title=track.title,
            direction=track.direction,
            width=round(track.width, 4),
            line="inside" if track.line_inside else "outside",
            line_width=track.line_width,
            colours=colours,
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


def _read_text(path: str) -> str:
    try:
        return read_plain(path, MAX_BYTES, TrackError, "a .yaml file").decode("utf-8")
    except UnicodeDecodeError as error:
        raise TrackError(
            f"{path} is not text: byte {error.start} is not UTF-8; a track file is YAML "
            "(for .npy arrays use `league tracks import`)"
        ) from None


def read(text: str, where: str) -> TrackFile:
    """Read YAML text; raise a TrackError with what is wrong and on which line."""
    if len(text) > MAX_BYTES:
        raise TrackError(
            f"{where} has {len(text):,} characters and a track file has at most {MAX_BYTES:,}; "
            "thin out its points"
        )
    try:
        root = _compose(text, where)
        content = yaml.SafeLoader("").construct_document(root)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        line = f"line {mark.line + 1}, " if mark is not None else ""
        problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "unreadable"
        raise TrackError(f"{where} is not YAML: {line}{problem}; correct it there") from None
    except (ValueError, OverflowError, TypeError, AttributeError, RecursionError) as error:
        raise TrackError(
            f"{where} holds a value that cannot be read ({error}); correct it"
        ) from None
    return _checked(content, where, root)


def built(content: dict[str, Any], where: str) -> Track:
    """Build the track of a file's content through its text, so that the text gives it again."""
    file = _checked(content, where)
    return build.track(file, write(file), where)


def _checked(content: object, where: str, root: yaml.Node | None = None) -> TrackFile:
    """Check a file's content; `root` is its YAML, for the line numbers of errors."""
    try:
        return TrackFile.model_validate(content)
    except ValidationError as error:
        raise TrackError(_reason(error, root, where)) from None


def _compose(text: str, where: str) -> yaml.MappingNode:
    """Parse to nodes without aliases, tags or deep nesting, which a track has no use for."""
    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    depth = 0
    for event in yaml.parse(text, Loader=loader):
        line = event.start_mark.line + 1
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None):
            raise TrackError(f"{where}, line {line}: anchors and aliases (& and *) are not allowed")
        if getattr(event, "tag", None):
            raise TrackError(f"{where}, line {line}: tags (!) are not allowed; write plain values")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > _MAX_DEPTH:
            raise TrackError(
                f"{where}, line {line}: lists nested {depth} deep; points are [[x, y], ...]"
            )
    root = yaml.compose(text, Loader=loader)
    if not isinstance(root, yaml.MappingNode):
        plain = "a list" if isinstance(root, yaml.SequenceNode) else "one plain value"
        raise TrackError(
            f"{where} is not a track file: it must hold fields such as `name: my_track`, "
            f"not {'nothing' if root is None else plain}"
        )
    seen: dict[str, int] = {}
    for key, _ in root.value:
        line = key.start_mark.line + 1
        if isinstance(key.value, str) and key.value in seen:
            raise TrackError(
                f"{where}, line {line}: `{_short(key.value)}` was given on line "
                f"{seen[key.value]} already; keep one"
            )
        seen[str(key.value)] = line
    return root


def _reason(error: ValidationError, root: yaml.Node | None, where: str) -> str:
    first = error.errors(include_url=False, include_context=False)[0]
    place = first["loc"]
    given = _short(repr(first["input"]))
    at_line = "" if root is None else f", line {_line_of(root, place)}"
    here = f"{where}{at_line}: `{_short(_path(place).removesuffix('.[key]'))}`"
    match first["type"]:
        case "missing":
            example = f"{place[-1]}: {_EXAMPLES.get(str(place[-1]), '...')}"
            return f"{where} lacks the field `{place[-1]}`; add a line such as `{example}`"
        case "extra_forbidden":
            return f"{here} is no field here; the fields are {', '.join(TrackFile.model_fields)}"
        case "literal_error" if place[-1] == "[key]":
            parts = ", ".join(vars(Colours()))
            return f"{here} is no field here; the fields are {parts}"
        case "too_short" | "too_long" if len(place) == 1 and place[0] in _LENGTHS:
            return f"{here} is {given}: give {_LENGTHS[place[0]]} points [x, y]"
        case _:
            return f"{here} is {given}: {_HINTS.get(str(place[0]), first['msg'])}"


_EXAMPLES = {
    "name": "my_track",
    "title": "My Track",
    "direction": "counter-clockwise",
    "width": "0.762",
    "line": "inside",
    "points": "[[0, 0], [3, 0], [3, 2], [0, 2]]",
}
_POINT = f"give points [x, y] as two finite numbers within {MAX_COORDINATE:g} m"
_HINTS = {
    "name": "give 1 to 64 letters, digits or underscores",
    "title": "give 1 to 100 characters on one line",
    "direction": "give counter-clockwise, clockwise or open",
    "width": "give a number from 0.3 to 4 m",
    "line": "give inside or outside",
    "line_width": "give a number from 0 to 0.3 m",
    "colours": "give each colour as [red, green, blue], whole numbers from 0 to 255",
    "origin": "give a text of at most 2000 characters",
    **dict.fromkeys(("start", "points", "left", "right", "waypoints"), _POINT),
}
_LENGTHS = {
    "points": f"3 to {MAX_POINTS}",
    "left": f"2 to {MAX_POINTS}",
    "right": f"2 to {MAX_POINTS}",
    "waypoints": f"2 to {MAX_POINTS + 1}",
}


def _path(place: tuple[int | str, ...]) -> str:
    """Write a place as a person would: points[3][0]."""
    text = ""
    for part in place:
        text += f"[{part}]" if isinstance(part, int) else f".{part}" if text else str(part)
    return text


def _line_of(root: yaml.Node, place: tuple[int | str, ...]) -> int:
    """Return the line, from 1, of the deepest node on the way to a place."""
    node: Any = root
    line = root.start_mark.line
    for part in place:
        if isinstance(node, yaml.MappingNode):
            pairs = [pair for pair in node.value if pair[0].value == str(part)]
            if not pairs:
                break
            key, node = pairs[0]
            line = key.start_mark.line
        elif isinstance(node, yaml.SequenceNode) and isinstance(part, int):
            node = node.value[part]
            line = node.start_mark.line
        else:
            break
    return line + 1


def _short(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:57]}..."


def write(file: TrackFile) -> str:
    """Write a track file's text: settings first, then a point a line, so that diffs stay small."""
    lines = [f"name: {file.name}", f"title: {_quoted(file.title)}", f"direction: {file.direction}"]
    lines += [f"width: {file.width!r}", f"line: {file.line}", f"line_width: {file.line_width!r}"]
    if file.start is not None:
        lines.append(f"start: {_pair(file.start)}")
    if file.colours:
        lines.append("colours:")
        lines += [f"  {part}: {rgb}" for part, rgb in file.colours.items() if rgb]
    if file.origin:
        lines.append(f"origin: {_quoted(file.origin)}")
    for field in ("points", "left", "right", "waypoints"):
        rows = getattr(file, field)
        if rows is not None:
            lines.append(f"{field}:")
            lines += [f"  - {_pair(row)}" for row in rows]
    return "\n".join(lines) + "\n"


def _pair(point: list[float]) -> str:
    return f"[{_number(point[0])}, {_number(point[1])}]"


def _number(value: float) -> str:
    """Write a number so that it is read as the same one: YAML takes 1e-05 for a text."""
    text = repr(value)
    return text if "." in text else text.replace("e", ".0e")


def _quoted(text: str) -> str:
    return yaml.safe_dump(text, default_style='"', width=10**9, allow_unicode=True).strip()
