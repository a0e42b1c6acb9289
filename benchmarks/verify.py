"""Measures `verify`, a few segments at a time, against only reading and hashing the same rows; prints the ratio.

python benchmarks/verify.py                        a ledger of 400,000 events; it is simulated first
python benchmarks/verify.py --ledger out/ledger    a ledger of yours

The other side reads each segment with pyarrow, and hashes the file and the canonical bytes of each row with hashlib;
these bytes are given to it, and it checks nothing. The two take turns after a few segments, so that a slow moment of
the machine hits both.
"""

import argparse
import hashlib
import os
import sys
import tempfile
import time
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fsar_ledger.ledger.rows import canonical, compiled
from fsar_ledger.ledger.rows.segment import read_table
from fsar_ledger.ledger.store.paths import CHAIN
from fsar_ledger.ledger.store.read import open_chain
from fsar_ledger.ledger.store.record import segment_of
from fsar_ledger.ledger.store.segments import Names, check_manifest
from fsar_ledger.ledger.verify.segment import examine, examine_some
from fsar_ledger.metrics.verified import ReadAgain
from fsar_ledger.runtime.experiment import run_experiment

from benchmarks.metrics import experiment  # isort: skip
from benchmarks.table import note  # isort: skip

RUNS = 50
AT_ONCE = 16
"""Segments that one side reads before the other."""


def read_and_hash(path: Path, rows: list[bytes]) -> None:
    data = path.read_bytes()
    hashlib.sha256(data).digest()
    with pq.ParquetFile(pa.BufferReader(data), page_checksum_verification=True) as file:
        file.read(use_threads=False)
    for row in rows:
        hashlib.sha256(row).digest()


def measure(ledger: Path, most: int) -> tuple[int, float, float, float]:
    """Return events, and CPU seconds of reading and hashing, of `verify` with one reader, and with both."""
    _, document, doubt = check_manifest(ledger)
    if document is None or doubt is not None:
        raise SystemExit(f"{ledger}: {doubt}")
    events, sums_s = 0, [0.0, 0.0, 0.0]
    placed = open_chain(ledger, document, is_damage_told=False).chain.placed[:most]
    for first in range(0, len(placed), AT_ONCE):
        part = [(one.number, one, Names(segment_of(one), CHAIN)) for one in placed[first : first + AT_ONCE]]
        rows = [canonical.from_table(read_table(ledger / names.place)) for _, _, names in part]
        times = [time.process_time()]
        for (_, _, names), lines in zip(part, rows, strict=True):
            read_and_hash(ledger / names.place, lines)
        times.append(time.process_time())
        for second_reader in (None, ReadAgain()):
            found = examine_some(examine, str(ledger), part, second_reader)
            times.append(time.process_time())
            if problem := next((facts.problems[0] for facts in found if facts.problems), None):
                raise SystemExit(str(problem))
        if first:  # the first ones pay for what is made once
            events += sum(map(len, rows))
            sums_s = [total + end - begin for total, begin, end in zip(sums_s, times, times[1:], strict=False)]
    plain_s, one_s, both_s = sums_s
    return events, plain_s, one_s, both_s


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--ledger", type=Path, help="instead of one that is made")
    parser.add_argument("--segments", type=int, default=1 << 20, help="the first ones of the ledger")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        ledger = options.ledger or Path(temporary) / "ledger"
        if options.ledger is None:
            run_experiment(ledger, experiment(RUNS), 1)
        events, plain_s, one_s, both_s = measure(ledger, options.segments)
    print(f"events {events:,}, load {os.getloadavg()[0]:.1f}; rows are joined in C: {compiled.IS_COMPILED}")
    for name, seconds in (
        ("read and hash", plain_s),
        ("verify, one reader", one_s),
        ("verify, as it is", both_s),
    ):
        per_event, rate = seconds / events * 1e6, events / seconds
        print(f"{name:20}{per_event:>7.2f} us an event{rate:>12,.0f} a CPU second   ratio {seconds / plain_s:5.2f}")
    note(
        "verify, default, one core",
        f"{events / both_s:,.0f} events/CPU s",
        f"read and hash {events / plain_s:,.0f}; ratio {both_s / plain_s:.2f}",
        "500,000/s",
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
