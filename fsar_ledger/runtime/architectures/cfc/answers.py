"""CFC: the coordinator calls supervisors, and records their answers without naming who asked.

Paper: sec:evaluation:baselines.
"""

from fsar_ledger.events import Event
from fsar_ledger.events.envelope import COORDINATOR
from fsar_ledger.events.supervision import SupervisorCalled
from fsar_ledger.projections.fold import State
from fsar_ledger.projections.request import Request
from fsar_ledger.runtime.handlers import supervision
from fsar_ledger.runtime.handlers.commands import Decides, React, Respond, Scheduled
from fsar_ledger.runtime.handlers.supervision import RespondToCall


def _nobody(_request: Request) -> None:
    return None


def respond(state: State, command: Respond) -> tuple[Event, ...]:
    """Record the answer that the called supervisor gave the coordinator, which does not know the requester."""
    return supervision.respond(state, command, _nobody)


def respond_to_call(state: State, command: RespondToCall) -> tuple[Event, ...]:
    """Let the supervisor who was called answer the open call."""
    return supervision.respond_to_call(state, command, _nobody)


def _on_call(state: State, event: SupervisorCalled, _now_us: int) -> tuple[Scheduled, ...]:
    return supervision.awaiting(state, event, COORDINATOR)


INSTEAD: dict[React, React] = {supervision.on_call: _on_call}
OWN: Decides = {Respond: respond, RespondToCall: respond_to_call}
