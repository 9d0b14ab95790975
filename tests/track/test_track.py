import math

import numpy as np
import pytest
from numba import njit

from league.track import files, projection
from league.track.track import TrackSet
from tests.track import shapes


def _index(tracks: int = 1, worlds: int = 1) -> np.ndarray:
    return np.arange(worlds) % tracks


def test_circle_has_the_length_radius_and_direction_of_a_circle():
    track = shapes.circle(radius=2.0, width=0.8)
    assert track.length == pytest.approx(4 * math.pi, rel=1e-3)
    assert track.min_radius == pytest.approx(2.0, rel=0.02)
    assert track.direction == "counter-clockwise"
    np.testing.assert_allclose(np.linalg.norm(track.left, axis=1), 1.6, atol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(track.right, axis=1), 2.4, atol=2e-3)
    # The outer border reaches 2.4 m, and the wall stands 0.84 m further out.
    np.testing.assert_allclose(track.room, (-3.24, -3.24, 3.24, 3.24), atol=5e-3)


def test_a_bend_to_the_right_has_negative_curvature():
    points = shapes.circle_points()[::-1]
    track = files.parse(shapes.text(points, direction="clockwise"))
    assert track.direction == "clockwise"
    np.testing.assert_allclose(track.curvature, -0.5, rtol=0.05)
    assert TrackSet(track).courses["inner"].tolist() == [-1.0]


def test_at_gives_the_hand_worked_place_and_heading_on_a_circle():
    tracks = TrackSet(shapes.circle())
    quarter = np.array([[tracks.tracks[0].length / 4]])
    frame = tracks.at(_index(), quarter)
    assert (frame.x.item(), frame.y.item()) == pytest.approx((0.0, 2.0), abs=2e-3)
    assert (frame.cos.item(), frame.sin.item()) == pytest.approx((-1.0, 0.0), abs=2e-3)
    assert frame.left.item() == pytest.approx(0.4, abs=1e-3)


@pytest.mark.parametrize("name", ["reinvent_2018", "needle_pass", "thread_lane", "long_meadow"])
def test_projecting_a_point_beside_the_track_gives_back_its_s_and_lateral(name):
    track = files.load(name)
    tracks = TrackSet(track)
    s = np.linspace(0, 0.999 * track.length, 400)[None]
    for side in (-0.6, 0.0, 0.6):
        frame = tracks.at(_index(), s)
        lateral = side * np.minimum(frame.left, frame.right)
        x, y = frame.x - lateral * frame.sin, frame.y + lateral * frame.cos
        found = tracks.project(_index(), x, y, s + 0.2)
        assert abs(tracks.signed_gap(_index(), found.s, s)).max() < 0.02
        assert abs(found.lateral - lateral).max() < 0.01


def test_s_wraps_at_the_start_line_of_a_loop():
    tracks = TrackSet(shapes.circle())
    length = tracks.tracks[0].length
    x, y = np.array([[2.0]]), np.array([[-0.1]])  # 0.1 m before the line
    found = tracks.project(_index(), x, y, np.array([[0.05]]))
    assert found.s.item() == pytest.approx(length - 0.1, abs=5e-3)
    again = tracks.project(_index(), x, -y, found.s + 0.15)  # and 0.1 m beyond
    assert again.s.item() == pytest.approx(0.1, abs=5e-3)
    assert tracks.signed_gap(_index(), again.s, found.s).item() == pytest.approx(0.2, abs=5e-3)


def test_s_stays_below_the_length_just_before_the_line():
    tracks = TrackSet(files.load("reinvent_2018"))
    s = np.array([[-1e-9, -1e-7, -1e-3, 0.0, tracks.length.item()]])
    frame = tracks.at(_index(), s)
    assert (frame.s >= 0).all() and (frame.s < tracks.length).all()


def test_an_open_track_holds_s_at_its_ends():
    tracks = TrackSet(shapes.straight(6.0))
    x = np.array([[-0.4, 3.0, 6.4]])
    y = np.array([[0.1, 0.1, 0.1]])
    found = tracks.project(_index(), x, y, np.array([[0.0, 3.2, 5.9]]))
    assert found.s[0].tolist() == pytest.approx([0.0, 3.0, 6.0], abs=1e-3)
    assert found.lateral[0].tolist() == pytest.approx([0.1] * 3, abs=1e-4)
    gap = tracks.signed_gap(_index(), np.array([[0.5]]), np.array([[5.5]]))
    assert gap.item() == pytest.approx(-5.0)  # no shorter way round


def test_a_car_on_the_inside_of_a_hairpin_is_found_where_it_is():
    points = shapes.stadium_points(straight=4.0, radius=0.4)
    track = files.parse(shapes.text(points, width=0.61))
    tracks = TrackSet(track)
    # Round the middle of the eastern half circle at (2, 0.4), 0.15 m from it: 0.25 m to the left.
    angle = np.linspace(-1.3, 1.3, 9)
    x, y = (2 + 0.15 * np.cos(angle))[None], (0.4 + 0.15 * np.sin(angle))[None]
    near = (2 + 0.4 * (angle + math.pi / 2))[None]
    found = tracks.project(_index(), x, y, near + 0.1)
    assert abs(found.lateral - 0.25).max() < 0.02
    assert abs(found.s - near).max() < 0.06
    assert (found.lateral < found.left).all()


def test_a_point_between_two_stretches_stays_on_the_stretch_it_came_from():
    points = shapes.stadium_points(straight=6.0, radius=0.5)
    tracks = TrackSet(files.parse(shapes.text(points, width=0.61)))
    length = tracks.tracks[0].length
    x, y = np.array([[0.0, 0.0]]), np.array([[0.6, 0.6]])
    # The upper straight (y = 1) is nearer, but the first point was last seen on the lower one.
    found = tracks.project(_index(), x, y, np.array([[0.1, length / 2 - 0.1]]))
    assert found.lateral[0].tolist() == pytest.approx([0.6, 0.4], abs=5e-3)
    assert found.s[0, 1].item() == pytest.approx(length / 2, abs=0.01)
    located = tracks.project(_index(), x[:, :1], y[:, :1])
    assert located.lateral.item() == pytest.approx(0.4, abs=5e-3)


def test_a_world_of_a_batch_equals_that_world_alone():
    chosen = [files.load(name) for name in ("reinvent_2018", "needle_pass", "broad_street")]
    tracks = TrackSet(*chosen, shapes.straight())
    worlds = 37
    draw = np.random.default_rng(3)
    index = _index(4, worlds)
    s = (5 * draw.random((worlds, 3))).astype(np.float32)
    frame = tracks.at(index, s)
    x, y = frame.x + 0.3 * draw.random((worlds, 3), np.float32), frame.y
    together = tracks.project(index, x, y, s)
    placed = tracks.project(index, x, y)
    for world in range(worlds):
        row = slice(world, world + 1)
        alone = tracks.project(index[row], x[row], y[row], s[row])
        own = TrackSet(tracks.tracks[int(index[world])])
        single = own.project(_index(), x[row], y[row], s[row])
        for name in ("s", "lateral", "x", "y", "cos", "sin", "curvature", "left", "right"):
            assert np.array_equal(getattr(alone, name)[0], getattr(together, name)[world])
            assert np.array_equal(getattr(single, name)[0], getattr(together, name)[world])
        assert np.array_equal(tracks.project(index[row], x[row], y[row]).s[0], placed.s[world])


def test_mirroring_a_track_mirrors_what_is_found_on_it():
    points = np.array(shapes.circle_points()) * (1.5, 1.0)
    track = files.parse(shapes.text(points.tolist()))
    mirrored = files.parse(shapes.text((points * (1, -1)).tolist(), direction="clockwise"))
    s = np.linspace(0, 12, 50)[None]
    frame = TrackSet(track).at(_index(), s)
    x, y = frame.x + 0.1, frame.y + 0.05
    found = TrackSet(track).project(_index(), x, y, s)
    other = TrackSet(mirrored).project(_index(), x, -y, s)
    assert abs(found.s - other.s).max() < 1e-4
    assert abs(found.lateral + other.lateral).max() < 1e-5


def test_a_track_set_without_tracks_is_refused():
    with pytest.raises(ValueError, match="at least one"):
        TrackSet()


def test_reversed_track_is_driven_the_other_way_from_the_same_line():
    track = shapes.circle(radius=2.0, width=0.8)
    back = track.reversed()
    assert back.direction == "clockwise"
    assert back.name == "test_track_reversed"
    np.testing.assert_array_equal(back.center[0], track.center[0])
    np.testing.assert_array_equal(back.center[1], track.center[-1])
    # What was on the left, the inside, is on the right now.
    np.testing.assert_array_equal(back.right[0], track.left[0])
    np.testing.assert_allclose(np.linalg.norm(back.left, axis=1), 2.4, atol=2e-3)
    np.testing.assert_allclose(back.curvature, -0.5, rtol=0.05)
    np.testing.assert_allclose(back.tangent[0], -track.tangent[0], atol=1e-9)
    assert back.length == pytest.approx(track.length)


@pytest.mark.parametrize("name", ["reinvent_2018", "needle_pass"])
def test_track_reversed_twice_is_the_track(name):
    track = files.load(name)
    again = track.reversed().reversed()
    for part in ("center", "left", "right"):
        np.testing.assert_array_equal(getattr(again, part), getattr(track, part))
    assert again.direction == track.direction


def test_reversed_place_is_a_lap_less_the_place_and_on_the_other_side():
    track = files.load("reinvent_2018")
    ways = TrackSet(track, track.reversed())
    frame = ways.at(_index(2, 1), np.array([[3.0]]))
    lateral = 0.2
    point = (frame.x - lateral * frame.sin, frame.y + lateral * frame.cos)
    back = ways.project(np.array([1]), *point)
    assert back.s.item() == pytest.approx(track.length - 3.0, abs=0.01)
    assert back.lateral.item() == pytest.approx(-0.2, abs=5e-3)
    assert back.cos.item() == pytest.approx(-frame.cos.item(), abs=1e-3)


def test_reversed_track_has_its_waypoints_in_the_other_order():
    # Quarters of a circle of 2 m from a quarter beyond the start line on, the second one twice.
    waypoints = [[0, 2], [-2, 0], [-2, 0], [0, -2], [2, 0], [0, 2]]
    track = files.parse(shapes.text(shapes.circle_points()) + f"waypoints: {waypoints}\n")
    back = track.reversed()
    assert back.waypoints.tolist() == waypoints[::-1]
    quarter = np.pi
    np.testing.assert_allclose(
        shapes.waypoint_places(track), np.array([1, 2, 2, 3, 4, 5]) * quarter, atol=2e-3
    )
    np.testing.assert_allclose(
        shapes.waypoint_places(back), np.array([3, 4, 5, 6, 6, 7]) * quarter, atol=2e-3
    )
    assert track.reversed().reversed().waypoints.tolist() == waypoints


def test_mirrored_track_turns_the_other_way_and_keeps_its_order():
    waypoints = [[0, 2], [-2, 0], [0, -2], [2, 0], [0, 2]]
    track = files.parse(shapes.text(shapes.circle_points()) + f"waypoints: {waypoints}\n")
    other = track.mirrored()
    assert (track.direction, other.direction) == ("counter-clockwise", "clockwise")
    np.testing.assert_allclose(other.curvature, -track.curvature, atol=1e-9)
    np.testing.assert_array_equal(other.left, track.right * [1, -1])
    np.testing.assert_allclose(shapes.waypoint_places(other), shapes.waypoint_places(track))
    again = files.parse(files.dump(other))
    np.testing.assert_allclose(again.center, other.center, atol=2e-3)
    np.testing.assert_array_equal(other.mirrored().center, track.center)


def test_reversed_straight_is_driven_from_its_far_end():
    track = shapes.straight()
    back = track.reversed()
    np.testing.assert_array_equal(back.center, track.center[::-1])
    np.testing.assert_array_equal(back.left, track.right[::-1])
    assert back.direction == "open"


@pytest.mark.parametrize("index", [[0, 1], [0, -1], [0, 0, 0]])
def test_a_world_on_no_track_of_the_set_is_an_error_and_no_wild_reading(index):
    tracks = TrackSet(shapes.circle())
    places, index = np.ones((2, 2)), np.array(index)
    for look in (
        lambda: tracks.at(index, places),
        lambda: tracks.project(index, places, places, places),
        lambda: tracks.signed_gap(index, places, places),
    ):
        with pytest.raises(IndexError, match="track"):
            look()


@njit
def curvature(tracks, s):
    points, courses = tracks
    return projection.curvature_at(points, courses[0], np.float32(s))


def test_curvature_at_a_place_is_that_of_the_nearest_centre_point():
    track = files.load("reinvent_2018")
    tracks, spacing = TrackSet(track), track.length / len(track.center)
    for row, nearest in ((0.0, 0), (10.4, 10), (10.6, 11), (len(track.center) - 0.4, 0)):
        found = curvature((tracks.points, tracks.courses), spacing * row)
        assert found == pytest.approx(track.curvature[nearest], rel=1e-5)
    # An open track holds it at its ends.
    ends = TrackSet(shapes.straight(6.0))
    for s in (-1.0, 7.0):
        assert curvature((ends.points, ends.courses), s) == pytest.approx(0.0, abs=1e-6)


def test_lap_is_the_loop_or_an_open_track_but_its_last_30_cm():
    tracks = TrackSet(shapes.circle(), shapes.straight(6.0))
    laps = tracks.lap_length(np.array([0, 1]))
    assert laps.tolist() == pytest.approx([tracks.length[0], 5.7], abs=1e-5)
