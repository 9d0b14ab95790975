import os
import threading
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from league.errors import TrackError
from league.track import files, spline
from league.track.track import Colours
from tests.track import shapes

SHARED = Path(__file__).parents[3] / "shared" / "tracks"
GOOD = shapes.text([[0, 0], [4, 0], [4, 3], [0, 3]])
WAYPOINTS = "[0, 0], [4, 0], [4, 3], [0, 3]"


def _refusal(text: str) -> str:
    with pytest.raises(TrackError) as caught:
        files.parse(text, "my.yaml")
    message = str(caught.value)
    assert "\n" not in message and len(message) < 500
    assert "my.yaml" in message
    return message


def test_twelve_tracks_ship_and_each_is_named_as_its_file():
    names = files.names()
    assert len(names) == 12
    assert [files.load(name).name for name in names] == names


def test_shipped_tracks_are_as_varied_as_promised():
    tracks = [files.load(name) for name in files.names()]
    assert min(track.width for track in tracks) == pytest.approx(0.61, abs=0.01)
    assert max(track.width for track in tracks) == pytest.approx(1.07, abs=0.01)
    assert 60 < max(track.length for track in tracks) < 90
    assert sum(track.direction == "clockwise" for track in tracks) >= 3
    assert {track.line_inside for track in tracks} == {True, False}
    # A car turns in 0.284 m at the least.
    assert 0.284 < min(track.min_radius for track in tracks) < 0.36


def test_reinvent_2018_has_the_figures_of_the_original():
    track = files.load("reinvent_2018")
    assert track.length == pytest.approx(17.71, abs=0.01)
    assert track.width == pytest.approx(0.762, abs=1e-6)
    assert track.direction == "counter-clockwise"
    assert track.min_radius == pytest.approx(0.77, abs=0.01)
    assert track.line_inside and track.line_width == 0.076
    np.testing.assert_allclose(track.center[0], (3.06, 0.683), atol=0.005)
    assert abs(np.degrees(np.arctan2(*track.tangent[0][::-1]))) < 0.5


@pytest.mark.skipif(not SHARED.is_dir(), reason="the reference geometry is not on this machine")
def test_reinvent_2018_lies_on_the_reference():
    reference = np.load(SHARED / "reinvent_base.npy")[:-1, :2]
    dense = spline.resample(reference, closed=True, spacing=0.01)
    ours = spline.resample(files.load("reinvent_2018").center, closed=True, spacing=0.01)
    for here, there in ((dense, ours), (ours, dense)):
        off = KDTree(there).query(here)[0]
        assert off.mean() < 0.02
        assert off.max() < 0.05


@pytest.mark.parametrize("name", files.names())
def test_the_text_of_a_track_gives_the_same_bits_again(name):
    track = files.load(name)
    again = files.parse(track.text)
    for field in ("center", "left", "right"):
        assert np.array_equal(getattr(track, field), getattr(again, field))
    assert again.text == track.text
    assert files.dump(track) == track.text


def test_rows_are_evenly_spaced_and_the_border_is_half_a_width_away():
    track = files.load("reinvent_2018")
    assert np.ptp(track.segment_lengths) < 2e-4
    assert track.segment_lengths.mean() == pytest.approx(0.05, rel=0.01)
    np.testing.assert_allclose(np.linalg.norm(track.left - track.center, axis=1), 0.381, atol=1e-9)
    # Left is left: the normal is the driving direction turned by +90 degrees.
    turned = track.tangent @ [[0, 1], [-1, 0]]
    np.testing.assert_allclose(track.left - track.center, 0.381 * turned, atol=1e-9)


def test_a_track_made_without_text_can_be_dumped_and_read_again():
    from dataclasses import replace

    track = replace(files.load("needle_pass"), text="", colours=Colours(road=(1, 2, 3)))
    again = files.parse(files.dump(track))
    assert again.colours == track.colours
    assert np.linalg.norm(again.center - track.center, axis=1).max() < 2e-3


def test_explicit_borders_are_met_by_the_normals():
    # A road 1 m to the left of a straight and 0.5 m to its right.
    points = [[0, 0], [2, 0], [4, 0], [6, 0]]
    borders = "left: [[-1, 1], [3, 1], [7, 1]]\nright: [[-1, -0.5], [7, -0.5]]\n"
    track = files.parse(shapes.text(points, direction="open", width=1.5) + borders)
    np.testing.assert_allclose(track.left[:, 1], 1.0, atol=1e-9)
    np.testing.assert_allclose(track.right[:, 1], -0.5, atol=1e-9)
    np.testing.assert_allclose(track.left[:, 0], track.center[:, 0], atol=1e-9)


def test_start_moves_row_0_along_the_centreline():
    track = files.parse(shapes.text(shapes.circle_points()) + "start: [0, 2.05]\n")
    np.testing.assert_allclose(track.center[0], (0, 2), atol=0.01)
    assert "start [0, 3] lies 1.00 m" in _refusal(
        shapes.text(shapes.circle_points()) + "start: [0, 3]\n"
    )


def test_a_corner_tighter_than_half_the_road_is_clipped_without_crossing():
    # Right angles of 0.3 m radius on a road 1.06 m wide: the inner border folds and is clipped.
    bend = np.linspace(-np.pi / 2, 0, 5)
    corner = np.stack([2.7 + 0.3 * np.cos(bend), -1.7 + 0.3 * np.sin(bend)], axis=1)
    side = np.concatenate([[[0, -2], [1, -2], [2, -2]], corner, [[3, -1], [3, 0], [3, 1]]])
    rest = np.array([[2.4, 1.8], [1, 2], [-1, 2], [-2.4, 1.8], [-3, 0.8], [-2.8, -1], [-1.5, -2]])
    points = files.rounded(np.concatenate([side, rest]), 3)
    track = files.parse(shapes.text(points, width=1.06))
    assert track.min_radius < 0.35
    reach = np.linalg.norm(track.left - track.center, axis=1)
    assert reach.min() < 0.35 and reach.max() == pytest.approx(0.53)
    assert track.width == pytest.approx(1.06)
    np.testing.assert_allclose(np.linalg.norm(track.right - track.center, axis=1), 0.53)


def test_waypoints_are_kept_as_given():
    track = files.parse(GOOD + f"waypoints: [{WAYPOINTS}, [0, 0]]\n")
    assert track.waypoints.tolist() == [[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]
    assert files.parse(GOOD).waypoints is None


def test_waypoints_are_written_only_where_there_are_some():
    read = files.read(GOOD, "my.yaml")
    assert "waypoints" not in files.write(read)
    # 1e-05 is a text to YAML, and 1.0e-05 the number.
    waypoints = [[1e-05, -2.5e-16], [4.0, 0.1 + 0.2], [1e-05, -2.5e-16]]
    text = files.write(read.model_copy(update={"waypoints": waypoints}))
    assert files.read(text, "my.yaml").waypoints == waypoints


def test_waypoints_may_begin_anywhere_on_the_lap():
    # A circle of 2 m from its east; the start line is moved to its north, a quarter further on.
    east = [[2, 0], [0, 2], [0, 2], [-2, 0], [0, -2], [2, 0]]
    text = shapes.text(shapes.circle_points()) + f"start: [0, 2]\nwaypoints: {east}\n"
    places = shapes.waypoint_places(files.parse(text))
    np.testing.assert_allclose(places, np.array([3, 4, 4, 5, 6, 7]) * np.pi, atol=2e-3)


def test_waypoints_that_step_back_a_little_are_held():
    points = [[0, 0], [3, 0], [6, 0]]
    text = shapes.text(points, direction="open") + "waypoints: [[0, 0], [3, 0], [2.8, 0], [6, 0]]"
    places = shapes.waypoint_places(files.parse(text))
    np.testing.assert_allclose(places, [0, 3, 3, 6], atol=1e-9)


def test_dumped_and_read_again_a_reversed_track_keeps_its_waypoints():
    track = files.parse(GOOD + f"waypoints: [{WAYPOINTS}, [0, 0]]\n")
    again = files.parse(files.dump(track.reversed()))
    assert again.waypoints.tolist() == [[0, 0], [0, 3], [4, 3], [4, 0], [0, 0]]


BROKEN = {
    "nan": (GOOD.replace("[4, 0]", "[.nan, 0]"), ["line 6", "points[1][0]", "finite"]),
    "infinity": (GOOD.replace("[4, 0]", "[4, .inf]"), ["points[1][1]", "finite"]),
    "width 0": (GOOD.replace("width: 0.8", "width: 0"), ["line 4", "`width` is 0", "0.3 to 4"]),
    "two points": (shapes.text([[0, 0], [4, 0]]), ["points", "3 to 2000"]),
    "wrong shape": (shapes.text([[0, 0, 1], [4, 0, 1], [4, 3, 1]]), ["points[0]", "[x, y]"]),
    "text for a number": (GOOD.replace("[4, 0]", "[four, 0]"), ["'four'", "two finite numbers"]),
    "text for a point": (shapes.text(["abc", "def", "ghi"]), ["points[0]", "'abc'"]),
    "far away": (GOOD.replace("[4, 0]", "[4e9, 0]"), ["points[1][0]", "1000 m"]),
    "too long": (shapes.text([[0, 0], [400, 0], [400, 300]]), ["at most 300 m"]),
    "too short": (shapes.text([[0, 0], [0.2, 0], [0.2, 0.3]]), ["2 to 300 m"]),
    "repeated point": (shapes.text([[0, 0], [4, 0], [4, 0], [4, 3]]), ["points[1] and points[2]"]),
    "closing point": (
        shapes.text([[0, 0], [4, 0], [4, 3], [0, 3], [0, 0]]),
        ["points[4] and points[0]", "closes by itself"],
    ),
    "figure of eight": (
        shapes.text([[0, 0], [4, 3], [8, 0], [8, 3], [4, 0], [0, 3]]),
        ["centreline crosses itself near (", "driving order"],
    ),
    "overlapping stretches": (
        shapes.text(shapes.stadium_points(straight=5.0, radius=0.35), width=1.0),
        ["border crosses itself", "narrower"],
    ),
    "wrong direction": (
        GOOD.replace("counter-clockwise", "clockwise"),
        ["points run counter-clockwise", "`direction: counter-clockwise`"],
    ),
    "unknown direction": (GOOD.replace("counter-clockwise", "left"), ["direction", "'left'"]),
    "spike": (
        shapes.text(
            [[0, 0], [2, 0], [4, 0], [4.15, 0.15], [4, 0.3], [2, 1.5], [0, 1.2]], width=0.4
        ),
        ["radius of 0."],
    ),
    "unknown field": (GOOD + "widht: 3\n", ["line 7", "`widht`", "width"]),
    "duplicate field": (GOOD + "width: 0.9\n", ["line 7", "line 4 already"]),
    "no points": (GOOD.split("points")[0], ["lacks the field `points`", "points: [["]),
    "one border": (GOOD + "left: [[0, 0], [1, 1]]\n", ["right is not", "give both"]),
    "crossing border": (
        shapes.text([[0, 0], [2, 0], [4, 0]], direction="open")
        + "left: [[-1, 0.4], [3, 0.4], [3, 0.6], [2, 0.2], [5, 0.4]]\n"
        + "right: [[-1, -0.4], [5, -0.4]]\n",
        ["left border", "left[", "driving order"],
    ),
    "swapped borders": (
        shapes.text([[0, 0], [2, 0], [4, 0]], direction="open")
        + "left: [[-1, -0.4], [5, -0.4]]\nright: [[-1, 0.4], [5, 0.4]]\n",
        ["no left border next to the centreline", "driver's own left"],
    ),
    "width contradicts borders": (
        shapes.text([[0, 0], [2, 0], [4, 0]], direction="open", width=1.2)
        + "left: [[-1, 0.4], [5, 0.4]]\nright: [[-1, -0.4], [5, -0.4]]\n",
        ["0.800 m apart", "`width: 0.800`"],
    ),
    "waypoint off the track": (
        GOOD + "waypoints: [[0, 0], [4, 0], [2, 1.5], [0, 0]]\n",
        ["waypoints[2] lies", "m from the centreline"],
    ),
    "waypoints out of order": (
        GOOD + "waypoints: [[0, 0], [4, 3], [4, 0], [0, 3], [0, 0]]\n",
        ["waypoints[2] is out of order", "driving order"],
    ),
    "waypoints the other way round": (
        GOOD + "waypoints: [[0, 0], [0, 3], [4, 3], [4, 0], [0, 0]]\n",
        ["waypoints[2] is out of order", "driving order"],
    ),
    "waypoints that go nowhere": (
        GOOD + "waypoints: [[0, 0], [0, 0]]\n",
        ["waypoints[1] is out of order", "once along"],
    ),
    "waypoints of a straight out of order": (
        shapes.text([[0, 0], [2, 0], [4, 0]], direction="open")
        + "waypoints: [[0, 0], [3, 0], [1, 0]]\n",
        ["waypoints[2] is out of order"],
    ),
    "waypoints that do not close": (
        GOOD + f"waypoints: [{WAYPOINTS}]\n",
        ["waypoints", "on a loop", "repeat"],
    ),
    "one waypoint": (GOOD + "waypoints: [[0, 0]]\n", ["line 7", "waypoints", "2 to 2001"]),
    "many waypoints": (GOOD + f"waypoints: {[[0, 0]] * 2002}\n", ["2 to 2001 points"]),
    "waypoint of three": (GOOD + "waypoints: [[0, 0, 1], [4, 0]]\n", ["waypoints[0]", "[x, y]"]),
    "waypoint nan": (GOOD + "waypoints: [[.nan, 0], [4, 0]]\n", ["waypoints[0][0]", "finite"]),
    "waypoints as prose": (GOOD + "waypoints: all\n", ["waypoints", "'all'", "[x, y]"]),
    "colour": (GOOD + "colours: {road: [1, 2, 300]}\n", ["colours.road[2]", "0 to 255"]),
    "name": (GOOD.replace("test_track", "../evil"), ["name", "letters"]),
    "empty": ("", ["not a track file", "nothing"]),
    "a list": ("[1, 2, 3]", ["not a track file", "a list"]),
    "prose": ("hello there", ["one plain value"]),
    "not YAML": ("name: [1, 2\npoints: {", ["not YAML", "line"]),
    "tabs": ("name:\n\t- x", ["not YAML", "line 2"]),
    "control characters": ("name: \x00", ["not YAML"]),
    "alias bomb": (
        "a: &a [x, x, x]\nb: &b [*a, *a, *a]\nc: &c [*b, *b, *b]\n",
        ["line 1", "anchors and aliases"],
    ),
    "python object": ("name: !!python/object/apply:os.system [ls]\n", ["line 1", "tags"]),
    "deep nesting": ("points: " + "[" * 3000, ["nested"]),
    "huge": ("# " + "x" * 1_000_001, ["1,000,003", "1,000,000"]),
    "many points": (shapes.text([[0, 0]] * 2001), ["3 to 2000 points"]),
    "impossible date": (GOOD + "origin: 2001-99-99\n", ["cannot be read", "month"]),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_file_gets_one_sentence_that_says_what_and_where(fault):
    text, expected = BROKEN[fault]
    message = _refusal(text)
    for phrase in expected:
        assert phrase in message, message


def test_the_file_the_faults_were_made_from_is_sound():
    assert files.parse(GOOD).direction == "counter-clockwise"


def test_an_unknown_name_is_answered_with_the_nearest():
    with pytest.raises(TrackError, match="reinvent_2018"):
        files.load("reinvent2018")


def test_paths_that_are_no_track_files_are_refused(tmp_path):
    (tmp_path / "folder.yaml").mkdir()
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00\x01")
    (tmp_path / "large.yaml").write_bytes(b" " * 1_000_001)
    os.mkfifo(tmp_path / "pipe.yaml")
    for name, phrase in {
        "missing.yaml": "No such file",
        "folder.yaml": "not a file",
        "bytes.yaml": "not UTF-8",
        "large.yaml": "larger than 1,000,000 bytes",
        "pipe.yaml": "not a file",
        "nul\0.yaml": "null byte",
    }.items():
        with pytest.raises(TrackError, match=phrase):
            files.load(tmp_path / name)


def test_a_track_is_saved_whole_and_loads_again(tmp_path):
    path = tmp_path / "new" / "test_track.yaml"
    files.save(files.parse(GOOD), path)
    assert path.read_text() == GOOD
    assert files.load(path).name == "test_track"
    assert [entry.name for entry in path.parent.iterdir()] == ["test_track.yaml"]


def test_a_broken_text_is_not_saved_and_leaves_the_old_file(tmp_path):
    path = tmp_path / "test_track.yaml"
    files.save(GOOD, path)
    with pytest.raises(TrackError, match="to be saved"):
        files.save(GOOD.replace("0.8", "0"), path)
    assert path.read_text() == GOOD


def test_a_write_that_fails_leaves_nothing_behind(tmp_path):
    (tmp_path / "taken").mkdir()
    with pytest.raises(TrackError, match="cannot be written"):
        files.save(GOOD, tmp_path / "taken")  # a folder cannot be replaced by a file
    (tmp_path / "file").write_text("")
    with pytest.raises(TrackError, match="cannot be written"):
        files.save(GOOD, tmp_path / "file" / "track.yaml")
    assert sorted(entry.name for entry in tmp_path.iterdir()) == ["file", "taken"]


def test_no_reader_ever_sees_half_a_file(tmp_path):
    path = tmp_path / "test_track.yaml"
    files.save(GOOD, path)
    seen = set()
    stop = threading.Event()

    def watch() -> None:
        while not stop.is_set():
            seen.add(path.read_text())

    watcher = threading.Thread(target=watch)
    watcher.start()
    other = GOOD.replace("A Test Track", "Another")
    for turn in range(40):
        files.save(other if turn % 2 else GOOD, path)
    stop.set()
    watcher.join()
    assert seen <= {GOOD, other}


def test_a_report_tells_the_figures_of_a_track():
    assert files.report(files.load("reinvent_2018")) == {
        "name": "reinvent_2018",
        "title": "re:Invent 2018",
        "length": 17.71,
        "width": 0.762,
        "direction": "counter-clockwise",
        "min_radius": 0.77,
        "points": 354,
    }
    assert files.report(shapes.straight())["min_radius"] == float("inf")
    assert shapes.straight().bends == "straight"
    assert files.load("reinvent_2018").bends == "smallest radius 0.77 m"


def test_the_list_of_tracks_for_people_is_up_to_date():
    readme = (files.folder() / "README.md").read_text()
    for name in files.names():
        track = files.load(name)
        row = next(line for line in readme.splitlines() if line.startswith(f"| `{name}`"))
        for figure in (track.title, f"{track.length:.2f} m", f"{track.width:.3f} m"):
            assert figure in row
        assert f"| {track.direction} | {track.min_radius:.2f} m |" in row


def test_in_a_wheel_the_tracks_lie_inside_the_package(tmp_path, monkeypatch):
    (tmp_path / "league" / "_tracks").mkdir(parents=True)
    files.save(GOOD, tmp_path / "league" / "_tracks" / "test_track.yaml")
    monkeypatch.setattr(files, "_PACKAGE", tmp_path / "league")
    assert files.names() == ["test_track"]
    assert files.load("test_track").title == "A Test Track"
