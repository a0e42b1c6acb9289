"""The shape every event shares: one frozen struct per fact, one tag per version.

An event says what happened; the envelope around it says where in a run. Envelope columns that every
row has (`run_id`, `seq`, `time_us`, `caused_by`, `type`) are kept beside the structs as columns, because
they are the same for whole runs or follow from the position. Envelope columns that only some events
have are ordinary fields with these names wherever they occur: `task_id`, `action_id` (task/step),
`request_id`, the principals `decided_by`, `requested_by`, `executed_by`, `supervised_by`, and `path`
(principals that the decision traversed, decider last).

A principal is None when the record does not name one; it is never defaulted. Times are integer
microseconds of run time, shares are parts per million; no event holds a float.
"""

from typing import Literal, TypeAlias

import msgspec


def tag(name: str) -> str:
    """The stored type of an event class: its name and version."""
    return f"{name}.v1"


class Event(
    msgspec.Struct, frozen=True, gc=False, tag_field="type", tag=tag, omit_defaults=True, forbid_unknown_fields=True
):
    """A fact, immutable to the leaves: fields hold strings, integers, booleans, None, or tuples of strings."""


COORDINATOR = "coordinator"
FLEET_SUPERVISOR = "supervisor/fleet"
REGISTRY = "service/registry"
COORDINATION = "service/coordination"
RECOVERY = "service/recovery"
POLICY = "service/policy"
TRUST = "service/trust"


def local_supervisor(robot: str) -> str:
    """The principal of the robot's own supervisor H_i: `robot/A1` is supervised by `supervisor/A1`."""
    return "supervisor/" + robot[6:]


def agent(robot: str, kind: Literal["planning", "execution", "communication", "recovery"]) -> str:
    """The principal of one of the four agents into which DHMA splits a robot: `agent/A1/planning`."""
    return f"agent/{robot[6:]}/{kind}"


# Open text, in an event (`RunStarted`) and everywhere: the experiment checks it against what is registered.
Architecture: TypeAlias = str
Scenario: TypeAlias = str
Workflow: TypeAlias = str

PolicyOutcome = Literal["allow", "deny", "review"]
PolicyScope = Literal["local", "fleet"]
Dimension = Literal["execution", "override", "audit"]
TrustScope = Literal["none", "capability", "task", "session", "persistent"]
RecoveryLevel = Literal["local", "peer", "fleet", "human"]
OverrideLevel = Literal["none", "soft-priority", "hard-preempt", "emergency-only"]
Availability = Literal["ready", "busy", "degraded", "restricted", "offline"]
Visibility = Literal["global", "domain", "trust-gated"]
Result = Literal["success", "partial", "failure"]
FailureCause = Literal["obstruction", "degradation"]
Operation = Literal["motion", "sensing"]
