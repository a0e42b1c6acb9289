"""Centralized fleet controller: one coordinator decides everything on synced copies; robots only execute."""

from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers import assistance
from fsar_ledger.runtime.handlers.shared import COMMON

from . import answers, coordinator, execution, recovery, request

CFC: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    coordinator,
    request,
    execution,
    recovery,
    own=answers.OWN,
    instead=answers.INSTEAD,
)
