"""Decomposition-heavy multi-agent fleet: every robot is four fleet-visible agents that negotiate."""

from fsar_ledger.runtime.architectures.handler_table import COMMON, Growth, HandlerTable

from . import agents, execution, recovery, request

DHMA: HandlerTable = HandlerTable.of(*COMMON, agents, request, execution, recovery)

GROWTH = Growth(17, 670, 10.2, 3, 450, 5.2)
"""Every candidate bids, which takes three agents and a record of each message between them."""
