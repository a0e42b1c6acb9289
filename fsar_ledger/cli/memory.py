"""The memory limit of commands that read ledgers, and the message when it is exceeded."""

import os
import signal
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from fsar_ledger.api.workload import stored, workers_of
from fsar_ledger.base import memory
from fsar_ledger.base.errors import LimitReached, UsageError

from .terminal import say

LEAST_MIB = 256
BASE_BYTES = 576 << 20
PER_BYTE = 16
"""By default a command may take `BASE_BYTES`, and `PER_BYTE` bytes for each byte of the segments on disk. Most commands
need 300 MiB and 10. Of a ledger of ten million events `study run multiverse`, `open` and `report` need more and are
given it with --memory: by default as much would be there for a small file that unpacks to much.
"""

PER_WORKER_BYTES = 192 << 20
"""Memory for each core or worker beyond two, since each has buffers of its own: `verify` takes 150 MiB for each."""

MACHINE_SHARE = 0.8


@contextmanager
def bounded(asked_mib: int | None, *ledgers: Path | None, workers: int | None = None) -> Iterator[None]:
    """Limit the memory of the command to what was asked for, or to what ledgers of this size need.

    Beyond that the command ends with one message and exit code 2.

    Raises:
        UsageError: The limit is less than a command needs to begin.
        LimitReached: The system, or a library with a limit of its own, refused more.
    """
    if asked_mib is not None and not LEAST_MIB <= asked_mib <= memory.MOST_MIB:
        raise UsageError(f"--memory {asked_mib}: expected at least {LEAST_MIB} and at most {memory.MOST_MIB} (MiB)")
    most = default_bytes(*ledgers, workers=workers) if asked_mib is None else asked_mib << 20

    def end() -> None:
        say(memory.exceeded_message())
        for child in memory.children():
            with suppress(OSError):
                os.kill(int(child), signal.SIGKILL)
        for path in tuple(memory.unfinished):
            with suppress(OSError):
                path.unlink()
        os._exit(LimitReached.exit_code)

    with memory.limited(most, end):
        try:
            yield
        except MemoryError as error:
            raise LimitReached(memory.exceeded_message()) from error


def default_bytes(*ledgers: Path | None, workers: int | None = None) -> int:
    """Return the default limit, which grows with the segments and workers, and is never all of the machine's memory."""
    more = max(0, (workers_of(None) if workers is None else workers) - 2)
    return min(
        BASE_BYTES + PER_WORKER_BYTES * more + PER_BYTE * stored(*ledgers),
        int(MACHINE_SHARE * memory.bytes_installed()),
    )
