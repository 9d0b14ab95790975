"""Files: written so that they appear whole or not at all, and read up to a limit."""

import errno
import os
from collections.abc import Generator
from contextlib import contextmanager, suppress
from pathlib import Path

from league.errors import LeagueError, explaining

SPECIAL = "it is no plain file"


@contextmanager
def replacing(
    path: str | os.PathLike[str],
    what: str,
    error: type[LeagueError],
    *,
    also: tuple[type[Exception], ...] = (),
) -> Generator[Path]:
    """Yield a temporary file to write; it takes the name `path` when the block succeeds.

    A link stays, and the file that it points to is replaced. Folders are made as needed; after an
    error the earlier file stays. `error` says that `what` cannot be written if the file system
    refuses, or a library, by one of the errors in `also`.
    """
    failure = f"{what} cannot be written to {os.fspath(path)}"
    path = _written(Path(path))
    temporary = path.parent / f".{path.name[:80]}.{os.urandom(6).hex()}"
    try:
        with explaining(failure, error, "give a place that can be written and has room", *also):
            if _is_special(path):
                raise OSError(errno.ENOTSUP, SPECIAL)  # a device would be lost
            path.parent.mkdir(parents=True, exist_ok=True)
            temporary.touch(exist_ok=False)
            yield temporary
            with temporary.open("rb") as written:
                os.fsync(written.fileno())
            temporary.replace(path)
    finally:
        with suppress(OSError):  # it has its new name, or was never made
            temporary.unlink()


def read_plain(
    path: str | os.PathLike[str], most: int, error: type[LeagueError], what: str
) -> bytes:
    """Return the bytes of a file, which is `what`, such as "a replay"; of at most `most` bytes."""
    remedy = f"give the path of {what}"
    with explaining(f"{path} cannot be read", error, remedy, ValueError):
        # Looked at before it is opened: opening a pipe would wait for ever.
        if os.path.exists(path) and not os.path.isfile(path):
            raise error(f"{path} is not a file: {remedy}")
        with open(path, "rb") as file:
            content = file.read(most + 1)
        if len(content) > most:
            raise error(f"{path} is larger than {most:,} bytes: {remedy}")
        return content


def check_writable(path: Path, what: str, error: type[LeagueError]) -> None:
    """Refuse a place where no file can be made, before the work that it is to keep."""
    target = _written(path)
    there = target.parent
    while not there.exists() and there != there.parent:
        there = there.parent
    if target.is_dir():
        reason = "it is a folder"
    elif _is_special(target):
        reason = SPECIAL
    elif not there.is_dir():
        reason = f"{there} is no folder"
    elif not os.access(there, os.W_OK | os.X_OK):
        reason = f"{there} cannot be written"
    else:
        return
    raise error(f"{what} cannot be written to {path} ({reason}): give a place that can be written")


def _written(path: Path) -> Path:
    """Return the file that is written for a path: of a link, what it points to."""
    return Path(os.path.realpath(path)) if path.is_symlink() else path


def _is_special(path: Path) -> bool:
    """Return whether a path is a device, a pipe or a socket."""
    return path.exists() and not (path.is_file() or path.is_dir())
