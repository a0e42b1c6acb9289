"""Ledgers that are the shards of a federation."""

from collections.abc import Sequence
from pathlib import Path

from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.ledger.store.append import Writer
from fsar_ledger.ledger.store.staging import stage
from fsar_ledger.runtime.experiment import Experiment

WHOLE = Experiment(("fsar", "cfc", "dhma"), ("door-relay", "fleet-contention"), 2, 7)
NAMES = ("north", "west", "south")


def origin(name: str) -> str:
    return f"example.org/{name}"


def append(path: Path, runs: Sequence[LedgerRun], name: str | None = None) -> Path:
    with Writer(path, name or origin(path.name)) as writer:
        for run in runs:
            writer.append(stage(path, [run]))
    return path


def parts(runs: Sequence[LedgerRun]) -> list[Sequence[LedgerRun]]:
    return [runs[:5], runs[5:9], runs[9:]]
