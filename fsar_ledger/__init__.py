"""An event-sourced audit ledger and replay analyzer for robot fleets, after the FSAR paper.

Python offers what the command line does, by the same names (docs/python.md):

    import fsar_ledger

    ledger = fsar_ledger.simulate("out/ledger", scenario="door-relay", runs=3).ledger
    ledger.metrics().polars()
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fsar_ledger.api.audit import Audit as Audit
    from fsar_ledger.api.events import Events as Events
    from fsar_ledger.api.events import LoggedEvent as LoggedEvent
    from fsar_ledger.api.explain import Account as Account
    from fsar_ledger.api.federate import federate as federate
    from fsar_ledger.api.key import key_new as key_new
    from fsar_ledger.api.key import key_public as key_public
    from fsar_ledger.api.key import witness_new as witness_new
    from fsar_ledger.api.ledger import Ledger as Ledger
    from fsar_ledger.api.ledger import open_ledger as open_ledger
    from fsar_ledger.api.prove import verify_proof as verify_proof
    from fsar_ledger.api.record import import_records as import_records
    from fsar_ledger.api.record import record as record
    from fsar_ledger.api.record import shards as shards
    from fsar_ledger.api.report import Reproduced as Reproduced
    from fsar_ledger.api.report import reproduce as reproduce
    from fsar_ledger.api.serve import principal_new as principal_new
    from fsar_ledger.api.simulate import Simulated as Simulated
    from fsar_ledger.api.simulate import simulate as simulate
    from fsar_ledger.api.table import Table as Table
    from fsar_ledger.api.verify import Verification as Verification
    from fsar_ledger.base import errors as errors
    from fsar_ledger.base.errors import FsarLedgerError as FsarLedgerError
    from fsar_ledger.base.workers import cluster as cluster
    from fsar_ledger.service.client import Client as Client
    from fsar_ledger.studies.calibration import calibrate as calibrate
    from fsar_ledger.studies.comparison import judge as judge
    from fsar_ledger.studies.placebo import placebo as placebo
    from fsar_ledger.studies.predictions import predict as predict
    from fsar_ledger.studies.robustness import ensemble as ensemble
    from fsar_ledger.studies.robustness import ranking as ranking
    from fsar_ledger.studies.sensitivity import sensitivity as sensitivity
    from fsar_ledger.studies.systems import systems as systems

__version__ = "0.20.0"

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

__all__ = sorted([*_HOME_OF, "errors"])


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
