"""Decomposition-heavy multi-agent fleet: every robot is four fleet-visible agents that negotiate."""

from ...handlers import execution as bodies
from ...handlers import supervision, task
from ..wiring import Wiring, wire
from . import agents, authority, execution, recovery, request

DHMA: Wiring = wire(task, bodies, supervision, agents, request, authority, execution, recovery)
