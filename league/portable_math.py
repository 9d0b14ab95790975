"""Compiled elementary functions in float32 that give the same bits on every machine.

libm and the vector libraries behind NumPy and torch round differently from processor to processor.
These are the single-precision polynomials of S. Moshier's Cephes library (Methods and Programs for
Mathematical Functions, 1989): only additions, multiplications and divisions, in a fixed order. Sine
and cosine are off by less than 1e-7 for angles up to 8,192 rad, and by less than 2 units in the
last place up to 30 rad.
"""

import math

import numpy as np

from league.jit import compiled, inner

f32 = np.float32

PI = f32(math.pi)
TWO_PI = f32(2 * math.pi)

_FOUR_OVER_PI = f32(4 / math.pi)
# Pi / 4 in three parts, so that multiples of it are subtracted without rounding.
_QUARTER_1, _QUARTER_2 = f32(0.78515625), f32(2.4187564849853515625e-4)
_QUARTER_3 = f32(3.77489497744594108e-8)
_SIN_1, _SIN_2, _SIN_3 = f32(-1.9515295891e-4), f32(8.3321608736e-3), f32(-1.6666654611e-1)
_COS_1, _COS_2 = f32(2.443315711809948e-5), f32(-1.388731625493765e-3)
_COS_3 = f32(4.166664568298827e-2)
_ATAN_1, _ATAN_2 = f32(8.05374449538e-2), f32(-1.38776856032e-1)
_ATAN_3, _ATAN_4 = f32(1.99777106478e-1), f32(-3.33329491539e-1)
_TAN_3_PI_8, _TAN_PI_8 = f32(2.414213562373095), f32(0.4142135623730950)
_HALF_PI, _QUARTER_PI = f32(math.pi / 2), f32(math.pi / 4)
_LOG2_E = f32(1.44269504088896341)
# The logarithm of 2 in two parts, so that multiples of it are subtracted without rounding.
_LN2_1, _LN2_2 = f32(0.693359375), f32(-2.12194440e-4)
_EXP_1, _EXP_2, _EXP_3 = f32(1.9875691500e-4), f32(1.3981999507e-3), f32(8.3334519073e-3)
_EXP_4, _EXP_5, _EXP_6 = f32(4.1665795894e-2), f32(1.6666665459e-1), f32(5.0000001201e-1)
_LEAST_EXP, _MOST_EXP = f32(-87.0), f32(88.0)
_LEAST_POWER = -126
_POWERS_OF_2 = (2.0 ** np.arange(_LEAST_POWER, 128)).astype(np.float32)
_ZERO, _HALF, _ONE = f32(0.0), f32(0.5), f32(1.0)


@inner
def clamp(value, low, high):
    """Return the value held between two limits; NaN stays NaN."""
    return low if value < low else (high if value > high else value)


@inner
def sincos(angle):
    """Return the sine and the cosine of an angle [rad], both float32."""
    size = abs(angle)
    octant = np.int32(size * _FOUR_OVER_PI)
    octant = octant + (octant & np.int32(1))
    part = f32(octant)
    rest = ((size - part * _QUARTER_1) - part * _QUARTER_2) - part * _QUARTER_3
    square = rest * rest
    sine = ((_SIN_1 * square + _SIN_2) * square + _SIN_3) * square * rest + rest
    cosine = ((_COS_1 * square + _COS_2) * square + _COS_3) * (square * square)
    cosine = (cosine - _HALF * square) + _ONE
    quadrant = (octant >> np.int32(1)) & np.int32(3)
    if quadrant & np.int32(1):
        sine, cosine = cosine, sine
    if quadrant >= np.int32(2):
        sine = -sine
    if quadrant == np.int32(1) or quadrant == np.int32(2):
        cosine = -cosine
    if angle < _ZERO:
        sine = -sine
    return sine, cosine


@compiled
def direction(angle):
    """Return the cosine and the sine of an angle [rad], rounded to float32, as float64."""
    sine, cosine = sincos(f32(angle))
    return np.float64(cosine), np.float64(sine)


@inner
def atan(value):
    """Return the arc tangent of a float32 [rad], in [-pi/2, pi/2]."""
    size = abs(value)
    base = _ZERO
    if size > _TAN_3_PI_8:
        base, size = _HALF_PI, -(_ONE / size)
    elif size > _TAN_PI_8:
        base, size = _QUARTER_PI, (size - _ONE) / (size + _ONE)
    square = size * size
    series = ((_ATAN_1 * square + _ATAN_2) * square + _ATAN_3) * square + _ATAN_4
    angle = base + (series * square * size + size)
    return -angle if value < _ZERO else angle


@inner
def exp(value):
    """Return e to the power of a float32, held between e^-87 and e^88; NaN stays NaN."""
    value = clamp(value, _LEAST_EXP, _MOST_EXP)
    whole = f32(math.floor(value * _LOG2_E + _HALF))
    rest = (value - whole * _LN2_1) - whole * _LN2_2
    series = ((((_EXP_1 * rest + _EXP_2) * rest + _EXP_3) * rest + _EXP_4) * rest + _EXP_5) * rest
    series = (series + _EXP_6) * (rest * rest) + rest + _ONE
    place = np.int32(whole) - _LEAST_POWER if whole == whole else 0
    return series * _POWERS_OF_2[place]


@inner
def heading_of(x, y):
    """Return the direction of a vector [rad] in (-pi, pi]; 0 for a vector of no length."""
    if abs(x) >= abs(y):
        if x == _ZERO:
            return _ZERO
        angle = atan(y / x)
        if x < _ZERO:
            angle = angle - PI if y < _ZERO else angle + PI
        return angle
    angle = _HALF_PI - atan(x / abs(y))
    return -angle if y < _ZERO else angle


@inner
def wrap_angle(angle):
    """Return the angle [rad] wrapped to [-pi, pi); what is in range keeps its bits."""
    if angle >= PI or angle < -PI:
        angle = angle - f32(math.floor((angle + PI) / TWO_PI)) * TWO_PI
        # Rounding can leave it a hair outside, or far outside after a million turns.
        if angle >= PI:
            angle = angle - TWO_PI
        if angle < -PI or angle >= PI:
            angle = -PI
    return angle


@inner
def wrap(value, length):
    """Return the value wrapped to [0, length)."""
    if value < _ZERO or value >= length:
        value = value - f32(math.floor(value / length)) * length
        # Rounding can leave it a hair outside.
        if value < _ZERO:
            value = value + length
        if value >= length:
            value = _ZERO
    return value
