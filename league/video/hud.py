"""Graphics over the picture: clock, lap counter, running order, events and the top view."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np

from league import times
from league.replay import Replay, broadcast
from league.sim.camera.scene import CAR_COLOURS
from league.sim.records import World
from league.track.markings import Plan
from league.track.track import Rgb
from league.video.pixels import mix
from league.video.stills import draw_things

WHITE: Rgb = (244, 246, 248)
DIM: Rgb = (168, 178, 188)
PANEL: Rgb = (13, 17, 23)
PANEL_OPACITY = 0.72
_LETTERS = 200  # longest text drawn; a longer one would not fit anyway

CAPTION_S = 2.6  # how long an event stays [s]
FADE_S = 0.25
SILENT = frozenset(
    {"start", "contact", "put_back", "lead_change", "attack", "side_by_side", "closest_fight"}
)
"""Lines of the story without a caption: the picture shows them."""
FIGHT_HZ = 5  # how often the gap of a fight changes: faster, it could not be read
NAME_LETTERS = 18

_MARGIN = 0.35  # how much of the field round the road the top view shows [m]
_LARGER = 1.6  # its cars are drawn this much larger than they are, to be seen
_DIMMED = 0.62

Chip = tuple[int, int, int]  # width, height and radius of its corners


class Hud:
    """Draws the broadcast's graphics for one replay at one size."""

    def __init__(self, replay: Replay, width: int, height: int, fights: tuple[str, ...]) -> None:
        self._replay, self._fights = replay, fights
        self._width, self._height = width, height
        self._unit = height / 720
        self._order = replay.running_order
        self._gaps = replay.gaps_s
        self._speeds = replay.speeds
        self._captions = [line for line in broadcast.of_replay(replay) if line.kind not in SILENT]
        self._finish = {car.car: car for car in replay.result.order if car.finished}
        self._top_view = TopView(replay, self._px(330), self._px(230))

    def draw(self, picture: np.ndarray, world: World, row: int, time_s: float) -> None:
        """Draw all graphics for one moment onto the picture."""
        frame = min(round(time_s * self._replay.step_hz), self._replay.num_frames - 1)
        self._draw_head(picture, frame, time_s)
        self._draw_order(picture, frame, time_s)
        self._draw_caption(picture, time_s)
        self._draw_fight(picture, frame)
        self._draw_map(picture, world, row)

    def draw_names(self, picture: np.ndarray, places: list[tuple[int, int, int]]) -> None:
        """Write each car's name above it, its middle at a pixel: (car, x, y)."""
        px = self._px
        for car, x, y in places if self._replay.num_cars > 1 else ():
            name = _short(self._replay.names[car])
            width = text_width(name, px(16), 500) + px(26)
            left, top = x - width // 2, y - px(26)
            put_panel(picture, (left, top, width, px(26)), px(8), opacity=0.55)
            self._draw_chip(picture, car, left + px(5), top + px(6), (5, 14, 2))
            put_text(picture, name, left + px(16), top + px(1), px(16), weight=500)

    def draw_result(self, picture: np.ndarray) -> None:
        """Draw the end card: the classification over the darkened picture."""
        px, result = self._px, self._replay.result
        picture //= 3
        row_height, width = px(44), px(760)
        height = px(112) + row_height * len(result.order)
        left, top = (self._width - width) // 2, (self._height - height) // 2
        put_panel(picture, (left, top, width, height), px(14), opacity=0.9)
        title = f"{self._replay.track.title}: {result.spec.kind.replace('_', ' ')}"
        put_text(picture, title[:44], left + px(28), top + px(14), px(28), weight=700)
        columns = {"total": px(470), "best lap": px(610), "penalty": width - px(28)}
        for name, x in columns.items():
            put_text(picture, name, left + x, top + px(58), px(17), DIM, right=True)
        for row, car in enumerate(result.order):
            y = top + px(90) + row * row_height
            self._draw_chip(picture, car.car, left + px(28), y + px(4), (30, 30, 7))
            self._draw_place(picture, car.place, left + px(43), y + px(6), px(19))
            put_text(picture, _short(car.name), left + px(76), y + px(4), px(22), weight=500)
            values = {
                "total": times.clock(car.total_s, 2) if car.finished else "not finished",
                "best lap": times.clock(car.best_lap_s, 2) if car.best_lap_s else "",
                "penalty": f"{car.penalty_s:.1f}" if car.penalty_s else "",
            }
            for name, value in values.items():
                put_text(picture, value, left + columns[name], y + px(5), px(20), right=True)

    def _px(self, units: float) -> int:
        """Return the pixels of a length in a picture 720 high."""
        return max(1, round(units * self._unit))

    def _draw_chip(
        self, picture: np.ndarray, car: int, x: int, y: int, size: Chip, opacity: float = 1.0
    ) -> None:
        """Draw a panel of a car's colour at a pixel; its size is that in a picture 720 high."""
        width, height, radius = map(self._px, size)
        put_panel(picture, (x, y, width, height), radius, CAR_COLOURS[car], opacity)

    @staticmethod
    def _draw_place(picture: np.ndarray, place: int, middle: int, y: int, size: int) -> None:
        """Write a place, dark, on a car's colour."""
        x = middle - text_width(str(place), size, 800) // 2
        put_text(picture, str(place), x, y, size, (16, 18, 22), weight=800)

    def _draw_head(self, picture: np.ndarray, frame: int, time_s: float) -> None:
        px = self._px
        laps = self._replay.spec.laps
        done = int(self._replay.columns.laps[frame].max())
        lap = f"LAP {min(done + 1, laps)}/{laps}" if done < laps else "FINISH"
        time_text = times.clock(min(time_s, self._replay.duration_s), 2)
        lap_width = text_width(lap, px(30), 700)
        width = lap_width + px(150)
        put_panel(picture, (px(24), px(24), width, px(56)), px(10))
        put_text(picture, lap, px(40), px(29), px(30), weight=700)
        x = px(24) + width - px(16)
        put_text(picture, time_text, x, px(34), px(24), DIM, weight=500, right=True)

    def _draw_order(self, picture: np.ndarray, frame: int, time_s: float) -> None:
        px = self._px
        row_height, width, top = px(36), px(300), px(90)
        rows = self._replay.num_cars
        put_panel(picture, (px(24), top, width, rows * row_height + px(12)), px(10))
        for place, car in enumerate(self._places(frame, time_s)):
            y = top + px(6) + place * row_height
            self._draw_chip(picture, car, px(34), y + px(5), (26, 26, 6))
            self._draw_place(picture, place + 1, px(47), y + px(6), px(17))
            name = _short(self._replay.names[car])
            put_text(picture, name, px(72), y + px(4), px(19), weight=500)
            value, colour = self._value(frame, time_s, car, place)
            x = px(24) + width - px(14)
            put_text(picture, value, x, y + px(5), px(17), colour, weight=500, right=True)

    def _places(self, frame: int, time_s: float) -> list[int]:
        """Return the cars by place: the finished by their time, then the rest by distance."""
        done = [car for car in self._finish.values() if car.total_s <= time_s + 1e-6]
        done_first = [car.car for car in sorted(done, key=lambda car: car.total_s)]
        if time_s >= self._replay.duration_s:
            return [car.car for car in self._replay.result.order]
        return done_first + [int(car) for car in self._order[frame] if car not in done_first]

    def _value(self, frame: int, time_s: float, car: int, place: int) -> tuple[str, Rgb]:
        """Return the text next to a name: time, penalty, speed or gap."""
        finish = self._finish.get(car)
        if finish is not None and finish.total_s <= time_s + 1e-6:
            return times.clock(finish.total_s, 2), WHITE
        penalty = float(self._replay.columns.penalty_s[frame, car])
        if penalty > 0:
            return f"penalty {penalty:.1f}", (255, 176, 60)
        if self._replay.num_cars == 1 or place == 0:
            return f"{self._speeds[frame, car]:.1f} m/s", DIM
        return f"+{self._gaps[frame, car]:.2f}", DIM

    def _draw_caption(self, picture: np.ndarray, time_s: float) -> None:
        current = [
            line for line in self._captions if line.time_s <= time_s < line.time_s + CAPTION_S
        ][-2:]
        px = self._px
        for row, line in enumerate(reversed(current)):
            age = time_s - line.time_s
            opacity = float(np.clip(min(age + 0.05, CAPTION_S - age) / FADE_S, 0.0, 1.0))
            y = self._height - px(78) - row * px(54)
            width = text_width(line.text, px(22), 500) + px(48)
            put_panel(picture, (px(24), y, width, px(46)), px(10), opacity=0.78 * opacity)
            self._draw_chip(picture, line.car, px(34), y + px(10), (6, 26, 3), opacity)
            put_text(picture, line.text, px(52), y + px(6), px(22), weight=500, opacity=opacity)

    def _draw_fight(self, picture: np.ndarray, frame: int) -> None:
        """Write who attacks which car and the gap in seconds, at the top of the picture."""
        every = max(1, self._replay.step_hz // FIGHT_HZ)
        text = self._fights[frame - frame % every]
        if not text:
            return
        px = self._px
        width = text_width(text, px(22), 600) + px(40)
        left = (self._width - width) // 2
        put_panel(picture, (left, px(24), width, px(46)), px(10))
        put_text(picture, text, left + px(20), px(30), px(22), weight=600)

    def _draw_map(self, picture: np.ndarray, world: World, row: int) -> None:
        px = self._px
        inset = self._top_view.draw(self._replay, world, row)
        height, width = inset.shape[:2]
        x, y = self._width - width - px(24), self._height - height - px(24)
        edge, colour = px(2), (235, 238, 240)
        frame = x - edge, y - edge, width + 2 * edge, height + 2 * edge
        put_panel(picture, frame, px(12), colour, opacity=0.85)
        # With round corners; a picture too small for it cuts it off.
        region = picture[y : y + height, x : x + width]
        shown = inset[: region.shape[0], : region.shape[1]]
        mix(region, shown, _rounded(width, height, px(11)), 256)


class TopView:
    """The whole track from above, small enough for a corner of the picture, with its cars."""

    def __init__(self, replay: Replay, width: int, height: int) -> None:
        """Paint the floor once, at most `width` pixels across and `height` down."""
        track = replay.track
        across, down = np.ptp(np.concatenate([track.left, track.right]), axis=0) + 2 * _MARGIN
        # A tall track lies on its side: the inset is wide.
        sideways = bool(down > 1.15 * across)
        across, down = (down, across) if sideways else (across, down)
        pixel = float(max(across / width, down / height))
        plan = Plan.of(track, pixel, _MARGIN, sideways=sideways)
        self._plan = replace(plan, picture=(plan.picture * _DIMMED).astype(np.uint8))

    def draw(self, replay: Replay, world: World, row: int) -> np.ndarray:
        """Return the picture of one world of a batch, RGB."""
        plan = replace(self._plan, picture=self._plan.picture.copy())
        draw_things(plan, replay.sim, world.row(row), size=_LARGER)
        return plan.picture


def _short(name: str) -> str:
    return name if len(name) <= NAME_LETTERS else name[: NAME_LETTERS - 1] + "\u2026"


@lru_cache(maxsize=1)
def _font() -> cv2.FontFace:
    return cv2.FontFace("sans")  # OpenCV's own copy of Rubik: nothing is looked up on the system


@lru_cache(maxsize=512)
def text_mask(text: str, size: int, weight: int) -> np.ndarray:
    """Return a text as coverage, uint8, of a height that depends only on the size."""
    height, base = round(size * 1.5), round(size * 1.1)
    width = max(1, round(len(text) * size * 1.2) + size)
    canvas = np.zeros((height, width, 3), np.uint8)
    if text:
        shown, place = text[:_LETTERS], (size // 8, base)
        cv2.putText(canvas, shown, place, (255, 255, 255), _font(), size, weight=weight)
    filled = np.flatnonzero(canvas[..., 0].any(axis=0))
    right = int(filled[-1]) + 2 if len(filled) else 1
    return np.ascontiguousarray(canvas[:, :right, 0])


def text_width(text: str, size: int, weight: int) -> int:
    """Return how many pixels a text takes across."""
    return text_mask(text, size, weight).shape[1]


def put_text(
    picture: np.ndarray,
    text: str,
    x: int,
    y: int,
    size: int,
    colour: Rgb = WHITE,
    *,
    weight: int = 400,
    right: bool = False,
    opacity: float = 1.0,
) -> None:
    """Write a text with its top left (or top right) corner at x, y."""
    mask = text_mask(text, size, weight)
    left = x - mask.shape[1] if right else x
    _blend(picture, mask, left, y, colour, opacity)


@lru_cache(maxsize=256)
def _rounded(width: int, height: int, radius: int) -> np.ndarray:
    fine = 4
    mask = np.zeros((height * fine, width * fine), np.uint8)
    r = max(0, min(radius, width // 2, height // 2)) * fine
    right, bottom = width * fine - 1, height * fine - 1
    cv2.rectangle(mask, (r, 0), (right - r, bottom), 255, -1)
    cv2.rectangle(mask, (0, r), (right, bottom - r), 255, -1)
    for x in (r, right - r):
        for y in (r, bottom - r):
            cv2.circle(mask, (x, y), r, 255, -1)
    return cv2.resize(mask, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)


def put_panel(
    picture: np.ndarray,
    box: tuple[int, int, int, int],
    radius: int,
    colour: Rgb = PANEL,
    opacity: float = PANEL_OPACITY,
) -> None:
    """Fill a rectangle with round corners; it is left, top, width and height."""
    x, y, width, height = box
    _blend(picture, _rounded(width, height, radius), x, y, colour, opacity)


def _blend(
    picture: np.ndarray, mask: np.ndarray, x: int, y: int, colour: Rgb, opacity: float
) -> None:
    """Mix a colour into the picture where the mask covers it; what lies outside is cut off."""
    height, width = picture.shape[:2]
    left, top = max(x, 0), max(y, 0)
    right, bottom = min(x + mask.shape[1], width), min(y + mask.shape[0], height)
    if left >= right or top >= bottom:
        return
    region = picture[top:bottom, left:right]
    paint = np.broadcast_to(np.array(colour, np.uint8), region.shape)
    mix(region, paint, mask[top - y : bottom - y, left - x : right - x], round(256 * opacity))
