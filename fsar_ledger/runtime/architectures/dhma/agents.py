"""DHMA: every robot is four fleet-visible agents that talk and pass work to each other.

A talk is the sequence of agents that work passes through. Each hop takes the latency of an internal message; a decision
at its end has these agents as its path. Only the hand-off of delegated work at its executor is recorded.
Paper: sec:evaluation:baselines, sec:evaluation:qualitative (Case 4). Reading: R21.
"""

from functools import lru_cache
from itertools import pairwise
from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Agent, AgentKind, PolicyOutcome, Robot, agent
from fsar_ledger.events.knowledge import PlannerEngaged, SnapshotTaken
from fsar_ledger.events.request import ContractQuestioned, GapDetected, InternalHandoff
from fsar_ledger.events.task import StepBegan
from fsar_ledger.events.world import ContextChanged, SnapshotPhaseSet
from fsar_ledger.projections.authority import Authority
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fleet import Fleet
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.policy import standing
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import in_force, stricter
from fsar_ledger.runtime.handlers.attribution import is_injected, recorded_by
from fsar_ledger.runtime.handlers.authority import close_execution
from fsar_ledger.runtime.handlers.commands import (
    ActionCommand,
    CloseExecution,
    Handlers,
    RobotCommand,
    Scheduled,
    commanded_robot,
    hop,
    hops,
    nobody,
    open_request,
    requester,
)
from fsar_ledger.runtime.handlers.execution import pause_running
from fsar_ledger.runtime.ports import Ask

Talk = tuple[AgentKind, ...]

CALL: Talk = ("planning", "communication")  # the planner wants a request to another robot
EVALUATION: Talk = (
    "communication",
    "planning",
    "execution",
)  # a call arrives, is evaluated, and the means for it are confirmed
RELAY: Talk = ("communication", "planning")  # a message from another robot reaches the planner
TO_PLANNING: Talk = ("communication", "planning")  # an award goes from agent to agent ...
TO_EXECUTION: Talk = ("planning", "execution")
FROM_PLANNING: Talk = ("planning", "communication")  # ... and each acknowledges it
FROM_EXECUTION: Talk = ("execution", "planning")
SETTLEMENT: Talk = ("communication", "planning", "execution", "communication")  # how a double booking is settled
VOIDING: Talk = ("execution", "communication", "planning", "communication")  # a contract that no longer holds
OWN_STEP: Talk = ("planning", "execution")
OWN_RESULT: Talk = ("execution", "planning")
RESULT: Talk = ("execution", "communication")
RECOVERY: Talk = (
    "execution",
    "recovery",
    "planning",
    "recovery",
)  # recovery hears of a failure or of how an attempt ended, and consults the planner
REPLANNING: Talk = ("execution", "planning", "execution", "planning")  # the change, the new plan, its confirmation
RENEGOTIATION: Talk = (
    "communication",
    "planning",
    "communication",
    "planning",
    "communication",
)  # the other robot agrees to it

HANDLERS = Handlers()


class HandOver(RobotCommand):
    """Record that the executor's agents pass on delegated work, or acknowledge it."""

    agents: Talk


@HANDLERS.decide(HandOver, commanded_robot)
def hand_over(state: State, command: HandOver) -> tuple[InternalHandoff, ...]:
    """Record each hop, without a requester: no message between agents names one. Reading: R21."""
    names = path(command.robot, command.agents)
    parties = recorded_by(state, command.robot, requested_by=None, executed_by=command.robot)
    # See docs/decisions/handoffs-of-delegated-work-are-records.md.
    return tuple([InternalHandoff(parties, sender, receiver) for sender, receiver in pairwise(names)])


def talk(fleet: Fleet, agents: Talk, key: str, name: int | str) -> tuple[Ask, ...]:
    """Return how long these agents talk: the latency of each hop."""
    return (hop(fleet, key, name),) if len(agents) == 2 else hops(fleet, key, str(name), len(agents) - 1)


def handed_over(
    fleet: Fleet, robot: Robot, agents: Talk, key: str, name: str, command: ActionCommand
) -> tuple[Scheduled, ...]:
    """Schedule the command for when these agents have passed on delegated work, and the record of the hand-off."""
    waits = talk(fleet, agents, key, name)
    return Scheduled(command, 0, waits), Scheduled(HandOver(robot, agents), 0, waits)


@lru_cache(1 << 15)  # a talk of every robot of a large fleet: most of its events are hops
def path(robot: Robot, agents: Talk) -> tuple[Agent, ...]:
    """Return the path of a decision that went through these agents of the robot, decider last."""
    return tuple(agent(robot, kind) for kind in agents)


class TakeSnapshot(RobotCommand):
    """Refresh a planner's snapshot of the robot's own policy."""


class DetectGap(ActionCommand):
    """Detect that the step needs another robot."""


class EngagePlanner(RobotCommand):
    """Direct the planner to a context change, which puts open contracts in question."""


def planner(robot: Robot) -> Agent:
    """Return the robot's planning agent."""
    return agent(robot, "planning")


# See docs/decisions/declared-rules-reach-every-architecture.md.
def snapshot(state: State, robot: Robot, capability: str | None, context: str | None) -> PolicyOutcome:
    """Return the robot's own policy as its planner knows it: its windows at the last snapshot, and its rules.

    No agent composes the fleet's rule or the requester's policy. Paper: sec:evaluation:baselines.
    """
    window = state.knowledge.snapshot.get(robot, "allow")
    return stricter(window, standing(state.policy, "local", robot, capability, context))


@HANDLERS.decide(TakeSnapshot, commanded_robot)
def take_snapshot(state: State, command: TakeSnapshot) -> tuple[Event, ...]:
    """Refresh the planner's snapshot with the policy as it is now."""
    return (SnapshotTaken(command.robot, in_force(state.world.local, command.robot)),)


@HANDLERS.decide_on(open_request, DetectGap, requester)
def detect_gap(state: State, _command: DetectGap, request: Request) -> tuple[Event, ...]:
    """Record the planner's finding that the step needs another robot."""
    robot = request.requester
    parties = recorded_by(state, robot, requested_by=robot, executed_by=None)
    return (GapDetected(request.subject, parties, request.capability),)


@HANDLERS.decide(EngagePlanner, commanded_robot)
def engage_planner(state: State, command: EngagePlanner) -> tuple[Event, ...]:
    """Make every agent that is party to an open action of the robot claim override until the action ends."""
    robot = command.robot
    events: list[Event] = [PlannerEngaged(robot, command.now_us + state.fleet.structure.engagement_us)]
    for action in state.execution.actions.values():
        if is_injected(action) or action.stage == "withdrawn" or robot not in (action.robot, action.on_behalf_of):
            continue
        claimants = (
            (planner(robot), agent(robot, "execution"))
            if robot == action.robot
            else (planner(robot), planner(action.robot))
        )
        events += claims(state.authority, action, "override", claimants, "context change")
    for request in state.request.open.values():
        if (
            request.target is not None
            and robot in (request.requester, request.target)
            and not _has_started(state.execution, request)
        ):
            events.append(ContractQuestioned(request.subject, robot))
    return tuple(events)


def _has_started(execution: Execution, request: Request) -> bool:
    """Return whether it is too late to question the contract: the action runs, has ended, or is an outsider's."""
    # See docs/decisions/outsider-requests-have-no-contract.md.
    if request.step == 0:
        return True
    action = execution.actions.get(request.action_id)
    if action is None:
        return request.is_accepted
    return action.stage not in ("queued", "approaching")


def claims(
    authority: Authority, action: Action, dimension: Any, claimants: tuple[Agent, ...], reason: str
) -> list[AuthorityClaimed]:
    """Return the claims by these agents that they do not hold already."""
    existing = {(claim.dimension, claim.claimant, claim.reason) for claim in authority.claims.get(action.action_id, ())}
    return [
        AuthorityClaimed(subject=action.subject, dimension=dimension, claimant=claimant, reason=reason)
        for claimant in claimants
        if (dimension, claimant, reason) not in existing
    ]


@HANDLERS.react(SnapshotPhaseSet)
def _first_snapshot(state: State, event: SnapshotPhaseSet, _now_us: int) -> tuple[Scheduled, ...]:
    return (
        Scheduled(
            TakeSnapshot(event.robot), max(1, event.phase_ppm * state.fleet.structure.snapshot_period_us // 1_000_000)
        ),
    )


@HANDLERS.react(SnapshotTaken)
def _next_snapshot(state: State, event: SnapshotTaken, now_us: int) -> tuple[Scheduled, ...]:
    structure = state.fleet.structure
    if now_us > structure.watch_us and not state.task:
        return ()
    return (Scheduled(TakeSnapshot(event.robot), structure.snapshot_period_us),)


@HANDLERS.react(StepBegan)
def _on_step(_state: State, event: StepBegan, _now_us: int) -> tuple[Scheduled, ...]:
    return (Scheduled(DetectGap(event.subject.action_id)),) if event.target_role is not None else ()


@HANDLERS.react(ContextChanged)
def _on_context(state: State, event: ContextChanged, now_us: int) -> tuple[Scheduled, ...]:
    return (*pause_running(state, event, now_us), Scheduled(EngagePlanner(event.robot)))


HANDLERS.decide(CloseExecution, nobody)(close_execution)
