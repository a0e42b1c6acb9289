"""Federated single-agent robotics: every robot stays one accountable principal, and the federation coordinates.

Paper: eq:federation, eq:fleet-model.
"""

from fsar_ledger.runtime.architectures.handler_table import HandlerTable
from fsar_ledger.runtime.handlers import assistance
from fsar_ledger.runtime.handlers.shared import COMMON, PUBLIC

from . import authority, availability, discovery, execution, recovery, request, request_reactions

FSAR: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    discovery,
    request,
    request_reactions,
    execution,
    authority,
    recovery,
    availability,
    *PUBLIC,
)
