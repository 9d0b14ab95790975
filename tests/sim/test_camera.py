"""What cars see: the geometry of the pictures, worked by hand."""

import itertools
import math

import numpy as np
import pytest

from league.sim.camera.renderer import Renderer
from league.sim.camera.scene_state import Lens
from league.sim.config import CameraConfig, SimConfig
from league.track.track import TrackSet
from tests.sim.looking import FOCAL, random_scenes, room, settings, world
from tests.sim.raycast import RayRenderer

RENDERERS = [Renderer, RayRenderer]
FAR_AWAY = (-5.0, -5.0, 0.0)


def pictures(renderer, now, tracks=None, **camera) -> np.ndarray:
    sim = settings(now.num_cars)
    made = renderer(tracks or room(), sim, CameraConfig(**camera))
    return made.render(now, 0)


def find_shift(left: np.ndarray, right: np.ndarray, guess: float) -> float:
    """Return by how many pixels `right` lies to the left of `left`, to a twentieth of a pixel."""
    columns = np.arange(len(left))
    inner = slice(20, -20)
    shifts = np.arange(guess - 3, guess + 3, 0.05)
    errors = [
        np.square(np.interp(columns + shift, columns, left) - right)[inner].sum()
        for shift in shifts
    ]
    return float(shifts[int(np.argmin(errors))])


def test_lens_has_the_focal_length_and_horizon_of_the_original():
    lens = Lens.of(CameraConfig())
    # 80 / tan(32.37 deg) = 126.19 px; 59.5 - 126.19 * tan(15 deg) = 25.69
    assert lens.focal == pytest.approx(126.19, abs=0.01)
    assert lens.horizon(math.radians(15)) == pytest.approx(25.69, abs=0.01)


def test_pictures_do_not_depend_on_the_number_of_threads(monkeypatch):
    tracks = room(half=3.0)
    now = random_scenes(tracks, 12, seed=4)
    found = []
    for threads in ("1", "3"):
        monkeypatch.setenv("OMP_NUM_THREADS", threads)
        found.append(pictures(Renderer, now, tracks))
    assert found[0].std() > 10
    assert np.array_equal(*found)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_foot_of_a_box_straight_ahead_is_at_the_hand_worked_row(renderer):
    # The camera is 0.145 m ahead of the base and 0.13 m up; the near face is 1 m farther: depth
    # 1 * 0.9659 + 0.13 * 0.2588 = 0.9996, below the axis 0.13 * 0.9659 - 1 * 0.2588 = -0.1333;
    # row 59.5 + 126.19 * -0.1333 / 0.9996 = 42.68.
    box = (0.145 + 1 + 0.15, 0, 0, 0.15, 0.2)
    empty = pictures(renderer, world(room(), [(0, 0, 0)]), eyes="mono")[0, 0]
    filled = pictures(renderer, world(room(), [(0, 0, 0)], [box]), eyes="mono")[0, 0]
    changed = np.nonzero((empty != filled)[:, 70:90].any(axis=1))[0]
    assert abs(changed.max() + 0.5 - 42.68) <= 1.0


def pixel_of(point, car, cfg: CameraConfig, eye: float) -> tuple[float, float]:
    """Return column and row of a point of the world, by rotation matrices."""
    yaw, pitch, roll = (float(car[name]) for name in ("yaw", "pitch", "roll"))
    body = about("z", yaw) @ about("y", pitch) @ about("x", roll)
    base = np.array([car["x"], car["y"], car["z"]])
    place = base + body @ (cfg.forward, eye, cfg.up)
    ahead, left, up = (body @ about("y", cfg.pitch)).T @ (np.array(point) - place)
    return 79.5 - FOCAL * left / ahead, 59.5 - FOCAL * up / ahead


def about(axis: str, angle: float) -> np.ndarray:
    cos, sin = math.cos(angle), math.sin(angle)
    if axis == "x":
        return np.array([(1, 0, 0), (0, cos, -sin), (0, sin, cos)])
    if axis == "y":
        return np.array([(cos, 0, sin), (0, 1, 0), (-sin, 0, cos)])
    return np.array([(cos, -sin, 0), (sin, cos, 0), (0, 0, 1)])


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("roll", [0.0, 0.15, -0.4])
@pytest.mark.parametrize("pitch", [0.0, 0.06, -0.1])
def test_picture_follows_the_height_roll_and_pitch_of_the_chassis(renderer, roll, pitch):
    tracks, cfg = room(), CameraConfig()
    empty = world(tracks, [(1.0, -0.5, 0.6)])
    # A box 10 cm across, 1.2 m ahead of the base.
    x, y = 1.0 + 1.2 * math.cos(0.6), -0.5 + 1.2 * math.sin(0.6)
    filled = world(tracks, [(1.0, -0.5, 0.6)], [(x, y, 0.0, 0.05, 0.05)])
    seen = []
    for now in (empty, filled):
        now.cars["z"], now.cars["roll"], now.cars["pitch"] = 0.03, roll, pitch
        seen.append(pictures(renderer, now, tracks)[0].astype(int))
    height = SimConfig().obstacles.height
    corners = itertools.product((x - 0.05, x + 0.05), (y - 0.05, y + 0.05), (0.0, height))
    outline = np.array(list(corners))
    for picture, eye in enumerate((0.03, -0.03)):
        pixels = [pixel_of(corner, filled.cars[0, 0], cfg, eye) for corner in outline]
        rows, columns = np.nonzero(seen[0][picture] != seen[1][picture])
        for found, wished in zip((columns, rows), zip(*pixels, strict=True), strict=True):
            assert found.min() == pytest.approx(min(wished), abs=1.5)
            assert found.max() == pytest.approx(max(wished), abs=1.5)


def test_body_that_rises_moves_the_camera_and_no_more():
    # 5 cm higher on its wheels is a camera 5 cm higher on its mast.
    now = world(room(), [(0, 0, 0.3), (1, 0.2, 1.0)])
    now.cars["z"] = 0.05
    raised = pictures(Renderer, now)
    now.cars["z"], now.cars["camera_up"] = 0.0, 0.05
    assert (raised == pictures(Renderer, now)).all()


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("roll", [0.1, -0.1])
def test_horizon_of_a_car_that_rolls_tilts_by_the_roll(renderer, roll):
    # A camera without tilt turns about its view, and with it the level top of the wall ahead.
    tracks, cfg = room(half=3.0), CameraConfig(pitch=0.0)
    now = world(tracks, [(0.0, 0.0, 0.0)])
    now.cars["roll"] = roll
    made = renderer(tracks, settings(1), cfg)
    picture = made.render(now, 0)[0, 0].astype(int)
    rim = (picture[:, 20:140] != picture[0, 0]).argmax(axis=0)  # the first row below the sky
    slope = np.polyfit(np.arange(20, 140), rim, 1)[0]
    assert slope == pytest.approx(-math.tan(roll), abs=0.005)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_foot_of_the_wall_is_at_the_hand_worked_row(renderer):
    # Wall at x = 6, camera at 0.145: 5.855 m ahead. Depth 5.6891, below the axis 0.1256 - 1.5154
    # = -1.3898: row 59.5 - 126.19 * 0.2443 = 28.67.
    now = world(room(half=6.0), [(0, 0, 0), FAR_AWAY])
    image = pictures(renderer, now, eyes="mono")[0, 0]
    wall = int(image[20, 80])
    differs = np.nonzero(np.abs(image[20:, 80].astype(int) - wall) > 15)[0]
    assert abs(20 + differs[0] - 0.5 - 28.67) <= 1.0


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("ahead", [0.5, 0.9, 1.6])
def test_disparity_on_a_car_ahead_is_focal_times_baseline_over_depth(renderer, ahead):
    # Back of the shell: 0.162 m behind the base at z = 0.0745, hardly leaning above.
    distance = 0.145 + ahead + 0.162
    now = world(room(), [(0, 0, 0), (distance, 0.02, 0)])
    left, right = pictures(renderer, now)[0].astype(float)
    height = 0.085
    depth = (ahead + 0.001) * math.cos(math.radians(15)) + (0.13 - height) * math.sin(
        math.radians(15)
    )
    below = (0.13 - height) * math.cos(math.radians(15)) - ahead * math.sin(math.radians(15))
    line = round(59.5 + FOCAL * below / depth)
    expected = FOCAL * 0.060 / depth

    def middle(image: np.ndarray) -> float:
        body = np.nonzero(np.abs(image[line] - image[line, 80]) < 4)[0]
        run = body[np.abs(body - 80) < 40]
        return (run.min() + run.max()) / 2

    assert abs(middle(left) - middle(right) - expected) <= 0.5


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("line", [45, 70, 100])
def test_disparity_on_the_road_is_focal_times_baseline_over_depth(renderer, line):
    tracks = room()
    now = world(tracks, [(0, -4.76, 0.2), FAR_AWAY])  # on the ring's centreline
    left, right = pictures(renderer, now, tracks)[0].astype(float)
    # Depth of the floor in a row: focal * height / (focal * sin + (row - cy) * cos).
    pitch = math.radians(15)
    depth = FOCAL * 0.13 / (FOCAL * math.sin(pitch) + (line - 59.5) * math.cos(pitch))
    expected = FOCAL * 0.060 / depth
    assert abs(find_shift(left[line], right[line], expected) - expected) <= 0.5


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_car_does_not_see_itself(renderer):
    seen = pictures(renderer, world(room(), [(0, 0, 0), FAR_AWAY]))
    alone = pictures(renderer, world(room(), [(0, 0, 0)]))
    assert np.array_equal(seen, alone)


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_car_ahead_is_seen_in_its_colour_by_both_eyes(renderer):
    now = world(room(), [(0, 0, 0), (0.8, 0, 0)])
    image = pictures(renderer, now, colour=True)[0]
    for eye in (image[:3], image[3:]):
        red, green, blue = eye[:, 35, 80].astype(int)  # car 1 is azure
        assert blue > green > red and blue > 150


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_frozen_car_is_dimmer(renderer):
    cars = [(0, 0, 0), (0.8, 0, 0)]
    plain = pictures(renderer, world(room(), cars))[0, 0, 35, 80]
    frozen = pictures(renderer, world(room(), cars, penalty=[0.0, 2.0]))[0, 0, 35, 80]
    assert frozen < plain - 30


@pytest.mark.parametrize("renderer", RENDERERS)
def test_front_wheels_turn_with_the_steering(renderer):
    cars = [(0, 0, 0), (0.75, 0.25, 1.2)]
    straight = pictures(renderer, world(room(), cars), width=320, height=240)
    turned = pictures(renderer, world(room(), cars, steering=0.5), width=320, height=240)
    changed = np.abs(straight.astype(int) - turned).max(axis=(0, 1)) > 8
    assert 20 < changed.sum() < 3000


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize(
    "camera", [{"eyes": "left"}, {"eyes": "mono"}, {"eyes": "stereo"}, {"colour": True}]
)
def test_shape_is_the_one_the_configuration_tells(renderer, camera):
    cfg = CameraConfig(width=32, height=24, **camera)
    image = pictures(renderer, world(room(), [(0, 0, 0)]), width=32, height=24, **camera)
    assert image.shape == (1, *cfg.shape) and image.dtype == np.uint8


def test_left_eye_alone_is_the_left_eye_of_the_pair():
    now = world(room(), [(0, 0, 0), (0.8, 0.1, 0.4)])
    pair = pictures(Renderer, now)
    assert np.array_equal(pictures(Renderer, now, eyes="left")[:, 0], pair[:, 0])


def test_colour_picture_turned_gray_is_the_gray_picture():
    now = world(room(), [(0, 0, 0), (0.8, 0.1, 0.4)])
    red, green, blue = pictures(Renderer, now, colour=True, eyes="mono")[0].astype(float)
    gray = pictures(Renderer, now, eyes="mono")[0, 0]
    assert np.abs(0.299 * red + 0.587 * green + 0.114 * blue - gray).max() < 2.5


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_world_looks_the_same_alone_and_in_a_batch(renderer):
    tracks = room(half=3.0)
    now = random_scenes(tracks, 4, seed=5)
    made = renderer(tracks, settings(3), CameraConfig(width=64, height=48))
    together = made.render(now, 1)
    for index in range(4):
        assert np.array_equal(made.render(now.row(index), 1)[0], together[index])


@pytest.mark.parametrize("renderer", RENDERERS)
def test_rows_choose_worlds(renderer):
    tracks = room(half=3.0)
    now = random_scenes(tracks, 4, seed=6)
    made = renderer(tracks, settings(3), CameraConfig(width=64, height=48))
    chosen = made.render(now, 0, np.array([3, 1]))
    assert np.array_equal(chosen, made.render(now, 0)[[3, 1]])
    assert made.render(now, 0, np.array([], np.int64)).shape == (0, 2, 48, 64)


def test_worlds_of_a_batch_may_be_on_different_tracks():
    small, large = room(half=3.0).tracks[0], room(half=6.0).tracks[0]
    tracks = TrackSet(small, large)
    now = world(tracks, [[(0, 0, 0)], [(0, 0, 0)]])
    now.worlds["track"] = [0, 1]
    for renderer in RENDERERS:
        both = renderer(tracks, settings(1), CameraConfig()).render(now, 0)
        for index, track in enumerate((small, large)):
            alone = renderer(TrackSet(track), settings(1), CameraConfig())
            single = now.row(index).copy()
            single.worlds["track"] = 0
            assert np.array_equal(alone.render(single, 0)[0], both[index])


def test_camera_parameters_of_a_car_move_its_horizon():
    now = world(room(half=3.0), [(0, 0, 0)])
    tilted = now.copy()
    tilted.cars["camera_pitch"] = 0.05

    def foot_of_wall(which) -> int:
        column = pictures(Renderer, which, room(half=3.0))[0, 0, :, 80].astype(int)
        return int(np.abs(np.diff(column))[5:60].argmax())

    # 0.05 rad is 126.19 * 0.05 = 6.3 px in the middle of the picture, a little more above it.
    assert 5 <= foot_of_wall(now) - foot_of_wall(tilted) <= 8


def test_each_world_of_a_batch_is_seen_from_its_own_mounting():
    now = world(room(half=3.0), [[(0, 0, 0), (0.8, 0.1, 0.4)]] * 3)
    now.cars["camera_up"] = [[0.0, 0.0], [0.03, 0.0], [0.03, 0.0]]
    now.cars["camera_pitch"] = [[0.0, 0.0], [0.0, 0.0], [0.04, 0.0]]
    made = Renderer(room(half=3.0), settings(2), CameraConfig())
    together = made.render(now, 0)
    for index in range(3):
        # A renderer that has seen no other mounting.
        assert np.array_equal(
            pictures(Renderer, now.row(index), room(half=3.0))[0], together[index]
        )
        assert not np.array_equal(together[index], together[index - 1])


@pytest.mark.parametrize("heading", [0.0, 0.5, 2.5, 4.0])
def test_no_sky_shows_between_the_floor_and_the_walls(heading):
    # The floor is drawn up to the farthest wall in view; farther corners are out of view here.
    now = world(room(half=3.0), [(2.0, 1.5, heading)])
    painted, cast = (pictures(one, now, room(half=3.0)).astype(int) for one in RENDERERS)
    sky = 0.299 * 200 + 0.587 * 212 + 0.114 * 222  # 209.6
    assert not ((abs(painted - sky) < 1) & (abs(cast - sky) > 30)).any()
