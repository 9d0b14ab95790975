"""The trained policies that ship with the project, known by their names."""

from __future__ import annotations

from pathlib import Path

_PACKAGE = Path(__file__).parents[1]


def folder() -> Path:
    """Return where they lie: in the wheel, or in a checkout beside the package."""
    inside = _PACKAGE / "_garage"
    return inside if inside.is_dir() else _PACKAGE.parent / "garage"


def names() -> list[str]:
    """Return the names of the shipped policies, sorted."""
    return sorted(path.stem for path in folder().glob("*.pt"))


def path(name: str) -> Path:
    """Return the checkpoint of a shipped policy."""
    return folder() / f"{name}.pt"
