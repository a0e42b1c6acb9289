"""Limits for a SELECT of the user's own."""

from fsar_ledger.errors import UsageError, option
from fsar_ledger.memory import MOST_MIB
from fsar_ledger.metrics.sandbox import Limits

MEMORY_MIB_MIN = 1024
SECONDS_MAX = 365 * 86_400


def limits_of(seconds: int | None = None, memory_mib: int | None = None) -> Limits:
    """Return these limits, with defaults for the rest.

    Raises:
        UsageError: Less than a second or more than a year; or less memory than the process needs for the packaged
            queries, or more than a machine has.
    """
    default = Limits()
    seconds = default.seconds if seconds is None else seconds
    memory_mib = default.memory_bytes >> 20 if memory_mib is None else memory_mib
    if not 1 <= seconds <= SECONDS_MAX:
        raise UsageError(f"{option('seconds', seconds)}: expected at least 1 and at most {SECONDS_MAX}, a year")
    if not MEMORY_MIB_MIN <= memory_mib <= MOST_MIB:
        raise UsageError(
            f"{option('memory_mib', memory_mib)}: expected at least {MEMORY_MIB_MIN} (MiB), of which the process "
            f"itself takes 400, and at most {MOST_MIB}"
        )
    return Limits(seconds=seconds, memory_bytes=memory_mib << 20)
