"""Pictures for people: the chase camera and the view from above."""

import numpy as np
import pytest

from league.sim.camera.scene import CAR_COLOURS
from league.video.stills import chase_view, top_view
from tests.sim.looking import room, settings, world


def nearness(image: np.ndarray, colour: tuple) -> np.ndarray:
    return np.abs(image.astype(int) - np.array(colour)).max(axis=-1)


def test_chase_view_looks_along_the_car_which_is_low_in_the_middle():
    now = world(room(), [(0, 0, 0.5), (1.5, 1.5, 0)])
    image = chase_view(room(), settings(2), now, 0, 0, 320, 180)
    assert image.shape == (180, 320, 3) and image.dtype == np.uint8
    lines, columns = np.nonzero(nearness(image, CAR_COLOURS[0]) < 40)
    assert abs(columns.mean() - 160) < 5
    assert 90 < lines.mean() < 170


def test_chase_camera_stays_inside_the_room():
    now = world(room(half=3.0), [(2.7, 2.7, -2.4)])  # the camera would be beyond the corner
    image = chase_view(room(half=3.0), settings(1), now, 0, 0, 160, 90)
    assert (nearness(image, CAR_COLOURS[0]) < 40).sum() > 200


@pytest.mark.parametrize("size", [(320, 240), (640, 200)])
def test_top_view_shows_each_car_where_it_is(size):
    width, height = size
    now = world(room(half=4.0), [(3.0, 2.0, 0), (-3.0, -1.0, 1)])
    image = top_view(room(half=4.0), settings(2), now, 0, width, height)
    assert image.shape == (height, width, 3)
    scale = 0.97 * min(width, height) / 8.0  # the room is 8 m on each side
    for slot, (x, y) in enumerate([(3.0, 2.0), (-3.0, -1.0)]):
        line, column = round(height / 2 - y * scale), round(width / 2 + x * scale)
        near = image[line - 3 : line + 4, column - 3 : column + 4]
        assert (nearness(near, CAR_COLOURS[slot]) < 60).any()


def test_rows_choose_the_world():
    now = world(room(), [[(0, 0, 0)], [(2, 1, 1)]])
    first, second = (top_view(room(), settings(1), now, k, 160, 120) for k in (0, 1))
    assert not np.array_equal(first, second)
