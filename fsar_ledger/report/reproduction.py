"""Write everything that the report says in numbers, for programs: `reproduction.json` beside the PDF.

The same heads and versions give the same bytes.
"""

import platform
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

import msgspec

import fsar_ledger
from fsar_ledger.report import numbers
from fsar_ledger.report.findings import Findings, Row, Told, Workflows

PACKAGES = ("duckdb", "pyarrow", "numpy", "scipy", "msgspec", "matplotlib", "typst")


def versions() -> dict[str, str]:
    """Return the versions of the software that made the report, by name."""
    ours = {"fsar-ledger": fsar_ledger.__version__, "Python": platform.python_version()}
    return ours | {name: version(name) for name in PACKAGES}


def reproduction(findings: Findings, counted: Sequence[Row]) -> bytes:
    """Return the text of the file.

    It holds heads, model, all printed numbers beside ours (`numbers.numbers`), the tests, the multiverse and the
    digests of the queries. Values are in the units of the queries, shares in [0, 1]; null is what is undefined, not
    judged or not drawn.
    """
    read = findings.multiverse
    parts = {"ablation": findings.ablation, "scaling": findings.scaling, "mechanisms": findings.mechanisms}
    held = {name: part and part.told for name, part in parts.items()} | {"workflows": findings.workflows}
    said: dict[str, Any] = {
        "versions": versions(),
        "ledgers": {"results": _head(findings)} | {name: _head(one) for name, one in held.items() if one},
        "model_version": findings.model_version,
        "constants": findings.parameters,
        "parameters_sha256": findings.parameters_sha256,
        "tally": numbers.tally(counted),
        "numbers": counted,
        "table_share": findings.table_share,
        "tests": findings.tests,
        "scenarios": findings.scenarios,
        "mechanisms": None if findings.mechanisms is None else findings.mechanisms.rows,
        "multiverse": None
        if read is None
        else {"readings": read.readings, "cells": read.cells, "rankings": read.rankings, "universes": read.universes},
        "queries": {one.name: one.sha256 for one in findings.sources},
    }
    return msgspec.json.format(msgspec.json.encode(said, order="deterministic"), indent=1) + b"\n"


def _head(one: Findings | Told | Workflows) -> Mapping[str, str | int]:
    """Return the head of the ledger that the numbers are from."""
    return {"commits": one.commits, "events": one.size, "root": one.root, "runs": one.run_count}
