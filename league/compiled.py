"""Numba as we use it: machine code for what Python loops over, kept on disk once it is made.

Numba looks for changes in a function's own file alone, so a file of compiled functions imports
nothing of ours but this one (a test holds it to that), and whatever other files know comes as an
argument. What is on disk does not notice either when the settings below change.
"""

# Numba gives its types a meaning that the checker does not know.
# pyright: reportReturnType=false, reportCallIssue=false

from collections.abc import Callable
from typing import TypeVar

from numba import njit

_Function = TypeVar("_Function", bound=Callable)


def compiled(function: _Function) -> _Function:
    """Compile a function that is called from Python; kept on disk wherever there is a place.

    Other threads run meanwhile: the films of two cars' eyes are painted side by side.
    """
    try:
        return njit(cache=True, nogil=True, error_model="numpy")(function)
    except RuntimeError:  # no folder can be written
        return njit(nogil=True, error_model="numpy")(function)


inner = njit(error_model="numpy", no_cpython_wrapper=True, no_cfunc_wrapper=True)
"""Compiles a function that only compiled ones call."""
