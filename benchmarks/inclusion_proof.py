"""Measures one inclusion proof of 10 million events, against hashing the tree anew; prints milliseconds and ratios.

    python benchmarks/inclusion_proof.py                     10 million events, 200 proofs
    python benchmarks/inclusion_proof.py --events 100000     a small run

The ledger holds the hashes of its tree only; the events are a counter. It takes 3 bytes an event in the folder for
temporary files and is removed at the end. Each proof starts cold: it has a reader of its own (the system may have the
file in memory).

The alternative is what a ledger without stored hashes must do: hash the whole tree from its leaf hashes, once, in
memory and with `hashlib` alone. Both must come to the same root, and the proof must lead to it.
"""

import argparse
import hashlib
import random
import shutil
import statistics
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from fsar_ledger.ledger.log import pack
from fsar_ledger.ledger.log.hashing import leaves_of
from fsar_ledger.ledger.log.merkle import Frontier, leaf_hash, root_of_inclusion
from fsar_ledger.ledger.log.note import checkpoint_of
from fsar_ledger.ledger.store.derived import node_reader
from fsar_ledger.ledger.store.paths import NODES
from fsar_ledger.ledger.store.proof import prove_inclusion

BATCH = 1 << 16
LIMIT_MS = 50


def leaf(number: int) -> bytes:
    return leaf_hash(b"%d" % number)


def rows(first: int, end: int) -> list[bytes]:
    """Return the bytes of these events."""
    return [b"%d" % number for number in range(first, end)]


def build(ledger: Path, events: int) -> Frontier:
    """Write the hashes of the tree that a ledger holds."""
    tree = Frontier()
    with open(ledger / NODES, "wb") as file:
        for first in range(0, events, BATCH):
            tree, nodes = pack.grow(tree, leaves_of(rows(first, min(events, first + BATCH))))
            file.write(nodes)
    return tree


def proof_ms(ledger: Path, frontier: Frontier, index: int) -> float:
    """Return the time of one proof, with the rows beside the event."""
    began = time.perf_counter_ns()
    tree = checkpoint_of("example.org/benchmark", frontier)
    found, hashes = prove_inclusion(ledger, node_reader(ledger, frontier, b"", rows), tree, index)
    spent = time.perf_counter_ns() - began
    if found != leaf(index) or root_of_inclusion(found, index, tree.size, hashes) != tree.root:
        raise SystemExit(
            f"differs: event {index} has leaf hash {found.hex()}, expected {leaf(index).hex()} "
            "and a proof that leads to the root"
        )
    return spent / 1e6


def hash_all_ms(events: int) -> tuple[float, bytes]:
    """Hash the tree from its leaf hashes, as the alternative; return the time and the root."""
    row = [leaf(number) for number in range(events)]
    sha256 = hashlib.sha256
    began = time.perf_counter_ns()
    while len(row) > 1:
        above = [sha256(b"\x01" + left + right).digest() for left, right in zip(row[::2], row[1::2], strict=False)]
        row = above + row[len(above) * 2 :]  # a last node without a sibling moves up unchanged
    return (time.perf_counter_ns() - began) / 1e6, row[0]


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--events", type=int, default=10_000_000)
    parser.add_argument("--proofs", type=int, default=200)
    options = parser.parse_args()
    ledger = Path(tempfile.mkdtemp(prefix="fsar-inclusion-"))
    try:
        tree = build(ledger, options.events)
        size = (ledger / NODES).stat().st_size
        draw = random.Random(1)
        spent = [proof_ms(ledger, tree, draw.randrange(options.events)) for _ in range(options.proofs)]
    finally:
        shutil.rmtree(ledger)
    alternative, root = hash_all_ms(options.events)
    if root != tree.root():
        print(
            f"differs: the stored hashes give the root {tree.root().hex()}, hashing anew {root.hex()}", file=sys.stderr
        )
        return 1
    median, worst = statistics.median(spent), max(spent)
    print(f"{options.events:,} events, {options.proofs} proofs, ", end="")
    print(f"{size / options.events:.1f} bytes of hashes an event")
    fastest, each_ns = min(spent), alternative * 1e6 / options.events
    print(f"one proof, fastest / median / slowest, ms   {fastest:>8.2f} {median:>8.2f} {worst:>8.2f}", end="   ")
    print(f"(goal: under {LIMIT_MS})")
    print(f"hashing the tree anew, ms                   {alternative:>8.0f}            ({each_ns:.0f} ns an event)")
    print(f"one proof / hashing the tree anew           {median / alternative:>8.6f}", end="            ")
    print(f"(1 : {alternative / median:,.0f})")
    return 0 if median < LIMIT_MS else 1


if __name__ == "__main__":
    sys.exit(main())
