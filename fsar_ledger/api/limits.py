"""Limits for a SELECT of the user's own."""

from fsar_ledger.errors import UsageError, option
from fsar_ledger.metrics.sandbox import Limits

MEMORY_MIB_MIN = 1024


def limits_of(seconds: int | None = None, memory_mib: int | None = None) -> Limits:
    """Return these limits, with defaults for the rest.

    Raises:
        UsageError: Less than a second, or less memory than the process needs for the packaged queries.
    """
    default = Limits()
    seconds = default.seconds if seconds is None else seconds
    memory_mib = default.memory_bytes >> 20 if memory_mib is None else memory_mib
    if seconds < 1:
        raise UsageError(f"{option('seconds', seconds)}: expected at least 1")
    if memory_mib < MEMORY_MIB_MIN:
        raise UsageError(
            f"{option('memory_mib', memory_mib)}: expected at least {MEMORY_MIB_MIN} (MiB), of which the process "
            "itself takes 400"
        )
    return Limits(seconds=seconds, memory_bytes=memory_mib << 20)
