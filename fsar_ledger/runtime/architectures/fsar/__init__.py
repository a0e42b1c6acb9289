"""Federated single-agent robotics: every robot stays one accountable principal; the federation only coordinates."""

from ...handlers import execution as bodies
from ...handlers import supervision, task
from ..wiring import Wiring, wire
from . import authority, execution, recovery, request

FSAR: Wiring = wire(task, bodies, supervision, request, execution, authority, recovery)
