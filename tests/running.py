"""Programs that are run to their end."""

import subprocess
from collections.abc import Sequence
from pathlib import Path
from typing import Any


def ran(command: Sequence[Any], check: bool = False, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command; what it wrote is text. It may fail unless that is checked."""
    return subprocess.run(command, capture_output=True, text=True, check=check, **options)


def rss_kib(process: int | str = "self") -> int:
    """The memory that a process holds now."""
    lines = Path(f"/proc/{process}/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))
