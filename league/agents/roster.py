"""Drivers by name or path: scripted ones, the policies that ship (the garage), checkpoints."""

import os
from pathlib import Path

from league.agents.scripted import LineDriver, Style
from league.envs.driver import Driver
from league.errors import PolicyError, nearest_names
from league.sim.config import CarConfig
from league.track.track import TrackSet

NAMES: dict[str, str] = {
    "blocker": "drives the racing line a little slower and moves in front of the car behind it",
    "cautious": "drives at three quarters of the pace, keeps its distance, goes round what stands",
    "centerline": "the honest beginner: follows the centreline, slow in bends, waits behind cars",
    "racing_line": "the bar to beat: the fastest line at the limit of grip, passes where it can",
}
"""Scripted drivers and what each does."""

_PACKAGE = Path(__file__).parents[1]

_STYLES: dict[str, Style] = {
    "blocker": Style(pace=0.85, grip=0.9, margin=0.08, blocks=True),
    "cautious": Style(
        pace=0.75,
        grip=0.85,
        margin=0.12,
        reserve=0.25,
        clearance=0.1,
        edge=0.04,
        braking=2.0,
        gap=0.3,
        freer_side=True,
    ),
    "centerline": Style(
        on_centerline=True,
        top_speed=2.0,
        grip=0.365,
        clearance=0.08,
        edge=0.05,
        approach=1.5,
        lead=0.4,
        braking=1.5,
        gap=0.3,
        waits=True,
    ),
    "racing_line": Style(),
}
"""How they drive."""


def garage() -> dict[str, Path]:
    """Return the checkpoints that ship with the project by their names, sorted."""
    installed = _PACKAGE / "_garage"  # in a wheel; in a checkout the folder lies at its root
    folder = installed if installed.is_dir() else _PACKAGE.parent / "garage"
    return {path.stem: path for path in sorted(folder.glob("*.pt"))}


def load(name_or_path: str, tracks: TrackSet, car: CarConfig) -> Driver:
    """Build a driver for the tracks that its rows race on, one alone for a scripted driver.

    It is the name of a scripted driver or of a policy in the garage, or a checkpoint, which ends in
    .pt. PolicyError: the name is unknown, the checkpoint not sound, or there are several tracks.
    """
    if path := _file(name_or_path):
        from league.agents import checkpoint
        from league.agents.policy import Policy

        return Policy(checkpoint.load(path), car)
    if len(tracks.tracks) != 1:
        raise PolicyError(
            f"{name_or_path!r} was asked to drive {len(tracks.tracks)} tracks at once: scripted "
            "drivers are built for one; give a set of one track"
        )
    return LineDriver(name_or_path, tracks.tracks[0], car, _STYLES[name_or_path])


def check(name_or_path: str) -> None:
    """Check that there is such a driver, without building it; PolicyError if there is none."""
    if path := _file(name_or_path):
        from league.agents import checkpoint

        checkpoint.load(path)


def checkpoint_path(name_or_path: str) -> str:
    """Return the file of a policy, the garage's too; PolicyError if it has none."""
    path = _file(name_or_path)
    if path is None:
        raise PolicyError(
            f"{name_or_path!r} is a scripted driver, which has no checkpoint: give FILE.pt, or "
            f"a policy of the garage ({', '.join(garage())})"
        )
    return path


def _file(name_or_path: str) -> str | None:
    """Return a policy's file, or None for a scripted driver."""
    if name_or_path.endswith(".pt"):
        return name_or_path
    if name_or_path in NAMES:
        return None
    shipped = garage()
    if name_or_path in shipped:
        return str(shipped[name_or_path])
    if os.path.isfile(name_or_path):  # False for what no file can be called
        raise PolicyError(f"{name_or_path!r} is a file: rename it, a checkpoint's name ends in .pt")
    raise PolicyError(
        f"there is no driver {name_or_path!r}; "
        f"{nearest_names(name_or_path, [*NAMES, *shipped])}; or give a checkpoint, FILE.pt"
    )
