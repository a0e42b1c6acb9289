"""One case for each reading of the paper: its rows, the mean of ours and the mean under the reading."""

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
CASES: dict[str, tuple[str, Runs, float, float]] = {
    # Reading: metric, events of each run, the mean as we read them, and the mean under the reading.
    "late_tasks_succeed": (
        "coordination_success",
        [[*task("t1", 5), *task("t2", 11), *task("t3", None)]],
        1 / 3,
        2 / 3,
    ),
    "whole_runs_succeed": (
        "coordination_success",
        [[*task("t1", 5), *task("t2", None)], task("t1", 5), []],
        3 / 4,
        1 / 2,
    ),
    "tasks_are_pooled": (
        "coordination_success",
        [[*task("t1", 5), *task("t2", 6), *task("t3", 7)], task("t1", None)],
        1 / 2,
        3 / 4,
    ),
    "routine_decides_nothing": ("governance_locality", [[MOTION, decided("robot/A1"), HALF]], 2 / 3, 1 / 2),
    "only_listed_decisions": (
        "governance_locality",
        [[MOTION, decided("robot/A1", name="OwnStepDecided"), decided("robot/A1"), HALF]],
        3 / 4,
        1 / 2,
    ),
    "denials_decide_each_time": ("governance_locality", [[decided("robot/A1"), DENIED, DENIED, DENIED]], 1 / 2, 1 / 4),
    "only_agents_are_traversed": (
        "governance_locality",
        [
            [
                decided("robot/A1", "robot/A1", "robot/B1"),
                decided("robot/A1", "agent/A1/planning", "robot/A1"),
                decided("coordinator"),
                HALF,
            ]
        ],
        0.0,
        1 / 4,
    ),
    "closings_are_the_requesters": (
        "governance_locality",
        [
            [
                decided("service/coordination", name="RequestClosed"),
                decided("coordinator", name="RequestClosed"),
                decided("service/registry"),
                HALF,
            ]
        ],
        0.0,
        1 / 4,
    ),
    "closings_decide_nothing": (
        "governance_locality",
        [[decided("service/coordination", name="RequestClosed"), decided("robot/A1"), HALF]],
        1 / 3,
        1 / 2,
    ),
    "ordered_retry_is_fleet": (
        "recovery_containment",
        [
            [
                row
                for by, name in (("coordinator", "a1"), ("robot/D1", "a2"), ("agent/D1/recovery", "a3"))
                for row in failed(0, "local", after_us=S, ordered_by=by, action=name)
            ]
        ],
        1.0,
        2 / 3,
    ),
    "failures_by_run": (
        "recovery_containment",
        [
            [*failed(0, "local", after_us=S), *failed(0, "human", after_us=S, action="a2")],
            failed(0, "local", after_us=S),
            [],
        ],
        2 / 3,
        3 / 4,
    ),
    "published_convention": ("recovery_containment", [failed(0, "human", after_us=S), []], 0.0, 1 / 2),
    "latency_of_departures": (
        "reassignment_latency_s",
        [[*failed(0, "local", after_us=S), *failed(0, "human", after_us=9 * S, left_after_us=3 * S, action="a2")]],
        2.0,
        3.0,
    ),
    "latency_until_helped": (
        "reassignment_latency_s",
        [
            [
                *failed(0, "peer", after_us=5 * S, left_after_us=S),
                *failed(0, "human", after_us=9 * S, left_after_us=S, action="a2"),
            ]
        ],
        1.0,
        3.0,
    ),
    "conflict_of_pair": (
        "authority_conflicts",
        [[*claimed(0, "x", 9), *claimed(1, "y", 9), *claimed(2, "z", 9), *claimed(3, "x", 9)]],
        1.0,
        3.0,
    ),
    "conflict_of_claim": (
        "authority_conflicts",
        [[*claimed(0, "x", 9), *claimed(1, "y", 9), *claimed(2, "y", 9), *claimed(3, "x", 9), *claimed(9, "w", 10)]],
        1.0,
        3.0,
    ),
    "conflict_of_action": (
        "authority_conflicts",
        [[row for name in ("override", "audit") for by in "xy" for row in claimed(1, by, 9, name)]],
        2.0,
        1.0,
    ),
    "instants_are_shared": ("authority_conflicts", [[*claimed(0, "x", 5), *claimed(5, "y", 9)]], 0.0, 1.0),
    "review_is_no_denial": (
        "policy_violations",
        [[window("review"), started()], [window("deny"), started()]],
        1.0,
        1 / 2,
    ),
    "motions_are_no_actions": ("policy_violations", [[window("deny"), MOTION, started()]], 2.0, 1.0),
    "violation_of_action": (
        "policy_violations",
        [[window("deny"), MOTION, started(), started(), started("a2")]],
        4.0,
        3.0,
    ),
    "reviews_are_no_interventions": (
        "human_intervention",
        [
            [event("SupervisorCalled", supervisor="supervisor/fleet", purpose=purpose)]
            for purpose in ("review", "recovery", "ordering")
        ],
        1.0,
        2 / 3,
    ),
    "level_four_is_fleet": (
        "human_intervention",
        [
            [event("SupervisorCalled", supervisor="supervisor/A1", purpose=purpose)]
            for purpose in ("review", "recovery")
        ],
        0.0,
        1 / 2,
    ),
    "routine_leaves_no_records": (
        "audit_attributability",
        [[MOTION, started(), event("InternalHandoff", executed_by="robot/B1")]],
        2 / 3,
        1 / 2,
    ),
    "only_listed_records": (
        "audit_attributability",
        [[MOTION, started(), event("RequestIssued"), event("InternalHandoff"), event("BidSubmitted")]],
        2 / 5,
        1 / 2,
    ),
    "denials_are_records": (
        "audit_attributability",
        [[started(), DENIED, decided("coordinator", name="RequestDenied")]],
        1.0,
        2 / 3,
    ),
    "handoffs_leave_no_records": (
        "audit_attributability",
        [[MOTION, started(), event("InternalHandoff"), event("BidSubmitted")]],
        1 / 2,
        2 / 3,
    ),
    "principals_on_the_record": (
        "audit_attributability",
        [[started(), event("ExecutionFinished", action_id="a1", robot="robot/B1", executed_by="robot/B1")]],
        1.0,
        1 / 2,
    ),
    "principals_of_the_action": (
        "audit_attributability",
        [
            [
                started(),
                event("BidSubmitted", action_id="a1", executed_by="robot/C1", robot="robot/C1"),
                event("BidSubmitted"),
            ]
        ],
        1 / 3,
        2 / 3,
    ),
    "absent_supervisors_are_excused": (
        "audit_attributability",
        [
            [
                event("SupervisorLeft", supervisor="supervisor/B1"),
                event("RoutineReported", robot="robot/B1", requested_by="robot/B1", executed_by="robot/B1"),
                event("RoutineReported", robot="robot/B1", executed_by="robot/B1"),
                event("SupervisorReturned", supervisor="supervisor/B1"),
                event("RoutineReported", robot="robot/B1", requested_by="robot/B1", executed_by="robot/B1"),
                started(),
            ]
        ],
        1 / 4,
        1 / 2,
    ),
}
