"""The paper's three workflows: each fact that it states follows from the scripted world, whatever the seed.

Paper: sec:prototype:workflows.
"""

from typing import TypeVar

import pytest

from fsar_ledger.base.errors import InvalidExperiment
from fsar_ledger.designs.constants import Constants, Outages
from fsar_ledger.designs.registered import PAPER_WORKFLOWS as WORKFLOWS
from fsar_ledger.events import Event
from fsar_ledger.events.envelope import Subject, Workflow
from fsar_ledger.events.execution import ExecutionFailed, ExecutionFinished, ExecutionStarted
from fsar_ledger.events.recovery import (
    AttemptRolledBack,
    FailureResolved,
    ReassignmentDecided,
    RecoveryAttempted,
    RecoveryAttemptFailed,
    RecoveryEscalated,
)
from fsar_ledger.events.registry import RegistryQueried
from fsar_ledger.events.request import (
    GapDetected,
    RequestAccepted,
    RequestAdmitted,
    RequestClosed,
    RequestDeferred,
    RequestDenied,
    RequestIssued,
)
from fsar_ledger.events.supervision import SupervisorCalled, SupervisorResponded
from fsar_ledger.events.task import TaskCompleted
from fsar_ledger.events.world import ActuatorDegraded, TaskArrived
from fsar_ledger.projections.fold import State, apply, fold
from fsar_ledger.projections.trust import scope_of
from fsar_ledger.runtime.architectures.fsar.request import EvaluateRequest
from fsar_ledger.runtime.experiment import Experiment, workflow_experiment
from fsar_ledger.runtime.handlers.commands import Respond
from fsar_ledger.runtime.simulation import RunSpec, handler_table_of, simulate_run
from fsar_ledger.runtime.world.schedule import schedule
from tests import past
from tests.runtime.histories import A, B, D, given, happen, types, window
from tests.runtime.live import decided
from tests.runtime.test_resume import assert_resumes
from tests.sure import only

SEEDS = (1, 2, 3, 42, 2026)
E = TypeVar("E", bound=Event)


def played(workflow: Workflow, seed: int, run: int = 0) -> tuple[Event, ...]:
    """The events of one run of the workflow."""
    return tuple(simulate_run(RunSpec(seed, "fsar", "full", workflow, 4, run), Constants()).events)


def every(events: tuple[Event, ...], kind: type[E]) -> list[E]:
    """The events of this type, in order."""
    return [event for event in events if isinstance(event, kind)]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_door_is_opened_for_a_by_b_under_its_own_runtime(seed: int) -> None:
    events = played("workflow-door-relay", seed)
    [gap], [answer] = every(events, GapDetected), every(events, RegistryQueried)
    [issued], [admitted] = every(events, RequestIssued), every(events, RequestAdmitted)
    assert (gap.principals.requested_by, gap.capability) == (A, "door.open.secure")
    assert "door.open.secure" not in fold(events).registry.modules[A]
    assert (answer.candidates, answer.relay) == ((B,), None)
    assert (issued.principals.requested_by, issued.principals.executed_by, issued.carried_policy) == (A, B, "allow")
    assert (admitted.principals.decided_by, admitted.outcome) == (B, "allow")
    started = next(
        event for event in every(events, ExecutionStarted) if event.subject.action_id == gap.subject.action_id
    )
    assert (started.robot, started.principals.executed_by, started.on_behalf_of) == (B, B, A)
    assert [event.principals.decided_by for event in every(events, RequestAccepted)] == [B]
    [closed] = every(events, RequestClosed)
    assert (closed.subject.action_id, closed.result) == (gap.subject.action_id, "success")
    assert every(events, TaskCompleted)
    assert not every(events, RequestDenied) + every(events, SupervisorCalled)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_door_relay_rests_on_a_task_scope(seed: int) -> None:
    state = fold(played("workflow-door-relay", seed))
    assert scope_of(state.trust, B, A, "door.open.secure", "A1-1") == "task"


@pytest.mark.parametrize("seed", SEEDS)
def test_the_admission_names_its_trust_and_the_authority_that_it_gives(seed: int) -> None:
    [admitted] = every(played("workflow-door-relay", seed), RequestAdmitted)
    assert admitted.trust == "task"
    assert (admitted.may_request, admitted.may_execute) == (True, True)
    assert (admitted.override, admitted.is_audited) == ("none", True)


@pytest.mark.parametrize("seed", SEEDS)
def test_recovery_of_the_slipping_grip_goes_through_all_four_levels(seed: int) -> None:
    events = played("workflow-layered-recovery", seed)
    [failure] = every(events, ExecutionFailed)
    assert (failure.robot, failure.cause) == (D, "degradation")
    budget = Constants().structure
    assert [(event.number, event.deadline_us) for event in every(events, RecoveryAttempted)] == [
        (1, (failure.detected_us or 0) + budget.local_budget_us),
        (2, (failure.detected_us or 0) + budget.local_budget_us),
    ]
    assert (budget.local_budget_us, budget.local_attempts) == (30_000_000, 2)
    found = [(event.result, event.achieved) for event in every(events, RecoveryAttemptFailed)]
    assert found == [("partial", ("load.gripped",)), ("failure", ())]
    order = [one for one in events if isinstance(one, RecoveryAttempted | RecoveryAttemptFailed | AttemptRolledBack)]
    assert [type(one).__name__ for one in order[:4]] == [
        "RecoveryAttempted",
        "RecoveryAttemptFailed",
        "AttemptRolledBack",
        "RecoveryAttempted",
    ], "what the grip achieved is undone before it is tried again"
    assert order[2].undone == ("load.gripped",)  # type: ignore[union-attr]
    assert [(event.level, event.to_level, event.reason) for event in every(events, RecoveryEscalated)] == [
        ("local", "peer", "budget exhausted"),
        ("peer", "fleet", "no capable peer"),
        ("fleet", "human", "no feasible reassignment: no capable robot"),
    ]
    [query] = every(events, RegistryQueried)
    assert (query.principals.requested_by, query.capability, query.candidates) == (D, "grasp.*", ())
    [reassignment] = every(events, ReassignmentDecided)
    assert (reassignment.helper, reassignment.reason) == (None, "no capable robot")
    [call], [answer], [resolved] = (
        every(events, SupervisorCalled),
        every(events, SupervisorResponded),
        every(events, FailureResolved),
    )
    assert (call.supervisor, answer.principals.decided_by) == ("supervisor/fleet", "supervisor/fleet")
    assert resolved.level == "human"
    assert every(events, TaskCompleted)
    assert not every(events, RequestIssued)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_grip_slips_during_a_heavy_transport_and_nothing_else_is_wrong(seed: int) -> None:
    events = played("workflow-layered-recovery", seed)
    [worn] = every(events, ActuatorDegraded)
    assert (worn.robot, worn.grade) == (D, "slipping")
    first = next(position for position, event in enumerate(events) if isinstance(event, ExecutionFinished))
    assert events.index(worn) < first  # while D is on its way to the load
    [task] = every(events, TaskArrived)
    assert (task.robot, "D carry.heavy" in task.steps) == (A, True)


@pytest.mark.parametrize("seed", [*SEEDS, *range(100, 140)])
def test_b_and_d_ask_at_once_and_the_time_critical_delivery_goes_first(seed: int) -> None:
    events = played("workflow-human-supervision", seed)
    issued = {event.principals.requested_by: event for event in every(events, RequestIssued)}
    assert {asker: event.principals.executed_by for asker, event in issued.items()} == {B: A, D: A}
    [critical] = [task for task in every(events, TaskArrived) if task.is_time_critical]
    assert critical.robot == B
    [call], [answer] = every(events, SupervisorCalled), every(events, SupervisorResponded)
    assert {call.subject.action_id, call.competing} == {event.subject.action_id for event in issued.values()}
    assert (call.supervisor, call.purpose) == ("supervisor/fleet", "ordering")
    assert answer.principals.decided_by == "supervisor/fleet"
    assert answer.preferred == issued[B].subject.action_id
    admitted = every(events, RequestAdmitted)
    assert [event.principals.requested_by for event in admitted] == [B, D]
    assert all(events.index(event) > events.index(answer) for event in admitted)
    found = {event.subject.action_id for event in every(events, RequestDeferred)}
    assert found == {call.competing, issued[D].subject.action_id}
    assert [event.principals.requested_by for event in every(events, ExecutionStarted) if event.robot == A] == [B, D]
    assert {task.task_id for task in every(events, TaskCompleted)} == {"B1-1", "D1-2"}


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_nothing_happens_in_a_workflow_that_its_script_does_not_say(workflow: Workflow) -> None:
    facts = [event for _, event in schedule(Constants(), 7, workflow, 0, 4)]
    assert {type(fact) for fact in facts} <= {TaskArrived, ActuatorDegraded}


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_a_workflow_resumes_anywhere(workflow: Workflow) -> None:
    for run in range(2):
        assert_resumes(RunSpec(5, "fsar", "full", workflow, 4, run), 10_000)


@pytest.mark.parametrize("workflow", WORKFLOWS)
def test_another_run_of_a_workflow_takes_other_times_and_the_same_course(workflow: Workflow) -> None:
    one, other = (played(workflow, 9, run) for run in (0, 1))
    assert one != other
    if workflow != "workflow-human-supervision":  # there the first to be evaluated may be either
        assert types(one) == types(other)


# Requests that compete for one robot


STEP = ("B carry.package A",)


def competing(is_critical: tuple[bool, bool] = (True, False), *before: Event) -> State:
    """B and D have both asked A for carry.package, and neither request has been evaluated."""
    tasks = (("B1-1", B, is_critical[0]), ("D1-2", D, is_critical[1]))
    arrived = [past.arrived(task, robot, STEP, is_time_critical=critical) for task, robot, critical in tasks]
    began = [past.began(Subject(task, f"{task}/1.1"), robot, 1, "carry.package", "A") for task, robot, _ in tasks]
    shown = [
        past.queried(Subject(task, f"{task}/1.1"), past.parties(robot, A), "carry.package", A)
        for task, robot, _ in tasks
    ]
    return given("fsar", *before, *arrived, *began, *shown)


def evaluated(state: State, action_id: str) -> tuple[Event, ...]:
    """What the executor decides about the request, which the state has taken in."""
    events = decided(state, EvaluateRequest(action_id))
    happen(state, *events)
    return events


def answered(state: State, action_id: str) -> list[str]:
    """The requests that are evaluated again after H_F's answer, in this order."""
    [number] = [
        number
        for number, call in state.supervision.calls.items()
        if (call.subject.action_id, call.purpose) == (action_id, "ordering")
    ]
    [answer] = decided(state, Respond(number))
    apply(state, answer)
    again = [one for react in handler_table_of("fsar").reacts[SupervisorResponded] for one in react(state, answer, 0)]
    return [
        one.command.action_id
        for one in sorted(again, key=lambda one: one.after_us)
        if isinstance(one.command, EvaluateRequest)
    ]


@pytest.mark.parametrize("first", ["B1-1/1.1", "D1-2/1.1"])
def test_the_first_request_calls_and_the_other_joins(first: str) -> None:
    state = competing()
    [other] = {"B1-1/1.1", "D1-2/1.1"} - {first}
    call = only(SupervisorCalled, evaluated(state, first))
    assert (call.supervisor, call.purpose, call.competing) == ("supervisor/fleet", "ordering", other)
    assert types(evaluated(state, other)) == ["RequestDeferred"]
    assert answered(state, first) == ["B1-1/1.1", "D1-2/1.1"]
    assert types(evaluated(state, "B1-1/1.1")) == ["RequestAdmitted", "ExecutionQueued"]
    assert types(evaluated(state, "D1-2/1.1")) == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"]


@pytest.mark.parametrize("first", ["B1-1/1.1", "D1-2/1.1"])
def test_of_two_time_critical_requests_the_first_to_come_goes_first(first: str) -> None:
    state = competing((True, True))
    [other] = {"B1-1/1.1", "D1-2/1.1"} - {first}
    evaluated(state, first)
    evaluated(state, other)
    assert answered(state, first) == [first, other]


def test_without_a_time_critical_task_requests_go_in_order_of_arrival() -> None:
    state = competing((False, False))
    assert types(evaluated(state, "D1-2/1.1")) == ["RequestAdmitted", "ExecutionQueued"]
    assert types(evaluated(state, "B1-1/1.1")) == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"]


def test_a_request_that_has_not_come_holds_nobody_up() -> None:
    state = competing()
    evaluated(state, "D1-2/1.1")
    assert answered(state, "D1-2/1.1") == ["D1-2/1.1"]
    assert types(evaluated(state, "D1-2/1.1")) == ["RequestAdmitted", "ExecutionQueued"]
    assert types(evaluated(state, "B1-1/1.1")) == ["RequestAdmitted", "RequestDeferred", "ExecutionQueued"]


def test_a_denied_request_competes_no_more() -> None:
    state = competing()
    apply(state, past.denied("B1-1/1.1", past.principals(A, B, A), "policy", "B1-1"))
    assert types(evaluated(state, "D1-2/1.1")) == ["RequestAdmitted", "ExecutionQueued"]


def test_an_order_does_not_lift_a_denial_that_came_meanwhile() -> None:
    state = competing()
    evaluated(state, "B1-1/1.1")
    evaluated(state, "D1-2/1.1")
    apply(state, window(A))
    found = [types(evaluated(state, name)) for name in answered(state, "B1-1/1.1")]
    assert found == [["RequestDenied"], ["RequestDenied"]]


def test_both_askers_are_trusted() -> None:
    trust = competing().trust
    assert (scope_of(trust, A, B, "carry.package"), scope_of(trust, A, D, "carry.package")) == ("task", "capability")


# Which experiments there are


def test_the_workflows_are_one_run_each_unless_more_are_asked_for() -> None:
    assert [
        (spec.scenario, spec.run, spec.architecture, spec.fleet_size) for spec in workflow_experiment().specs()
    ] == [(name, 0, "fsar", 4) for name in WORKFLOWS]
    assert len(list(workflow_experiment(seed=7, runs=3, workflows=WORKFLOWS[:1]).specs())) == 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"scenarios": (*WORKFLOWS, "door-relay")}, "beside scenarios"),
        ({"architectures": ("cfc",)}, r"found cfc \(full\), expected fsar \(full\)"),
        ({"configurations": ("without-trust-evaluation",)}, r"found fsar \(without-trust-evaluation\)"),
        ({"fleet_size": 8}, "fleet size 8, expected 4"),
        ({"constants": Constants(outages=Outages(0.1))}, "found outages, expected none"),
    ],
)
def test_a_workflow_is_played_as_the_paper_has_it(changes: dict[str, object], message: str) -> None:
    asked: dict[str, object] = {"architectures": ("fsar",), "scenarios": WORKFLOWS, "runs": 1, **changes}
    with pytest.raises(InvalidExperiment, match=message):
        Experiment(**asked)  # type: ignore[arg-type]
