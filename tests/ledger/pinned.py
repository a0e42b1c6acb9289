"""What is pinned of the event types: `python -m tests.ledger.pinned` writes it again after they change.

It writes the canonical bytes of one row of each type, and `RELEASE`, the release that a ledger names as that of its
events. The first change after a release makes it the next release.
"""

from collections.abc import Sequence
from pathlib import Path

import msgspec

import fsar_ledger
from fsar_ledger.ledger.rows import canonical, schema
from fsar_ledger.ledger.rows.schema import LAYOUTS, StoredType
from tests.ledger.keep_release import LEDGERS, stored_types

ROWS = Path(__file__).with_name("canonical_rows.jsonl")


def pinned_row(layout: StoredType) -> bytes:
    """Return the canonical bytes of a row of this type in which every field has a value."""
    samples: dict[str, object] = {"integer": 1_234_567, "boolean": True, "strings": ("robot/A1", 'a "quoted" é\n')}
    values = {
        field.name: sorted(field.values)[0]
        if field.values
        else f"{field.name}\tü/\\\u2028\x1f"
        if field.kind == "string"
        else samples[field.kind]
        for field in layout.fields
    }
    columns: dict[str, Sequence[object]] = {name: [value] for name, value in values.items()}
    columns |= {"run_id": ["run-1"], "seq": [7], "time_us": [2_500_000], "caused_by": [6], "type": [layout.tag]}
    (line,) = canonical.lines(layout.tag, columns)
    return line.removesuffix(b"\n")


def release_to_name() -> str:
    """Return the release that ledgers with the current event types name."""
    kept, version = LEDGERS / schema.RELEASE / "events.jsonl", fsar_ledger.__version__
    then = [msgspec.json.decode(line) for line in kept.read_bytes().splitlines()] if kept.exists() else None
    if then is None or then == [{tag: fields} for tag, fields in stored_types(LAYOUTS.values()).items()]:
        return schema.RELEASE
    major, minor, _ = version.split(".")
    return f"{major}.{int(minor) + 1}.0" if (LEDGERS / version).exists() else version


def main() -> None:
    """Write the rows and the release."""
    ROWS.write_bytes(b"".join(pinned_row(layout) + b"\n" for layout in LAYOUTS.values()))
    path = Path(schema.__file__)
    old, new = (f'RELEASE = "{name}"\n' for name in (schema.RELEASE, release_to_name()))
    path.write_text(path.read_text("utf-8").replace(old, new), "utf-8")


if __name__ == "__main__":
    main()
