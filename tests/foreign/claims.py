"""Compare answers about a record that lacks a concern with those about the whole record."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import pyarrow as pa
import pyarrow.compute as pc
from msgspec.structs import replace

from fsar_ledger.events import CONCERN_OF, CONCERNS
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.ledger.rows.codec import LedgerRun, encode
from fsar_ledger.ledger.rows.schema import LAYOUTS
from fsar_ledger.metrics.database import Database
from fsar_ledger.metrics.library import Query, library
from fsar_ledger.metrics.provenance import unobserved
from tests.queries.keys import required

Row = dict[str, Any]

OF_GAPS = {"facts/unobservable", "audit/record_gaps", "facts/carried_events"}
"""Queries that are themselves about what is not observed, and have rows only for that; or that choose events of the
record and answer nothing about the run."""
GAPS = {"observes", "not_observed", "runs_not_observed"}
"""Columns that are themselves about what is not observed."""

TOLD: dict[str, set[str]] = {
    "audit/request_timeline": {"step", "note", "sender"},
    "audit/failure_timeline": {"step", "until_s"},
    "audit/supervisor_of": {"first_us", "last_us", "first_seq", "last_seq", "records"},
    "audit/unattributed_records": {
        *("records", "unattributed", "without_origin", "without_executor", "without_supervisor")
    },
    "audit/requests": {"began_s", "ended_s", "seq", "asked_by", "allowed_by", "supervised_by"},
    "audit/interventions": {"asked_by"},
    "audit/policy_known_at": {"why_unknown"},
}
"""By query, the columns that say what stands on record and no more: how many records there are, which is the first and
the last, whom they name; or why there is no answer. Over fewer records they may say something else; the answer still
says what is not observed.
"""
WHOLE = "whole"
BY_RUN = [
    name
    for name, query in library().queries.items()
    if query.key is not None and "run_id" in query.key and name not in OF_GAPS
    if not name.startswith("staging/")
]
"""The queries whose rows are each about one run, but for the views of the events themselves."""
KEPT_BY_NAMES = {"audit/policy_known_at", "audit/unattributed_records"}
"""Queries with a row for each principal that stands on record: where none does, there is one for NULL."""


class Claim(NamedTuple):
    """What a query may say of a run only if the run observes all of these concerns; no values: anything but NULL."""

    query: str
    column: str
    values: tuple[object, ...]
    concerns: tuple[str, ...]


CLAIMS = (
    Claim("audit/robot_activity", "doing", ("idle",), ("execution", "recovery")),
    Claim("audit/robot_state_at", "state", ("idle",), ("execution", "recovery", "registry", "supervision", "world")),
    Claim("audit/capability_surface", "may_ask", (), ("fleet", "trust")),
    Claim("audit/relay_links", "is_trusted", (), ("fleet", "trust")),
    Claim("audit/requests", "denials", (0,), ("request", "knowledge", "supervision")),
    Claim("audit/requests", "failures", (0,), ("recovery",)),
    Claim("audit/requests", "result", ("not begun", "not finished"), ("execution", "request")),
    Claim("audit/supervisor_of", "records_off_shift", (), ("supervision",)),
    Claim("facts/delegated_trust", "is_direct", (), ("fleet", "trust")),
    Claim("facts/governed_starts", "outcome", ("allow",), ("policy",)),
    Claim("facts/governed_starts", "is_approved", (False,), ("supervision",)),
    Claim("facts/known_policy", "outcome", ("allow", "review"), ("policy", "request", "knowledge")),
    Claim("facts/policy_decisions", "is_against_fleet", (False,), ("policy",)),
)


def baseless(database: Database) -> Iterator[str]:
    """Yield what queries say of runs that do not observe what it rests on."""
    observed = {row["run_id"]: row["observes"] for row in database.rows("SELECT run_id, observes FROM runs")}
    for claim in CLAIMS:
        for row in database.query(claim.query, {}).to_pylist():
            value, seen = row[claim.column], observed[row["run_id"]]
            is_claimed = value in claim.values if claim.values else value is not None
            if is_claimed and not set(seen) >= set(claim.concerns):
                yield f"{claim.query}: {claim.column} {value!r} of a run that observes only {', '.join(seen)}"


def without(runs: list[LedgerRun], concern: str | None, name: str) -> pa.Table:
    """Return the rows of these runs as a source would record them that does not observe this concern.

    The events keep their places, so that answers can be compared; `name` comes before the name of each run.
    """
    rows = encode([LedgerRun(f"{name}:{run.run_id}", run.times_us, run.caused_by, run.events) for run in runs])
    tags = [tag for tag in LAYOUTS if concern is not None and CONCERN_OF.get(tag.partition(".")[0]) == concern]
    left = rows.filter(pc.invert(pc.is_in(rows["type"], pa.array(tags, pa.string()))))
    observes = [
        None if said is None else [one for one in said if one != concern] for said in left["observes"].to_pylist()
    ]
    at = left.schema.get_field_index("observes")
    return left.set_column(at, "observes", pa.array(observes, left.schema.field("observes").type))


def recorded_without(run: LedgerRun, concern: str) -> LedgerRun:
    """Return the run as a source records it that does not observe this concern.

    What a missing event caused is said to be caused by what caused that one.
    """
    started = run.events[0]
    assert isinstance(started, RunStarted)
    kept = [seq for seq, event in enumerate(run.events) if CONCERN_OF.get(type(event).__name__) != concern]
    place = {seq: number for number, seq in enumerate(kept)}

    def cause_of(seq: int) -> int | None:
        cause = run.caused_by[seq]
        while cause is not None and cause not in place:
            cause = run.caused_by[cause]
        return None if cause is None else place[cause]

    observes = tuple(one for one in started.observes if one != concern)
    begun = replace(started, kind="foreign", observes=observes, source="example.org")
    events = [begun, *(run.events[seq] for seq in kept[1:])]
    return LedgerRun(run.run_id, [run.times_us[seq] for seq in kept], [cause_of(seq) for seq in kept], events)


def vain_claims(database: Database, query: Query, whole: str) -> Iterator[str]:
    """Yield what a query says of runs that lack a concern and not of the whole ones, whose names begin with `whole`.

    The database holds each run as `CONCERN:NAME` without the concern, and as `whole:NAME`. Of the facts that other
    queries are made of, and of what is judged, only the word of what is not observed is asked for: their values are
    NULL in what reads them (`tests/queries/test_observing.py`).
    """
    is_asked = query.name.startswith("audit/")
    key = [column for column in query.key or () if column != "run_id"]
    full: dict[tuple[Any, ...], Row] = {}
    parts: dict[str, list[tuple[tuple[Any, ...], Row]]] = {concern: [] for concern in CONCERNS}
    for row in database.query(query.name, required(query)).to_pylist():
        lacks, _, name = row.pop("run_id").partition(":")
        place = (name, *(str(row[column]) for column in key))
        if lacks == whole:
            full[place] = row
        else:
            parts[lacks].append((place, row))
    for concern, rows in parts.items():
        said = {
            column
            for place, row in rows
            for column, value in row.items()
            if value is not None and place in full and value != full[place][column]
        } - GAPS
        vain = said - TOLD.get(query.name, set())
        if vain and is_asked:
            yield f"{query.name} without {concern}: {', '.join(sorted(vain))} neither NULL nor as with it"
        strange = sum(place not in full for place, _ in rows)
        if strange and is_asked and query.name not in KEPT_BY_NAMES:
            yield f"{query.name} without {concern}: {strange} of {len(rows)} rows that are not there with it"
        differs = {place: apart_from_gaps(row) for place, row in rows} != {
            place: apart_from_gaps(row) for place, row in full.items()
        }
        if differs and concern not in {one.concern for one in unobserved(database, query)}:
            yield f"{query.name} without {concern}: another answer, and no word of what is not observed"


def apart_from_gaps(row: Row) -> Row:
    return {column: value for column, value in row.items() if column not in GAPS}
