"""Why an event happened: the triggers, the facts that were read, who wrote them, and what was answered."""

import re
from collections.abc import Callable
from itertools import pairwise

import msgspec
import pytest

from fsar_ledger.analysis.fork_base import base_of_record, rerun
from fsar_ledger.analysis.reads import Read
from fsar_ledger.analysis.why import DecisionTrace, decisions, first_of, reasons
from fsar_ledger.base.errors import UsageError
from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.events import Event
from fsar_ledger.events.execution import ExecutionStarted
from fsar_ledger.events.fleet import RunStarted
from fsar_ledger.events.recovery import AssistanceRequested
from fsar_ledger.events.request import RequestDenied, RequestIssued
from fsar_ledger.events.supervision import SupervisorResponded
from fsar_ledger.events.trust import TrustSet
from fsar_ledger.events.world import LinkCameUp, PolicyWindowOpened, RobotCameBack, RobotWentOff
from fsar_ledger.ledger.rows.codec import LedgerRun
from fsar_ledger.projections.fold import fold
from fsar_ledger.runtime.change_texts import parsed
from fsar_ledger.runtime.simulation import handler_table_of
from tests.analysis.conftest import simulated


def found(record: LedgerRun, kind: type[Event], is_meant: Callable[[Event], bool] = lambda _: True) -> int:
    """The seq of the first such event."""
    return next(seq for seq, event in enumerate(record.events) if isinstance(event, kind) and is_meant(event))


def read(made: DecisionTrace, place: str, name: str) -> Read:
    return next(one for one in made.reads if (one.place, one.name) == (place, name))


@pytest.fixture(scope="module")
def denied() -> LedgerRun:
    """A run in which the executor denies a request under a window of its own."""
    return simulated("fsar", 6)


@pytest.fixture(scope="module")
def distrusted(denied: LedgerRun) -> LedgerRun:
    """The same run, but for a supervisor who withdraws the executor's trust while the first request is on its way."""
    seq = found(denied, RequestIssued)
    request = denied.events[seq]
    assert isinstance(request, RequestIssued)
    pair = f"{request.principals.executed_by} {request.principals.requested_by}"
    change = f"trust {pair} none from {denied.times_us[seq] / 1e6 + 0.001:.6f}s"
    return rerun(base_of_record(denied, "0" * 64)).fork(parsed([change])).record


OWN_WINDOW = 351


def test_a_denial_names_the_window_that_was_open_and_the_event_that_opened_it(denied: LedgerRun) -> None:
    assert isinstance(denied.events[OWN_WINDOW], RequestDenied)
    window = read(reasons(denied, OWN_WINDOW, 1).made[0], "world.local", "[robot/B1]")
    assert window.value == (("local/B1/0", "deny"),)
    assert window.written_by is not None
    opened = denied.events[window.written_by]
    assert isinstance(opened, PolicyWindowOpened)
    assert opened.window == "local/B1/0"


def test_the_members_of_a_set_are_told_in_the_same_order_in_every_process() -> None:
    record = simulated("fsar")
    made = reasons(record, found(record, AssistanceRequested), 1).made[0]
    assert read(made, "fleet.teams[1]", "keys").value == ["robot/A1", "robot/B1", "robot/C1", "robot/D1"]


def test_a_denial_for_want_of_trust_names_the_entry_and_who_set_it(distrusted: LedgerRun) -> None:
    seq = found(distrusted, RequestDenied, lambda one: isinstance(one, RequestDenied) and one.reason == "trust")
    entry = read(reasons(distrusted, seq, 1).made[0], "trust.entries[robot/B1, robot/A1]", "[*, *]")
    assert (entry.value, entry.is_absent) == ("none", False)
    assert entry.written_by == found(distrusted, TrustSet)


@pytest.mark.parametrize(
    ("change", "command"),
    [
        ("rule fleet deny robot=robot/B1 from 20s", "SetPolicyRule"),
        ("trust robot/B1 robot/A1 none from 20s", "SetTrust"),
        ("density all 1 from 20s", "SetSupervisionDensity"),
        ("budget robot/B1 local 1s 1 from 20s", "SetRecoveryBudget"),
    ],
)
def test_a_fork_is_made_again_under_observation(denied: LedgerRun, change: str, command: str) -> None:
    record = rerun(base_of_record(denied, "0" * 64)).fork(parsed([change])).record
    made = decisions(record, {first_of(record, seq) for seq in range(len(record.events))})
    assert command in {type(one.command).__name__ for one in made.values() if one.reaction is None}


def test_what_a_supervisor_commands_from_outside_has_no_trigger(distrusted: LedgerRun) -> None:
    answer = reasons(distrusted, found(distrusted, TrustSet), 1)
    (made,) = answer.made
    assert (made.origin, made.command, made.triggered_by, answer.triggers) == ("command", "SetTrust", None, ())
    assert made.handler == "handlers.trust.set_trust"


def test_what_is_not_there_is_read_as_absent_and_was_written_by_nobody(denied: LedgerRun) -> None:
    pair = read(reasons(denied, OWN_WINDOW, 1).made[0], "trust.entries", "[robot/B1, robot/A1]")
    assert (pair.value, pair.is_absent, pair.written_by) == (None, True, None)


def test_an_event_has_the_trigger_on_record_and_its_chain_ends_at_a_fact_of_the_world(denied: LedgerRun) -> None:
    answer = reasons(denied, OWN_WINDOW, 1)
    assert answer.made[0].triggered_by == denied.caused_by[OWN_WINDOW] == answer.triggers[0]
    assert answer.made[0].scheduled_by == "architectures.fsar.request._on_request"
    for effect, cause in pairwise(answer.triggers):
        assert denied.caused_by[first_of(denied, effect)] == cause
    (last,) = reasons(denied, answer.triggers[-1], 1).made
    assert (last.origin, last.reads) == ("world", ())


def test_events_that_were_made_at_once_have_one_account(denied: LedgerRun) -> None:
    seq = next(seq for seq in range(100, len(denied.events)) if first_of(denied, seq) != seq)
    one, other = reasons(denied, seq, 1), reasons(denied, first_of(denied, seq), 1)
    assert one.made == other.made
    assert one.made[0].count >= 2


def test_the_founding_has_no_reasons(denied: LedgerRun) -> None:
    for seq in (0, 5):
        answer = reasons(denied, seq)
        assert [(one.seq, one.origin) for one in answer.made] == [(0, "founding")]
        assert answer.triggers == ()


def test_answers_at_ports_are_those_of_the_run(denied: LedgerRun) -> None:
    base = rerun(base_of_record(denied, "0" * 64))
    asked = {one.name: one.text for one in base.asked}
    told = [
        answered
        for seq in range(60, len(denied.events), 7)
        for made in reasons(denied, seq, 1).made
        for answered in made.answers
    ]
    assert len(told) > 10
    assert all(asked[one.question] == one.answer for one in told)


def test_a_supervisors_verdict_and_the_time_it_took_are_among_the_answers() -> None:
    record = simulated("cfc", 1)
    made = reasons(record, found(record, SupervisorResponded), 1).made[0]
    kinds = [one.question.partition(":")[0] for one in made.answers]
    assert ("response" in kinds, "call" in kinds) == (True, True)


def test_a_command_that_was_kept_names_the_facts_that_brought_its_robot_or_link_back(runs: list[LedgerRun]) -> None:
    many = Constants(outages=Outages(off_rate_per_s=0.05, link_rate_per_s=0.05))
    for record in (*runs, simulated("fsar", 1, many)):
        made = decisions(record, {first_of(record, seq) for seq in range(len(record.events))})
        kept = {seq: one for seq, one in made.items() if one.waited_for}
        is_interrupted = any(isinstance(event, RobotWentOff) for event in record.events)
        assert bool(kept) == is_interrupted, "runs with outages keep commands, and no others"
        for seq, one in kept.items():
            cause = record.caused_by[seq]
            assert cause is not None
            assert one.reaction is not None
            assert cause < one.waited_for[0] <= one.waited_for[-1] < seq
            actor = handler_table_of(record.run_id.partition(".")[0]).actors[type(one.command)]
            ends = {actor(fold(record.events[:seq]), one.command), *(ask.sender for ask, _ in one.reaction.answers)}
            for fact in (record.events[fact] for fact in one.waited_for):
                assert isinstance(fact, RobotCameBack | LinkCameUp)
                assert fact.robot in ends


def test_what_a_decision_waited_for_is_among_its_reasons(runs: list[LedgerRun]) -> None:
    record = runs[1]
    seq, back = next(
        (seq, one.waited_for)
        for seq, one in decisions(record, {first_of(record, seq) for seq in range(len(record.events))}).items()
        if one.waited_for
    )
    (made,) = reasons(record, seq, 1).made
    assert made.waited_for == back
    assert set(back) <= set(made.rests_on)


def test_deeper_answers_begin_with_the_shallow_ones_and_end() -> None:
    record = simulated("dhma")
    seq = found(record, ExecutionStarted)
    by_depth = [reasons(record, seq, depth).made for depth in (1, 2, 3, None)]
    assert len(by_depth[0]) == 1
    for shallow, deep in pairwise(by_depth):
        assert deep[: len(shallow)] == shallow
    whole = by_depth[-1]
    assert {first_of(record, seq) for one in whole for seq in one.rests_on} <= {one.seq for one in whole}
    assert all(seq < one.seq for one in whole for seq in one.rests_on)


def test_a_record_that_replay_contradicts_is_refused_by_the_first_event(denied: LedgerRun) -> None:
    times_us = [*denied.times_us]
    times_us[200] += 1
    forged = msgspec.structs.replace(denied, times_us=times_us)
    with pytest.raises(UsageError, match=r"event 200: the record is not what .* `fsar-ledger verify --replay`"):
        reasons(forged, OWN_WINDOW)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"kind": "live"}, "found a live run, whose commands are not stored, expected a simulated run"),
        ({"model_version": "1"}, "model_version: found '1', expected '3'; replay it with fsar-ledger 0.2.0"),
        ({"model_version": "9"}, "model_version: found '9', expected '3'; replay it with the version that wrote it"),
    ],
)
def test_a_run_that_cannot_be_made_again_is_refused(denied: LedgerRun, changes: dict[str, str], expected: str) -> None:
    started = denied.events[0]
    assert isinstance(started, RunStarted)
    foreign = msgspec.structs.replace(denied, events=[msgspec.structs.replace(started, **changes), *denied.events[1:]])
    with pytest.raises(UsageError, match=re.escape(expected)):
        reasons(foreign, OWN_WINDOW)
