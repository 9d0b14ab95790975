import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from league.track import build, spline


def test_a_circle_through_twelve_points_is_a_circle_within_half_a_millimetre():
    angle = np.arange(12) * np.pi / 6
    points = 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows = spline.resample(points, closed=True, spacing=0.05)
    np.testing.assert_allclose(np.linalg.norm(rows, axis=1), 2.0, atol=5e-4)
    assert len(rows) == round(4 * np.pi / 0.05)


def test_an_open_curve_runs_from_its_first_point_to_its_last():
    rows = spline.resample(np.array([[0, 0], [1, 0], [3, 0]]), closed=False, spacing=0.1)
    np.testing.assert_allclose(rows[[0, -1]], [[0, 0], [3, 0]], atol=1e-12)
    np.testing.assert_allclose(np.diff(rows[:, 0]), 0.1, atol=1e-9)


def test_a_border_inside_a_bend_ends_at_the_middle_of_its_circle():
    angle = np.arange(126) * 2 * np.pi / 126
    rows = np.stack([np.cos(angle), np.sin(angle)], axis=1)  # radius 1, spacing 0.05
    inward = spline.left_normal(rows, closed=True)
    wide, narrow = np.full(126, 1.5), np.full(126, 0.9)
    np.testing.assert_allclose(spline.unfold(rows, inward, wide, closed=True), 0.98, atol=1e-6)
    np.testing.assert_array_equal(spline.unfold(rows, inward, narrow, closed=True), narrow)
    np.testing.assert_array_equal(spline.unfold(rows, -inward, wide, closed=True), wide)


def test_a_border_inside_an_open_right_angle_is_clipped_to_its_bisector():
    along = np.linspace(0, 2, 41)
    rows = np.concatenate(
        [np.stack([along, 0 * along], axis=1), np.stack([0 * along[1:] + 2, along[1:]], axis=1)]
    )
    normal = np.concatenate([np.tile([0.0, 1.0], (40, 1)), np.tile([-1.0, 0.0], (41, 1))])
    reach = spline.unfold(rows, normal, np.full(81, 0.6), closed=False)
    # At x = 1.7 the bisector of the corner at (2, 0) is 0.3 m above the row.
    assert reach[34] == pytest.approx(0.98 * 0.3, abs=1e-6)
    assert reach[[0, 10, 70, 80]].tolist() == [0.6] * 4


def test_normals_meet_a_border_that_is_not_parallel():
    rows = np.stack([np.arange(5.0), np.zeros(5)], axis=1)
    up = np.tile([0.0, 1.0], (5, 1))
    border = np.array([[-1.0, 1.0], [3.5, 2.8]])  # rises by 0.4 per metre, ends before x = 4
    reach = spline.cast(rows, up, border, closed=False, limit=5.0)
    np.testing.assert_allclose(reach[:4], [1.4, 1.8, 2.2, 2.6])
    assert np.isnan(reach[4])
    assert np.isnan(spline.cast(rows, -up, border, closed=False, limit=5.0)).all()


def test_a_crossing_is_found_and_a_touching_neighbour_is_none():
    square = np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]])
    bow = square[[0, 2, 1, 3]]
    assert build.first_crossing(square, closed=True) is None
    assert build.first_crossing(bow, closed=True) == (0, 2)
    assert build.first_crossing(square, square + np.array([0.5, 0.5]), closed=True) is not None
    assert build.first_crossing(square, square * 3 - 1, closed=True) is None


def test_a_straight_of_many_points_does_not_cross_itself():
    x = np.cumsum(np.random.default_rng(1).uniform(0.01, 0.2, 300))
    for slope in (0.0, 0.1, 1e-9):
        assert build.first_crossing(np.stack([x, slope * x], axis=1), closed=False) is None


def test_crossings_agree_with_trying_all_pairs():
    generator = np.random.default_rng(4)
    for _ in range(60):
        line = generator.normal(size=(12, 2)).cumsum(axis=0)
        found = build.first_crossing(line, closed=False)
        pairs = [(i, j) for i in range(11) for j in range(i + 2, 11) if _cross(line, i, j)]
        assert (found is None) == (not pairs)
        assert found is None or found in pairs


def _cross(line: np.ndarray, i: int, j: int) -> bool:
    """Solve for where the two lines meet and see whether it is within both segments."""
    p, q, r, s = line[i], line[i + 1], line[j], line[j + 1]
    part = np.linalg.solve(np.stack([q - p, r - s], axis=1), r - p)
    return bool(((part >= 0) & (part <= 1)).all())


@pytest.mark.parametrize("closed", [True, False])
def test_a_curve_is_the_cubic_spline_through_its_points(closed):
    points = np.random.default_rng(3).uniform(0, 5, (20, 2))
    curve = spline.through(points, closed=closed)
    wanted = CubicSpline(curve.place, curve.points, bc_type="periodic" if closed else "natural")
    place = np.linspace(0, curve.place[-1], 333)
    np.testing.assert_allclose(curve(place), wanted(place), atol=1e-12)


def test_interpolation_is_linear_and_holds_its_ends():
    place, values = np.array([0.0, 1.0, 3.0]), np.array([2.0, 4.0, 0.0])
    wanted = np.array([-1.0, 0.0, 0.25, 1.0, 2.5, 3.0, 9.0])
    assert spline.interpolate(wanted, place, values).tolist() == [2.0, 2.0, 2.5, 4.0, 1.0, 0.0, 0.0]


def test_turns_are_the_angles_between_directions():
    angle = np.array([0.0, 1e-9, 0.03, -0.4, 1.5, 3.0, -3.1])
    base = np.array([0.3, -2.0, 1.0, 0.0, 2.5, 0.7, -1.2])
    first, second = (np.stack([np.cos(a), np.sin(a)], axis=1) for a in (base, base + angle))
    np.testing.assert_allclose(spline.turns(first, second), angle, atol=1e-12)
