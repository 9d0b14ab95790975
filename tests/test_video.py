from dataclasses import replace

import av
import numpy as np
import pytest
import torch

from league import times, video
from league.errors import ReplayError
from league.sim.camera.renderer import Painter
from league.sim.camera.scene import BOX, BOX_COLOUR, CAR, CAR_COLOURS, MODELS, lit
from league.sim.camera.tables import THING_COLUMNS, Pose
from league.video import hud
from league.video.film import SHADOW_EDGE, SHADOW_KEPT, Film, Mp4, shadow_of
from league.video.pixels import mix
from tests.recorded import by_hand, moved, raced


def thing(model, *columns, colour):
    """Return a row of things_of, in colour."""
    return np.array([MODELS.index(model), *columns, *lit(colour, gray=False)])


def driving(frames: int = 8):
    """Return a race of two cars along the start straight (it runs along +x near y = 0.68)."""
    return by_hand(
        frames,
        lambda w, n: moved(w, x=[3.6 + 0.1 * n, 3.0 + 0.1 * n], y=[0.75, 0.6], yaw=[0.0, 0.0]),
    )


def near(picture: np.ndarray, colour: tuple[int, int, int], slack: int = 40) -> np.ndarray:
    return (np.abs(picture.astype(int) - colour) <= slack).all(axis=2)


def test_a_still_shows_the_cars_the_order_and_the_track_from_above():
    picture = video.still(driving(), 0.3)
    assert picture.shape == (720, 1280, 3)
    assert picture.dtype == np.uint8
    for colour in CAR_COLOURS[:2]:
        assert near(picture, colour)[:, 330:900].sum() > 300, "the car on the road"
        assert near(picture, colour)[90:180, 24:70].sum() > 200, "its place in the running order"
        assert near(picture, colour)[470:, 920:].sum() > 15, "the car on the map"


def test_the_cars_move_from_picture_to_picture_between_two_steps():
    made = driving()
    first, between = video.still(made, 2 / 15), video.still(made, 2.5 / 15)
    changed = (first != between).any(axis=2)[200:600, 330:900]
    assert changed.sum() > 2000


def test_a_video_has_all_its_pictures_and_plays_in_browsers(tmp_path):
    parts = []
    path = video.render(
        driving(), tmp_path / "race.mp4", size=(320, 180), fps=30, progress=parts.append
    )
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert (stream.width, stream.height, stream.average_rate) == (320, 180, 30)
        shown = [frame.pts * frame.time_base for frame in container.decode(stream)]
    # 7 steps of 1/15 s, then 4 s of classification, first and last picture included.
    assert len(shown) == round((7 / 15 + 4) * 30) + 1
    assert np.diff(np.array(shown, dtype=float)) == pytest.approx(1 / 30)
    assert parts == sorted(parts)
    assert parts[-1] == 1.0
    assert [file.name for file in tmp_path.iterdir()] == ["race.mp4"]
    # The index stands before the pictures, so a browser can begin at once.
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")


def test_film_ends_shortly_after_the_last_fight_is_decided():
    made = raced()
    first, last = made.result.order
    assert first.finished and made.result.spec.ranking == "total"
    # Who is last has no rival once the other has finished.
    assert made.decided_s == min(first.total_s, made.duration_s)
    best = made.result.spec.model_copy(update={"ranking": "best"})
    result = made.result.model_copy(update={"spec": best})
    assert replace(made, result=result).decided_s == made.duration_s
    order = (first.model_copy(update={"finished": False}), last)
    result = made.result.model_copy(update={"order": order})
    assert replace(made, result=result).decided_s == made.duration_s


def test_end_card_covers_the_race_and_names_stand_at_the_cars():
    made = driving()
    film = Film(made)
    names = film._hud.draw_names
    film._hud.draw_names = lambda *_: None
    (without,) = film.pictures(np.array([0.3]))
    film._hud.draw_names = names
    drawn, card = film.pictures(np.array([0.3, film.ends_s + 1.0]))
    rows, columns = np.nonzero((drawn != without).any(axis=2))
    cars = near(drawn, CAR_COLOURS[0]) | near(drawn, CAR_COLOURS[1])
    on_road = np.nonzero(cars[:, 330:900])
    assert 0 < rows.max() < on_road[0].max()
    assert on_road[1].min() + 230 < columns.min() < columns.max() < on_road[1].max() + 430
    assert card.mean() < 0.5 * drawn.mean()
    assert near(card, (244, 246, 248))[250:500, 260:1020].sum() > 500


def test_above_the_walls_there_is_no_bright_strip():
    picture = video.still(driving(), 0.3)
    assert picture[0, 400:].max() < 100


def test_a_video_that_cannot_be_written_leaves_nothing(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(ReplayError, match="cannot be written"):
        video.render(driving(2), tmp_path / "taken", size=(320, 180), fps=2)
    assert [file.name for file in tmp_path.iterdir()] == ["taken"]


@pytest.mark.parametrize("size", [(321, 180), (100, 100), (5000, 3000)])
def test_a_size_that_cannot_be_made_is_refused(tmp_path, size):
    with pytest.raises(ReplayError, match="even sides"):
        video.render(driving(2), tmp_path / "a.mp4", size=size)


def test_colours_survive_the_coding(tmp_path):
    path = str(tmp_path / "a.mp4")
    picture = np.full((64, 64, 3), (226, 52, 62), np.uint8)
    with Mp4(path, (64, 64), 15, crf=10) as made:
        for _ in range(3):
            made.add(picture)
    with av.open(path) as container:
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(frames) == 3
    assert np.abs(frames[1].astype(int) - picture).max() <= 6


def test_key_frames_come_often_and_no_picture_waits_for_a_later_one(tmp_path):
    path = str(tmp_path / "a.mp4")
    noise = np.random.default_rng(1)
    with Mp4(path, (64, 48), 15) as made:
        for _ in range(80):
            made.add(noise.integers(0, 255, (48, 64, 3), dtype=np.uint8))
    with av.open(path) as container:
        packets = [p for p in container.demux(video=0) if p.pts is not None]
    keys = [number for number, packet in enumerate(packets) if packet.is_keyframe]
    assert keys[0] == 0
    assert max(np.diff([*keys, 80])) <= 30
    assert all(packet.pts == packet.dts for packet in packets)


@pytest.mark.parametrize("cars", [1, 2])
def test_the_map_puts_a_car_where_it_is(cars):
    made = by_hand(1, lambda w, _: moved(w, x=[5.0] * cars, y=[0.7] * cars), cars)
    top = hud.TopView(made, 330, 230)
    picture = top.draw(made, made.worlds(), 0)
    y, x = np.nonzero(near(picture, CAR_COLOURS[0], 20))
    outline = np.concatenate([made.track.left, made.track.right])
    low, high = outline.min(axis=0) - 0.35, outline.max(axis=0) + 0.35
    scale = picture.shape[1] / (high - low)[0]
    assert x.mean() == pytest.approx((5.0 - low[0]) * scale, abs=2)
    assert y.mean() == pytest.approx((high[1] - 0.7) * scale, abs=2)


def test_graphics_beyond_the_edge_are_cut_off():
    picture = np.zeros((40, 60, 3), np.uint8)
    hud.put_panel(picture, (-10, -10, 300, 300), 4, (255, 255, 255), opacity=1.0)
    hud.put_text(picture, "far outside", 500, 500, 20)
    hud.put_text(picture, "", 5, 5, 20)
    assert (picture == 255).all()


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(0, "0:00.00"), (5.256, "0:05.26"), (61.5, "1:01.50"), (59.999, "1:00.00")],
)
def test_times_read_like_on_a_timing_screen(seconds, text):
    assert times.clock(seconds, 2) == text


def test_torch_threads_are_left_alone():
    before = torch.get_num_threads()
    video.still(driving(2), 0.0, size=(320, 180))
    assert torch.get_num_threads() == before


@pytest.mark.parametrize("time_s", [0.0, 0.4])
def test_floor_of_a_film_is_that_of_the_cameras_to_the_last_bit(time_s):
    made = Film(driving(3), (640, 360))
    pose = Pose(*made._replay.track.center[round(30 * time_s)], 0.56, 0.8, 0.6, 0.96, 0.28)
    wanted, bare = np.empty((1, 1, 360, 640, 3), np.uint8), np.empty((0, THING_COLUMNS))
    seen = np.zeros(1, np.int64), wanted, np.array([pose]), bare[None], made._painter._floor
    Painter.paint(made._painter, *seen)
    assert len(np.unique(wanted[0, 0, 200:])) > 20
    np.testing.assert_array_equal(made._painter.picture(pose, bare), wanted[0, 0])


def test_shadow_of_a_box_reaches_from_its_foot_along_the_light():
    # The sun stands at (0.5, -0.1, 0.9): 0.9 m of height throw 0.5 m towards -x, 0.1 m towards +y.
    outline = shadow_of(thing(BOX, 2.0, 1.0, 0.0, 1.0, 0.0, 0.4, 0.2, 0.9, colour=BOX_COLOUR))
    # Turned by 90 deg it lies along y: x from 1.9 to 2.1, y from 0.8 to 1.2.
    inside = [(2.09, 0.81), (2.09, 1.19), (1.41, 1.29), (1.41, 0.91)]
    outside = [(2.11, 1.0), (2.0, 0.79), (1.39, 1.1), (1.5, 1.31), (1.5, 0.82)]
    for places, are_inside in ((inside, True), (outside, False)):
        for place in places:
            assert (outline[:, :2] @ place <= outline[:, 2]).all() == are_inside, place


def test_cars_darken_the_floor_in_their_shadow_and_nowhere_else():
    film = Film(driving(3), (640, 360))
    painter = film._painter
    pose = Pose(3.0, 0.7, 0.56, 1.0, 0.0, np.cos(0.27), np.sin(0.27))
    car = thing(CAR, 4.4, 0.7, 1.0, 0.0, 0.0, 1.0, 1.0, 1.0, colour=CAR_COLOURS[0])
    bare, shaded = (painter.picture(pose, np.stack([car])[start:]) for start in (1, 0))
    # Where each pixel's ray meets the floor, and how far outside the shadow that is.
    lens, v, u = painter._lens, *np.mgrid[0:360, 0:640]
    across, down = (u - lens.cx) / lens.focal, (v - lens.cy) / lens.focal
    far = 0.56 / np.maximum(np.sin(0.27) + down * np.cos(0.27), 1e-9)
    x, y = 3.0 + far * (np.cos(0.27) - down * np.sin(0.27)), 0.7 - far * across
    outline = shadow_of(car)
    beyond = (outline[:, 0] * x[..., None] + outline[:, 1] * y[..., None] - outline[:, 2]).max(-1)
    # The car hides what is not nearer than its tail, at 4.238 m.
    in_front = x < 4.238 - 0.01
    full, none = in_front & (beyond < -SHADOW_EDGE), in_front & (beyond > SHADOW_EDGE)
    assert full.sum() > 200
    np.testing.assert_array_equal(shaded[none], bare[none])
    kept = round(256 * SHADOW_KEPT)
    np.testing.assert_allclose(shaded[full], bare[full].astype(int) * kept // 256, atol=1)


@pytest.mark.parametrize("opacity", [1.0, 0.72])
def test_paint_is_mixed_by_the_share_that_covers(opacity):
    draw = np.random.default_rng(0)
    picture, paint = draw.integers(0, 256, (2, 40, 30, 3), np.uint8)
    mask = draw.integers(0, 256, (40, 30), np.uint8)
    before = picture.astype(int)
    mix(picture, paint, mask, round(256 * opacity))
    share = mask[..., None].astype(int) * round(256 * opacity) // 256
    np.testing.assert_array_equal(picture, (share * paint + (255 - share) * before) // 255)
