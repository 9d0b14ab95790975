import time
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import KDTree

from league.errors import TrackError
from league.race_spec import Entry, RaceSpec
from league.racing import race
from league.track import files, importer, spline
from tests.track import shapes

SHARED = Path(__file__).parents[3] / "shared" / "tracks"
COMMUNITY = sorted(SHARED.glob("*.npy")) if SHARED.is_dir() else []


def _rows(count: int = 80, *, clockwise: bool = False, closed: bool = True) -> np.ndarray:
    """A ring of 3 m x 2 m, 0.8 m wide, as the community writes it; first row repeated."""
    angle = np.linspace(0, 2 * np.pi, count) * (-1 if clockwise else 1)
    unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    center = unit * (3, 2)
    inner, outer = unit * (2.6, 1.6), unit * (3.4, 2.4)
    rows = np.concatenate([center, inner, outer], axis=1)
    return rows if closed else rows[: count // 2]


def _write(path: Path, rows: object) -> Path:
    np.save(path, rows)
    return path


@pytest.mark.skipif(not COMMUNITY, reason="the community's files are not on this machine")
def test_all_ten_community_files_are_there():
    assert len(COMMUNITY) == 10


@pytest.mark.parametrize("path", COMMUNITY, ids=lambda path: path.stem)
def test_a_community_track_is_reproduced_within_a_centimetre(path):
    rows = np.load(path)
    track = importer.read_npy(path)
    dense = spline.resample(track.center, closed=track.closed, spacing=0.005)
    assert KDTree(dense).query(rows[:, :2])[0].max() < 0.01
    assert np.linalg.norm(track.center[0] - rows[0, :2]) < 0.005
    sides = (rows[:, 2:4], rows[:, 4:6])
    inner_is_left = track.direction != "clockwise"
    for border, given in zip(
        (track.left, track.right), sides[:: 1 if inner_is_left else -1], strict=True
    ):
        # Every border point of ours lies on the given border line.
        gap = _distance_to_line(border, given)
        assert np.median(gap) < 0.003
        assert np.percentile(gap, 95) < 0.01
    again = files.parse(track.text)
    for field in ("center", "left", "right"):
        assert np.array_equal(getattr(again, field), getattr(track, field))


@pytest.mark.parametrize("path", COMMUNITY, ids=lambda path: path.stem)
def test_waypoints_of_a_community_track_are_its_rows_to_the_bit(path):
    rows = np.load(path)
    track = importer.read_npy(path)
    assert np.array_equal(track.waypoints, rows[:, :2])
    assert np.array_equal(files.parse(track.text).waypoints, rows[:, :2])
    _assert_in_step(track, rows)


def _assert_in_step(track, rows: np.ndarray) -> None:
    """Assert that waypoints lie as far apart along our lap as along the lines that join them."""
    places = shapes.waypoint_places(track)
    chords = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1)
    # Two rows up to 8 mm off the curve; a bend of 0.3 m is 4 % longer than a chord of 0.3 m.
    np.testing.assert_allclose(np.diff(places), chords, rtol=0.05, atol=0.01)
    assert not np.diff(places)[chords == 0].any()
    if track.closed:
        assert places[-1] - places[0] == pytest.approx(track.length)
    assert min(places[0], track.length - places[0]) < 1e-3  # row 0 is on the start line


def _distance_to_line(points: np.ndarray, line: np.ndarray) -> np.ndarray:
    parts = np.linspace(0, 1, 60)[:, None, None]
    dense = (line[:-1] + (line[1:] - line[:-1]) * parts).reshape(-1, 2)
    return KDTree(dense).query(points)[0]


@pytest.mark.skipif(not COMMUNITY, reason="the community's files are not on this machine")
def test_the_known_figures_of_community_tracks_come_out():
    spain = importer.read_npy(SHARED / "Spain_track.npy")
    assert spain.direction == "clockwise" and spain.length == pytest.approx(60.0, abs=0.1)
    assert not spain.line_inside
    straight = importer.read_npy(SHARED / "Straight_track.npy")
    assert straight.direction == "open" and straight.length == pytest.approx(5.71, abs=0.01)
    bowtie = importer.read_npy(SHARED / "Bowtie_track.npy")
    assert bowtie.width == pytest.approx(0.609, abs=0.003) and not bowtie.line_inside
    wide = importer.read_npy(SHARED / "reInvent2019_wide.npy")
    assert wide.width == pytest.approx(1.066, abs=0.003) and wide.line_inside


@pytest.mark.parametrize("clockwise", [False, True])
def test_the_inner_ring_becomes_the_border_on_the_right_side_of_the_driver(tmp_path, clockwise):
    path = _write(tmp_path / "ring.npy", _rows(clockwise=clockwise))
    track = importer.read_npy(path)
    assert track.direction == ("clockwise" if clockwise else "counter-clockwise")
    inner, outer = (track.right, track.left) if clockwise else (track.left, track.right)
    assert np.linalg.norm(inner, axis=1).max() < np.linalg.norm(outer, axis=1).max()
    assert np.ptp(inner[:, 0]) == pytest.approx(5.2, abs=0.02)
    assert np.ptp(outer[:, 0]) == pytest.approx(6.8, abs=0.02)


def test_repeated_rows_and_rows_out_of_square_change_little(tmp_path):
    clean = importer.read_npy(_write(tmp_path / "clean.npy", _rows()))
    rows = _rows()
    rows = np.insert(rows, 20, rows[20], axis=0)  # a zero-length segment
    # The inner border's rows slide along it: no longer perpendicular to the centre.
    rows[:-1, 2:4] = np.roll(rows[:-1, 2:4], 3, axis=0)
    rows[-1] = rows[0]
    skew = importer.read_npy(_write(tmp_path / "skew.npy", rows))
    assert KDTree(clean.center).query(skew.center)[0].max() < 0.03
    left = np.linalg.norm(skew.left - skew.center, axis=1)
    np.testing.assert_allclose(left, 0.4, atol=0.06)
    assert skew.width == pytest.approx(clean.width, abs=0.005)


@pytest.mark.parametrize("clockwise", [False, True])
def test_waypoints_are_the_rows_as_they_are_repeated_ones_too(tmp_path, clockwise):
    rows = _rows(clockwise=clockwise) + (0.1, 0.2) * 3
    rows[-1] = rows[0]
    rows = np.insert(rows, 20, rows[20], axis=0)  # a zero-length segment
    track = importer.read_npy(_write(tmp_path / "ring.npy", rows))
    assert len(rows) == 81
    assert np.array_equal(track.waypoints, rows[:, :2])
    assert np.array_equal(files.parse(track.text).waypoints, rows[:, :2])
    _assert_in_step(track, rows)


def test_waypoints_of_an_open_track_are_its_rows(tmp_path):
    rows = _straight()
    track = importer.read_npy(_write(tmp_path / "straight.npy", rows))
    assert np.array_equal(track.waypoints, rows[:, :2])
    # 61 rows on 6 m.
    np.testing.assert_allclose(shapes.waypoint_places(track), np.linspace(0, 6, 61), atol=1e-3)


def test_waypoints_of_a_loop_end_where_they_begin_whatever_the_file_does(tmp_path):
    rows = _rows()
    once = importer.read_npy(_write(tmp_path / "once.npy", rows[:-1]))
    assert np.array_equal(once.waypoints, [*rows[:-1, :2], rows[0, :2]])
    rows[-1] += 0.004  # meant to be row 0
    nearly = importer.read_npy(_write(tmp_path / "nearly.npy", rows))
    assert np.array_equal(nearly.waypoints, [*rows[:-1, :2], rows[0, :2]])


def test_waypoints_of_the_largest_array_fit_into_a_track_file(tmp_path):
    rows = _rows(2001)[:-1]
    track = importer.read_npy(_write(tmp_path / "large.npy", rows))
    assert len(track.waypoints) == 2001
    assert np.array_equal(files.parse(track.text).waypoints, track.waypoints)


def test_waypoints_in_single_precision_are_written_in_double(tmp_path):
    rows = _rows().astype(np.float32)
    rows[-1] = rows[0]
    track = importer.read_npy(_write(tmp_path / "single.npy", rows))
    assert np.array_equal(track.waypoints, rows[:, :2].astype(np.float64))


def _clockwise() -> np.ndarray:
    """A clover, bending both ways, driven clockwise; row 0 at the end, another one twice."""
    angle = -np.linspace(0, 2 * np.pi, 120)
    radius = 2.5 + 0.4 * np.cos(3 * angle)
    center = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    center[-1] = center[0]
    left = spline.left_normal(center[:-1], closed=True)
    left = 0.4 * np.concatenate([left, left[:1]])
    rows = np.concatenate([center, center - left, center + left], axis=1)
    return np.insert(rows, 30, rows[30], axis=0)


def _out_of_square() -> np.ndarray:
    """The ring with both borders' rows slid along them, one ahead and one back."""
    rows = _rows(120)[:-1]
    rows[:, 2:4] = np.roll(rows[:, 2:4], -4, axis=0)
    rows[:, 4:6] = np.roll(rows[:, 4:6], 3, axis=0)
    return np.concatenate([rows, rows[:1]])


def _straight() -> np.ndarray:
    """Six metres towards the south-west, 0.76 m wide, with both ends open."""
    along, left = np.array([-0.8, -0.6]), np.array([0.6, -0.8])
    center = 5.0 + np.linspace(0, 6, 61)[:, None] * along
    return np.concatenate([center, center + 0.38 * left, center - 0.38 * left], axis=1)


@pytest.mark.parametrize("driver", ["centerline", "racing_line"])
@pytest.mark.parametrize(
    ("make", "direction"),
    [(_clockwise, "clockwise"), (_out_of_square, "counter-clockwise"), (_straight, "open")],
)
def test_imported_tracks_are_driven_to_the_end(tmp_path, driver, make, direction):
    rows = make()
    track = importer.read_npy(_write(tmp_path / "made.npy", rows))
    assert track.direction == direction
    given = np.linalg.norm(np.diff(rows[:, :2], axis=0), axis=1).sum()
    assert track.length == pytest.approx(given, abs=0.05)
    spec = RaceSpec(kind="time_trial", entries=(Entry(name=driver),), laps=1)
    (car,) = race.run(spec, track=track, record=False).result.order
    assert car.finished and car.laps == 1
    assert (car.off_tracks, car.crashes, car.immobilised, car.reversed) == (0, 0, 0, 0)


def test_an_inner_border_that_loops_in_a_tight_bend_is_cut_clean():
    # Offsetting a bend of 0.25 m radius by 0.45 m makes the inner border loop.
    angle = np.linspace(-np.pi / 2, 0, 9)
    bend = np.stack([3 + 0.25 * np.cos(angle), 0.25 + 0.25 * np.sin(angle)], axis=1)
    lower = np.stack([np.linspace(-2, 2.9, 25), np.zeros(25)], axis=1)
    right = np.stack([np.full(10, 3.25), np.linspace(0.4, 2, 10)], axis=1)
    angle = np.linspace(0, np.pi, 30)
    top = np.stack([3.125 * np.cos(angle) + 0.125, 2 + 1.5 * np.sin(angle)], axis=1)[1:]
    left = np.stack([np.full(5, -3.0), np.linspace(1.8, 1.0, 5)], axis=1)
    center = np.concatenate([lower[6:], bend, right, top, left, lower[:7]])
    normal = spline.left_normal(center[:-1], closed=True)
    normal = np.concatenate([normal, normal[:1]])
    rows = np.concatenate([center, center + 0.45 * normal, center - 0.45 * normal], axis=1)
    track = importer.from_rows(rows, "tight", "tight.npy")
    assert track.width == pytest.approx(0.9, abs=0.02)
    assert track.min_radius < 0.4


def test_a_name_is_made_from_the_files_name(tmp_path):
    path = _write(tmp_path / "My ring (2).npy", _rows())
    track = importer.read_npy(path)
    assert track.name == "My_ring_2"
    assert track.title == "My ring 2"


def _declared(path: Path, shape: str, descr: str = "<f8", body: bytes = b"") -> Path:
    header = f"{{'descr': '{descr}', 'fortran_order': False, 'shape': {shape}, }}"
    header += " " * (118 - len(header) % 64) + "\n"
    path.write_bytes(
        b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + body
    )
    return path


def test_ten_gigabytes_are_refused_at_once_declared_or_real(tmp_path):
    declared = _declared(tmp_path / "declared.npy", "(208333333, 6)")
    real = _declared(tmp_path / "real.npy", "(2000, 6)")
    with open(real, "r+b") as file:
        file.truncate(10 * 2**30)  # sparse: takes no room on the disk
    begin = time.process_time()
    with pytest.raises(TrackError, match=r"208,333,333 rows.*4 to 2000"):
        importer.read_npy(declared)
    with pytest.raises(TrackError, match="larger than 1,000,000 bytes"):
        importer.read_npy(real)
    # Reading 10 GB takes many seconds; this is a bound on work, not on speed.
    assert time.process_time() - begin < 5


def _with(value: float) -> np.ndarray:
    rows = _rows()
    rows[7, 2] = value
    return rows


BROKEN = {
    "one column short": (lambda: _rows()[:, :5], r"shape \(80, 5\).*\(N, 6\)"),
    "one dimension": (lambda: np.zeros(6), r"shape \(6,\)"),
    "three rows": (lambda: _rows()[:3], "3 rows"),
    "one place": (lambda: np.zeros((50, 6)), "1 different centre"),
    "nan": (lambda: _with(np.nan), "row 7, column 2 is nan"),
    "infinity": (lambda: _with(np.inf), "row 7, column 2 is inf"),
    "millimetres": (lambda: _rows() * 100, "at most 300 m and 60 m"),
    "kilometres": (lambda: _rows() * 1e9, "within 1000 m"),
    "text": (lambda: np.full((9, 6), "a"), "floating-point"),
    "complex": (lambda: _rows() + 1j, "complex128"),
    "no borders": (lambda: np.tile(_rows()[:, :2], 3), "both sides of the centre"),
    "borders swapped about": (lambda: _rows()[:, [2, 3, 0, 1, 4, 5]], "both sides of the centre"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_broken_array_gets_one_sentence(tmp_path, fault):
    make, phrase = BROKEN[fault]
    path = _write(tmp_path / "broken.npy", make())
    with pytest.raises(TrackError, match=phrase) as caught:
        importer.read_npy(path)
    assert "broken.npy" in str(caught.value) and "\n" not in str(caught.value)


def test_objects_are_refused_without_being_unpickled(tmp_path):
    class Trap:
        def __reduce__(self):
            return (_spring, ())

    path = tmp_path / "trap.npy"
    np.save(path, np.array([[Trap()] * 6] * 10, dtype=object), allow_pickle=True)
    with pytest.raises(TrackError, match="object"):
        importer.read_npy(path)


def _spring() -> None:
    raise AssertionError("the file ran code")


def test_files_that_are_no_arrays_are_refused(tmp_path):
    (tmp_path / "folder.npy").mkdir()
    (tmp_path / "empty.npy").write_bytes(b"")
    (tmp_path / "text.npy").write_text("hello")
    whole = _write(tmp_path / "whole.npy", _rows()).read_bytes()
    (tmp_path / "cut.npy").write_bytes(whole[:-100])
    np.savez(tmp_path / "zipped", rows=_rows())
    (tmp_path / "zipped.npz").rename(tmp_path / "zipped.npy")
    for name in ("missing.npy", "folder.npy", "empty.npy", "text.npy", "cut.npy", "zipped.npy"):
        with pytest.raises(TrackError, match=name.split(".")[0]):
            importer.read_npy(tmp_path / name)
