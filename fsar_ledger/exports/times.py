"""Run time as the time of day that other formats ask for."""

from datetime import UTC, datetime, timedelta

from fsar_ledger.base import printable, utc
from fsar_ledger.base.errors import UsageError

LATEST_YEAR = 9000
"""Leaves room for the longest run, of 2^53 microseconds, before the last year that a date can have."""
TOLD = "times count from 1970-01-01T00:00:00Z in runs whose first event names no epoch"


def epoch_us(run: str, epoch: str | None) -> int:
    """Return run time 0 in microseconds since 1970, from the epoch that event 0 of a run names; 0 if it names none.

    Raises: UsageError if that is no time in ISO 8601 between 1970 and `LATEST_YEAR`.
    """
    if epoch is None:
        return 0
    try:
        found = utc.parsed(epoch)
        if not utc.EPOCH <= found <= datetime(LATEST_YEAR, 1, 1, tzinfo=UTC):
            raise ValueError("too early or too late")
    except ValueError as error:
        raise UsageError(
            f"run {printable.value(run)}: found the epoch {printable.value(epoch)}, expected a time in ISO 8601 "
            f"between 1970 and {LATEST_YEAR}; name another run"
        ) from error
    return (found - utc.EPOCH) // utc.MICROSECOND


def rfc3339(time_us: int) -> str:
    """Return a time in UTC from its microseconds since 1970."""
    return utc.shown(utc.EPOCH + timedelta(microseconds=time_us), "microseconds")
