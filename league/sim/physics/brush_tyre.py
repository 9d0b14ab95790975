"""Compiled: the forces of a tyre, along the wheel and across it; both solvers drive on these.

Brush tyre after E. Fiala (1954) and H. Pacejka, Tire and Vehicle Dynamics, chapter 3: the drive
takes its share of the friction circle, and what it leaves is the grip across the wheel. No force
does more in one physics step than stop the motion it opposes: each is held to `cap` times its
speed (docs/physics.md has equations and proof).
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportArgumentType=false, reportCallIssue=false, reportReturnType=false

import math

import numpy as np

from league.jit import inner
from league.portable_math import clamp

DRIVE_SHARE = np.float32(0.95)
"""Largest share of the grip that drive or brakes may take; the rest still steers."""
SLIP_FLOOR = np.float32(0.05)
"""Slowest rolling speed a slip is counted against [m/s]."""
_ZERO, _ONE, _THREE = np.float32(0.0), np.float32(1.0), np.float32(3.0)


@inner
def drive_force(wished, rolling, grip, cap):
    """Return the force along the wheels [N].

    Args:
        wished: force that the motor asks for [N].
        rolling: speed along the wheels [m/s].
        grip: friction coefficient times load [N].
        cap: largest braking force per speed [kg/s].
    """
    most = grip * DRIVE_SHARE
    # Brakes act against rolling ahead only, and at most stop it.
    stop = max(rolling, _ZERO) * cap
    return max(min(wished, most), -min(most, stop))


@inner
def lateral_force(sliding, rolling, drive, grip, slope, cap):
    """Return the force across the wheels [N], against the sliding.

    Args:
        sliding: speed across the wheels [m/s].
        rolling: speed along the wheels [m/s].
        drive: force along the wheels [N].
        grip: friction coefficient times load [N].
        slope: cornering stiffness over three times the friction coefficient [1/rad].
        cap: largest force per speed [kg/s].
    """
    rest = grip * grip - drive * drive
    left = np.float32(math.sqrt(rest))
    # F = left (3 z - 3 z |z| + z^3), z = stiffness load slip / (3 left), |z| <= 1.
    slip = sliding / max(abs(rolling), SLIP_FLOOR)
    z = clamp(slip * grip * slope / left, -_ONE, _ONE)
    size = abs(z)
    force = left * z * (size * (size - _THREE) + _THREE)
    held = abs(sliding) * cap
    return clamp(-force, -held, held)
