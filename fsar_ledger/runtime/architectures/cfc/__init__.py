"""Centralized fleet controller: one coordinator decides everything on synced copies; robots only execute."""

from ...handlers import execution as bodies
from ...handlers import supervision, task
from ..wiring import Wiring, wire
from . import coordinator, execution, recovery, request

CFC: Wiring = wire(task, bodies, supervision, coordinator, request, execution, recovery)
