"""Federated single-agent robotics: every robot stays one accountable principal; the federation only coordinates."""

from fsar_ledger.runtime.architectures.wiring import Wiring, wire
from fsar_ledger.runtime.handlers import execution as bodies
from fsar_ledger.runtime.handlers import policy, supervision, task, trust

from . import authority, discovery, execution, recovery, request

FSAR: Wiring = wire(task, bodies, supervision, trust, policy, discovery, request, execution, authority, recovery)
