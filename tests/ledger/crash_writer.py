"""A process that appends batches one by one, says so, and is killed by test_crash.py in the middle."""

import sys
from pathlib import Path

from fsar_ledger.ledger.append import Writer, stage
from tests.ledger.samples import ORIGIN, made_up_batches

if __name__ == "__main__":
    path, commits = Path(sys.argv[1]), int(sys.argv[2])
    batches = made_up_batches(commits)
    print("ready", flush=True)
    with Writer(path, ORIGIN) as writer:
        for batch in batches[writer.head.commits :]:
            head = writer.append(stage(path, batch))
            print(head.commits, flush=True)
