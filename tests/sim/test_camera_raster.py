"""The compiled painter by hand-worked pixels."""

import math

import numpy as np
import pytest
from numba import njit

from league.sim.camera import painting, raster
from league.sim.camera.ground import texels
from league.sim.camera.renderer import _part, models
from league.sim.camera.scene import CAR, DECK, FAR_CAR, MODELS
from league.sim.camera.tables import THING_COLUMNS, Optics, Pose, Room, Texture


@njit
def draw_room(pictures, optics, view, room, things, far, models):
    raster.draw_room(pictures, optics, view, room, things, far, models)


@njit
def draw_floor(pictures, start, stop, texture, optics, view):
    painting.draw_floor(pictures, start, stop, texture, optics, view)


def optics(channels=1, eyes=(0.0,), focal=10.0, cx=4.5, cy=4.5):
    return Optics(focal, cx, cy, np.array(eyes), channels, 0.02)


def level(z=1.0) -> Pose:
    """Return a camera at the origin that looks along +x, level."""
    return Pose(0.0, 0.0, z, 1.0, 0.0, 1.0, 0.0)


def room(colours=(10, 20, 30, 40), half=5.0, height=2.0):
    table = np.zeros((4, 3), np.uint8)
    table[:, 0] = colours
    return Room(-half, -half, half, half, height, table)


def drawn(things=(), walls=None, size=10, channels=1, pose=None, **lens) -> np.ndarray:
    pictures = np.full((1, size, size * channels), 99, np.uint8)
    table = np.array(things, float).reshape(-1, THING_COLUMNS)
    draw_room(
        pictures,
        optics(channels, **lens),
        pose or level(),
        walls or room(),
        table,
        1e9,
        models(channels == 1),
    )
    return pictures[0].reshape(size, size, channels)


def box(x, y, size, shade) -> tuple:
    return (2, x, y, 1.0, 0.0, 0.0, size, size, size, shade, shade, shade, 0.0, 0.0, 0.0)


def test_a_wall_fills_the_pixels_whose_centres_it_covers():
    # The wall at x = 5 is 2 m high, the eye 1 m up: rows 4.5 -+ 10 / 5 = 2.5 to 6.5, so 3 to 6.
    seen = drawn()[..., 0]
    assert (seen[3:7] == 20).all()
    assert (seen[:3] == 99).all() and (seen[7:] == 99).all()


def test_walls_that_meet_in_a_corner_leave_no_pixel_between_them():
    # Turned by 45 degrees the corner at (5, 5) is straight ahead.
    turned = Pose(0.0, 0.0, 1.0, math.sqrt(0.5), math.sqrt(0.5), 1.0, 0.0)
    seen = drawn(pose=turned)[4, :, 0]
    assert set(seen[:5].tolist()) == {30} and set(seen[5:].tolist()) == {20}


def test_a_box_covers_the_wall_behind_it_and_the_nearer_box_the_farther_one():
    # Each front face is 2 m ahead and 1 m wide: 5 pixels about column 4.5, rows 4.5 to 9.5.
    seen = drawn([box(2.5, 0.0, 1.0, 200.0)])[..., 0]
    assert (seen[5:10, 2:7] == 200).all()
    assert not (seen[:, :2] == 200).any() and not (seen[:, 7:] == 200).any()
    for order in ([0, 1], [1, 0]):
        two = [box(2.5, 0.0, 1.0, 200.0), box(4.0, 0.0, 1.0, 100.0)]
        seen = drawn([two[index] for index in order])[..., 0]
        assert (seen[5:10, 2:7] == 200).all()


def test_what_reaches_behind_the_camera_is_cut_and_not_mirrored():
    # A box about the camera's left shoulder: its right side at y = 0.2 runs past the eye and ends
    # 0.5 m ahead, at column 4.5 - 10 * 0.2 / 0.5 = 0.5.
    seen = drawn([box(0.0, 0.7, 1.0, 200.0)], pose=level(0.5))[..., 0]
    assert seen[4, 0] == 200
    assert not (seen[:, 1:] == 200).any()


def test_in_colour_each_channel_gets_its_own_value():
    colours = np.array([[1, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, 12]], np.uint8)
    walls = Room(-5.0, -5.0, 5.0, 5.0, 2.0, colours)
    assert (drawn(walls=walls, channels=3)[4, 4] == (4, 5, 6)).all()


@pytest.mark.parametrize("channels", [1, 3])
def test_floor_is_the_bilinear_mean_of_four_texels(channels):
    # Straight down from 1 m with focal length 10, a pixel is 0.1 m and so is a texel. The camera at
    # (1.025, 1.05): a column's centre lies 1/4 texel right of one, a row's 1/2 above one.
    draw = np.random.default_rng(4)
    image = draw.integers(0, 256, (20, 20, channels), dtype=np.uint8)
    texture = Texture(texels(image.squeeze()), 20, 0.0, 0.0, 0.1)
    down = Pose(1.025, 1.05, 1.0, 1.0, 0.0, 0.0, 1.0)
    pictures = np.zeros((1, 9, 9 * channels), np.uint8)
    draw_floor(pictures, 0, 9, texture, optics(channels, cx=4.0, cy=4.0), down)
    # Row 4, column 4 is the camera's own foot: texel (1.025 / 0.1 - 0.5, 1.05 / 0.1 - 0.5). Rows go
    # towards -x and columns towards -y.
    got = pictures.reshape(9, 9, channels)
    for row, column in ((4, 4), (0, 0), (8, 3)):
        x, y = 9.75 - (row - 4), 10.0 - (column - 4)
        low, line = math.floor(x), round(y)
        wished = 0.25 * image[line, low].astype(float) + 0.75 * image[line, low + 1]
        assert got[row, column] == pytest.approx(wished, abs=1.5)


def test_floor_beyond_the_texture_repeats_its_rim_and_reads_nothing_outside():
    image = np.full((4, 4), 77, np.uint8)
    texture = Texture(image.reshape(-1), 4, 0.0, 0.0, 0.1)
    pictures = np.zeros((1, 10, 10), np.uint8)
    level_ = level(1.0)
    draw_floor(pictures, 5, 10, texture, optics(), level_._replace(x=1e7, y=-1e7))
    draw_floor(pictures, 0, 5, texture, optics(), level_)  # above the horizon
    assert (pictures == 77).all()


@pytest.mark.parametrize("rounding", [-1e-15, 0.0, 1e-15])
def test_of_planes_with_equal_gaps_the_first_parts_whatever_the_rounding(rounding):
    planes = np.array([[1.0, 0.0, 0.0, 0.5], [0.0, 1.0, 0.0, 0.5]])
    reach = np.array([0.25, 0.25 + rounding])  # of either solid from either plane
    rows = np.zeros((2, 2, 4))
    _part(rows, [0, 1], planes, np.stack([-2 * reach, reach]), np.stack([-reach, 2 * reach]))
    assert rows[0, 1].tolist() == planes[0].tolist()
    assert rows[1, 0].tolist() == (-planes[0]).tolist()


@njit
def ordered(first, last, x, y, z, tables):
    return raster._order(first, last, x, y, z, tables)


@pytest.mark.parametrize("model", MODELS)
def test_solids_are_painted_behind_what_their_parting_plane_puts_before_them(model):
    tables = models(True)
    first, last, _ = tables.models[MODELS.index(model)]
    draw = np.random.default_rng(2)
    eyes = draw.uniform((-2, -2, 0.01), (2, 2, 0.5), (400, 3))
    # Eyes that lie in a plane that parts two solids see neither before the other.
    eyes[::5, 2], eyes[1::5, 1] = DECK, 0.044
    for eye in eyes:
        order = ordered(first, last, *eye, tables).tolist()
        assert sorted(order) == list(range(last - first))
        for one in range(last - first):
            for other in range(last - first):
                plane = tables.parting[first + one, other]
                # The second lies beyond the plane, and the eye on the side of the first.
                if one != other and plane[:3] @ eye < plane[3] - 1e-9:
                    assert order.index(other) < order.index(one)


def test_planes_part_a_car_whichever_way_its_wheels_stand():
    tables = models(True)
    first, last, far = tables.models[MODELS.index(CAR)]
    assert far == MODELS.index(FAR_CAR)
    for angle in (-math.radians(30), 0.1, math.radians(30)):
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        for one in range(last - first):
            start, stop, *_, steered = tables.solids[first + one]
            points = tables.vertices[start:stop].copy()
            if steered:
                points[:, :2] = points[:, :2] @ turn + tables.pivots[first + one]
            for other in range(last - first):
                plane = tables.parting[first + one, other]
                if one != other:
                    assert (points @ plane[:3] <= plane[3] + 1e-6).all()
