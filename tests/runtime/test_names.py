"""Names and values from outside that the state could not tell from its own are refused; nothing changes."""

from typing import Any

import msgspec
import pytest

from fsar_ledger.events.command import CommandRejected
from fsar_ledger.events.envelope import Subject
from fsar_ledger.events.world import TaskArrived
from fsar_ledger.projections.fold import State, apply
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.handlers.commands import Command, TakeTurn
from fsar_ledger.runtime.handlers.request import ReportResult, RequestCapability
from fsar_ledger.runtime.handlers.task import SubmitTask
from tests import past
from tests.runtime.histories import DOOR, A, B, given, types
from tests.runtime.live import decided, play
from tests.sure import only

ASK = RequestCapability(A, B, DOOR, "visit", "q1")
TASK = SubmitTask(A, "T9", ("A carry.package", "A door.open.secure B"), 60_000_000)


def after(*commands: Command) -> State:
    """The state after these commands."""
    state = given("fsar")
    for command in commands:
        play(state, command)
    return state


def refusal(state: State, command: Command) -> str:
    rejected = only(CommandRejected, decided(state, command))
    return rejected.reason


def test_a_result_that_is_none_is_rejected() -> None:
    state = after(ASK, EvaluateRequest("q1"), TakeTurn("q1"))
    apply(state, past.started(Subject("visit", "q1"), B, A, DOOR, 9_000_000))
    wrong: Any = "weird"
    found = refusal(state, ReportResult(B, "q1", wrong))
    assert found == "unknown result weird, expected one of success, partial, failure"


def test_a_task_does_not_take_the_name_of_a_request() -> None:
    state = after(msgspec.structs.replace(ASK, action_id="T9/1.1"))
    assert "is taken" in refusal(state, TASK)
    assert types(decided(state, msgspec.structs.replace(TASK, task_id="T"))) == ["TaskArrived"]


def test_a_request_does_not_take_the_name_of_help() -> None:
    assert "without a colon" in refusal(given("fsar"), msgspec.structs.replace(ASK, action_id="assist:T1/1.1"))
    assert "without a slash or a colon" in refusal(given("fsar"), msgspec.structs.replace(TASK, task_id="assist:T1"))


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"steps": ("A carry.package ",)}, "step 'A carry.package '"),
        ({"checkpoints": ("99", "x")}, "checkpoint '99', expected the numbers of steps, 1 to 2"),
        ({"checkpoints": ("1", "x")}, "checkpoint 'x'"),
        ({"checkpoints": ("0",)}, "checkpoint '0'"),
    ],
)
def test_a_task_whose_steps_or_checkpoints_are_none_is_rejected(changes: dict[str, Any], found: str) -> None:
    assert refusal(given("fsar"), SubmitTask(**{**msgspec.structs.asdict(TASK), **changes})).startswith(found)


@pytest.mark.parametrize("checkpoints", [None, (), ("1", "2")])
def test_a_task_with_the_numbers_of_its_steps_as_checkpoints_arrives(checkpoints: tuple[str, ...] | None) -> None:
    arrived = only(TaskArrived, decided(given("fsar"), msgspec.structs.replace(TASK, checkpoints=checkpoints)))
    assert arrived.checkpoints == checkpoints
