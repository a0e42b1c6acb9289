"""The shape every event shares: one frozen struct per fact, one tag per version.

An event says what happened; the envelope around it says where in a run. Envelope columns that every row has (`run_id`,
`seq`, `time_us`, `caused_by`, `type`) are kept beside the structs as columns, because they are constant in a run or
follow from the position. Envelope columns that only some events have are grouped in parts: types of their own, whose
fields are stored as the columns of the same names. A subject (`Subject`, `RequestSubject`) says what an event is about;
principals (`Principals`, `Parties`) say who decided, asked, executes and supervises.

A principal is None when the record does not name one; it is never defaulted. Times are integer microseconds of run
time, shares are parts per million; no event holds a float.
"""

from typing import Any, Generic, Literal, NewType, TypeAlias, TypeVar

import msgspec

Robot = NewType("Robot", str)
Supervisor = NewType("Supervisor", str)
Service = NewType("Service", str)
Agent = NewType("Agent", str)
Coordinator = NewType("Coordinator", str)
Principal: TypeAlias = Robot | Supervisor | Service | Agent | Coordinator
"""Any principal that a record can name."""

# Names of tasks, actions and requests: plain text to the type checker.
TaskId: TypeAlias = str
ActionId: TypeAlias = str
RequestId: TypeAlias = str

_Event = TypeVar("_Event", bound="Event")
_Task = TypeVar("_Task", bound=TaskId | None, covariant=True)
_Action = TypeVar("_Action", bound=ActionId | None, covariant=True)
_Request = TypeVar("_Request", bound=RequestId | None, covariant=True)


def tag(name: str) -> str:
    """Return the stored type of an event class: its name and version."""
    return f"{name}.v1"


# See docs/decisions/integers-only-in-events.md.
class Event(
    msgspec.Struct, frozen=True, gc=False, tag_field="type", tag=tag, omit_defaults=True, forbid_unknown_fields=True
):
    """A fact, immutable throughout: fields hold strings, integers, booleans, None, or tuples of strings."""


class Part(msgspec.Struct, frozen=True, gc=False):
    """A group of columns of an event; each field is stored as the column of its name."""


def flat(event: Event) -> dict[str, Any]:
    """Return the stored columns of an event by name: its fields, and those of its parts."""
    columns: dict[str, Any] = {}
    for name, value in msgspec.structs.asdict(event).items():
        columns |= msgspec.structs.asdict(value) if isinstance(value, Part) else {name: value}
    return columns


def with_columns(event: _Event, **columns: object) -> _Event:
    """Return a copy of the event with these columns replaced. Raises: TypeError for a column that it does not have."""
    fields: dict[str, object] = {}
    for name, value in msgspec.structs.asdict(event).items():
        if isinstance(value, Part):
            inside = {column: columns.pop(column) for column in value.__struct_fields__ if column in columns}
            fields[name] = msgspec.structs.replace(value, **inside) if inside else value
    return msgspec.structs.replace(event, **fields, **columns)


class Subject(Part, Generic[_Task, _Action], frozen=True):
    """What an event is about: an action (task/step) of a task."""

    task_id: _Task
    action_id: _Action


class RequestSubject(Part, Generic[_Task, _Action, _Request], frozen=True):
    """What an event about a request refers to; `request_id` is None where the architecture does not name requests."""

    task_id: _Task
    action_id: _Action
    request_id: _Request


class Parties(Part, frozen=True, kw_only=True):
    """The principals that a record names: who asked, which robot executes, who supervises it."""

    requested_by: Principal | None
    executed_by: Robot | None
    supervised_by: Supervisor | None

    def decided(self, *path: Principal) -> "Principals":
        """Return the principals of a decision that took this path; the last one on it decided."""
        return Principals(
            decided_by=path[-1],
            requested_by=self.requested_by,
            executed_by=self.executed_by,
            supervised_by=self.supervised_by,
            path=path,
        )


class Principals(Part, frozen=True, kw_only=True):
    """The principals that the record of a decision names: the parties, the decider, and the path.

    `path`: the principals through which the decision passed, decider last.
    """

    decided_by: Principal | None
    requested_by: Principal | None
    executed_by: Robot | None
    supervised_by: Supervisor | None
    path: tuple[Principal, ...]


COORDINATOR = Coordinator("coordinator")
FLEET_SUPERVISOR = Supervisor("supervisor/fleet")
REGISTRY = Service("service/registry")
COORDINATION = Service("service/coordination")
RECOVERY = Service("service/recovery")
POLICY = Service("service/policy")
TRUST = Service("service/trust")


def local_supervisor(robot: Robot) -> Supervisor:
    """Return the principal of the robot's own supervisor H_i: `supervisor/A1` for `robot/A1`."""
    return Supervisor("supervisor/" + robot[6:])


def supervisor_named(name: str) -> Supervisor:
    """Return this name as that of a supervisor, unchecked: a command may name anything in its place."""
    return Supervisor(name)


def robot_named(role: str, team: int) -> Robot:
    """Return the principal of a simulated robot: `robot/A1` is the robot of role A in team 1."""
    return Robot(f"robot/{role}{team}")


AgentKind = Literal["planning", "execution", "communication", "recovery"]


def agent(robot: Robot, kind: AgentKind) -> Agent:
    """Return the principal of one of the four agents into which DHMA splits a robot: `agent/A1/planning`."""
    return Agent(f"agent/{robot[6:]}/{kind}")


def robot_of(agent: Agent) -> Robot:
    """Return the robot that an agent belongs to: `robot/A1` for `agent/A1/planning`."""
    return Robot("robot/" + agent.split("/")[1])


def as_robot(principal: Principal) -> Robot:
    """Return the principal as a robot. Raises: ValueError if it is not one."""
    if not principal.startswith("robot/"):
        raise ValueError(f"found the principal {principal!r}, expected a robot such as 'robot/A1'")
    return Robot(principal)


def recorded_robot(principal: str) -> Robot:
    """Return the principal as a robot, unchecked: the record of another system may name anything in its place."""
    return Robot(principal)


# Open text, in events (`RunStarted`) and everywhere else: the experiment checks it against what is registered.
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
FailureCause: TypeAlias = str  # one of FAILURE_CAUSES where our handlers decide, open text in other records
FAILURE_CAUSES = ("obstruction", "degradation")
DEPARTED = "departed"
"""The cause of what ends because its robot has left the fleet. Paper: sec:discussion:heterogeneity."""
Operation = Literal["motion", "sensing"]
