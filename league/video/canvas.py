"""Drawing on a picture: text, panels and insets with soft edges, all blended in place."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from league.track.track import Rgb

WHITE: Rgb = (244, 246, 248)
DIM: Rgb = (168, 178, 188)
PANEL: Rgb = (13, 17, 23)
PANEL_OPACITY = 0.72
_LETTERS = 200  # longest text drawn; a longer one would not fit anyway


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
        cv2.putText(
            canvas,
            text[:_LETTERS],
            (size // 8, base),
            (255, 255, 255),
            _font(),
            size,
            weight=weight,
        )
    filled = np.flatnonzero(canvas[..., 0].any(axis=0))
    right = int(filled[-1]) + 2 if len(filled) else 1
    return np.ascontiguousarray(canvas[:, :right, 0])


def text_width(text: str, size: int, weight: int = 400) -> int:
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
) -> int:
    """Write a text with its top left (or top right) corner at x, y and return its width."""
    mask = text_mask(text, size, weight)
    left = x - mask.shape[1] if right else x
    _blend(picture, mask, left, y, colour, opacity)
    return mask.shape[1]


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
    x: int,
    y: int,
    width: int,
    height: int,
    *,
    radius: int,
    colour: Rgb = PANEL,
    opacity: float = PANEL_OPACITY,
) -> None:
    """Fill a rectangle with round corners."""
    _blend(picture, _rounded(width, height, radius), x, y, colour, opacity)


def put_picture(picture: np.ndarray, inset: np.ndarray, x: int, y: int, *, radius: int) -> None:
    """Lay a picture over another, with round corners."""
    height, width = inset.shape[:2]
    mask = _rounded(width, height, radius)
    region = picture[y : y + height, x : x + width]
    share = mask[: region.shape[0], : region.shape[1], None].astype(np.uint16)
    part = inset[: region.shape[0], : region.shape[1]]
    region[:] = ((part * share + region * (255 - share)) // 255).astype(np.uint8)


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
    part = mask[top - y : bottom - y, left - x : right - x, None].astype(np.uint16)
    share = (part * round(256 * opacity)) >> 8
    region[:] = ((np.array(colour, np.uint16) * share + region * (255 - share)) // 255).astype(
        np.uint8
    )
