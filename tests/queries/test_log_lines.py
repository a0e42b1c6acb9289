"""Every event reads as a line: given rows, expected words."""

from typing import Any

import pytest

from fsar_ledger.events import CONCERNS
from fsar_ledger.ledger.rows.schema import COLUMNS, LAYOUTS
from fsar_ledger.metrics.database import Value
from tests.queries.histories import Row, S, act, answer, event, run
from tests.recycled import from_rows

A, B = "robot/A1", "robot/B1"
SUPERVISOR = "supervisor/A1"
IN_BOTH = {"AuthorityClaimed.v1"}
"""The type that a timeline of a request tells only where it revokes."""
FILLING: dict[str, Value] = {"string": "x", "integer": 1_000_000, "boolean": True, "strings": ["x"]}


def line(row: Row) -> tuple[Any, ...]:
    """Who, whom, what and the note of this event, behind the start of its run."""
    *_, found = answer("facts/log_lines", run(row), columns=("seq", "sender", "receiver", "message", "note"))
    return found[1:]


def words(name: str) -> set[str]:
    with from_rows([]) as database:
        return {str(row["type"]) for row in database.query(f"facts/{name}").to_pylist()}


def test_every_event_type_has_words() -> None:
    told, others = words("message_words"), words("occurrence_words")
    missing = set(LAYOUTS) - told - others
    assert not missing, f"{sorted(missing)}: say how `log` words each in queries/facts/occurrence_words.sql"
    assert told | others == set(LAYOUTS)
    assert told & others == IN_BOTH


def run_with(tag: str, *, is_bare: bool) -> list[Row]:
    """The rows of a run, named as the type, of one such event; a bare one has only the fields that it must have."""
    fields = [field for field in LAYOUTS[tag].fields if not (is_bare and field.is_nullable)]
    given = {field.name: min(field.values) if field.values else FILLING[COLUMNS[field.name]] for field in fields}
    return run({"type": tag, "time_us": S, **given}, run_id=tag)


@pytest.mark.parametrize("is_bare", [True, False])
def test_every_event_has_one_line_that_says_something(is_bare: bool) -> None:
    tags = [tag for tag in LAYOUTS if not tag.startswith("RunStarted")]
    columns = ("run_id", "seq", "time_s", "message", "note")
    told = answer("facts/log_lines", *(run_with(tag, is_bare=is_bare) for tag in tags), columns=columns)
    lines = [(tag, line) for tag, *line in told if line[0] != 0]
    assert sorted(tag for tag, _ in lines) == sorted(tags)
    for tag, (seq, time_s, message, note) in lines:
        assert (seq, time_s) == (1, 1.0), tag
        assert message.strip(" :;"), tag
        assert note is None or (note.strip(" ;") == note != ""), (tag, note)


def test_the_words_of_an_event_name_parts_of_the_line_that_are_there() -> None:
    with from_rows([]) as database:
        told = {str(row["type"]): row for row in database.query("facts/occurrence_words").to_pylist()}
    columns = ("run_id", "seq", "sender", "receiver", "message")
    runs = (run_with(tag, is_bare=False) for tag in told if not tag.startswith("RunStarted"))
    lines = {tag: line for tag, seq, *line in answer("facts/log_lines", *runs, columns=columns) if seq == 1}
    for tag, (sender, receiver, message) in lines.items():
        assert None not in (sender, receiver), tag
        if told[tag]["detail"] is not None:
            detail = f"{tag}: `details` of queries/facts/occurrences.sql has no key {told[tag]['detail']}"
            assert str(message).startswith(f"{told[tag]['words']}: "), detail
    assert len(lines) == len(told) - 1


@pytest.mark.slow
def test_the_parts_of_an_event_are_named_where_they_are_known() -> None:
    opened = event("PolicyWindowOpened", S, robot=B, scope="fleet", window="fleet/B1/0", outcome="deny")
    assert line(opened) == (B, B, "policy window opens: fleet/B1/0", "fleet deny")
    trusted = event("TrustSet", S, robot=A, peer=B, scope="task", capability="lift", decided_by="H_F", reason="met")
    assert line(trusted) == (A, B, "trust: task", "lift; met; decided by H_F")
    begun = act("StepBegan", S, "t1/1.1", robot=A, step=1, attempt=2, capability="lift")
    assert line(begun) == (A, A, "turns to: lift", "step 1; attempt 2")
    budget = event("RecoveryBudgetSet", S, robot=A, level="peer", t_max_us=5 * S, n_max=2, decided_by=SUPERVISOR)
    assert line(budget) == (SUPERVISOR, A, "sets recovery budget: peer, 2 attempts within 5.0 s", None)
    once = event("RecoveryBudgetSet", S, robot=A, level="local", t_max_us=S, n_max=1, decided_by=SUPERVISOR)
    assert line(once) == (SUPERVISOR, A, "sets recovery budget: local, 1 attempt within 1.0 s", None)
    arrived = event("TaskArrived", S, task_id="t1", robot=A, steps=["A lift"], budget_us=S, due_us=2 * S)
    assert line(arrived) == (A, A, "receives task: t1", "1 step; budget 1.0 s; due 2.0 s")
    follows = event("TrustThresholdsSet", S, promote_after=3, downgrade_after=0, decided_by="H_F")
    assert line(follows)[2] == "sets how trust follows the record: promoted after 3, never downgraded"
    rejected = event("CommandRejected", S, command="SubmitTask", subject="t9", reason="unknown robot")
    assert line(rejected) == (None, None, "command rejected: SubmitTask", "about t9; unknown robot")
    rule = event("PolicyRuleSet", S, scope="fleet", outcome="deny", capability="lift", decided_by="H_F")
    assert line(rule) == ("every robot", "every robot", "policy rule: fleet deny", "lift; decided by H_F")


def test_the_answer_of_the_registry_is_in_the_line_of_the_question() -> None:
    asked = event(
        "RegistryQueried",
        S,
        requested_by=A,
        capability="lift",
        candidates=[B],
        rejected=["robot/C1"],
        rejected_by=["trust"],
    )
    assert line(asked) == (A, "service/registry", "query: lift", f"candidates: {B}; left out: robot/C1 by trust")


def test_a_claim_reads_as_a_claim_and_a_revocation_as_one() -> None:
    claim = {"action_id": "t1/1.1", "dimension": "execution", "claimant": B}
    found = line(event("AuthorityClaimed", S, **claim, reason="acceptance"))
    assert found == (*(B, B), *("claims authority: execution", "acceptance"))
    assert line(event("AuthorityClaimed", S, **claim, reason="revocation")) == (B, B, "revokes", None)


def test_the_words_are_those_of_the_timeline_of_a_request() -> None:
    denied = event(
        "RequestDenied", S, action_id="t1/1.1", decided_by=B, requested_by=A, executed_by=B, path=[B], reason="policy"
    )
    columns = ("seq", "time_s", "sender", "receiver", "message", "note", "action_id")
    with from_rows(run(denied)) as database:
        [told] = [
            tuple(row[column] for column in columns)
            for row in database.query("audit/request_timeline", {"run": "r1"}).to_pylist()
        ]
    assert told == answer("facts/log_lines", run(denied), columns=columns)[1]


def test_a_line_has_the_concern_of_its_event_and_the_start_of_a_run_none() -> None:
    rows = run(event("RobotWentOff", S, robot=A))
    found = answer("facts/log_lines", rows, columns=("type", "concern"))
    assert found == [("RunStarted.v2", None), ("RobotWentOff.v1", "world")]
    assert "world" in CONCERNS


def test_a_pause_has_no_reason_that_its_event_does_not_say() -> None:
    assert line(act("ExecutionPaused", S, "t1/1.1", robot=A)) == (A, A, "pauses", None)


def test_who_called_a_supervisor_is_not_made_up_in_a_record_of_another_system() -> None:
    fleet, of_a = "supervisor/fleet", {"requested_by": A, "purpose": "recovery"}
    asked = act("RequestIssued", 3 * S, "t1/1.1", requested_by=A, decided_by=A, capability="lift")
    called = act("SupervisorCalled", 4 * S, "t1/1.1", supervisor=fleet, purpose="recovery")
    answered = act("SupervisorResponded", 5 * S, "t1/1.1", decided_by=fleet, approves=True, **of_a)

    def told(*events: Row, kind: str = "foreign") -> list[tuple[Any, ...]]:
        rows = run(*events, kind=kind, observes=[], records=["SupervisorCalled", "SupervisorResponded"])
        return answer("facts/log_lines", rows, columns=("sender", "receiver"))[1:]

    assert told(asked, called, answered, kind="live")[1:] == [(A, fleet), (fleet, A)]
    assert told(asked, called, answered)[1:] == [(None, fleet), (fleet, fleet)]
    assert told(called, {**answered, "executed_by": B}) == [(None, fleet), (fleet, B)]
    assert told(answered) == [(fleet, fleet)]
