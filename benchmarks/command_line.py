"""Measures how long a command takes to answer, against starting Python and importing typer; prints the ratios.

python benchmarks/command_line.py                each 20 times
python benchmarks/command_line.py --repeats 5    fewer
"""

import argparse
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMAND = [sys.executable, "-m", "fsar_ledger"]
ALTERNATIVE = [sys.executable, "-c", "import typer"]


def seconds(command: list[str]) -> float:
    began = time.perf_counter()
    subprocess.run(command, capture_output=True, check=True)
    return time.perf_counter() - began


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--repeats", type=int, default=20)
    repeats = parser.parse_args().repeats
    with tempfile.TemporaryDirectory() as temporary:
        ledger = str(Path(temporary) / "ledger")
        seconds([*COMMAND, "simulate", ledger, "--runs", "2"])
        for name, rest in (
            ("--help", ()),
            ("simulate", ("--help",)),
            ("info", (ledger,)),
            ("sql", (ledger, "SELECT 1")),
        ):
            pairs = [(seconds([*COMMAND, name, *rest]), seconds(ALTERNATIVE)) for _ in range(repeats)]
            ratio, fastest = statistics.median(one / other for one, other in pairs), min(one for one, _ in pairs)
            typer = min(other for _, other in pairs)
            print(f"{name:10} {fastest * 1000:6.0f} ms   import typer {typer * 1000:6.0f} ms   ratio {ratio:5.2f}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
