"""DHMA: every robot is four fleet-visible agents that pass work to each other. Paper: sec:evaluation:baselines."""

from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Agent, PolicyOutcome, Robot, agent
from fsar_ledger.events.knowledge import PlannerEngaged, SnapshotTaken
from fsar_ledger.events.request import ContractQuestioned
from fsar_ledger.events.world import ContextChanged, SnapshotPhaseSet
from fsar_ledger.projections.authority import Authority
from fsar_ledger.projections.execution import Action, Execution
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.knowledge import Knowledge
from fsar_ledger.projections.request import Request
from fsar_ledger.projections.world import in_force
from fsar_ledger.runtime.handlers.actors import named, nobody
from fsar_ledger.runtime.handlers.attribution import is_injected
from fsar_ledger.runtime.handlers.authority import close_execution
from fsar_ledger.runtime.handlers.commands import Actors, CloseExecution, Command, Decides, Reacts, Scheduled
from fsar_ledger.runtime.handlers.execution import pause_running


class TakeSnapshot(Command):
    """Refresh a planner's snapshot of the robot's own policy."""

    robot: Robot


class EngagePlanner(Command):
    """Direct the planner to a context change, which puts open contracts in question."""

    robot: Robot


def planner(robot: Robot) -> Agent:
    """Return the robot's planning agent."""
    return agent(robot, "planning")


def snapshot(knowledge: Knowledge, robot: Robot) -> PolicyOutcome:
    """Return the robot's own policy as its planner last saw it."""
    return knowledge.snapshot.get(robot, "allow")


def take_snapshot(state: State, command: TakeSnapshot) -> tuple[Event, ...]:
    """Refresh the planner's snapshot with the policy as it is now."""
    return (SnapshotTaken(command.robot, in_force(state.world.local, command.robot)),)


def engage_planner(state: State, command: EngagePlanner) -> tuple[Event, ...]:
    """Make every agent that is party to an open action of the robot claim override until the action ends."""
    robot = command.robot
    made: list[Event] = [PlannerEngaged(robot, command.now_us + state.fleet.structure.engagement_us)]
    for action in state.execution.actions.values():
        if is_injected(action) or action.stage == "withdrawn" or robot not in (action.robot, action.on_behalf_of):
            continue
        claimants = (
            (planner(robot), agent(robot, "execution"))
            if robot == action.robot
            else (planner(robot), planner(action.robot))
        )
        made += claims(state.authority, action, "override", claimants, "context change")
    for request in state.request.open.values():
        if (
            request.target is not None
            and robot in (request.requester, request.target)
            and not _has_started(state.execution, request)
        ):
            made.append(ContractQuestioned(request.subject, robot))
    return tuple(made)


def _has_started(execution: Execution, request: Request) -> bool:
    """Tell whether it is too late to question the contract: the action runs, has ended, or is an outsider's."""
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
    known = {(claim.dimension, claim.claimant, claim.reason) for claim in authority.claims.get(action.action_id, ())}
    return [
        AuthorityClaimed(action.subject, dimension, claimant, reason)
        for claimant in claimants
        if (dimension, claimant, reason) not in known
    ]


def _first_snapshot(state: State, event: SnapshotPhaseSet, _now_us: int) -> tuple[Scheduled, ...]:
    return (
        Scheduled(
            TakeSnapshot(event.robot), max(1, event.phase_ppm * state.fleet.structure.snapshot_period_us // 1_000_000)
        ),
    )


def _next_snapshot(state: State, event: SnapshotTaken, now_us: int) -> tuple[Scheduled, ...]:
    structure = state.fleet.structure
    if now_us > structure.watch_us and not state.task:
        return ()
    return (Scheduled(TakeSnapshot(event.robot), structure.snapshot_period_us),)


def _on_context(state: State, event: ContextChanged, now_us: int) -> tuple[Scheduled, ...]:
    return (*pause_running(state, event, now_us), Scheduled(EngagePlanner(event.robot)))


DECIDES: Decides = {TakeSnapshot: take_snapshot, EngagePlanner: engage_planner, CloseExecution: close_execution}
ACTORS: Actors = {
    TakeSnapshot: named,
    EngagePlanner: named,
    CloseExecution: nobody,
}
REACTS: Reacts = {SnapshotPhaseSet: _first_snapshot, SnapshotTaken: _next_snapshot, ContextChanged: _on_context}
