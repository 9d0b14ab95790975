"""Elementary functions in float32: how exact they are, where they wrap, which bits they give."""

import math

import numba
import numpy as np
import pytest

from league import portable_math


def over(function, results=1):
    """Return the compiled function for arrays: float32 of any shape, its results along axis 0."""
    if results == 2:

        @numba.njit(error_model="numpy")
        def loop(values, out):
            for k in range(len(values)):
                out[0, k], out[1, k] = function(values[k])

    else:

        @numba.njit(error_model="numpy")
        def loop(values, out):
            for k in range(len(values)):
                out[0, k] = function(values[k])

    def call(values):
        values = np.asarray(values, np.float32)
        out = np.empty((results, values.size), np.float32)
        loop(values.ravel(), out)
        return out.reshape(results, *values.shape) if results > 1 else out.reshape(values.shape)

    return call


def over_two(function):
    """Return the compiled function of two numbers for arrays."""

    @numba.njit(error_model="numpy")
    def loop(one, other, out):
        for k in range(len(one)):
            out[k] = function(one[k], other[k])

    def call(one, other):
        one, other = np.broadcast_arrays(np.asarray(one, np.float32), np.asarray(other, np.float32))
        out = np.empty(one.size, np.float32)
        loop(one.ravel(), other.ravel(), out)
        return out.reshape(one.shape)

    return call


SINCOS, ATAN = over(portable_math.sincos, 2), over(portable_math.atan)
EXP, WRAP_ANGLE = over(portable_math.exp), over(portable_math.wrap_angle)
HEADING_OF, WRAP = over_two(portable_math.heading_of), over_two(portable_math.wrap)
PI = np.float32(math.pi)


def grid(most: float, number: int = 200_001) -> np.ndarray:
    """Return float32 numbers evenly spaced over both signs."""
    return np.linspace(-most, most, number).astype(np.float32)


def exact(function, *columns):
    """Return Python's function of float32 numbers, in float64."""
    rows = zip(*(column.astype(float).tolist() for column in columns), strict=True)
    return np.array([function(*row) for row in rows])


def units(got, wanted):
    """Return the largest error in units in the last place of the wanted numbers."""
    return (abs(got - wanted) / np.spacing(abs(wanted).astype(np.float32))).max()


def bits(values):
    """Return float32 numbers as the integers that have their bits."""
    return np.asarray(values, np.float32).view(np.uint32).ravel().tolist()


@pytest.mark.parametrize("most", [math.pi, 30.0])
def test_sine_and_cosine_are_within_two_units_in_the_last_place(most):
    sine, cosine = SINCOS(grid(most))
    assert units(sine, exact(math.sin, grid(most))) <= 2
    assert units(cosine, exact(math.cos, grid(most))) <= 2


def test_sine_and_cosine_of_large_angles_are_within_a_ten_millionth():
    sine, cosine = SINCOS(grid(8192.0))
    assert abs(sine - exact(math.sin, grid(8192.0))).max() < 1e-7
    assert abs(cosine - exact(math.cos, grid(8192.0))).max() < 1e-7


def test_arc_tangent_is_within_three_units_in_the_last_place():
    sizes = np.geomspace(1e-20, 1e20, 50_001).astype(np.float32)
    for values in (grid(10.0), sizes, -sizes):
        assert units(ATAN(values), exact(math.atan, values)) <= 3
    assert ATAN([np.inf, -np.inf]).tolist() == [PI / 2, -PI / 2]


def test_exponential_is_within_one_unit_in_the_last_place_and_held_at_its_ends():
    values = grid(87.0)
    assert units(EXP(values), exact(math.exp, values)) <= 1
    low, high = EXP([-87.0, 88.0])
    assert EXP([-1e9, -np.inf, 1e9, np.inf]).tolist() == [low, low, high, high]


def test_heading_agrees_with_atan2_all_round():
    angle, length = np.linspace(-math.pi, math.pi, 100_001)[1:], np.geomspace(1e-15, 1e15, 100_000)
    x = (length * np.cos(angle)).astype(np.float32)
    y = (length * np.sin(angle)).astype(np.float32)
    assert abs(HEADING_OF(x, y) - exact(math.atan2, y, x)).max() < 3e-7


@pytest.mark.parametrize(
    ("x", "y", "heading"),
    [(1, 0, 0), (0, 1, PI / 2), (-1, 0, PI), (-1, -0.0, PI), (0, -1, -PI / 2), (0, 0, 0)],
)
def test_heading_along_the_axes_is_exact(x, y, heading):
    assert HEADING_OF([x], [y]).tolist() == [heading]


@pytest.mark.parametrize(
    ("angle", "wrapped"),
    [
        (0.0, 0.0),
        (math.pi, -math.pi),
        (-math.pi, -math.pi),
        (3.5, 3.5 - 2 * math.pi),
        (-3.5, 2 * math.pi - 3.5),
        (7.0, 0.7168),
        (3 * math.pi, -math.pi),
    ],
)
def test_angles_are_wrapped_to_half_a_turn_either_way(angle, wrapped):
    assert WRAP_ANGLE([angle]).item() == pytest.approx(wrapped, abs=1e-4)


@pytest.mark.parametrize("most", [4.0, 20.0, 1e3, 1e9])
def test_wrapped_angle_is_in_range_and_the_same_direction(most):
    wrapped = WRAP_ANGLE(grid(most))
    assert (wrapped >= -PI).all() and (wrapped < PI).all()
    off = np.remainder(wrapped.astype(float) - grid(most) + math.pi, math.tau) - math.pi
    # What 2 pi lacks in float32 is counted once for each turn.
    assert most > 1e3 or abs(off).max() < 4e-7 * max(most / 4, 1)


def test_angle_in_range_keeps_its_bits():
    angles = np.append(grid(3.1415925), [-PI, np.nextafter(PI, np.float32(0))])
    assert bits(WRAP_ANGLE(angles)) == bits(angles)


@pytest.mark.parametrize("length", [0.3, 12.0, 17.67])
@pytest.mark.parametrize("laps", [2, 100, 1e6])
def test_wrapped_place_is_on_the_lap_and_the_same_place(length, laps):
    length = np.float32(length)
    places = grid(laps * length)
    wrapped = WRAP(places, length)
    assert (wrapped >= 0).all() and (wrapped < length).all()
    half = float(length) / 2
    off = np.remainder(wrapped.astype(float) - places + half, 2 * half) - half
    assert laps > 100 or abs(off).max() < 1e-6 * laps


def test_places_at_the_line_are_wrapped_to_the_beginning():
    below = np.nextafter(np.float32(12), np.float32(0))
    places = [-1e-9, 0.0, 12.0, 24.0, -12.0, below, 13.5]
    assert WRAP(places, 12.0).tolist() == [0, 0, 0, 0, 0, below, 1.5]


def test_mirrored_arguments_give_mirrored_results_to_the_bit():
    values = grid(50.0)[:100_000]
    sine, cosine = SINCOS(values)
    assert np.array_equal(SINCOS(-values), [-sine, cosine])
    assert np.array_equal(ATAN(-values), -ATAN(values))
    other = values[::-1] + np.float32(0.7)
    assert np.array_equal(HEADING_OF(other, -values), -HEADING_OF(other, values))


def test_nan_stays_nan():
    for function in (SINCOS, ATAN, EXP, WRAP_ANGLE):
        assert np.isnan(function([np.nan])).all()
    assert np.isnan(WRAP([np.nan], 12.0)).all()


def test_number_has_the_same_bits_alone_and_among_others():
    values = grid(40.0, 4097)
    together = WRAP_ANGLE(3 * HEADING_OF(SINCOS(values)[0], values))
    for place in (0, 1, 7, 2048, 4096):
        one = values[place : place + 1]
        alone = WRAP_ANGLE(3 * HEADING_OF(SINCOS(one)[0], one))
        assert bits(alone) == bits(together[place])


def test_results_have_these_bits_on_every_machine():
    assert bits(SINCOS([0.5, 3.0, 100.0, 5000.25])) == [
        0x3EF57744, 0x3E1081C3, 0xBF01A12E, 0xBF6B42C2,
        0x3F60A940, 0xBF7D7026, 0x3F5CC0EE, 0x3EC9DFFB,
    ]  # fmt: skip
    assert bits(ATAN([0.5, 1.0, 3.0, 100.0])) == [0x3EED6338, 0x3F490FDB, 0x3F9FE0BC, 0x3FC7C830]
    assert bits(EXP([0.5, 1.0, 3.0, 80.0])) == [0x3FD3094C, 0x402DF854, 0x41A0AF2E, 0x792ABBCE]
