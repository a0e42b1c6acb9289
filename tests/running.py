"""Programs that are run to their end, and what a process may take."""

import resource
import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any


def ran(command: Sequence[Any], check: bool = False, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command; what it wrote is text. It may fail unless that is checked."""
    return subprocess.run(command, capture_output=True, text=True, check=check, **options)


@contextmanager
def files_of_at_most(size_bytes: int) -> Iterator[None]:
    """Make the kernel refuse to write a file beyond this size (EFBIG); Python ignores the signal that it sends."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def rss_kib(process: int | str = "self") -> int:
    """The memory that a process holds now."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
