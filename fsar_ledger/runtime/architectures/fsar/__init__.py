"""Federated single-agent robotics: every robot stays one accountable principal, and the federation coordinates.

Paper: eq:federation, eq:fleet-model.
"""

from fsar_ledger.runtime.architectures.handler_table import Growth, HandlerTable
from fsar_ledger.runtime.handlers import (
    advertising,
    assistance,
    fleet,
    policy,
    registry,
    supervision,
    task,
    trust,
    withdrawal,
)
from fsar_ledger.runtime.handlers import authority as rights
from fsar_ledger.runtime.handlers import execution as bodies
from fsar_ledger.runtime.handlers import request as requests

from . import authority, availability, discovery, execution, recovery, request, request_reactions

_PUBLIC = (fleet, registry, advertising, requests, rights, trust, policy)

FSAR: HandlerTable = HandlerTable.of(
    task,
    bodies,
    assistance,
    supervision,
    withdrawal,
    discovery,
    request,
    request_reactions,
    execution,
    authority,
    recovery,
    availability,
    *_PUBLIC,
)

GROWTH = Growth(5, 350, 0, 3, 180, 2.0)
"""The registry names every candidate in its answer."""
