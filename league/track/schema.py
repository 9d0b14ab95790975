"""What a track file may say, and how its YAML text is read and written."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from league.errors import TrackError

MAX_BYTES = 1_000_000
"""Largest track file read [bytes]."""
MAX_POINTS = 2000
"""Most points in one list."""
MAX_COORDINATE = 1000.0
"""Largest coordinate [m]."""

_MAX_DEPTH = 4

Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
Coordinate = Annotated[Number, Field(ge=-MAX_COORDINATE, le=MAX_COORDINATE)]
Point = Annotated[list[Coordinate], Field(min_length=2, max_length=2)]
Channel = Annotated[int, Field(strict=True, ge=0, le=255)]
Rgb = Annotated[list[Channel], Field(min_length=3, max_length=3)]
Polyline = Annotated[list[Point], Field(min_length=2, max_length=MAX_POINTS)]


class _Strict(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class ColoursFile(_Strict):
    """Colours of the floor, sRGB 0-255; what is left out keeps its default."""

    road: Rgb | None = None
    """The road."""
    field: Rgb | None = None
    """The ground beside it."""
    line: Rgb | None = None
    """The border lines."""
    dash: Rgb | None = None
    """The dashes along the centreline."""
    wall: Rgb | None = None
    """The wall round the room."""


class TrackFile(_Strict):
    """The content of a track file; lengths in metres, x to the east, y to the north."""

    name: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_]{0,63}$")]
    """Short name: letters, digits, underscore."""
    title: Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f\x7f]+$")]
    """What a person calls it."""
    direction: Literal["counter-clockwise", "clockwise", "open"]
    """Which way round it is driven, as the order of the points says; `open` does not return."""
    width: Annotated[Number, Field(ge=0.3, le=4.0)]
    """Distance between the borders [m]."""
    line: Literal["inside", "outside"]
    """Whether the white line lies inside the border, on the road, or outside it."""
    line_width: Annotated[Number, Field(ge=0.0, le=0.3)] = 0.076
    """Width of the white lines [m]."""
    start: Point | None = None
    """Where the start line crosses the centreline; the first of the points if left out."""
    colours: ColoursFile = Field(default_factory=ColoursFile)
    """Colours of the floor."""
    origin: Annotated[str, Field(max_length=2000)] = ""
    """Where the shape comes from."""
    points: Annotated[list[Point], Field(min_length=3, max_length=MAX_POINTS)]
    """Centreline in driving order; a smooth curve joins them. A loop does not repeat the first."""
    left: Polyline | None = None
    """Border on the driver's left; both borders follow from points and width if left out."""
    right: Polyline | None = None
    """Border on the driver's right."""
    waypoints: Annotated[list[Point], Field(min_length=2, max_length=MAX_POINTS + 1)] | None = None
    """What reward functions are told as `waypoints`, in driving order; evenly spaced points of the
    centreline if left out. Unlike `points`, a loop repeats its first as its last."""

    @property
    def closed(self) -> bool:
        """Whether the track is a loop."""
        return self.direction != "open"


def read(text: str, where: str) -> TrackFile:
    """Read YAML text, or say in one sentence what is wrong and on which line."""
    if len(text) > MAX_BYTES:
        raise TrackError(
            f"{where} has {len(text):,} characters and a track file has at most {MAX_BYTES:,}; "
            "thin out its points"
        )
    try:
        root = _compose(text, where)
        content = yaml.SafeLoader("").construct_document(root)
    except yaml.YAMLError as error:
        raise TrackError(f"{where} is not YAML: {_yaml_reason(error)}; correct it there") from None
    except (ValueError, OverflowError, TypeError, AttributeError, RecursionError) as error:
        raise TrackError(
            f"{where} holds a value that cannot be read ({error}); correct it"
        ) from None
    return checked(content, where, root)


def checked(content: object, where: str, root: yaml.Node | None = None) -> TrackFile:
    """Check a file's content; `root` is its YAML, to tell lines by."""
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
        raise TrackError(
            f"{where} is not a track file: it must hold fields such as `name: my_track`, "
            f"not {_kind(root)}"
        )
    _refuse_duplicates(root, where)
    return root


def _refuse_duplicates(root: yaml.MappingNode, where: str) -> None:
    seen: dict[str, int] = {}
    for key, _ in root.value:
        line = key.start_mark.line + 1
        if isinstance(key.value, str) and key.value in seen:
            raise TrackError(
                f"{where}, line {line}: `{_short(key.value)}` was given on line "
                f"{seen[key.value]} already; keep one"
            )
        seen[str(key.value)] = line


def _kind(node: yaml.Node | None) -> str:
    if node is None:
        return "nothing"
    return "a list" if isinstance(node, yaml.SequenceNode) else "one plain value"


def _yaml_reason(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    problem = getattr(error, "problem", None) or getattr(error, "reason", None) or "unreadable"
    return f"line {mark.line + 1}, {problem}" if mark is not None else str(problem)


def _reason(error: ValidationError, root: yaml.Node | None, where: str) -> str:
    """Put the first complaint into a sentence with the line it is about."""
    first = error.errors(include_url=False, include_context=False)[0]
    place = first["loc"]
    given = _short(repr(first["input"]))
    at_line = "" if root is None else f", line {_line_of(root, place)}"
    here = f"{where}{at_line}: `{_short(_path(place))}`"
    match first["type"]:
        case "missing":
            example = f"{place[-1]}: {_EXAMPLES.get(str(place[-1]), '...')}"
            return f"{where} lacks the field `{place[-1]}`; add a line such as `{example}`"
        case "extra_forbidden":
            model = TrackFile if len(place) == 1 else ColoursFile
            return f"{here} is no field here; the fields are {', '.join(model.model_fields)}"
        case "too_short" | "too_long":
            return f"{here} is {given}: {_LENGTHS.get(_family(place), first['msg'])}"
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
    "start": _POINT,
    "colours": "give each colour as [red, green, blue], whole numbers from 0 to 255",
    "origin": "give a text of at most 2000 characters",
    "points": _POINT,
    "left": _POINT,
    "right": _POINT,
    "waypoints": _POINT,
}
_LENGTHS = {
    "point": _POINT,
    "points": f"give 3 to {MAX_POINTS} points [x, y]",
    "left": f"give 2 to {MAX_POINTS} points [x, y]",
    "right": f"give 2 to {MAX_POINTS} points [x, y]",
    "waypoints": f"give 2 to {MAX_POINTS + 1} points [x, y]",
    "colours": _HINTS["colours"],
}


def _family(place: tuple[int | str, ...]) -> str:
    first, *rest = place
    if first == "start" or (rest and isinstance(rest[0], int)):
        return "point"
    return str(first)


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
            found = [pair for pair in node.value if pair[0].value == str(part)]
            if not found:
                break
            key, node = found[0]
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
    colours = file.colours.model_dump(exclude_none=True)
    if colours:
        lines.append("colours:")
        lines += [f"  {part}: {list(rgb)}" for part, rgb in colours.items()]
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
