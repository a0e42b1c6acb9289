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


def shown_us(time_us: int, timespec: str = "auto") -> str:
    """Return a time in microseconds since 1970 as the text of `iso_text`."""
    return iso_text(EPOCH + time_us * MICROSECOND, timespec)
