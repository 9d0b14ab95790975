"""Medals for laps: how near a lap comes to the fastest one that is possible."""

from __future__ import annotations

MEDALS = {"platinum": 1.03, "gold": 1.10, "silver": 1.20, "bronze": 1.35}
"""Largest lap time of each, over the lap bound (racing_line/racing_line.py)."""


def medal(lap_s: float, bound_s: float | None) -> str:
    """Return the best medal that a lap earns; empty for none.

    Args:
        lap_s: lap time, penalties included [s].
        bound_s: time that no flying lap can beat [s]; None if unknown.
    """
    if bound_s is None:
        return ""
    return next((name for name, most in MEDALS.items() if lap_s <= most * bound_s), "")


def times(bound_s: float | None) -> dict[str, float]:
    """Return the lap time that each medal asks for [s]; none where the bound is unknown."""
    return {name: most * bound_s for name, most in MEDALS.items()} if bound_s else {}
