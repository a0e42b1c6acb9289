"""An event-sourced audit ledger and replay analyzer for robot fleets, after the FSAR paper.

Python offers what the command line does, by the same names (docs/python.md):

    import fsar_ledger

    ledger = fsar_ledger.simulate("out/ledger", scenario="door-relay", runs=3).ledger
    ledger.metrics().polars()
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fsar_ledger.api.audit import Audit
    from fsar_ledger.api.events import Events, LoggedEvent
    from fsar_ledger.api.explain import Account
    from fsar_ledger.api.federate import federate
    from fsar_ledger.api.key import key_new, key_public, witness_new
    from fsar_ledger.api.ledger import Ledger, open_ledger
    from fsar_ledger.api.prove import verify_proof
    from fsar_ledger.api.record import import_records, record, shards
    from fsar_ledger.api.report import Reproduced, reproduce
    from fsar_ledger.api.serve import principal_new
    from fsar_ledger.api.simulate import Simulated, simulate
    from fsar_ledger.api.table import Table
    from fsar_ledger.api.verify import Verification
    from fsar_ledger.base import errors
    from fsar_ledger.base.errors import FsarLedgerError
    from fsar_ledger.base.workers import cluster
    from fsar_ledger.service.client import Client
    from fsar_ledger.studies.calibration import calibrate
    from fsar_ledger.studies.comparison import judge
    from fsar_ledger.studies.placebo import placebo
    from fsar_ledger.studies.predictions import predict
    from fsar_ledger.studies.robustness import ensemble, ranking
    from fsar_ledger.studies.sensitivity import sensitivity
    from fsar_ledger.studies.systems import systems

__version__ = "0.19.0"

__all__ = [
    "Account",
    "Audit",
    "Client",
    "Events",
    "FsarLedgerError",
    "Ledger",
    "LoggedEvent",
    "Reproduced",
    "Simulated",
    "Table",
    "Verification",
    "calibrate",
    "cluster",
    "ensemble",
    "errors",
    "federate",
    "import_records",
    "judge",
    "key_new",
    "key_public",
    "open_ledger",
    "placebo",
    "predict",
    "principal_new",
    "ranking",
    "record",
    "reproduce",
    "sensitivity",
    "shards",
    "simulate",
    "systems",
    "verify_proof",
    "witness_new",
]

_HOMES = {
    "api.audit": ("Audit",),
    "api.events": ("Events", "LoggedEvent"),
    "api.explain": ("Account",),
    "api.federate": ("federate",),
    "api.key": ("key_new", "key_public", "witness_new"),
    "api.ledger": ("Ledger", "open_ledger"),
    "api.prove": ("verify_proof",),
    "api.record": ("import_records", "record", "shards"),
    "api.report": ("Reproduced", "reproduce"),
    "api.serve": ("principal_new",),
    "api.simulate": ("Simulated", "simulate"),
    "api.table": ("Table",),
    "api.verify": ("Verification",),
    "base.errors": ("FsarLedgerError",),
    "base.workers": ("cluster",),
    "service.client": ("Client",),
    "studies.calibration": ("calibrate",),
    "studies.comparison": ("judge",),
    "studies.placebo": ("placebo",),
    "studies.predictions": ("predict",),
    "studies.robustness": ("ensemble", "ranking"),
    "studies.sensitivity": ("sensitivity",),
    "studies.systems": ("systems",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    """Load a public name on first use, so that importing the package loads no library."""
    if name == "errors":
        return import_module(f"{__name__}.base.errors")
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME_OF[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
