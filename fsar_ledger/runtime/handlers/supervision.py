"""The fleet supervisor H_F decides what is put before them, after a while. Paper: eq:supervision."""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import FLEET_SUPERVISOR
from fsar_ledger.events.recovery import FailureResolved
from fsar_ledger.events.supervision import ActuatorServiced, SupervisorCalled, SupervisorResponded
from fsar_ledger.projections.fold import State

from .commands import Decides, Draw, Reacts, Respond, Scheduled


def respond(state: State, command: Respond) -> tuple[Event, ...]:
    """H_F has approved the review, ordered the commands, or resolved the failure (and had a degraded robot serviced)."""
    action = state.execution.actions.get(command.action_id)
    request = state.request.get(command.action_id)
    if request is None and action is None:
        return ()
    is_cfc = state.fleet.architecture == "cfc"
    if action is not None:
        task_id, requested_by, executed_by = action.task_id, action.requested_by, action.executed_by
    else:
        assert request is not None
        task_id, executed_by = request.task_id, request.target
        requested_by = None if is_cfc else request.requester
    responded = SupervisorResponded(
        task_id,
        command.action_id,
        FLEET_SUPERVISOR,
        requested_by,
        executed_by,
        FLEET_SUPERVISOR,
        (FLEET_SUPERVISOR,),
        command.purpose,  # type: ignore[arg-type]
    )
    recovery = state.recovery.get(command.action_id)
    if command.purpose != "recovery" or recovery is None:
        return (responded,)
    resolved = FailureResolved(task_id, command.action_id, recovery.robot, recovery.failure, "human")
    if recovery.robot in state.world.degraded:
        return (responded, ActuatorServiced(recovery.robot), resolved)
    return (responded, resolved)


def _on_call(state: State, event: SupervisorCalled, _now_us: int) -> tuple[Scheduled, ...]:
    action = state.execution.actions.get(event.action_id)
    ordinal = action.failures if action is not None else 0
    share = state.fleet.structure.ordering_response_ppm if event.purpose == "ordering" else 1_000_000
    response = Draw("response", f"{event.action_id}/{event.purpose}/{ordinal}", share)
    return (Scheduled(Respond(event.action_id, event.purpose), 0, (response,)),)


DECIDES: Decides = {Respond: respond}
REACTS: Reacts = {SupervisorCalled: _on_call}
