"""The paper's four cases: what each claim counts, of how many, and what does not count."""

from collections.abc import Sequence
from typing import Any

from tests.queries.histories import Row, act, answer, event, run

TRUST, RECOVERY, CONTENTION, DELIVERY = (
    "mixed-trust-inspection",
    "failure-recovery-chain",
    "fleet-contention",
    "collaborative-delivery",
)
SCENARIOS = {1: TRUST, 2: RECOVERY, 3: CONTENTION, 4: DELIVERY}


def counted(number: int, **histories: Sequence[Row]) -> dict[str, dict[str, int]]:
    """What each history adds to the numerator of each claim of the case; one that is no case of a claim does not have
    it."""
    runs = [run(*events, run_id=name, scenario=SCENARIOS[number]) for name, events in histories.items()]
    found: dict[str, dict[str, int]] = {name: {} for name in histories}
    for name, claim, count in answer(f"cases/case_{number}_evidence", *runs, columns=("run_id", "claim", "counted")):
        assert claim not in found[name], "counted twice"
        found[name][claim] = count
    return found


def of(claim: str, found: dict[str, dict[str, int]]) -> dict[str, int | None]:
    """The claim of each history; None where it is no case of it."""
    return {name: claims.get(claim) for name, claims in found.items()}


def added(claim: str, found: dict[str, dict[str, int]]) -> dict[str, int | None]:
    """The claim of each history that adds to it; all are cases of it."""
    counts = of(claim, found)
    assert None not in counts.values()
    return {name: count for name, count in counts.items() if count}


# --- case 1 ---

INJECTED = event(
    "OutsiderRequestInjected", 1, task_id="x1", robot="robot/D1", peer="robot/C1", capability="inspect.private_zone"
)
ISSUED = act("RequestIssued", 3, "x1", requested_by="robot/D1")
DENIED = event("RequestDenied", 4, task_id="x1", reason="advertisement")


def queried(*candidates: str) -> Row:
    return act(
        "RegistryQueried",
        2,
        "x1",
        requested_by="robot/D1",
        capability="inspect.private_zone",
        candidates=list(candidates),
    )


def test_a_request_without_trust_discovers_whom_it_is_told_or_asks_and_is_executed_when_that_begins() -> None:
    found = counted(
        1,
        hidden=[INJECTED, queried(), DENIED],
        shown=[INJECTED, queried("robot/C1"), DENIED],
        asked=[INJECTED, ISSUED],
        begun=[INJECTED, ISSUED, act("ExecutionStarted", 5, "x1")],
    )
    assert of("discovered", found) == {"hidden": 0, "shown": 1, "asked": 1, "begun": 1}
    assert of("attempted", found) == {"hidden": 0, "shown": 0, "asked": 1, "begun": 1}
    assert added("executed", found) == {"begun": 1}


def test_a_request_of_which_nothing_more_is_recorded_is_no_case() -> None:
    found = counted(1, alone=[INJECTED], others=[INJECTED, act("ExecutionStarted", 5, "t1/1")])
    assert found == {"alone": {}, "others": {}}


# --- case 2 ---

JOINED = [
    event("RobotJoined", robot=f"robot/{role}1", role=role, team=1, supervisor=f"supervisor/{role}1") for role in "ABCD"
]
RECOVERING, PLANNING = "agent/D1/recovery", "agent/D1/planning"


def failed(time_us: int = 1, failure: int = 1, cause: str = "obstruction", robot: str = "robot/D1") -> Row:
    return act("ExecutionFailed", time_us, "t1/1", failure=failure, robot=robot, cause=cause)


def attempted(by: str, failure: int = 1) -> Row:
    return event(
        "RecoveryAttempted",
        2,
        failed_action="t1/1",
        failure=failure,
        robot="robot/D1",
        decided_by=by,
        number=1,
        level="local",
        deadline_us=9,
    )


def resolved(level: str = "local", failure: int = 1) -> Row:
    return event("FailureResolved", 9, action_id="t1/1", failure=failure, level=level, robot="robot/D1")


def escalated(by: str, failure: int = 1) -> Row:
    return event(
        "RecoveryEscalated",
        7,
        failed_action="t1/1",
        failure=failure,
        robot="robot/D1",
        decided_by=by,
        level="local",
        to_level="human",
    )


def disputed(*claimants: str, began_us: int = 3, ended_us: int = 8) -> list[Row]:
    about = {"task_id": "t1", "action_id": "t1/1", "dimension": "override", "reason": "dispute"}
    released = [event("AuthorityReleased", ended_us, claimant=claimant, **about) for claimant in claimants]
    return [*[event("AuthorityClaimed", began_us, claimant=claimant, **about) for claimant in claimants], *released]


def test_a_run_is_contained_locally_if_the_robot_itself_resolves_every_failure() -> None:
    found = counted(
        2,
        itself=[failed(), attempted("robot/D1"), resolved()],
        human=[failed(), attempted("robot/D1"), resolved("human")],
        one_of_two=[
            failed(),
            attempted("robot/D1"),
            resolved(),
            failed(10, 2),
            attempted("robot/D1", 2),
            resolved("peer", 2),
        ],
        never=[failed(), attempted("robot/D1")],
        ordered=[failed(), attempted("coordinator"), resolved()],
        no_failure=[],
    )
    expected = {"itself": 1, "human": 0, "one_of_two": 0, "never": 0, "ordered": 0, "no_failure": None}
    assert of("contained locally", found) == expected


def test_a_failure_is_escalated_at_once_if_the_coordinator_does_what_is_done_first() -> None:
    found = counted(
        2,
        at_once=[failed(), attempted("coordinator"), resolved()],
        robot_first=[failed(), attempted("robot/D1"), attempted("coordinator")],
        supervisor=[failed(), escalated("supervisor/D1")],
        nothing_done=[failed()],
        one_of_two=[failed(), attempted("coordinator"), failed(5, 2), attempted("robot/D1", 2)],
    )
    assert added("escalated at once", found) == {"at_once": 1}


def test_a_loop_is_a_dispute_of_two_agents_about_a_failure_that_is_escalated_then() -> None:
    begun, end = [failed(), attempted(RECOVERING)], escalated(RECOVERING)
    found = counted(
        2,
        loop=[*begun, *disputed(RECOVERING, PLANNING), end],
        settled=[*begun, *disputed(RECOVERING, PLANNING), resolved()],
        one_agent=[*begun, *disputed(RECOVERING), end],
        not_about_recovery=[*begun, *disputed(PLANNING, "agent/D1/execution"), end],
        one_after_the_other=[
            *begun,
            *disputed(RECOVERING, ended_us=4),
            *disputed(PLANNING, began_us=4, ended_us=5),
            end,
        ],
        before_it_failed=[*disputed(RECOVERING, PLANNING, began_us=0), *begun, end],
        after_the_escalation=[*begun, end, *disputed(RECOVERING, PLANNING)],
        no_agents=[failed(), attempted("robot/D1"), *disputed("robot/D1", "robot/A1"), escalated("robot/D1")],
    )
    assert added("recovery loop", found) == {"loop": 1}


def test_only_a_worn_actuator_of_d_is_degradation() -> None:
    found = counted(
        2,
        worn=[
            *JOINED,
            failed(cause="degradation"),
            attempted("robot/D1"),
            resolved(),
            failed(10, 2),
            attempted("robot/D1", 2),
        ],
        of_a=[*JOINED, failed(cause="degradation", robot="robot/A1"), attempted("robot/A1"), resolved()],
    )
    assert of("contained locally (degradation)", found) == {"worn": 1, "of_a": None}
    assert of("contained locally", found) == {"worn": 0, "of_a": 1}


# --- case 3 ---


def begun(task: str, time_us: int, capability: str = "door.open.secure") -> Row:
    return act(
        "StepBegan", time_us, f"{task}/1", robot="robot/A1", step=1, attempt=1, capability=capability, target_role="B"
    )


def over(task: str, *claimants: str, dimension: str = "execution") -> list[Row]:
    return [
        act("AuthorityClaimed", 5, f"{task}/1", dimension=dimension, claimant=claimant, reason="command")
        for claimant in claimants
    ]


def called(task: str, supervisor: str = "supervisor/fleet", purpose: str = "ordering") -> Row:
    return act("SupervisorCalled", 6, f"{task}/1", supervisor=supervisor, purpose=purpose)


BOTH = [begun("t1", 1), begun("t2", 2)]


def test_two_tasks_contend_while_the_steps_of_both_are_open() -> None:
    found = counted(
        3,
        both=BOTH,
        one_after_the_other=[begun("t1", 1), event("TaskCompleted", 2, task_id="t1"), begun("t2", 3)],
        the_first_has_turned_on=[begun("t1", 1), begun("t1", 2, "carry.heavy"), begun("t2", 3)],
        other_capabilities=[begun("t1", 1), begun("t2", 2, "carry.heavy")],
        one_task_twice=[begun("t1", 1), begun("t1", 2)],
    )
    assert {name for name, count in of("conflicts", found).items() if count is not None} == {"both"}
    assert of("conflicts", found)["both"] == 0


def test_conflicts_over_the_contended_capability_count_and_those_over_execution_apart() -> None:
    found = counted(
        3,
        execution=[*BOTH, *over("t1", "coordinator", "robot/C1")],
        two=[*BOTH, *over("t1", "coordinator", "robot/C1"), *over("t2", "x", "y", dimension="override")],
        each_its_own=[*BOTH, *over("t1", "coordinator"), *over("t2", "robot/C1")],
        another_capability=[*BOTH, begun("t3", 3, "carry.heavy"), *over("t3", "x", "y")],
    )
    assert added("conflicts", found) == {"execution": 1, "two": 2}
    assert added("conflicts over execution", found) == {"execution": 1, "two": 1}


def test_a_conflict_is_for_h_f_if_it_is_called_after_it_to_order_the_two() -> None:
    conflict = [*BOTH, *over("t1", "coordinator", "robot/C1")]
    found = counted(
        3,
        called=[*conflict, called("t2")],
        not_called=conflict,
        called_before=[*BOTH, called("t2"), *over("t1", "coordinator", "robot/C1")],
        no_conflict=[*BOTH, called("t2")],
        not_about_who_executes=[*BOTH, *over("t1", "x", "y", dimension="override"), called("t2")],
        to_recover=[*conflict, called("t2", purpose="recovery")],
        of_b=[*conflict, called("t2", "supervisor/B1")],
        about_something_else=[*conflict, called("t9")],
    )
    assert added("conflict for H_F", found) == {"called": 1}


# --- case 4 ---

KNOWN = {"requested_by": "robot/A1", "executed_by": "robot/D1", "supervised_by": "supervisor/D1"}
ENDED = act("ExecutionFinished", 8, "t1/1", robot="robot/D1", result="success", **KNOWN)
STEP = act("StepBegan", 1, "t1/1", robot="robot/A1", step=1, attempt=1, capability="carry.heavy", target_role="D")
ORPHAN = event("CandidateMatched", 2, task_id="t1", decided_by="coordinator", supervised_by="supervisor/fleet")
"""It has no origin, no executor and no action; what comes before it in the history caused it."""


def handed_over(**histories: Sequence[Row]) -> dict[str, dict[str, int]]:
    """What handoffs from A to D count in which this happens."""
    return counted(4, **{name: [*JOINED, STEP, *events, ENDED] for name, events in histories.items()})


def internal(sender: str, receiver: str, **fields: Any) -> Row:
    robot = f"robot/{sender.split('/')[1]}"
    return event("InternalHandoff", 3, executed_by=robot, sender=sender, receiver=receiver, **fields)


def test_the_events_of_a_handoff_are_counted_and_those_that_lack_a_principal() -> None:
    replanned = event("ReplanOrdered", 3, task_id="t1", decided_by="coordinator")
    found = handed_over(
        result=[],
        complete=[act("RequestAccepted", 2, "t1/1", **KNOWN)],
        tied_by_its_cause=[ORPHAN, ORPHAN],
        tied_to_nothing=[{**ORPHAN, "caused_by": 0}],
        disturbed=[attempted("coordinator"), replanned],
    )
    assert of("events", found) == dict.fromkeys(found, 1) | {"complete": 2, "tied_by_its_cause": 3}
    assert added("unattributed events", found) == {"tied_by_its_cause": 2}


def test_messages_between_agents_of_the_executor_count_beside_the_chain() -> None:
    way_in = [internal("agent/D1/communication", PLANNING), internal(PLANNING, "agent/D1/execution")]
    named = {"requested_by": "robot/A1", "supervised_by": "supervisor/D1"}
    found = handed_over(
        there_and_back=[*way_in, internal("agent/D1/execution", PLANNING)],
        of_the_requester=[internal("agent/A1/planning", "agent/A1/communication")],
        of_nothing=[internal(PLANNING, "agent/D1/execution", caused_by=0)],
        attributed=[internal(PLANNING, "agent/D1/execution", **named)],
    )
    assert added("internal events", found) == {"there_and_back": 3}
    assert added("internal events (inward)", found) == {"there_and_back": 2}
    assert of("events", found) == dict.fromkeys(found, 1)


def test_only_what_a_asks_and_d_has_ended_is_a_handoff() -> None:
    found = counted(
        4,
        of_d=[*JOINED, {**STEP, "robot": "robot/D1"}, ENDED],
        unfinished=[*JOINED, STEP, act("ExecutionStarted", 8, "t1/1", robot="robot/D1", **KNOWN)],
        to_b=[*JOINED, STEP, {**ENDED, "robot": "robot/B1"}],
    )
    assert found == {"of_d": {}, "unfinished": {}, "to_b": {}}
