"""What is written over the picture: clock, lap counter, running order, events, the top view."""

from __future__ import annotations

import numpy as np

from league.replay import Replay, story
from league.sim.camera.scene import CAR_COLOURS
from league.sim.world import World
from league.video import canvas
from league.video.topview import TopView

CAPTION_S = 2.6
"""How long an event stays [s]."""
FADE_S = 0.25
SILENT = frozenset({"start", "contact", "put_back", "lead_change"})
"""Events that the picture tells by itself."""
NAME_LETTERS = 18


class Hud:
    """Draws the broadcast's graphics for one replay at one size."""

    def __init__(self, replay: Replay, width: int, height: int) -> None:
        self._replay = replay
        self._width, self._height = width, height
        self._unit = height / 720
        self._order = story.running_order(replay)
        self._gaps = story.gaps_s(replay)
        self._speeds = story.speeds(replay)
        self._captions = [
            (event, text) for event, text in story.captions(replay) if event.kind not in SILENT
        ]
        self._finish = {car.car: car for car in replay.result.order if car.finished}
        self._top_view = TopView(replay, self._px(330), self._px(230))

    def draw(self, picture: np.ndarray, world: World, row: int, time_s: float) -> None:
        """Draw all graphics for one moment onto the picture."""
        frame = min(round(time_s * self._replay.step_hz), self._replay.num_frames - 1)
        self._draw_head(picture, frame, time_s)
        self._draw_order(picture, frame, time_s)
        self._draw_caption(picture, time_s)
        self._draw_map(picture, world, row)

    def _px(self, units: float) -> int:
        """Return a length given for a picture 720 high, in pixels of this one."""
        return max(1, round(units * self._unit))

    def _draw_head(self, picture: np.ndarray, frame: int, time_s: float) -> None:
        px = self._px
        laps = self._replay.spec.laps
        done = int(self._replay.columns.laps[frame].max())
        lap = f"LAP {min(done + 1, laps)}/{laps}" if done < laps else "FINISH"
        time_text = clock(min(time_s, self._replay.duration_s))
        lap_width = canvas.text_width(lap, px(30), 700)
        width = lap_width + px(150)
        canvas.put_panel(picture, px(24), px(24), width, px(56), radius=px(10))
        canvas.put_text(picture, lap, px(40), px(29), px(30), weight=700)
        x = px(24) + width - px(16)
        canvas.put_text(picture, time_text, x, px(34), px(24), canvas.DIM, weight=500, right=True)

    def _draw_order(self, picture: np.ndarray, frame: int, time_s: float) -> None:
        px = self._px
        row_height, width, top = px(36), px(300), px(90)
        rows = self._replay.num_cars
        canvas.put_panel(picture, px(24), top, width, rows * row_height + px(12), radius=px(10))
        for place, car in enumerate(self._places(frame, time_s)):
            y = top + px(6) + place * row_height
            canvas.put_panel(
                picture,
                px(34),
                y + px(5),
                px(26),
                px(26),
                radius=px(6),
                colour=CAR_COLOURS[car],
                opacity=1.0,
            )
            dark = (16, 18, 22)
            number = str(place + 1)
            middle = px(47) - canvas.text_width(number, px(17), 800) // 2
            canvas.put_text(picture, number, middle, y + px(6), px(17), dark, weight=800)
            name = self._replay.names[car]
            name = name if len(name) <= NAME_LETTERS else name[: NAME_LETTERS - 1] + "\u2026"
            canvas.put_text(picture, name, px(72), y + px(4), px(19), weight=500)
            told, colour = self._standing(frame, time_s, car, place)
            x = px(24) + width - px(14)
            canvas.put_text(picture, told, x, y + px(5), px(17), colour, weight=500, right=True)

    def _places(self, frame: int, time_s: float) -> list[int]:
        """Return the cars by place: the finished by their time, then the rest by distance."""
        done = [car for car in self._finish.values() if car.total_s <= time_s + 1e-6]
        done_first = [car.car for car in sorted(done, key=lambda car: car.total_s)]
        if time_s >= self._replay.duration_s:
            return [car.car for car in self._replay.result.order]
        return done_first + [int(car) for car in self._order[frame] if car not in done_first]

    def _standing(
        self, frame: int, time_s: float, car: int, place: int
    ) -> tuple[str, tuple[int, int, int]]:
        finish = self._finish.get(car)
        if finish is not None and finish.total_s <= time_s + 1e-6:
            return clock(finish.total_s), canvas.WHITE
        penalty = float(self._replay.columns.penalty_s[frame, car])
        if penalty > 0:
            return f"penalty {penalty:.1f}", (255, 176, 60)
        if self._replay.num_cars == 1 or place == 0:
            return f"{self._speeds[frame, car]:.1f} m/s", canvas.DIM
        return f"+{self._gaps[frame, car]:.2f}", canvas.DIM

    def _draw_caption(self, picture: np.ndarray, time_s: float) -> None:
        current = [
            (event, text)
            for event, text in self._captions
            if event.time_s <= time_s < event.time_s + CAPTION_S
        ][-2:]
        px = self._px
        for line, (event, text) in enumerate(reversed(current)):
            age = time_s - event.time_s
            opacity = float(np.clip(min(age + 0.05, CAPTION_S - age) / FADE_S, 0.0, 1.0))
            y = self._height - px(78) - line * px(54)
            width = canvas.text_width(text, px(22), 500) + px(48)
            canvas.put_panel(
                picture, px(24), y, width, px(46), radius=px(10), opacity=0.78 * opacity
            )
            canvas.put_panel(
                picture,
                px(34),
                y + px(10),
                px(6),
                px(26),
                radius=px(3),
                colour=CAR_COLOURS[event.car],
                opacity=opacity,
            )
            canvas.put_text(picture, text, px(52), y + px(6), px(22), weight=500, opacity=opacity)

    def _draw_map(self, picture: np.ndarray, world: World, row: int) -> None:
        px = self._px
        inset = self._top_view.draw(self._replay, world, row)
        height, width = inset.shape[:2]
        x, y = self._width - width - px(24), self._height - height - px(24)
        edge = px(2)
        canvas.put_panel(
            picture,
            x - edge,
            y - edge,
            width + 2 * edge,
            height + 2 * edge,
            radius=px(12),
            colour=(235, 238, 240),
            opacity=0.85,
        )
        canvas.put_picture(picture, inset, x, y, radius=px(11))


def clock(seconds: float) -> str:
    """Return a time as people read it on a timing screen: m:ss.mm."""
    hundredths = round(seconds * 100)
    return f"{hundredths // 6000}:{hundredths // 100 % 60:02d}.{hundredths % 100:02d}"
