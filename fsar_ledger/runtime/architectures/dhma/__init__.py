"""Decomposition-heavy multi-agent fleet: every robot is four fleet-visible agents that negotiate."""

from fsar_ledger.runtime.architectures.wiring import Wiring, wire
from fsar_ledger.runtime.handlers import execution as bodies
from fsar_ledger.runtime.handlers import supervision, task, withdrawal

from . import agents, authority, execution, recovery, request, talk

DHMA: Wiring = wire(task, bodies, supervision, withdrawal, talk, agents, request, authority, execution, recovery)
