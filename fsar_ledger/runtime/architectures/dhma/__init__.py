"""Decomposition-heavy multi-agent fleet: every robot is four fleet-visible agents that negotiate."""

from fsar_ledger.runtime.architectures import COMMON, HandlerTable

from . import agents, execution, recovery, request

DHMA: HandlerTable = HandlerTable.of(
    *COMMON, agents, request, execution, recovery, own=request.OWN, instead=request.INSTEAD
)
