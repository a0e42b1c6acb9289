"""Fleet membership, what robots possess, and the state a robot is in.

Paper: eq:fleet, eq:runtime, eq:possess.

The commands here are public; `issued_by` is the issuer, None if not stated.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import (
    COORDINATION,
    DEPARTED,
    FLEET_SUPERVISOR,
    RECOVERY,
    Principal,
    Robot,
    Supervisor,
    local_supervisor,
)
from fsar_ledger.events.execution import ExecutionFailed, ExecutionWithdrawn
from fsar_ledger.events.fleet import Departure, RobotDeparted, RobotJoined, RobotReturned
from fsar_ledger.events.registry import AvailabilityChanged, CapabilityInstalled, CapabilityRemoved
from fsar_ledger.events.request import RequestClosed
from fsar_ledger.events.task import TaskAbandoned
from fsar_ledger.events.trust import InitialTrustSet
from fsar_ledger.projections.execution import HELPING, Action, Execution, left_us
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.registry import Contract, Registry, path_of, possesses, surface
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.task import Task

from .assistance import help_failed, helped
from .attribution import parties, recorded_by
from .authority import released
from .candidates import contradiction, version_of
from .commands import Handlers, acting
from .execution import holds_robot
from .public import PublicCommand, absent_robot, carried_out, made_from, not_governed, not_in_charge, unknown_supervisor
from .recovery import escalated
from .task import has_not_begun

HANDLERS = Handlers()


class JoinFleet(PublicCommand):
    """Register a robot in the domain's registry, under its own supervisor if it has one.

    One that has departed returns by the same command, as the same robot: its name is its own. Who knows the robot
    recognises it by `public_key`, which is compared and nothing more. Paper: sec:discussion:heterogeneity.
    """

    robot: Robot
    role: str
    team: int
    supervisor: Supervisor | None = None
    domain: str = ""
    place: str | None = None
    issued_by: Supervisor | None = None
    public_key: str | None = None


class LeaveFleet(PublicCommand):
    """Remove the robot from the fleet, on its own authority (`issued_by` None) or that of a supervisor."""

    robot: Robot
    issued_by: Supervisor | None = None


class InstallCapability(PublicCommand):
    """Install a capability that the robot did not have. Paper: eq:possess."""

    robot: Robot
    capability: str
    version: str
    preconditions: tuple[str, ...] = ()
    postconditions: tuple[str, ...] = ()
    resources: tuple[str, ...] = ()
    issued_by: Supervisor | None = None


class RemoveCapability(PublicCommand):
    """Remove a capability from the robot."""

    robot: Robot
    capability: str
    issued_by: Supervisor | None = None


@HANDLERS.decide(JoinFleet)
def join_fleet(state: State, command: JoinFleet) -> tuple[Event, ...]:
    """Make the robot a member, with initial trust of the narrowest scope both ways; it possesses nothing yet.

    What requires more is refused until an operator approves, or the record promotes it. Paper:
    sec:discussion:heterogeneity (the text gives no direction).
    """
    robot, wrong = command.robot, None
    if robot in state.fleet.departed:
        return _return(state, command)
    if robot in state.fleet.robots:
        wrong = f"{robot} is a member already"
    elif not _is_robots_name(robot):
        wrong = f"{robot!r} is no robot's name, expected one such as robot/A1"
    elif not command.role or command.team < 1:
        wrong = f"role {command.role!r} of team {command.team}, expected a role and a team from 1"
    elif not _may_supervise(command):
        wrong = f"supervisor {command.supervisor}, expected {local_supervisor(robot)}, none, or who issues it"
    elif (stranger := _stranger(state.fleet, command)) is not None:
        wrong = stranger
    elif not all(path_of(command.domain)):
        wrong = f"domain {command.domain!r} is no path, expected one such as hall/cell, or nothing for the fleet's own"
    elif command.public_key == "":
        wrong = "an empty public key, expected one, or none"
    elif command.place == "":
        wrong = "an empty place, expected a name such as floor/2, or none for a fleet of one place"
    trust = [
        InitialTrustSet(robot=robot, scope="capability", is_trusting=is_trusting, decided_by=command.issued_by)
        for is_trusting in (True, False)
    ]
    return carried_out(command, robot, wrong, command.issued_by, made_from(RobotJoined, command), *trust)


def _return(state: State, command: JoinFleet) -> tuple[Event, ...]:
    """Make the robot a member again, with its trust, if it is the one that departed."""
    prior, robot, issuer = state.fleet.robots[command.robot], command.robot, command.issued_by
    wrong = None if issuer is None else not_in_charge(state.fleet, issuer, robot)
    for name in ("role", "team", "supervisor", "domain", "place", "public_key"):
        if wrong is None and getattr(command, name) != getattr(prior, name):
            wrong = (
                f"{name} {getattr(command, name)}, expected {getattr(prior, name)}: {robot} has departed, and its name "
                "stays its own"
            )
    return carried_out(command, robot, wrong, issuer, returned(state, robot, issuer or robot))


def returned(state: State, robot: Robot, decided_by: Principal | None) -> RobotReturned:
    """Return the event that the robot is a member again."""
    return RobotReturned(robot=robot, fence=state.fleet.fences.get(robot, 0), decided_by=decided_by)


@HANDLERS.decide(LeaveFleet)
def leave_fleet(state: State, command: LeaveFleet) -> tuple[Event, ...]:
    """Remove the robot from the fleet, and end all that ends with it."""
    robot, issuer = command.robot, command.issued_by
    wrong = absent_robot(state.fleet, robot)
    if wrong is None and issuer is not None:
        wrong = not_in_charge(state.fleet, issuer, robot)
    events = () if wrong is not None else departure(state, robot, "announced", issuer or robot, command.now_us)
    return carried_out(command, robot, wrong, issuer, *events)


# See docs/decisions/departures-are-fenced.md.
def departure(state: State, robot: Robot, reason: Departure, decided_by: Principal, now_us: int) -> tuple[Event, ...]:
    """Return the departure and what ends with it: nothing stays open that only this robot could end.

    The registry lists it as offline; its claims are released; requests in flight to and from it end as
    failure(departed); its begun actions fail, and go through recovery without it; a task that waits for it to act is
    given up. What others have begun for it ends as usual. Paper: sec:discussion:heterogeneity.
    """
    actions = [action for action in state.execution.actions.values() if action.stage != "withdrawn"]
    by_turn = sorted(actions, key=lambda action: holds_robot(state.execution, action))  # the next has no turn meanwhile
    waiting = [action for action in by_turn if has_not_begun(action) and robot in (action.robot, action.on_behalf_of)]
    begun = [action for action in by_turn if action.robot == robot and not has_not_begun(action)]
    ended = {action.action_id for action in (*waiting, *begun)}
    claims = [claim for action_claims in state.authority.claims.values() for claim in action_claims]
    return (
        RobotDeparted(robot=robot, reason=reason, fence=state.fleet.fences.get(robot, 0) + 1, decided_by=decided_by),
        *_offline(state, robot),
        *released(claim for claim in claims if claim.claimant == robot or claim.subject.action_id in ended),
        *_help_ends(state, robot),
        *(event for action in begun for event in _cut_off(state, action, now_us)),
        *(ExecutionWithdrawn(action.subject, action.robot) for action in waiting),
        *(
            closed_as_departed(state, request)
            for request in state.request.open.values()
            if _is_in_flight(state, request, robot)
        ),
        *(
            TaskAbandoned(task.task_id)
            for task in state.task.values()
            if _waits_for(task, robot) and task.action_id not in {action.action_id for action in begun}
        ),
    )


def _offline(state: State, robot: Robot) -> tuple[AvailabilityChanged, ...]:
    """List what the robot advertises as offline, if there is a registry."""
    records = tuple(surface(state.registry, robot))
    if "shared-registry" in state.fleet.without or all(record.availability == "offline" for record in records):
        return ()
    if robot not in state.registry.silent:
        return (AvailabilityChanged(robot=robot, capability=None, availability="offline", reason=DEPARTED),)
    return tuple(
        AvailabilityChanged(robot=robot, capability=record.capability, availability="offline", reason=DEPARTED)
        for record in records
        if record.availability != "offline"
    )


def _help_ends(state: State, robot: Robot) -> tuple[Event, ...]:
    """End the help that the robot gives, and the help that it is given."""
    current = state.execution.current.get(robot, "")
    helping = [(current.removeprefix(HELPING), robot)] if current.startswith(HELPING) else []
    helping += [
        (action_id, recovery.tried[-1])
        for action_id, recovery in state.recovery.items()
        if recovery.robot == robot and recovery.tried and recovery.tried[-1] != robot
    ]
    failures = ((helper, helped(state, action_id, helper)) for action_id, helper in helping)
    return tuple(help_failed(*failure, helper, DEPARTED) for helper, failure in failures if failure is not None)


def _cut_off(state: State, action: Action, now_us: int) -> tuple[Event, ...]:
    """Withdraw the begun action from the robot, as failed: its recovery continues without the robot.

    An earlier failure continues from its current level; the robot's own level is over.
    """
    withdrawn, recovery = ExecutionWithdrawn(action.subject, action.robot), state.recovery.get(action.action_id)
    if recovery is not None:
        if recovery.level != "local" or "layered-recovery" in state.fleet.without:
            return (withdrawn,)
        return escalated(action, recovery, parties(state, action).decided(RECOVERY), "peer", DEPARTED), withdrawn
    failed = ExecutionFailed(
        subject=action.subject,
        robot=action.robot,
        failure=action.failures + 1,
        cause=DEPARTED,
        remaining_us=left_us(action, now_us) if action.stage == "running" else action.remaining_us,
        detected_us=now_us,
    )
    return failed, withdrawn


def _is_in_flight(state: State, request: Request, robot: Robot) -> bool:
    """Return whether the request waits for an answer, a turn or a result that the robot gives or receives."""
    if request.is_over or request.is_unanswered or request.result is not None or not request.candidates:
        return False
    involved = (request.requester, request.candidates[0], None if request.is_relayed else request.relay)
    action = state.execution.actions.get(request.action_id)
    if action is None:
        return robot in involved
    return has_not_begun(action) and robot in (action.robot, action.on_behalf_of)


def closed_as_departed(state: State, request: Request) -> RequestClosed:
    """Return the end of the request: failure(departed). Paper: sec:discussion:heterogeneity."""
    executor = request.target or request.candidates[0] if request.candidates else request.requester
    recorded = recorded_by(state, request.requester, requested_by=request.requester, executed_by=executor)
    return RequestClosed(request.request_subject, recorded.decided(COORDINATION), "failure", DEPARTED)


def _waits_for(task: Task, robot: Robot) -> bool:
    """Return whether the robot acts in the task's current step."""
    return task.step < len(task.steps) and acting(task, task.step) == robot


def _may_supervise(command: JoinFleet) -> bool:
    """Return whether the robot can be under this supervisor: its own, or a person, perhaps beside other robots."""
    supervisor = command.supervisor
    if supervisor in (None, local_supervisor(command.robot)):
        return True
    is_person = (
        f"{supervisor}".startswith("supervisor/")
        and supervisor != FLEET_SUPERVISOR
        and f"{supervisor}" != "supervisor/"
    )
    return is_person and command.issued_by in (supervisor, FLEET_SUPERVISOR)


def _stranger(fleet: Fleet, command: JoinFleet) -> str | None:
    """Return why the issuer is unknown to the fleet, or None; the robot's supervisor becomes known."""
    return None if command.issued_by in (None, command.supervisor) else unknown_supervisor(fleet, command.issued_by)


def _is_robots_name(name: str) -> bool:
    """Return whether the name is `robot/` and one word."""
    word = name.removeprefix("robot/")
    return word != name and "/" not in word and word.split() == [word]


@HANDLERS.decide(InstallCapability)
def install_capability(state: State, command: InstallCapability) -> tuple[Event, ...]:
    """Install the capability, not yet advertised. Paper: sec:model:capability."""
    robot, capability = command.robot, command.capability
    wrong = not_governed(state.fleet, robot, command.issued_by)
    if wrong is None and possesses(state.registry, robot, capability):
        wrong = (
            f"{robot} possesses version {state.registry.modules[robot][capability].version} already, "
            "expected an upgrade"
        )
    if wrong is None and (not capability.strip() or "*" in capability):
        wrong = f"capability {capability!r} is no name, expected one such as grasp.robust"
    if wrong is None and version_of(command.version) is None:
        wrong = f"{command.version!r} is no version, expected one such as 1.2.0"
    contract = Contract(command.preconditions, command.postconditions, command.resources)
    wrong = wrong or contradiction(contract)
    return carried_out(command, capability, wrong, command.issued_by, made_from(CapabilityInstalled, command, contract))


@HANDLERS.decide(RemoveCapability)
def remove_capability(state: State, command: RemoveCapability) -> tuple[Event, ...]:
    """Remove the capability and its advertisement."""
    robot, capability = command.robot, command.capability
    wrong = (
        not_governed(state.fleet, robot, command.issued_by)
        or not_possessed(state.registry, robot, capability)
        or in_use(state.execution, robot, capability)
    )
    return carried_out(command, capability, wrong, command.issued_by, CapabilityRemoved(robot, capability))


def not_possessed(registry: Registry, robot: Robot, capability: str) -> str | None:
    """Return why to reject a command that needs the robot's capability, or None if it possesses it."""
    return None if possesses(registry, robot, capability) else f"{robot} does not possess {capability}"


def in_use(execution: Execution, robot: Robot, capability: str) -> str | None:
    """Return why the capability cannot be changed now, or None: an action at the robot needs it."""
    for name in (execution.current.get(robot, ""), *execution.queues.get(robot, ())):
        action = execution.actions.get(name)
        if action is not None and action.capability == capability:
            return f"{capability} is in use by {name}, expected it to be over"
    return None
