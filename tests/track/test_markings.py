from dataclasses import replace

import cv2
import numpy as np
import pytest

from league.errors import ConfigError
from league.track import files, importer, markings
from league.track.track import Track
from tests.track import shapes

MPP = 0.01


def _mean_colour(floor: markings.FloorPicture, x: float, y: float, reach: int = 2) -> np.ndarray:
    col, row = np.round(floor.pixel_of(np.array([x, y]))).astype(int)
    patch = floor.image[row - reach : row + reach + 1, col - reach : col + reach + 1]
    return patch.reshape(-1, 3).mean(axis=0)


def _near(found: np.ndarray, wanted: tuple[int, int, int]) -> bool:
    return bool(np.abs(found - wanted).max() < 8)


def test_each_part_of_the_floor_has_its_colour():
    track = shapes.circle(radius=2.0, width=0.8)  # road from 1.6 to 2.4 m, lines inside it
    floor = markings.floor(track, MPP, colour=True)
    away = np.array([np.cos(0.5), np.sin(0.5)])
    for radius, wanted in {
        1.4: track.colours.field,
        1.638: track.colours.line,
        1.75: track.colours.road,
        2.25: track.colours.road,
        2.362: track.colours.line,
        2.6: track.colours.field,
    }.items():
        assert _near(_mean_colour(floor, *(radius * away)), wanted), radius


def test_lines_outside_the_border_leave_the_whole_road():
    track = files.parse(
        shapes.text(shapes.circle_points()).replace("line: inside", "line: outside")
    )
    floor = markings.floor(track, MPP, colour=True)
    away = np.array([np.cos(0.5), np.sin(0.5)])
    assert _near(_mean_colour(floor, *(2.37 * away)), track.colours.road)
    assert _near(_mean_colour(floor, *(2.438 * away)), track.colours.line)
    assert _near(_mean_colour(floor, *(1.562 * away)), track.colours.line)


@pytest.mark.parametrize("mpp", [0.005, 0.01, 0.02])
def test_painted_areas_are_true_to_a_few_millimetres(mpp):
    # A white field and a black road: the picture sums up to the ring.
    colours = (
        "colours: {road: [0, 0, 0], field: [250, 250, 250], line: [0, 0, 0], dash: [0, 0, 0]}\n"
    )
    track = files.parse(shapes.text(shapes.circle_points()) + colours)
    image = markings.floor(track, mpp, colour=False).image[:, :].astype(float)
    strip = np.pi * (2.4**2 - 1.6**2)
    # The start line is the only bright thing on the road: half of 0.1 m x 0.8 m.
    dark = image.size * mpp**2 - (image / 250).sum() * mpp**2
    edge_length = 2 * np.pi * (2.4 + 1.6)
    assert abs(dark - (strip - 0.04)) / edge_length < 0.003


def test_a_pixel_lies_where_its_row_and_column_say():
    track = shapes.circle()
    floor = markings.floor(track, MPP, colour=True)
    x_min, y_min, x_max, y_max = track.room
    assert (floor.origin_x, floor.origin_y) == (x_min, y_min)
    assert floor.image.shape == (
        int(np.ceil((y_max - y_min) / MPP)),
        int(np.ceil((x_max - x_min) / MPP)),
        3,
    )
    assert floor.pixel_of(np.array([x_min + 0.035, y_min + 0.025])).tolist() == pytest.approx(
        [3.0, 2.0]
    )
    # The start line is at (2, 0), on the east: its checkers vary, the opposite side does not.
    col, row = np.round(floor.pixel_of(np.array([2.2, 0.025]))).astype(int)
    start = floor.image[row - 1 : row + 2, col - 10 : col + 10].astype(float)
    assert np.ptp(start) > 150


def test_dashes_are_a_quarter_of_an_orange_centre_line():
    track = files.load("harbour_oval")
    floor = markings.floor(track, 0.005, colour=True)
    rows = track.center[20:60]  # on the straight, away from the start line
    x = np.linspace(rows[0, 0], rows[-1, 0], 4000)
    place = np.round(floor.pixel_of(np.stack([x, np.full_like(x, rows[0, 1])], axis=1))).astype(int)
    orange = floor.image[place[:, 1], place[:, 0]].astype(float) - track.colours.road
    share = (orange[:, 0] > 100).mean()
    assert share == pytest.approx(0.5, abs=0.06)  # 51 of 102 mm


@pytest.mark.parametrize("track", [files.load("reinvent_2018"), shapes.straight()])
def test_dashes_lie_evenly_without_numpys_interpolation_that_may_fuse_sums(monkeypatch, track):
    count = round(track.length / markings.DASH_PITCH)
    wanted = (np.arange(count) + 0.5) * track.length / count
    knots = np.arange(len(track.center)) * track.segment_lengths.mean()
    period = track.length if track.closed else None
    middles = [np.interp(wanted, knots, column, period=period) for column in track.center.T]
    monkeypatch.delattr(np, "interp")
    found = markings.dashes(track).mean(axis=1)
    assert found == pytest.approx(np.stack(middles, axis=1), abs=1e-12)


def test_gray_is_the_luma_of_the_colours():
    track = files.load("reinvent_2018")
    colour = markings.floor(track, 0.02, colour=True).image.astype(float)
    gray = markings.floor(track, 0.02, colour=False).image.astype(float)
    assert np.abs(colour @ (0.299, 0.587, 0.114) - gray).max() <= 1.0


def test_the_floor_is_the_same_each_time_and_slightly_rough():
    track = files.load("reinvent_2018")
    first = markings.floor(track, MPP, colour=False).image
    assert np.array_equal(first, markings.floor(track, MPP, colour=False).image)
    field = first[5:60, 5:60].astype(float)
    row = int((0.80 - track.room[1]) / MPP)  # between the dashes and the upper line
    road = first[row : row + 10, 400:600].astype(float)
    assert field.std() == pytest.approx(6.0, abs=1.0)
    assert road.std() == pytest.approx(3.0, abs=1.0)


def test_the_road_is_whole_inside_a_bend_that_clips_its_border():
    points = [[0, 0], [2, 0], [2.9, 0], [3.21, 0.09], [3.3, 0.4], [3.3, 1.3], [3.3, 2.6]]
    points += [[2.4, 3.6], [0.6, 3.6], [-0.8, 2.6], [-1.0, 1.0]]
    track = files.parse(shapes.text(points, width=1.06))
    reach = np.linalg.norm(track.left - track.center, axis=1)
    assert reach.min() < 0.45  # clipped
    floor = markings.floor(track, MPP, colour=True)
    row = int(reach.argmin())
    inward = (track.left[row] - track.center[row]) / reach[row]
    for distance in np.arange(0.05, 0.44, 0.02):
        spot = track.center[row] + distance * inward
        assert _near(_mean_colour(floor, *spot, reach=0), track.colours.road)


@pytest.mark.parametrize("mpp", [0.0, -1.0, float("nan"), 1e-5])
def test_a_senseless_resolution_is_refused(mpp):
    with pytest.raises(ConfigError, match="give"):
        markings.floor(shapes.circle(), mpp, colour=False)


@pytest.mark.parametrize("track", [shapes.straight(), files.load("comet")], ids=lambda t: t.name)
def test_a_poster_is_a_picture_with_north_up(track: Track):
    sheet = markings.poster(track)
    assert sheet.dtype == np.uint8 and sheet.ndim == 3
    assert 900 <= sheet.shape[1] <= 1700 and sheet.shape[0] <= 1200
    back = cv2.imdecode(np.frombuffer(markings.png(sheet), np.uint8), cv2.IMREAD_COLOR)
    assert np.array_equal(back[..., ::-1], sheet)


def test_text_of_a_tall_poster_ends_before_the_north_arrow():
    around = np.linspace(0, 2 * np.pi, 241)[:, None]
    rows = [
        np.hstack([(1.2 + aside) * np.cos(around), (6 + aside) * np.sin(around)])
        for aside in (0.0, -0.3, 0.3)
    ]
    tall = importer.from_rows(np.hstack(rows), "tall", "here")
    sheet = markings.poster(replace(tall, title="A long title of a track that is tall and narrow"))
    paper = sheet[0, 0]
    head = sheet[30:110]
    inked = np.flatnonzero((head != paper).any(axis=(0, 2)))
    arrow = inked > sheet.shape[1] - 85
    assert arrow.any() and inked[~arrow].max() < inked[arrow].min() - 10
    assert (sheet[30:110, -20:] == paper).all()


def test_north_is_up_on_a_poster():
    # The layout of 2018 leaves the north-east corner of its room empty.
    sheet = markings.poster(files.load("reinvent_2018")).astype(int)
    floor = sheet[200:-80, 60:-60]
    road = np.abs(floor - files.load("reinvent_2018").colours.road).max(axis=2) < 16
    half, middle = road.shape[0] // 2, road.shape[1] // 2
    assert road[:half, middle:].sum() < 0.7 * road[half:, middle:].sum()
    assert road[:half, middle:].sum() < 0.7 * road[:half, :middle].sum()
