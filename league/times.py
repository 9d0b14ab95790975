"""Times and laps as people read them."""

from __future__ import annotations

from datetime import UTC, datetime


def clock(seconds: float) -> str:
    """Return a time as people read it on a timing screen: m:ss.mmm."""
    minutes, rest = divmod(round(seconds * 1000), 60_000)
    return f"{minutes}:{rest / 1000:06.3f}"


def laps(count: int) -> str:
    """Return a number of laps in words."""
    return f"{count} lap" if count == 1 else f"{count} laps"


def day(seconds: float | None) -> str:
    """Return a time [s since 1970] as people read it, in UTC."""
    if seconds is None:
        return ""
    return datetime.fromtimestamp(seconds, tz=UTC).strftime("%Y-%m-%d %H:%M")
