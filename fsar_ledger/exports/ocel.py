"""Runs as an object-centric event log: OCEL 2.0 in JSON (ocel-standard.org), for process mining.

An event that names an object is an event; what it names are its objects, each with its role as the qualifier of the
relation. All names begin with the number of the run, since robots of two runs are not the same. The rest of an event's
fields are its attributes: lists as JSON text, times in microseconds of run time.
"""

import shutil
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import msgspec

from fsar_ledger.events.envelope import flat
from fsar_ledger.ledger.rows.codec import LedgerRun

from . import NAMING, TOLD, Written, elements, epoch_us, named_in, rfc3339

RUN = [{"name": "run_id", "type": "string"}]
"""The attributes of every type of object."""


class _Log:
    """What was found in the runs so far: counts, types of events with the types of their attributes, of objects."""

    def __init__(self, numbers: Mapping[str, int]) -> None:
        self.events = self.left_out = self.objects = 0
        self.event_types: dict[str, dict[str, str]] = {}
        self.object_types: set[str] = set()
        self._numbers = numbers

    def events_of(self, run: LedgerRun, objects: dict[str, str]) -> Iterator[dict[str, Any]]:
        """Yield the events of a run that name objects, and put these into `objects`, by label with their kinds."""
        number = self._numbers.get(run.run_id, 0)
        start_us = epoch_us(run.run_id, getattr(run.events[0], "epoch", None))
        for seq, (event, time_us) in enumerate(zip(run.events, run.times_us, strict=True)):
            columns = flat(event)
            named = named_in(columns)
            if not named:
                self.left_out += 1
                continue
            self.events += 1
            objects.update({one.label: one.kind for one in named})
            kind = type(event).__name__
            envelope = {"run_id": run.run_id, "seq": seq, "caused_by": run.caused_by[seq]}
            yield {
                "id": f"{number}:{seq}",
                "type": kind,
                "time": rfc3339(start_us + time_us),
                "attributes": list(self._attributes(kind, envelope | columns)),
                "relationships": [
                    {"objectId": f"{number}:{one.label}", "qualifier": role} for one, role in named.items()
                ],
            }

    def objects_of(self, run: LedgerRun, objects: Mapping[str, str]) -> Iterator[dict[str, Any]]:
        """Yield the objects of a run, from their labels and kinds."""
        number = self._numbers.get(run.run_id, 0)
        self.objects += len(objects)
        self.object_types.update(objects.values())
        for label, kind in objects.items():
            about = {"name": "run_id", "time": rfc3339(0), "value": run.run_id}
            yield {"id": f"{number}:{label}", "type": kind, "attributes": [about], "relationships": []}

    def _attributes(self, kind: str, columns: Mapping[str, Any]) -> Iterator[dict[str, Any]]:
        types = self.event_types.setdefault(kind, {})
        for name, value in columns.items():
            if value is None or name in NAMING:
                continue
            if isinstance(value, tuple):
                value = msgspec.json.encode(value).decode()
            types[name] = "boolean" if isinstance(value, bool) else "integer" if isinstance(value, int) else "string"
            yield {"name": name, "value": value}

    def types(self) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        """Return the types of the events and of the objects, as the format has them."""
        return (
            [
                {"name": kind, "attributes": [{"name": name, "type": one} for name, one in sorted(types.items())]}
                for kind, types in sorted(self.event_types.items())
            ],
            [{"name": kind, "attributes": RUN} for kind in sorted(self.object_types)],
        )


def write(out: Path, runs: Iterable[LedgerRun], numbers: Mapping[str, int]) -> Written:
    """Write the runs to this path; memory holds one of them. `numbers` has the number of each run.

    Raises: OSError, or UsageError as `epoch_us`.
    """
    log = _Log(numbers)
    with out.open("wb") as file, TemporaryFile() as kept:  # the objects, which come after all events

        def events() -> Iterator[dict[str, Any]]:
            for run in runs:
                objects: dict[str, str] = {}
                yield from log.events_of(run, objects)
                between = b",\n" if kept.tell() else b""
                kept.write(between + b"".join(elements(log.objects_of(run, objects))) if objects else b"")

        file.write(b'{"events":[')
        file.writelines(elements(events()))
        file.write(b'],\n"objects":[')
        kept.seek(0)
        shutil.copyfileobj(kept, file)
        event_types, object_types = map(msgspec.json.encode, log.types())
        file.write(b'],\n"eventTypes":' + event_types + b',\n"objectTypes":' + object_types + b"}\n")
    return Written(
        log.events, (f"{log.objects:,} objects", f"{log.left_out:,} events name no object and are not in it", TOLD)
    )
