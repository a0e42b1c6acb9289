"""Runs that were forged before they were committed: each is one honest run with one lie in it.

A forger who owns the writer can give such a run hashes that agree; only the handlers know better.
"""

from itertools import count
from typing import Any, NamedTuple

from fsar_ledger.designs.constants import Constants
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Robot, Subject, with_columns
from fsar_ledger.events.execution import (
    ExecutionFailed,
    ExecutionFinished,
    ExecutionStarted,
    RoutinePerformed,
    RoutineWithheld,
)
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.recovery import FailureResolved, RecoveryAttempted
from fsar_ledger.events.request import RequestAccepted, RequestAdmitted, RequestDenied, RequestIssued
from fsar_ledger.events.trust import RoleTrustSet
from fsar_ledger.events.world import ContextChanged, ObstructionAppeared, RoutineDue
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.runtime.simulation import RunSpec, run_id, simulate_run
from tests import past


def _has_all_that_is_forged(record: LedgerRun) -> bool:
    causes = {event.cause for event in record.events if isinstance(event, ExecutionFailed)}
    resolved = [event.level for event in record.events if isinstance(event, FailureResolved)]
    has = {type(event) for event in record.events}
    ends_with_the_world = isinstance(record.events[-1], ContextChanged)
    started = next((event for event in record.events if isinstance(event, ExecutionStarted)), None)
    if started is None or started.principals.supervised_by is None or causes != {"obstruction"}:
        return False
    return resolved[:1] == ["local"] and ends_with_the_world and has >= {RequestDenied, RoutineWithheld}


HONEST = next(
    record
    for run in count(439)
    if _has_all_that_is_forged(
        record := simulate_run(RunSpec(42, "fsar", "full", "failure-recovery-chain", 4, run), Constants())
    )
)


def changed(
    record: LedgerRun, seq: int, event: Event | None = None, time_us: int | None = None, caused_by: int | None = None
) -> LedgerRun:
    """The record with another event, time or cause at that place."""
    events, times, causes = list(record.events), list(record.times_us), list(record.caused_by)
    events[seq] = events[seq] if event is None else event
    times[seq] = times[seq] if time_us is None else time_us
    causes[seq] = causes[seq] if caused_by is None else caused_by
    return LedgerRun(record.run_id, times, causes, events)


def dropped(record: LedgerRun, seq: int) -> LedgerRun:
    """The record without this event; what it caused is said to be caused by what had caused it."""
    causes = [record.caused_by[seq] if cause == seq else cause for cause in record.caused_by]
    causes = [cause if cause is None or cause < seq else cause - 1 for cause in causes]
    times_us, events = list(record.times_us), list(record.events)
    del times_us[seq], causes[seq], events[seq]
    return LedgerRun(record.run_id, times_us, causes, events)


def added(record: LedgerRun, seq: int, event: Event, time_us: int, cause: int) -> LedgerRun:
    """The record with one event more, which then has this seq."""
    causes = [one if one is None or one < seq else one + 1 for one in record.caused_by]
    return LedgerRun(
        record.run_id,
        [*record.times_us[:seq], time_us, *record.times_us[seq:]],
        [*causes[:seq], cause, *causes[seq:]],
        [*record.events[:seq], event, *record.events[seq:]],
    )


def swapped(record: LedgerRun, seq: int) -> LedgerRun:
    """The record with this event and the next in the other order."""
    events, times = list(record.events), list(record.times_us)
    events[seq : seq + 2], times[seq : seq + 2] = reversed(events[seq : seq + 2]), reversed(times[seq : seq + 2])
    return LedgerRun(record.run_id, times, record.caused_by, events)


def stopped(seq: int) -> LedgerRun:
    """The honest record, as if the run had ended before that event."""
    return LedgerRun(HONEST.run_id, HONEST.times_us[:seq], HONEST.caused_by[:seq], HONEST.events[:seq])


def renamed(record: LedgerRun) -> LedgerRun:
    """The record under the name that its first event gives it."""
    started = record.events[0]
    assert isinstance(started, RunStarted)
    return LedgerRun(run_id(started), record.times_us, record.caused_by, record.events)


def seq_of(kind: type[Event], after: int = 0, record: LedgerRun = HONEST) -> int:
    """The place of the first such event."""
    return next(seq for seq in count(after) if isinstance(record.events[seq], kind))


def restated(seq: int, /, **fields: Any) -> LedgerRun:
    """The honest record, with other values in one event."""
    return changed(HONEST, seq, with_columns(HONEST.events[seq], **fields))


def denied(seq: int) -> RequestDenied:
    """A refusal in the place of this admission."""
    admitted = HONEST.events[seq]
    assert isinstance(admitted, RequestAdmitted)
    return RequestDenied(admitted.subject, admitted.principals, "policy")


class Forgery(NamedTuple):
    """A forged run, and what replay must name: seq, field and the last part of the handler (None: nobody decides
    there)."""

    run: LedgerRun
    seq: int
    field: str
    handler: str | None


TRUST = seq_of(RoleTrustSet)
ADMITTED = seq_of(RequestAdmitted)
ACCEPTED = seq_of(RequestAccepted)
STARTED = seq_of(ExecutionStarted)
ISSUED = seq_of(RequestIssued)
FAILED = seq_of(ExecutionFailed)
RESOLVED = seq_of(FailureResolved)
REFUSED = seq_of(RequestDenied)
FINISHED = seq_of(ExecutionFinished)
DUE = seq_of(RoutineDue)
WITHHELD = seq_of(RoutineWithheld)
LAST = len(HONEST.events) - 1
PERFORMED, ATTEMPT, OBSTRUCTED = seq_of(RoutinePerformed), seq_of(RecoveryAttempted), seq_of(ObstructionAppeared)
withheld = HONEST.events[WITHHELD]
assert isinstance(withheld, RoutineWithheld)
LATE = HONEST.times_us[LAST] + 1

FORGERIES = {
    "an admission is made a refusal": Forgery(
        changed(HONEST, ADMITTED, denied(ADMITTED)), ADMITTED, "type", "fsar.request.evaluate_request"
    ),
    "a refusal is left out": Forgery(dropped(HONEST, REFUSED), REFUSED, "type", "fsar.request.evaluate_request"),
    "the reason of a refusal is another": Forgery(
        restated(REFUSED, reason="trust"), REFUSED, "reason", "fsar.request.evaluate_request"
    ),
    "an execution without admission": Forgery(
        dropped(HONEST, ADMITTED), ADMITTED, "type", "fsar.request.evaluate_request"
    ),
    "an execution that nobody accepted": Forgery(
        dropped(HONEST, ACCEPTED), ACCEPTED, "type", "fsar.execution.take_turn"
    ),
    "an acceptance by another robot": Forgery(
        restated(ACCEPTED, decided_by="robot/C1"), ACCEPTED, "decided_by", "fsar.execution.take_turn"
    ),
    "a request in the name of another": Forgery(
        restated(ISSUED, requested_by="robot/C1"), ISSUED, "requested_by", "fsar.discovery.issue_request"
    ),
    "no supervisor is named": Forgery(
        restated(STARTED, supervised_by=None), STARTED, "supervised_by", "fsar.execution.start"
    ),
    "an admission rests on more trust": Forgery(
        restated(ADMITTED, trust="persistent"), ADMITTED, "trust", "fsar.request.evaluate_request"
    ),
    "the fleet is founded with more trust": Forgery(
        restated(TRUST, scope="persistent"), TRUST, "scope", "world.founding"
    ),
    "a robot trusts one robot more at the founding": Forgery(
        added(HONEST, TRUST, past.trusted(Robot("robot/A1"), Robot("robot/C1"), "task"), 0, 0),
        TRUST,
        "type",
        "world.founding",
    ),
    "an execution starts early": Forgery(
        changed(HONEST, STARTED, time_us=HONEST.times_us[STARTED] - 1), STARTED, "time_us", "fsar.execution.start"
    ),
    "an execution takes longer": Forgery(
        restated(STARTED, ends_us=HONEST.times_us[FINISHED] + 1), STARTED, "ends_us", "fsar.execution.start"
    ),
    "a failure has another cause": Forgery(
        restated(FAILED, cause="degradation"), FAILED, "cause", "handlers.execution.detect_obstruction"
    ),
    "a failure is left out": Forgery(dropped(HONEST, FAILED), FAILED, "type", "handlers.execution.detect_obstruction"),
    "a failure was resolved by a human": Forgery(
        restated(RESOLVED, level="human"), RESOLVED, "level", "fsar.recovery.end_attempt"
    ),
    "an attempt was caused by something else": Forgery(
        changed(HONEST, ATTEMPT, caused_by=1), ATTEMPT, "caused_by", "fsar.recovery.start_recovery"
    ),
    "a result is partial": Forgery(
        restated(FINISHED, result="partial"), FINISHED, "result", "handlers.execution.finish_attempt"
    ),
    "a withheld routine is performed": Forgery(
        changed(HONEST, WITHHELD, RoutinePerformed(withheld.principals, withheld.robot, withheld.operation)),
        WITHHELD,
        "type",
        "fsar.execution.decide_routine",
    ),
    "two events of one decision are swapped": Forgery(
        swapped(HONEST, ADMITTED), ADMITTED, "type", "fsar.request.evaluate_request"
    ),
    "a decision comes before its cause": Forgery(
        swapped(HONEST, PERFORMED - 1), PERFORMED - 1, "type", "world.schedule.schedule"
    ),
    "a decision is doubled": Forgery(
        added(HONEST, ACCEPTED, HONEST.events[ACCEPTED], HONEST.times_us[ACCEPTED], 1),
        ACCEPTED,
        "caused_by",
        "fsar.execution.take_turn",
    ),
    "a task is begun that did not arrive": Forgery(
        added(
            HONEST,
            DUE,
            past.began(Subject("A9-1", "A9-1/1.1"), Robot("robot/A1"), 1, "carry.package", None),
            HONEST.times_us[DUE],
            0,
        ),
        DUE,
        "type",
        "world.schedule.schedule",
    ),
    "a fact of the world is left out, its consequence is not": Forgery(
        dropped(HONEST, DUE), DUE, "type", "world.schedule.schedule"
    ),
    "a fact of the world is added, without its consequence": Forgery(
        added(HONEST, LAST + 1, RoutineDue(Robot("robot/A1"), "sensing"), LATE, 0), LAST + 1, "type", None
    ),
    "a robot fails without a cause in the world": Forgery(
        added(HONEST, STARTED + 1, HONEST.events[FAILED], HONEST.times_us[STARTED] + 1, STARTED),
        STARTED + 1,
        "type",
        "world.schedule.schedule",
    ),
    "a fact of the world is said to have a cause": Forgery(
        changed(HONEST, OBSTRUCTED, caused_by=1), OBSTRUCTED, "caused_by", "world.schedule.schedule"
    ),
    "the run goes on after its end": Forgery(
        added(HONEST, LAST + 1, HONEST.events[PERFORMED], LATE, LAST), LAST + 1, "type", None
    ),
    "the run stops halfway": Forgery(stopped(RESOLVED), RESOLVED, "type", "fsar.recovery.end_attempt"),
}
