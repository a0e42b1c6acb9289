"""Give random records of other systems to every verb: `python -m tests.foreign.soak [EVENTS]`, by default 100,000.

Each ledger, in turn of either format, holds some random runs. Every verb must answer about it, or refuse in words, with
one of its exit codes, and no query says anything that rests on a concern which the run does not observe
(`claims.py`). Prints the calls of each verb, and each finding as it comes; exits with 1 if there is any.
"""

import random
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from fsar_ledger.api.ledger import open_ledger
from tests.foreign.claims import baseless
from tests.foreign.histories import append, foreign_run
from tests.foreign.verbs import SLOW, VERBS, ask, calls

EVENTS, RUNS, SIZE = 100_000, 8, 500
SLOW_EVERY = 10
"""One ledger of so many is also given to the verbs that take seconds."""


def main(events: int) -> int:
    """Run the soak; return the exit code."""
    codes: Counter[str] = Counter()
    told = findings = claims = number = 0
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        while told < events:
            draw = random.Random(number)
            runs = [foreign_run(f"night-{number}-{one}", SIZE, draw) for one in range(RUNS)]
            ledger = Path(folder) / f"ledger-{number}"
            append(ledger, runs)
            told += sum(len(run.events) for run in runs)
            for verb, (expected, _) in VERBS.items():
                if verb in SLOW and number % SLOW_EVERY:
                    continue
                for words in calls(verb, ledger, runs, Path(folder) / "out", draw):
                    found = ask(*words)
                    codes[f"{verb} {found.code}"] += 1
                    if found.trace is not None or found.code not in expected:
                        findings += 1
                        print(f"ledger {number}: {' '.join(words)}\n{found.code} {found.err}{found.trace}", flush=True)
            with open_ledger(ledger).database() as database:
                for claim in baseless(database):
                    claims += 1
                    print(f"ledger {number}: {claim}", flush=True)
            number += 1
    for name, count in sorted(codes.items()):
        verb, _, code = name.rpartition(" ")
        print(f"{verb:16} exit code {code:>2} {count:>8,} calls")
    print(
        f"{told:,} events in {number:,} ledgers, {findings:,} findings, "
        f"{claims:,} claims about what was not recorded, {time.perf_counter() - began:.0f} s"
    )
    return 1 if findings or claims else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else EVENTS))
