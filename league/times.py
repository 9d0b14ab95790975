"""Times and counts as people read them."""

from datetime import UTC, datetime


def clock(seconds: float, decimals: int = 3) -> str:
    """Return a time as people read it on a timing screen: m:ss.mmm, or with fewer decimals."""
    parts = 10**decimals
    minutes, rest = divmod(round(seconds * parts), 60 * parts)
    return f"{minutes}:{rest / parts:0{decimals + 3}.{decimals}f}"


def duration(seconds: float) -> str:
    """Return a duration in whole seconds as m:ss, or h:mm:ss."""
    minutes, rest = divmod(int(seconds + 0.5), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"


def counted(number: int, noun: str) -> str:
    """Return a number with its noun, in the plural unless it is 1."""
    if number == 1:
        return f"1 {noun}"
    if noun.endswith("y"):
        return f"{number} {noun[:-1]}ies"
    return f"{number} {noun}{'es' if noun.endswith('ch') else 's'}"


def day(seconds: float | None) -> str:
    """Return a time [s since 1970] as people read it, in UTC."""
    return _in_utc(seconds, "%Y-%m-%d %H:%M")


def time_of_day(seconds: float | None) -> str:
    """Return the time of day, to the second, of a time [s since 1970], in UTC."""
    return _in_utc(seconds, "%H:%M:%S")


def _in_utc(seconds: float | None, form: str) -> str:
    return "" if seconds is None else datetime.fromtimestamp(seconds, tz=UTC).strftime(form)
