"""The decomposed fleet without one mechanism."""

from functools import partial
from typing import Any

from fsar_ledger.events import Event
from fsar_ledger.events.authority import AuthorityClaimed
from fsar_ledger.events.envelope import Agent, flat, robot_of
from fsar_ledger.events.request import ContractQuestioned
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.world import in_force
from fsar_ledger.runtime.architectures.dhma import agents, authority, execution, recovery, request, talk
from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers.commands import DecideRoutine

from .knockout import Knockout, decided_by, in_every_decision, in_no_time, leaving_out, nothing, seeing


def _passed_at_once(state: State, command: authority.PassExecution) -> tuple[Event, ...]:
    """Let the sender release at the same instant at which the receiver claims."""
    events = authority.pass_execution(state, command)
    acknowledged = authority.acknowledge_execution(
        state, authority.AcknowledgeExecution(command.action_id, command.round, command.sender)
    )
    return (*acknowledged, *events)


def _snapshots_of_now(state: State) -> Any:
    """Return the knowledge with snapshots that show the policy in force at every robot."""
    return state.knowledge.__replace__(
        snapshot={robot: in_force(state.world.local, robot) for robot in state.fleet.robots}
    )


def _talking_in_no_time(table: HandlerTable) -> HandlerTable:
    """Let the agents of a robot hear each other at once; what they say is on record as before."""
    quick = partial(seeing, "fleet", in_no_time("hop_ppm"))
    return HandlerTable(
        table.decides, {event: tuple(map(quick, several)) for event, several in table.reacts.items()}, table.actors
    )


def _decided_as_one(_state: State, event: Event) -> Event:
    agent: Agent | None = flat(event).get("decided_by")
    if agent is None or not agent.startswith("agent/"):
        return event
    return decided_by(event, robot_of(agent))


_policy_now = partial(seeing, "knowledge", _snapshots_of_now)

KNOCKOUTS = (
    Knockout("acknowledged-handoffs", "dhma", {authority.PassExecution: _passed_at_once}),
    Knockout("planner-claims", "dhma", change=leaving_out(AuthorityClaimed, agents.EngagePlanner)),
    Knockout("recovery-disputes", "dhma", {recovery.Dispute: nothing}),
    Knockout("contract-questioning", "dhma", change=leaving_out(ContractQuestioned, agents.EngagePlanner)),
    Knockout(
        "policy-snapshots",
        "dhma",
        {
            request.EvaluateBid: _policy_now(request.evaluate_bid),
            execution.PlanOwnStep: _policy_now(execution.plan_own_step),
            DecideRoutine: _policy_now(execution.decide_routine),
        },
    ),
    Knockout("hop-latency", "dhma", change=_talking_in_no_time),
    Knockout("handoff-records", "dhma", {talk.HandOver: nothing}),
    Knockout("agent-decisions", "dhma", change=in_every_decision(_decided_as_one)),
    Knockout("nested-queries", "dhma", {authority.RunOutsider: nothing}),
)
