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

from tests.running import ran

ROOT = Path(__file__).resolve().parents[2]


YARDSTICK_S = 0.12
"""CPU seconds that the yardstick takes on the core for which bounds are stated, one of some 3.5 GHz to itself."""
LITTLE_S = 4
"""CPU seconds that are within every bound, however fast the core."""


class Cost(NamedTuple):
    """The exit code (-9: timed out), the message, and the cost.

    Units: CPU and wall seconds, MiB of the largest process. `slowness` is how many times as long as `YARDSTICK_S` the
    yardstick took, right after the command; at least 1. A shared core can take twice the CPU seconds for the same work.
    A command of less than `LITTLE_S` is not worth a yardstick, and has 1.
    """

    code: int
    said: str
    processor_s: float
    wall_s: float
    memory_mib: int
    slowness: float


def yardstick() -> float:
    """Return the CPU seconds that a fixed piece of work takes here and now, while each other core does it too.

    A command uses all cores, and cores that share their units take more CPU seconds for the same work.
    """
    others = []
    for _ in range(1, len(os.sched_getaffinity(0))):
        if not (other := os.fork()):
            _work()
            os._exit(0)
        others.append(other)
    took = _work()
    for other in others:
        os.waitpid(other, 0)
    return took


def _work() -> float:
    """Return the CPU seconds of the fixed piece of work."""
    began, total = time.process_time(), 0
    for number in range(2_000_000):
        total += number * number & 7
    return time.process_time() - began


def cost_of(arguments: Sequence[str], place: Path, patience_s: float = 120, checkout: Path = ROOT) -> Cost:
    """Run the command of this checkout in that folder, with its cache there."""
    environment = {**os.environ, "PYTHONPATH": str(checkout), "XDG_CACHE_HOME": str(place / "cache")}
    call = [sys.executable, "-S", str(Path(__file__).resolve()), str(patience_s), *arguments]
    done = ran(call, cwd=place, env=environment, check=True)
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
    processor_s = usage.ru_utime + usage.ru_stime
    slowness = max(1.0, (yardstick() + yardstick()) / 2 / YARDSTICK_S) if processor_s > LITTLE_S else 1.0
    print(json.dumps(Cost(process.returncode, message, processor_s, wall_s, usage.ru_maxrss >> 10, slowness)))


if __name__ == "__main__":
    main(float(sys.argv[1]), sys.argv[2:])
