"""Centralized fleet controller: one coordinator decides everything on synced copies; robots only execute."""

from fsar_ledger.runtime.architectures.handler_table import Growth, HandlerTable
from fsar_ledger.runtime.handlers import assistance, supervision, task, withdrawal
from fsar_ledger.runtime.handlers import execution as bodies

from . import answers, coordinator, execution, recovery, request

CFC: HandlerTable = HandlerTable.of(
    task,
    bodies,
    assistance,
    supervision,
    withdrawal,
    coordinator,
    request,
    execution,
    recovery,
    own=answers.OWN,
    instead=answers.INSTEAD,
)

GROWTH = Growth(6, 350, 0, 12, 190, 0)
"""Every candidate is matched, but the more candidates there are, the fewer steps the coordinator gets to."""
