"""Times in UTC: as ISO 8601 text, and as microseconds since 1970."""

from datetime import UTC, datetime, timedelta

EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
MICROSECOND = timedelta(microseconds=1)


def parsed(text: str) -> datetime:
    """Parse an ISO 8601 time; without a zone it is UTC. Raises: ValueError for any other text."""
    if len(text) > len("YYYYMMDD") and text.isdecimal():  # milliseconds, of which Python takes some for a date and hour
        raise ValueError(f"found the number {text:.40}, expected a time in ISO 8601")
    return zoned(datetime.fromisoformat(text))


def zoned(when: datetime) -> datetime:
    """Return the time with its zone; without one it is UTC."""
    return when if when.tzinfo is not None else when.replace(tzinfo=UTC)


def iso_text(when: datetime, timespec: str = "auto") -> str:
    """Return a time in UTC as text that ends in Z; `timespec` is that of `datetime.isoformat`."""
    return when.isoformat(timespec=timespec).replace("+00:00", "Z")


def microseconds(when: datetime) -> int:
    """Return the microseconds from 1970 to a time with a zone."""
    return (when - EPOCH) // MICROSECOND


def read_us(time: object) -> int | None:
    """Return microseconds since 1970 from ISO 8601 (UTC without a zone), or from a number; None for anything else.

    The size of a number shows its unit: in 2001 to 2286 s, ms, us and ns since 1970 have 10, 13, 16 and 19 digits.
    """
    if isinstance(time, int | float):
        candidates = (time * 10**6, time * 1000, time, time // 1000)
        return next((round(us) for us in candidates if 10**15 <= us < 10**16), None)
    if not isinstance(time, str):
        return None
    try:
        return microseconds(parsed(time))
    except ValueError:
        return None


def shown_us(time_us: int, timespec: str = "auto") -> str:
    """Return a time in microseconds since 1970 as the text of `iso_text`."""
    return iso_text(EPOCH + time_us * MICROSECOND, timespec)
