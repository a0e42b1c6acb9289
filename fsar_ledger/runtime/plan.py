"""A plan in a ledger: the name it goes by, where it stands, and which batches are still to be made under it."""

from collections.abc import Iterable, Iterator
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


class Commit(msgspec.Struct, frozen=True):
    """The names of the runs of a commit, and of its plans."""

    runs: frozenset[str]
    plans: frozenset[str]


def commits_of(ledger: LedgerView) -> Iterator[Commit]:
    """What each commit holds, in order. Raises: LedgerCorrupted for a segment that cannot be read."""
    for table in ledger.tables(["run_id", "type"]):
        names = table.column("run_id")
        plans = frozenset(names.filter(pa.array(standing_alone(whole(table.column("type"))))).to_pylist())
        yield Commit(frozenset(names.unique().to_pylist()) - plans, plans)


class Standing(msgspec.Struct, frozen=True):
    """What a ledger holds of a plan: whether the plan is on record, the names of all runs, and of those from before it was."""

    is_recorded: bool
    held: frozenset[str]
    before: frozenset[str]


def standing(plan: str, commits: Iterable[Commit]) -> Standing:
    """How the plan of this name stands among the commits; one that is not on record would come after all."""
    held: set[str] = set()
    before: frozenset[str] | None = None
    for commit in commits:
        if plan in commit.plans:
            before = frozenset(held)
        held |= commit.runs
    everything = frozenset(held)
    return Standing(before is not None, everything, everything if before is None else before)
