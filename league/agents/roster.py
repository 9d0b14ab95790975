"""A name or a path -> a Driver."""

from __future__ import annotations

from league.agents import garage
from league.agents.driver import Driver
from league.agents.scripted import LineDriver, Style
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


def load(name_or_path: str, tracks: TrackSet, car: CarConfig) -> Driver:
    """Build a driver for the tracks that its rows race on.

    Args:
        name_or_path: name of a scripted driver or of a policy in the garage, or a checkpoint,
            which ends in .pt.
        tracks: the set, which says on what device to decide; a scripted driver needs it to hold
            one track.
        car: the car it will drive.

    Raises:
        PolicyError: the name is unknown, the checkpoint not sound, or the driver cannot drive
            this set.
    """
    if path := _file(name_or_path):
        return policy(path, tracks, car)
    if len(tracks.tracks) != 1:
        raise PolicyError(
            f"{name_or_path!r} was asked to drive {len(tracks.tracks)} tracks at once: scripted "
            "drivers are built for one; give a set of one track"
        )
    return LineDriver(name_or_path, tracks.tracks[0], car, _STYLES[name_or_path])


def check(name_or_path: str) -> None:
    """See that there is such a driver, without building it.

    Raises:
        PolicyError: the name is unknown, or the checkpoint not sound.
    """
    if path := _file(name_or_path):
        from league.agents import checkpoint  # late: torch takes seconds

        checkpoint.load(path)


def _file(name_or_path: str) -> str | None:
    """Return a policy's file, or None for a scripted driver."""
    if name_or_path.endswith(".pt"):
        return name_or_path
    if name_or_path in garage.names():
        return str(garage.path(name_or_path))
    if name_or_path in NAMES:
        return None
    known = [*NAMES, *garage.names()]
    raise PolicyError(
        f"there is no driver {name_or_path!r}; nearest: "
        f"{nearest_names(name_or_path, known)}; or give a checkpoint, FILE.pt"
    )


def policy(path: str, tracks: TrackSet, car: CarConfig) -> Driver:
    """Build the driver of a checkpoint; it drives any set of tracks.

    Args:
        path: the checkpoint.
        tracks: the set, which says on what device to decide.
        car: the car it will drive.

    Raises:
        PolicyError: the file is not a sound checkpoint.
    """
    from league.agents import checkpoint
    from league.agents.policy import Policy

    return Policy(checkpoint.load(path), car)
