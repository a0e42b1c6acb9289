"""One case for each reading of the paper: its rows, the mean of ours and the mean under the reading."""

from typing import NamedTuple

from tests.queries.histories import Row, S, event

WHOLE = {"requested_by": "robot/A1", "executed_by": "robot/B1", "supervised_by": "supervisor/B1"}
DENIED = event(
    "RequestDenied",
    task_id="t1",
    action_id="a1",
    decided_by="coordinator",
    path=["coordinator"],
    reason="policy",
    executed_by="robot/B1",
)


def decided(by: str, *path: str, name: str = "RequestIssued", **fields: str) -> Row:
    return event(name, decided_by=by, path=list(path or (by,)), **fields)


def task(name: str, completed_us: int | None) -> list[Row]:
    done = [] if completed_us is None else [event("TaskCompleted", completed_us, task_id=name)]
    return [event("TaskArrived", 0, task_id=name, budget_us=10), *done]


def failed(
    time_us: int,
    level: str,
    *,
    after_us: int,
    left_after_us: int | None = None,
    ordered_by: str | None = None,
    action: str = "a1",
) -> list[Row]:
    """A failure, a retry half a second later if somebody orders one, and its resolution at this level."""
    about = {"failed_action": action, "failure": 1, "robot": "robot/D1"}
    found = [event("ExecutionFailed", time_us, action_id=action, failure=1, robot="robot/D1", cause="obstruction")]
    if ordered_by:
        found.append(event("RecoveryAttempted", time_us + S // 2, decided_by=ordered_by, level="local", **about))
    if left_after_us is not None:
        found.append(event("RecoveryEscalated", time_us + left_after_us, level="local", to_level=level, **about))
    return [*found, event("FailureResolved", time_us + after_us, action_id=action, failure=1, level=level)]


def claimed(time_s: int, claimant: str, until_s: int, dimension: str = "override", reason: str = "why") -> list[Row]:
    fields = {"action_id": "a1", "dimension": dimension, "claimant": claimant, "reason": f"{reason} {time_s}"}
    return [event("AuthorityClaimed", time_s * S, **fields), event("AuthorityReleased", until_s * S, **fields)]


def window(outcome: str) -> Row:
    return event("PolicyWindowOpened", robot="robot/B1", scope="local", window=outcome, outcome=outcome)


def started(action: str = "a1") -> Row:
    return event("ExecutionStarted", action_id=action, robot="robot/B1", on_behalf_of="robot/B1", **WHOLE)


MOTION = event(
    "RoutinePerformed", robot="robot/B1", operation="motion", decided_by="robot/B1", path=["robot/B1"], **WHOLE
)
HALF = decided("agent/A1/planning", "agent/A1/planning", "agent/A1/execution")
"""A decision that is never local: with one that is, locality is a half."""

Runs = list[list[Row]]


class Case(NamedTuple):
    """The mean of a metric of these runs as we read them, and under the reading."""

    metric: str
    ours: float
    read: float
    runs: Runs


CASES: dict[str, Case] = {
    "late_tasks_succeed": Case(
        "coordination_success", 1 / 3, 2 / 3, [[*task("t1", 5), *task("t2", 11), *task("t3", None)]]
    ),
    "whole_runs_succeed": Case(
        "coordination_success", 3 / 4, 1 / 2, [[*task("t1", 5), *task("t2", None)], task("t1", 5), []]
    ),
    "tasks_are_pooled": Case(
        "coordination_success", 1 / 2, 3 / 4, [[*task("t1", 5), *task("t2", 6), *task("t3", 7)], task("t1", None)]
    ),
    "routine_decides_nothing": Case("governance_locality", 2 / 3, 1 / 2, [[MOTION, decided("robot/A1"), HALF]]),
    "only_listed_decisions": Case(
        "governance_locality",
        3 / 4,
        1 / 2,
        [[MOTION, decided("robot/A1", name="OwnStepDecided"), decided("robot/A1"), HALF]],
    ),
    "denials_decide_each_time": Case(
        "governance_locality", 1 / 2, 1 / 4, [[decided("robot/A1"), DENIED, DENIED, DENIED]]
    ),
    "only_agents_are_traversed": Case(
        "governance_locality",
        0.0,
        1 / 4,
        [
            [
                decided("robot/A1", "robot/A1", "robot/B1"),
                decided("robot/A1", "agent/A1/planning", "robot/A1"),
                decided("coordinator"),
                HALF,
            ]
        ],
    ),
    "closings_are_the_requesters": Case(
        "governance_locality",
        0.0,
        1 / 4,
        [
            [
                decided("service/coordination", name="RequestClosed"),
                decided("coordinator", name="RequestClosed"),
                decided("service/registry"),
                HALF,
            ]
        ],
    ),
    "closings_decide_nothing": Case(
        "governance_locality",
        1 / 3,
        1 / 2,
        [[decided("service/coordination", name="RequestClosed"), decided("robot/A1"), HALF]],
    ),
    "ordered_retry_is_fleet": Case(
        "recovery_containment",
        1.0,
        2 / 3,
        [
            [
                row
                for by, name in (("coordinator", "a1"), ("robot/D1", "a2"), ("agent/D1/recovery", "a3"))
                for row in failed(0, "local", after_us=S, ordered_by=by, action=name)
            ]
        ],
    ),
    "failures_by_run": Case(
        "recovery_containment",
        2 / 3,
        3 / 4,
        [
            [*failed(0, "local", after_us=S), *failed(0, "human", after_us=S, action="a2")],
            failed(0, "local", after_us=S),
            [],
        ],
    ),
    "published_convention": Case("recovery_containment", 0.0, 1 / 2, [failed(0, "human", after_us=S), []]),
    "latency_of_departures": Case(
        "reassignment_latency_s",
        2.0,
        3.0,
        [[*failed(0, "local", after_us=S), *failed(0, "human", after_us=9 * S, left_after_us=3 * S, action="a2")]],
    ),
    "latency_until_helped": Case(
        "reassignment_latency_s",
        1.0,
        3.0,
        [
            [
                *failed(0, "peer", after_us=5 * S, left_after_us=S),
                *failed(0, "human", after_us=9 * S, left_after_us=S, action="a2"),
            ]
        ],
    ),
    "conflict_of_pair": Case(
        "authority_conflicts",
        1.0,
        3.0,
        [[*claimed(0, "x", 9), *claimed(1, "y", 9), *claimed(2, "z", 9), *claimed(3, "x", 9)]],
    ),
    "conflict_of_claim": Case(
        "authority_conflicts",
        1.0,
        3.0,
        [[*claimed(0, "x", 9), *claimed(1, "y", 9), *claimed(2, "y", 9), *claimed(3, "x", 9), *claimed(9, "w", 10)]],
    ),
    "conflict_of_action": Case(
        "authority_conflicts",
        2.0,
        1.0,
        [[row for name in ("override", "audit") for by in "xy" for row in claimed(1, by, 9, name)]],
    ),
    "instants_are_shared": Case("authority_conflicts", 0.0, 1.0, [[*claimed(0, "x", 5), *claimed(5, "y", 9)]]),
    "review_is_no_denial": Case(
        "policy_violations", 1.0, 1 / 2, [[window("review"), started()], [window("deny"), started()]]
    ),
    "motions_are_no_actions": Case("policy_violations", 2.0, 1.0, [[window("deny"), MOTION, started()]]),
    "violation_of_action": Case(
        "policy_violations", 4.0, 3.0, [[window("deny"), MOTION, started(), started(), started("a2")]]
    ),
    "reviews_are_no_interventions": Case(
        "human_intervention",
        1.0,
        2 / 3,
        [
            [event("SupervisorCalled", supervisor="supervisor/fleet", purpose=purpose)]
            for purpose in ("review", "recovery", "ordering")
        ],
    ),
    "level_four_is_fleet": Case(
        "human_intervention",
        0.0,
        1 / 2,
        [
            [event("SupervisorCalled", supervisor="supervisor/A1", purpose=purpose)]
            for purpose in ("review", "recovery")
        ],
    ),
    "routine_leaves_no_records": Case(
        "audit_attributability", 2 / 3, 1 / 2, [[MOTION, started(), event("InternalHandoff", executed_by="robot/B1")]]
    ),
    "only_listed_records": Case(
        "audit_attributability",
        2 / 5,
        1 / 2,
        [[MOTION, started(), event("RequestIssued"), event("InternalHandoff"), event("BidSubmitted")]],
    ),
    "denials_are_records": Case(
        "audit_attributability", 1.0, 2 / 3, [[started(), DENIED, decided("coordinator", name="RequestDenied")]]
    ),
    "handoffs_leave_no_records": Case(
        "audit_attributability", 1 / 2, 2 / 3, [[MOTION, started(), event("InternalHandoff"), event("BidSubmitted")]]
    ),
    "hops_of_records_are_records": Case(
        "audit_attributability",
        1 / 2,
        1 / 4,
        [
            [
                MOTION,
                decided(
                    "agent/B1/execution",
                    *("agent/B1/communication", "agent/B1/planning", "agent/B1/execution"),
                ),
            ]
        ],
    ),
    "principals_on_the_record": Case(
        "audit_attributability",
        1.0,
        1 / 2,
        [[started(), event("ExecutionFinished", action_id="a1", robot="robot/B1", executed_by="robot/B1")]],
    ),
    "principals_of_the_action": Case(
        "audit_attributability",
        1 / 3,
        2 / 3,
        [
            [
                started(),
                event("BidSubmitted", action_id="a1", executed_by="robot/C1", robot="robot/C1"),
                event("BidSubmitted"),
            ]
        ],
    ),
    "absent_supervisors_are_missing": Case(
        "audit_attributability",
        1 / 2,
        1 / 4,
        [
            [
                event("RobotJoined", robot="robot/B1", supervisor="supervisor/B1"),
                event("SupervisorLeft", supervisor="supervisor/B1"),
                event("RoutineReported", robot="robot/B1", requested_by="robot/B1", executed_by="robot/B1"),
                event("RoutineReported", robot="robot/B1", executed_by="robot/B1"),
                event("SupervisorReturned", supervisor="supervisor/B1"),
                event("RoutineReported", robot="robot/B1", requested_by="robot/B1", executed_by="robot/B1"),
                started(),
            ]
        ],
    ),
}
