"""Mechanisms that can be switched off one at a time, to show which number each of them carries.

A switch changes one decision of one architecture and leaves the world as it is. It is for the record of
the fit; no switch is on in any published number.
"""

from typing import NamedTuple

import msgspec

from fsar_ledger.events import Event
from fsar_ledger.events.configuration import Configuration
from fsar_ledger.events.envelope import Architecture
from fsar_ledger.events.request import RequestClosed
from fsar_ledger.projections.fold import State
from fsar_ledger.runtime.architectures.cfc import execution as cfc_execution
from fsar_ledger.runtime.architectures.dhma import authority as dhma_authority
from fsar_ledger.runtime.architectures.dhma import recovery as dhma_recovery
from fsar_ledger.runtime.architectures.fsar import authority as fsar_authority
from fsar_ledger.runtime.architectures.fsar import request as fsar_request
from fsar_ledger.runtime.architectures.wiring import Wiring
from fsar_ledger.runtime.handlers.commands import CloseRequest, Command, Decide
from fsar_ledger.runtime.simulation import wiring


class Switch(NamedTuple):
    """One mechanism: what it is, whose it is, the metrics it should carry, and the decisions without it."""

    mechanism: str
    architecture: Architecture
    metrics: tuple[str, ...]
    decides: dict[type[Command], Decide]
    configuration: Configuration = "full"

    def structure(self) -> Wiring:
        """The architecture's wiring without the mechanism."""
        whole = wiring(self.architecture)
        return Wiring({**whole.decides, **self.decides}, whole.reacts, whole.actors)


def _nothing(_state: State, _command: Command) -> tuple[Event, ...]:
    return ()


def _closed_by_requester(state: State, command: CloseRequest) -> tuple[Event, ...]:
    return tuple(
        msgspec.structs.replace(event, decided_by=event.requested_by, path=(event.requested_by,)) if isinstance(event, RequestClosed) else event
        for event in fsar_request.close_request(state, command)
    )


def _passed_at_once(state: State, command: dhma_authority.PassExecution) -> tuple[Event, ...]:
    """The sender lets go in the same instant in which the receiver claims."""
    events = dhma_authority.pass_execution(state, command)
    acknowledged = dhma_authority.acknowledge_execution(state, dhma_authority.AcknowledgeExecution(command.action_id, command.round, command.sender))
    return (*acknowledged, *events)


SWITCHES: tuple[Switch, ...] = (
    Switch("closing by the coordination engine (else by the requester)", "fsar", ("governance_locality",), {CloseRequest: _closed_by_requester}),
    Switch("revocation waits for the request boundary (else no claim)", "fsar", ("authority_conflicts",), {fsar_authority.Revoke: _nothing}),
    Switch("requester's policy and fleet rule composed", "fsar", ("policy_violations",), {}, "without-policy-composition"),
    Switch("layered recovery", "fsar", ("recovery_containment", "human_intervention"), {}, "without-layered-recovery"),
    Switch("context changes make robots and supervisors claim (else no claim)", "cfc", ("authority_conflicts",), {cfc_execution.SafeStop: _nothing}),
    Switch("hand-off is acknowledged (else at once)", "dhma", ("authority_conflicts",), {dhma_authority.PassExecution: _passed_at_once}),
    Switch("recovery is disputed by an engaged planner", "dhma", ("recovery_containment", "reassignment_latency_s"), {dhma_recovery.Dispute: _nothing}),
)
