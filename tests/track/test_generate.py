import numpy as np
import pytest
from scipy.spatial import KDTree
from scipy.spatial.distance import pdist

from league.errors import TrackError
from league.track import build, files, generate, spline


def _drawn(count: int = 60, **wishes):
    return [generate.generate(seed, **wishes) for seed in range(count)]


def test_generated_tracks_are_sound_and_as_asked():
    for track in _drawn():
        build.sound(track)  # crossings, overlaps, radii, reach
        assert track.closed
        assert track.min_radius >= 0.5
        assert 0.599 < track.width < 1.101
        assert 15 <= track.length <= 40


def test_stretches_of_a_generated_track_keep_clear_of_each_other():
    # Overlaps are rare enough that seeds matter: without the check, seed 70 comes too near.
    for seed in range(60, 80):
        track = generate.generate(seed, width=(1.0, 1.1))
        pairs = KDTree(track.center).query_pairs(track.width + 0.08, output_type="ndarray")
        apart = pairs[:, 1] - pairs[:, 0]
        apart = np.minimum(apart, len(track.center) - apart) * 0.05
        # Points of two roads nearer than a width belong to one bend.
        assert apart.max() < spline.FOLD_REACH * track.width / 2 + 0.2


def test_the_same_seed_gives_the_same_track_and_another_seed_another():
    first, again, other = (generate.generate(seed) for seed in (7, 7, 8))
    assert first.text == again.text
    assert np.array_equal(first.center, again.center)
    assert first.text != other.text


def test_the_text_of_a_generated_track_gives_the_same_bits():
    for track in _drawn(10):
        again = files.parse(track.text)
        for field in ("center", "left", "right"):
            assert np.array_equal(getattr(again, field), getattr(track, field))


def test_generated_tracks_differ_clearly():
    tracks = _drawn(100)
    outlines = np.stack([_as_driven(track) for track in tracks])
    # Root mean square distance of the two courses, each seen from its own start line.
    assert pdist(outlines.reshape(100, -1)).min() / 8 > 0.3
    turning = [np.abs(track.curvature).sum() * 0.05 / (2 * np.pi) for track in tracks]
    assert np.median(turning) > 1.5  # a plain oval has 1
    straight = [(np.abs(track.curvature) < 0.1).mean() for track in tracks]
    assert max(straight) > 0.4 and min(straight) < 0.15


def _as_driven(track) -> np.ndarray:
    rows = np.linspace(0, len(track.center), 64, endpoint=False).astype(int)
    along = track.tangent[0]
    return (track.center[rows] - track.center[0]) @ np.array([along, (-along[1], along[0])]).T


def test_both_directions_are_drawn_and_one_can_be_asked_for():
    assert {track.direction for track in _drawn(12)} == {"clockwise", "counter-clockwise"}
    assert {track.direction for track in _drawn(6, direction="clockwise")} == {"clockwise"}


@pytest.mark.parametrize(
    "wishes",
    [
        {"min_radius": 1.5, "width": (1.07, 1.07), "length": (60.0, 90.0)},
        {"min_radius": 0.3, "width": (0.6, 0.6), "length": (8.0, 12.0)},
        {"min_radius": 0.25, "width": (0.3, 0.3)},
    ],
)
def test_wishes_are_kept(wishes):
    for track in _drawn(8, **wishes):
        assert track.min_radius >= wishes["min_radius"]
        assert track.width == pytest.approx(wishes["width"][0], abs=1e-3)
        low, high = wishes.get("length", (15.0, 40.0))
        assert low <= track.length <= high


def test_the_start_lies_on_a_straight():
    for track in _drawn(20):
        rows = np.r_[-8:9]
        assert np.abs(track.curvature[rows]).mean() <= np.abs(track.curvature).mean()


@pytest.mark.parametrize(
    ("seed", "wishes", "phrase"),
    [
        (-1, {}, "seed is -1"),
        (0, {"min_radius": float("nan")}, "min_radius is nan"),
        (0, {"width": (1.0, 0.5)}, "width is 1.0 to 0.5"),
        (0, {"length": (0.0, 10.0)}, "length is 0.0"),
        (0, {"direction": "left"}, "direction is 'left'"),
        (0, {"min_radius": 5.0, "length": (15.0, 20.0)}, "no sound track was found.*longer"),
    ],
)
def test_what_cannot_be_drawn_is_refused_with_a_reason(seed, wishes, phrase):
    with pytest.raises(TrackError, match=phrase):
        generate.generate(seed, **wishes)
