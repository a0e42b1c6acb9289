"""Programs that are run to their end."""

import subprocess
from collections.abc import Sequence
from typing import Any


def ran(command: Sequence[Any], check: bool = False, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run the command; what it wrote is text. It may fail unless that is checked."""
    return subprocess.run(command, capture_output=True, text=True, check=check, **options)
