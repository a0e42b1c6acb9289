"""Federated single-agent robotics: every robot stays one accountable principal, and the federation coordinates.

Paper: eq:federation, eq:fleet-model.
"""

from fsar_ledger.runtime.architectures import COMMON, PUBLIC, HandlerTable
from fsar_ledger.runtime.handlers import assistance, isolation

from . import authority, availability, discovery, execution, recovery, reports, request

FSAR: HandlerTable = HandlerTable.of(
    *COMMON,
    assistance,
    discovery,
    request,
    execution,
    authority,
    recovery,
    availability,
    reports,
    isolation,
    *PUBLIC,
)
