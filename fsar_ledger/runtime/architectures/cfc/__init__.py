"""Centralized fleet controller: one coordinator decides everything on synced copies; robots only execute."""

from fsar_ledger.runtime.architectures import COMMON, HandlerTable
from fsar_ledger.runtime.handlers import assistance

from . import coordinator, execution, request

CFC: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    coordinator,
    request,
    execution,
    own=coordinator.OWN,
    instead=coordinator.INSTEAD,
)
