"""The class of this machine: races in Bullet have the same bits on machines of one class.

All else is computed in the same order with portable functions; Bullet calls the machine's libm
(docs/physics.md), which rounds as its version and the processor's features have it.
"""

import contextlib
import hashlib
import math
import platform
import struct
from functools import cache
from pathlib import Path

FEATURES = ("avx", "avx2", "avx512f", "fma", "fma4")
"""Features of a processor by which libm chooses how it computes."""
_FUNCTIONS = (math.sin, math.cos, math.tan, math.asin, math.acos, math.atan, math.exp)


@cache
def machine_class() -> str:
    """Return architecture, C library, features of the processor, and a hash of libm's answers."""
    flags: set[str] = set()
    with contextlib.suppress(OSError):  # there is no such file but on Linux
        flags = set(Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").split())
    features = "+".join(name for name in FEATURES if name in flags) or platform.processor()
    answers = [function(n / 4096) for n in range(-4095, 4096) for function in _FUNCTIONS]
    answers += [math.atan2(n / 64, 1 - n / 97) for n in range(4096)]
    libm = hashlib.sha256(struct.pack(f"<{len(answers)}d", *answers)).hexdigest()[:12]
    library = "".join(platform.libc_ver()) or platform.system()
    return f"{platform.machine()} {library} {features} libm:{libm}"[:200]
