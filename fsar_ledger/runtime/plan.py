"""A plan in a ledger: the name it goes by, and what of it is there."""

from hashlib import sha256

import msgspec
import pyarrow as pa

from fsar_ledger.events.experiment import ExperimentPlanned
from fsar_ledger.ledger.arrow import whole
from fsar_ledger.ledger.check import standing_alone
from fsar_ledger.ledger.codec import RunRecord
from fsar_ledger.ledger.read import LedgerView


def plan_id(planned: ExperimentPlanned) -> str:
    """A readable name and a digest of all that was planned, as runs have: another plan has another name."""
    digest = sha256(msgspec.json.encode(planned, order="sorted")).hexdigest()[:12]
    return f"plan.n{planned.fleet_size}.s{planned.seed}.x{planned.run_count:04d}-{digest}"


def plan_record(planned: ExperimentPlanned) -> RunRecord:
    """What is committed of a plan: one event under its own name, at the beginning of time."""
    return RunRecord(plan_id(planned), (0,), (None,), (planned,))


def misnamed(record: RunRecord) -> tuple[str, str, str] | None:
    """The field in which a plan is not as it is committed, with what was found and expected; None if there is none."""
    planned = record.events[0]
    assert isinstance(planned, ExperimentPlanned)
    expected = plan_record(planned)
    pairs = (("run_id", record.run_id, expected.run_id), ("time_us", record.times_us[0], expected.times_us[0]))
    return next(((field, f"{found!r:.300}", repr(right)) for field, found, right in pairs if found != right), None)


class Held(msgspec.Struct, frozen=True):
    """The names of the runs that a ledger holds, and of its plans."""

    runs: frozenset[str]
    plans: frozenset[str]


def held(ledger: LedgerView) -> Held:
    """What the ledger holds. Raises: LedgerCorrupted for a segment that cannot be read."""
    names: set[str] = set()
    plans: set[str] = set()
    for table in ledger.tables(["run_id", "type"]):
        names.update(table.column("run_id").unique().to_pylist())
        plans.update(table.column("run_id").filter(pa.array(standing_alone(whole(table.column("type"))))).to_pylist())
    return Held(frozenset(names - plans), frozenset(plans))
