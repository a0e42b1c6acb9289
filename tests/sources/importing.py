"""Imports as a user calls them, and what a ledger holds of a run then."""

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from fsar_ledger.ledger.opening import open_ledger
from fsar_ledger.ledger.verify import verify
from fsar_ledger.sources.adapter import adapter_of, opened
from fsar_ledger.sources.importing import Imported, import_files
from tests.sources.vda import Line, written

Row = dict[str, Any]
OPENS_AND_CLOSES = ("SourceOpened.v1", "SourceClosed.v1")


def imported(ledger: Path, file: Path, **others: Any) -> Imported:
    """Import the file as run `night`, and return what became of it."""
    adapter, _ = adapter_of("vda5050", None)
    with opened([str(file)]) as inputs:
        return import_files(ledger, inputs, adapter, **{"run": "night", **others})


def filed(folder: Path, lines: Iterable[Line] | bytes, name: str = "night.jsonl") -> Path:
    """Write the lines to a file of that name."""
    file = folder / name
    file.write_bytes(lines if isinstance(lines, bytes) else written(lines))
    return file


def rows(ledger: Path, run: str = "night") -> list[Row]:
    """Return the events of the run, as they are stored."""
    view = open_ledger(ledger)
    found = [json.loads(line) for part in view.parts(run) for line in view.rows(part.first, part.end)]
    return [row for row in found if row["run_id"] == run]


def kinds(ledger: Path) -> list[str]:
    """Return the types of what was derived."""
    names = [row["type"].partition(".v")[0] for row in rows(ledger)]
    return [name for name in names if name not in ("RunStarted", "SourceOpened", "SourceClosed", "Observed")]


def recorded(ledger: Path, run: str = "night") -> list[Row]:
    """Return the run without the events of opening and closing a source, which tell of interruptions.

    Numbers and causes are those that it would have without them; which event was the cause is kept.
    """
    found = [row for row in rows(ledger, run) if row["type"] not in OPENS_AND_CLOSES]
    number = {row["seq"]: at for at, row in enumerate(found)}
    places = ("seq", "caused_by")
    return [row | {name: number.get(row.get(name), row.get(name)) for name in places if name in row} for row in found]


def record_numbers(ledger: Path, run: str = "night") -> list[int]:
    """Return the numbers of the records, in the order of the run."""
    return [row["record_number"] for row in rows(ledger, run) if row["type"] == "Observed.v1"]


def is_good(ledger: Path) -> bool:
    """Return whether the ledger verifies."""
    return verify(ledger).ok
