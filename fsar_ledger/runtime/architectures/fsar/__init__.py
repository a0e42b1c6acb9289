"""Federated single-agent robotics: every robot stays one accountable principal; the federation only coordinates."""

from fsar_ledger.runtime.architectures.wiring import Wiring, wire
from fsar_ledger.runtime.handlers import authority as rights
from fsar_ledger.runtime.handlers import execution as bodies
from fsar_ledger.runtime.handlers import request as requests
from fsar_ledger.runtime.handlers import supervision, task

from . import authority, discovery, execution, recovery, request

FSAR: Wiring = wire(task, bodies, supervision, discovery, request, execution, authority, recovery, requests, rights)
