"""The folder of a run: its lock, whether it holds a run, and how a new one replaces that."""

import os
from pathlib import Path

from league.errors import ConfigError, PolicyError
from league.training.monitor import history

LEARNT = ("best.pt", "last.pt", "state.pt")  # files that only learning again would bring back
PRINTED = "printed.txt"  # the last lines that a reward function has printed
SIMTRACE = "simtrace"  # the folder of traces that community log tools read
_WRITTEN = (
    *(*LEARNT, PRINTED, "training.png", "win_matrix.json", "win_matrix.png"),
    *("pool/pool.json", "pool/*.pt"),
    *("tensorboard/events.out.tfevents.*", f"{SIMTRACE}/**/*-iteration.csv"),
)


def lock(folder: Path) -> int | None:
    """Keep other runs out of a folder until `unlock` of the result; ConfigError if it is in use."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(handle)
        raise ConfigError(
            f"another run is learning in {folder}: wait for its end, or give another --out"
        ) from None
    except OSError:  # a file system without locks
        os.close(handle)
        return None
    return handle


def unlock(handle: int | None) -> None:
    """Let other runs into the folder."""
    if handle is not None:
        os.close(handle)


def is_taken(folder: Path) -> bool:
    """Whether a run has saved something there."""
    return any((folder / name).exists() for name in LEARNT)


def summary(folder: Path) -> str:
    """Return how far the run in a folder has come, as a phrase."""
    try:
        rows = history.read(folder / "history.jsonl")
    except PolicyError:
        return "a run"
    updates = [row for row in rows if isinstance(row, history.UpdateRow)]
    if not updates:
        return "a run"
    return f"a run of {updates[-1].samples:,} decisions and {updates[-1].time_s:.0f} s"


def clear(folder: Path) -> None:
    """Remove the files of an earlier run, and no others."""
    for pattern in _WRITTEN:
        for path in folder.glob(pattern):
            path.unlink(missing_ok=True)
