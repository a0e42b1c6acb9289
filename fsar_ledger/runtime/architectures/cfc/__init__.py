"""Centralized fleet controller: one coordinator decides everything on synced copies; robots only execute."""

from fsar_ledger.runtime.architectures.handler_table import COMMON, Growth, HandlerTable
from fsar_ledger.runtime.handlers import assistance

from . import coordinator, execution, recovery, request

CFC: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    coordinator,
    request,
    execution,
    recovery,
    own=coordinator.OWN,
    instead=coordinator.INSTEAD,
)

GROWTH = Growth(6, 350, 0, 12, 190, 0)
"""Every candidate is matched, but the more candidates there are, the fewer steps the coordinator gets to."""
