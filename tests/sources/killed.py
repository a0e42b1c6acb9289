"""Import a file in small commits, to be killed at any moment: python -m tests.sources.killed LEDGER FILE."""

import sys
from pathlib import Path

from fsar_ledger.sources import importing
from tests.sources.importing import imported

if __name__ == "__main__":
    importing.COMMIT_EVENTS = 64
    print("begins", flush=True)
    imported(Path(sys.argv[1]), Path(sys.argv[2]))
