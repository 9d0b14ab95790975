"""The floor of a room as a picture: field, road, white lines, dashes, start line.

Pixel (row, col) shows the square of the floor with its middle at
(origin_x + (col + 0.5) mpp, origin_y + (row + 0.5) mpp): rows grow with y, so seen as a picture it
is upside down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from league.errors import ConfigError
from league.track import spline
from league.track.track import Rgb, Track

DASH_WIDTH, DASH_LENGTH, DASH_PITCH = 0.025, 0.051, 0.102
"""Centre dashes [m]; the original's are 1 inch wide, 2 long and 4 apart."""
START_DEPTH, START_SQUARE = 0.1, 0.05
"""Depth of the checkered start line and the side of its squares [m]."""
START_COLOURS: tuple[Rgb, Rgb] = ((24, 24, 26), (226, 226, 222))  # the start line's two colours
ROAD_NOISE, FIELD_NOISE = 3.0, 6.0
"""Standard deviation of the texture, in levels of 255; gentler than the original's 8 and 22."""
MAX_PIXELS = 60_000_000  # largest picture of a floor

SHIFT = 4  # fractional bits of a drawn corner

_FINE = 3  # the drawing is this much finer than the picture: anti-aliasing
_TILE = 512  # side of the repeated noise tile [pixels]
_POSTER = (1600, 1000)  # largest picture of the floor on a poster [pixels]
_HEAD, _FRAME = 130, 30  # height of a poster's head, and width of its frame [pixels]
_PAPER: Rgb = (250, 249, 246)
_INK: Rgb = (28, 34, 42)
_SOFT_INK: Rgb = (104, 112, 120)
Colour = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class FloorPicture:
    """The painted floor of the rectangle `Track.room`."""

    image: np.ndarray  # uint8, shape (H, W) gray or (H, W, 3) RGB; rows grow with y, columns with x
    origin_x: float  # world x of the outer edge of column 0 [m]
    origin_y: float  # world y of the outer edge of row 0 [m]
    metres_per_pixel: float  # side of a pixel [m]

    def pixel_of(self, points: np.ndarray) -> np.ndarray:
        """Return (col, row) of world points [m]; whole numbers are pixel middles."""
        return (points - (self.origin_x, self.origin_y)) / self.metres_per_pixel - 0.5


def floor(track: Track, metres_per_pixel: float, *, colour: bool) -> FloorPicture:
    """Paint the floor of the track's room; gray is the Rec. 601 luma of the colours."""
    x_min, y_min, x_max, y_max = track.room
    if not metres_per_pixel > 0:
        raise ConfigError(f"metres_per_pixel is {metres_per_pixel}: give more than 0, such as 0.01")
    columns = int(np.ceil((x_max - x_min) / metres_per_pixel))
    rows = int(np.ceil((y_max - y_min) / metres_per_pixel))
    if rows * columns > MAX_PIXELS:
        raise ConfigError(
            f"a floor of {columns} x {rows} pixels is too large: give more metres per pixel than "
            f"{metres_per_pixel:g}"
        )
    fine = np.empty((rows * _FINE, columns * _FINE, 3), np.uint8)
    fine[0] = track.colours.field
    fine[1:] = fine[0]  # whole rows at a time: four times faster than pixels
    on_road = np.zeros((rows, columns), np.uint8)

    def fill(polygons: np.ndarray, image: np.ndarray, colour: Rgb | int) -> None:
        place = (polygons - (x_min, y_min)) * (len(image) / rows / metres_per_pixel) - 0.5
        for corners in np.round(place * (1 << SHIFT)).astype(np.int32):
            cv2.fillConvexPoly(image, corners, colour, lineType=cv2.LINE_8, shift=SHIFT)

    # Filled polygons spill over by half a fine pixel.
    painted = layers(track, 0.5 * metres_per_pixel / _FINE)
    for polygons, rgb in painted:
        fill(polygons, fine, rgb)
    for polygons, _ in painted[:2]:
        fill(polygons, on_road, 255)
    image = cv2.resize(fine, (columns, rows), interpolation=cv2.INTER_AREA)
    noise = np.tile(_noise_tile(), (rows // _TILE + 1, columns // _TILE + 1))[:rows, :columns]
    noise = noise * np.where(on_road > 0, np.float32(ROAD_NOISE), np.float32(FIELD_NOISE))
    image = cv2.add(image, cv2.merge([noise] * 3), dtype=cv2.CV_8U)
    if not colour:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    return FloorPicture(image, x_min, y_min, metres_per_pixel)


def _noise_tile() -> np.ndarray:
    """Return noise of unit variance that repeats at its edges, slightly blurred."""
    white = np.random.default_rng(2018).standard_normal((_TILE, _TILE)).astype(np.float32)
    # A Gaussian of 0.7 pixels along each axis, added in an order that no library decides.
    weights = np.exp(-0.5 / 0.7**2 * np.arange(4.0) ** 2)
    weights /= weights[0] + 2.0 * weights[1:].sum()
    soft = white
    for _ in range(2):
        wide = np.pad(soft, ((3, 3), (0, 0)), mode="wrap").astype(np.float64)
        blurred = wide[3:-3] * weights[0]
        for k in (3, 2, 1):
            blurred += (wide[3 - k : _TILE + 3 - k] + wide[3 + k : _TILE + 3 + k]) * weights[k]
        soft = blurred.astype(np.float32).T
    return soft / soft.std()


def layers(track: Track, spill: float = 0.0) -> list[tuple[np.ndarray, Rgb]]:
    """Return what is painted on the field, one over the other: quadrilaterals, (K, 4, 2), and RGB.

    White lines, road, each less `spill` [m] on either side; dashes, and the start line's squares.
    """
    inner, outer = (-track.line_width, 0.0) if track.line_inside else (0.0, track.line_width)
    painted = [
        (_strip(track, outer, spill), track.colours.line),
        (_strip(track, inner, spill), track.colours.road),
        (dashes(track), track.colours.dash),
    ]
    if track.closed:
        painted += zip(_start_squares(track), START_COLOURS, strict=True)
    return painted


def _strip(track: Track, wider: float, spill: float) -> np.ndarray:
    """Return the road as quadrilaterals, (K, 4, 2), each border moved out by `wider - spill` [m].

    Quadrilaterals of the two halves are filled one by one, so that folds of a tight bend overlap
    harmlessly; the clipped reach of such bends is widened to its surroundings first.
    """
    quads = []
    for side, border in ((1.0, track.left), (-1.0, track.right)):
        reach = np.linalg.norm(border - track.center, axis=1)
        direction = (border - track.center) / reach[:, None]
        reach = _unclipped(track, reach, side) + wider - spill
        edge = track.center + direction * reach[:, None]
        begin, end = spline.segments(track.center, closed=track.closed)
        edge_begin, edge_end = spline.segments(edge, closed=track.closed)
        folded = ((edge_end - edge_begin) * (end - begin)).sum(axis=1) < 0
        far, near = edge_end.copy(), edge_begin.copy()
        far[folded], near[folded] = edge_begin[folded], edge_end[folded]
        quads.append(np.stack([begin, end, far, near], axis=1))
    return np.concatenate(quads)


def _unclipped(track: Track, reach: np.ndarray, side: float) -> np.ndarray:
    """Undo the shortening of a border inside bends tighter than the half width."""
    spacing = float(track.segment_lengths.mean())
    points = max(1, round(2 * reach.max() / spacing))
    around = -_largest(-_largest(reach, points, track), points, track)  # closes narrow gaps
    bend = _largest(side * track.curvature, points, track)
    return np.where(bend * around > 0.5, around, reach)


def _largest(values: np.ndarray, points: int, track: Track) -> np.ndarray:
    """Return the largest value within so many points of each point of a track, (N,)."""
    around = np.pad(values, points, mode="wrap" if track.closed else "edge")
    return np.lib.stride_tricks.sliding_window_view(around, 2 * points + 1).max(axis=1)


def dashes(track: Track) -> np.ndarray:
    """Return the dashes along the centreline as rectangles, shape (K, 4, 2)."""
    count = max(1, round(track.length / DASH_PITCH))
    s = (np.arange(count) + 0.5) * (track.length / count)
    lines = np.concatenate([track.center, track.tangent], axis=1)
    if track.closed:
        lines = np.concatenate([lines, lines[:1]])
    knots = np.arange(len(lines)) * float(track.segment_lengths.mean())
    at = np.stack([spline.interpolate(s, knots, column) for column in lines.T], axis=1)  # (K, 4)
    middle, along = at[:, :2], at[:, 2:]
    return _rectangles(middle, along, DASH_LENGTH, DASH_WIDTH)


def _start_squares(track: Track) -> tuple[np.ndarray, np.ndarray]:
    """Return the dark and the bright squares of the start line, each of shape (K, 4, 2)."""
    along = track.tangent[0]
    across = np.array([-along[1], along[0]])
    reach = float(np.linalg.norm(track.left[0] - track.center[0]))
    width = reach + float(np.linalg.norm(track.right[0] - track.center[0]))
    count = max(2, round(width / START_SQUARE))
    side = width / count
    lateral = reach - (np.arange(count) + 0.5) * side
    squares: tuple[list[Any], list[Any]] = ([], [])
    for row in range(2):
        forward = (row - 0.5) * START_DEPTH / 2
        middle = track.center[0] + along * forward + across * lateral[:, None]
        boxes = _rectangles(middle, np.tile(along, (count, 1)), START_DEPTH / 2, side)
        squares[0].append(boxes[row::2])
        squares[1].append(boxes[1 - row :: 2])
    return np.concatenate(squares[0]), np.concatenate(squares[1])


def _rectangles(middle: np.ndarray, along: np.ndarray, length: float, width: float) -> np.ndarray:
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    ahead, aside = along * (length / 2), across * (width / 2)
    front, rear = middle + ahead, middle - ahead
    return np.stack([front + aside, rear + aside, rear - aside, front - aside], axis=1)


def placed(outline: np.ndarray, x: float, y: float, cos: float, sin: float) -> np.ndarray:
    """Return the world points [m] of an outline (ahead, left), (N, 2), at a place and heading."""
    return outline @ np.array([[cos, sin], [-sin, cos]]) + (x, y)


@dataclass(frozen=True, eq=False)
class Plan:
    """A rectangle of a track's floor seen from above, to draw on; what lies north is up."""

    picture: np.ndarray  # RGB uint8, shape (H, W, 3)
    # world place of the outer corner of the picture's upper left pixel [m], shape (2,)
    corner: np.ndarray
    pixel: float  # side of a pixel [m]
    sideways: bool = False  # a quarter turn to the left: what lies east is up

    @classmethod
    def of(
        cls, track: Track, pixel: float, margin: float | None = None, *, sideways: bool = False
    ) -> Plan:
        """Paint a track's whole room, or what lies within a margin round its road [m]."""
        ground = floor(track, pixel, colour=True)
        (left, bottom), (top, right) = (0, 0), ground.image.shape[:2]
        if margin is not None:
            outline = np.concatenate([track.left, track.right])
            ends = np.stack([outline.min(axis=0) - margin, outline.max(axis=0) + margin])
            ends = np.maximum(np.round(ground.pixel_of(ends) + 0.5).astype(int), 0)
            (left, bottom), (right, top) = ends.tolist()
        picture = ground.image[bottom:top, left:right]
        picture = picture.transpose(1, 0, 2)[::-1, ::-1] if sideways else picture[::-1]
        east = left + picture.shape[0] if sideways else left
        corner = np.array([ground.origin_x + east * pixel, ground.origin_y + top * pixel])
        return cls(np.ascontiguousarray(picture), corner, pixel, sideways)

    def framed(self, width: int, height: int, colour: Rgb) -> Plan:
        """Return the plan in the middle of a larger picture, with a frame of one colour."""
        down, across = height - self.picture.shape[0], width - self.picture.shape[1]
        edges = (down // 2, down - down // 2, across // 2, across - across // 2)
        picture = cv2.copyMakeBorder(self.picture, *edges, cv2.BORDER_CONSTANT, value=colour)
        corner = self.corner + np.array([-edges[2], edges[0]]) * self.pixel
        return replace(self, picture=picture, corner=corner)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return pixels of world points [m], (N, 2), as OpenCV takes them with `shift=SHIFT`."""
        east, north = (points - self.corner).T / self.pixel
        place = np.stack([-north, -east] if self.sideways else [east, -north], axis=1)
        return np.round((place - 0.5) * (1 << SHIFT)).astype(np.int32)

    def fill(self, outline: np.ndarray, colour: Colour) -> None:
        """Fill a polygon of world points [m], (N, 2)."""
        cv2.fillPoly(self.picture, [self.pixels(outline)], colour, cv2.LINE_AA, SHIFT)

    def edge(self, outline: np.ndarray, colour: Colour, thickness: int) -> None:
        """Draw the edge of a polygon of world points [m], (N, 2), `thickness` pixels wide."""
        points = [self.pixels(outline)]
        cv2.polylines(self.picture, points, True, colour, thickness, cv2.LINE_AA, SHIFT)


def poster(track: Track) -> np.ndarray:
    """Draw a track for people: north up, start line, direction, figures; RGB, shape (H, W, 3)."""
    x_min, y_min, x_max, y_max = track.room
    pixel = max((x_max - x_min) / _POSTER[0], (y_max - y_min) / _POSTER[1])
    plan = Plan.of(track, pixel)
    _chevrons(plan, track)
    edge = max(4, round(0.04 / pixel))
    height, width = (size + 2 * edge for size in plan.picture.shape[:2])
    plan = plan.framed(width, height, track.colours.wall)
    size = f"{track.length:.2f} m long   {track.width:.3f} m wide"
    about = f"{size}   {track.direction}   {track.bends}"
    # Right of the text there is room for the north arrow.
    text = max(_text_width(track.title, 46, bold=True), _text_width(about, 26)) + 80
    wide = max(width, min(text, 4 * _POSTER[0]), 900 - 2 * _FRAME) + 2 * _FRAME
    sheet = np.full((_HEAD + height + _FRAME, wide, 3), _PAPER, np.uint8)
    left = (sheet.shape[1] - width) // 2
    sheet[_HEAD : _HEAD + height, left : left + width] = plan.picture
    _write(sheet, track.title, (_FRAME, 62), 46, _INK, bold=True)
    _write(sheet, about, (_FRAME, 106), 26, _SOFT_INK)
    metres = next((m for m in (1, 2, 5, 10, 20) if m / pixel > 120), 20)
    x, y = left + edge + 24, sheet.shape[0] - _FRAME - edge - 24
    for thickness, rgb in ((8, _INK), (4, _PAPER)):
        cv2.line(sheet, (x, y), (x + round(metres / pixel), y), rgb, thickness, cv2.LINE_AA)
    _write(sheet, f"{metres} m", (x, y - 16), 24, _PAPER)
    x, y = sheet.shape[1] - _FRAME - 26, 84
    needle = np.array([[x, y - 40], [x + 13, y], [x, y - 9], [x - 13, y]], np.int32)
    cv2.fillPoly(sheet, [needle], _SOFT_INK, lineType=cv2.LINE_AA)
    _write(sheet, "N", (x - 8, y + 26), 24, _SOFT_INK)
    return sheet


def png(image: np.ndarray) -> bytes:
    """Encode an RGB picture as PNG."""
    return cv2.imencode(".png", cv2.cvtColor(image, cv2.COLOR_RGB2BGR))[1].tobytes()


def _chevrons(plan: Plan, track: Track) -> None:
    """Point out the driving direction with three marks beyond the start line."""
    spacing = float(track.segment_lengths.mean())
    size = 0.2 * track.width
    plain = plan.picture.copy()
    for number in range(3):
        ahead = 0.3 + size * (0.6 + 2.0 * number)
        row = min(round(ahead / spacing), len(track.center) - 1)
        outline = np.array([(-1, 1.2), (0, 1.2), (1, 0), (0, -1.2), (-1, -1.2), (0, 0)])
        plan.fill(placed(size * outline, *track.center[row], *track.tangent[row]), (255, 255, 255))
    cv2.addWeighted(plan.picture, 0.85, plain, 0.15, 0.0, dst=plan.picture)


def _write(
    sheet: np.ndarray, text: str, place: tuple[int, int], size: int, rgb: Rgb, *, bold: bool = False
) -> None:
    """Write text with its base line at a place."""
    cv2.putText(sheet, text, place, rgb, cv2.FontFace("sans"), size, 700 if bold else 400)


def _text_width(text: str, size: int, *, bold: bool = False) -> int:
    font, weight = cv2.FontFace("sans"), 700 if bold else 400
    return cv2.getTextSize((0, 0), text, (0, 0), font, size, weight)[2]
