"""The plan of an experiment in a ledger, and its name."""

from hashlib import sha256

import msgspec

from fsar_ledger.events.experiment import ExperimentPlanned
from fsar_ledger.ledger.rows.codec import LedgerRun


def plan_id(planned: ExperimentPlanned) -> str:
    """Return a readable name with a digest of everything planned, as runs have; no two plans share a name."""
    digest = sha256(msgspec.json.encode(planned, order="sorted")).hexdigest()[:12]
    return f"plan.n{planned.fleet_size}.s{planned.seed}.x{planned.run_count:04d}-{digest}"


def plan_record(planned: ExperimentPlanned) -> LedgerRun:
    """Return the record to commit for a plan: a run with its name and one event, at time 0."""
    return LedgerRun(plan_id(planned), (0,), (None,), (planned,))


def misnamed(record: LedgerRun) -> tuple[str, str, str] | None:
    """Return the first field in which the record of a plan is wrong, with what was found and expected, or None."""
    planned = record.events[0]
    assert isinstance(planned, ExperimentPlanned)
    expected = plan_record(planned)
    pairs = (("run_id", record.run_id, expected.run_id), ("time_us", record.times_us[0], expected.times_us[0]))
    return next(((field, f"{found!r:.300}", repr(right)) for field, found, right in pairs if found != right), None)
