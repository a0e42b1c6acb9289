"""Decomposition-heavy multi-agent fleet: every robot is four fleet-visible agents that negotiate."""

from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers.shared import COMMON

from . import agents, authority, execution, recovery, request, request_reactions, talk

DHMA: HandlerTable = HandlerTable.of(*COMMON, talk, agents, request, request_reactions, authority, execution, recovery)
