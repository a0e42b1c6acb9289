"""Measure the cost of a command: `python -m tests.ledger.bomb_trial SECONDS ARGUMENT ...` runs it and prints its cost.

The operating system counts the memory of the process that started another as its own at first, so a small process
stands between a test and the command.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]


class Cost(NamedTuple):
    """The exit code (-9: timed out), the message, and the cost.

    Units: CPU and wall seconds, MiB of the largest process.
    """

    code: int
    said: str
    processor_s: float
    wall_s: float
    memory_mib: int


def cost_of(arguments: Sequence[str], place: Path, patience_s: float = 120, checkout: Path = ROOT) -> Cost:
    """Run the command of this checkout in that folder, with its cache there."""
    environment = {**os.environ, "PYTHONPATH": str(checkout), "XDG_CACHE_HOME": str(place / "cache")}
    call = [sys.executable, "-S", str(Path(__file__).resolve()), str(patience_s), *arguments]
    done = subprocess.run(call, cwd=place, env=environment, capture_output=True, text=True, check=True)
    return Cost(*json.loads(done.stdout))


def main(patience_s: float, arguments: Sequence[str]) -> None:
    """Print the cost of this call as JSON."""
    with tempfile.TemporaryFile() as said:
        began = time.monotonic()
        process = subprocess.Popen(
            [sys.executable, "-m", "fsar_ledger", *arguments], stdout=subprocess.DEVNULL, stderr=said
        )
        while True:
            ended, status, usage = os.wait4(process.pid, os.WNOHANG)
            if ended:
                break
            if time.monotonic() - began > patience_s:
                process.kill()
            time.sleep(0.02)
        process.returncode = os.waitstatus_to_exitcode(status)
        wall_s = time.monotonic() - began
        said.seek(0)
        message = said.read(1 << 20).decode(errors="replace")
    print(json.dumps(Cost(process.returncode, message, usage.ru_utime + usage.ru_stime, wall_s, usage.ru_maxrss >> 10)))


if __name__ == "__main__":
    main(float(sys.argv[1]), sys.argv[2:])
