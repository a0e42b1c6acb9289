"""List every number that the paper's result tables print, with its class and outcome, for the first page.

Nothing is judged here: the answers are those of the tables (`gives`, the signs and levels of the tests), by the
registered rules. A number that the paper's own text excludes does not stand, whatever the runs show. A number that
depends on a dial which the text leaves open is not judged; it gets the range over that dial.
"""

import platform
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from importlib.resources.abc import Traversable
from typing import Any

import msgspec

import fsar_ledger
from fsar_ledger.base import printable
from fsar_ledger.base.parameters import read_parameters
from fsar_ledger.metrics import verdicts
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.study_results import Comparison, changed, packaged
from fsar_ledger.report.findings import Findings, LedgerHead, Row, Workflows
from fsar_ledger.report.printing import flat, words

STANDS, FAILS, UNDECIDED, OPEN = "stands", "does not", "undecided", "open"
OUTCOMES = (STANDS, FAILS, UNDECIDED, OPEN)

TABLES: Mapping[str, str] = {
    "results": "Evaluation results",
    "ablation": "Ablation",
    "ablation_text": "Ablation (text)",
    "cases": "Cases",
    "significance": "Significance",
    "scaling": "Scaling",
}
"""The tables in the paper's order, as the first page names them."""

FITTED, INFORMED, EXCLUDED, UNSPECIFIED = "fitted", "informed", "cannot follow", "unspecified"
BY_CONSTRUCTION = "by construction"
ALL = "all"
"""How the table of cases writes a share of 1."""


def numbers(findings: Findings, *, is_fitted: bool = True) -> tuple[Row, ...]:
    """Return one row for each printed number of the tables that we have runs for, in the paper's order.

    Columns: table, metric, architecture, configuration, fleet_size, scenario, comparison, case (None where they do not
    apply), class, printed (as in the paper), paper, ours, n, interval, difference (90 %), margin, distance and reach
    (the 90 % interval, or the range over an open dial; both in margins), gives, share, could, outcome. With `is_fitted`
    False the fit was of another model, and no number counts as fitted.
    """
    rows = [
        _row("results", row, _class(row, is_fitted=is_fitted))
        for row in findings.cells
        if any(one["mean"] is not None for one in findings.cells)
    ]
    if (ablation := findings.ablation) is not None:
        rows += [
            _row(name, row, row["class"], _dialled(row, ablation.curve))
            for name, found in (("ablation", ablation.cells), ("ablation_text", ablation.text))
            for row in found
        ]
    rows += [_case(row) for row in findings.cases]
    rows += [_test(row) for row in findings.tests if any(one["t"] is not None for one in findings.tests)]
    if (scaling := findings.scaling) is not None:
        rows += [
            _row("scaling", row, row["class"], [row["mean"], row["one"], *_dialled(row, scaling.curve, "fleet_size")])
            for row in scaling.cells
        ]
    return tuple(rows)


def _class(row: Row, *, is_fitted: bool) -> str:
    kind = (
        registration()
        .declaration_for("results", {"metric": row["metric"], "architecture": row["architecture"]})
        .kind.replace("_", " ")
    )
    return INFORMED if kind == FITTED and not is_fitted else kind


def _dialled(row: Row, curve: Iterable[Row], *further: str) -> list[float | None]:
    """Return our means of this number at every position of the dial that the text leaves open.

    `further` names columns that must match in addition to the usual ones.
    """
    same = ("metric", "architecture", "configuration", "scenario", *further)
    return [point["mean"] for point in curve if all(point[name] == row[name] for name in same)]


def _row(table: str, row: Row, kind: str, dial: Sequence[float | None] = ()) -> Row:
    margin = verdicts.MARGINS[row["metric"]]
    given = [mean - row["paper"] for mean in dial if mean is not None] if kind == UNSPECIFIED else []
    ends = (min(given), max(given)) if given else row["difference"]
    return _blank(table) | {
        **{
            name: row.get(name)
            for name in ("metric", "architecture", "configuration", "fleet_size", "scenario", "n", "interval", "paper")
        },
        **{name: row[name] for name in ("difference", "distance", "gives", "share", "could")},
        "class": kind,
        "printed": row["paper_printed"],
        "ours": row["mean"],
        "margin": margin,
        "reach": None if ends is None else (ends[0] / margin, ends[1] / margin),
        "outcome": _outcome(kind, row["gives"]),
    }


def _outcome(kind: str, gives: str | None) -> str:
    if kind in (EXCLUDED, UNSPECIFIED):
        return FAILS if kind == EXCLUDED else OPEN
    return {"yes": STANDS, "no": FAILS}.get(gives or "", UNDECIDED)


def _case(row: Row) -> Row:
    """Return a number of a case. It is decided if a mechanism restates it, since no chance is involved then.

    No margin was registered for the others.
    """
    paper, ours = 1.0 if row["paper"] == ALL else float(row["paper"]), row["value"]
    is_exact = row["class"] == BY_CONSTRUCTION and ours is not None
    told = {name: row[name] for name in ("case", "architecture", "class")} | {
        "printed": row["paper"],
        "paper": paper,
        "ours": ours,
    }
    return _blank("cases") | told | {"outcome": (STANDS if ours == paper else FAILS) if is_exact else UNDECIDED}


def _test(row: Row) -> Row:
    """Return a pairwise test: it stands if the sign of t and the level of significance are as printed."""
    is_made, agrees = row["sign_agrees"] is not None, row["sign_agrees"] and row["level_agrees"]
    return _blank("significance") | {
        **{name: row[name] for name in ("metric", "comparison", "n")},
        "class": INFORMED,
        "printed": f"{row['paper_level']}",
        "paper": row["paper_t"],
        "ours": row["t"],
        "outcome": (STANDS if agrees else FAILS) if is_made else UNDECIDED,
    }


def _blank(table: str) -> Row:
    where = ("metric", "architecture", "configuration", "fleet_size", "scenario", "comparison", "case")
    ours = (
        "class",
        "printed",
        "paper",
        "ours",
        "n",
        "interval",
        "difference",
        "margin",
        "distance",
        "reach",
        "gives",
        "share",
        "could",
        "outcome",
    )
    return {"table": table} | dict.fromkeys((*where, *ours))


def missing(rows: Iterable[Row]) -> list[str]:
    """Name the tables that no run is of."""
    held = {row["table"] for row in rows}
    return [title for name, title in TABLES.items() if name not in held]


def tally(rows: Sequence[Row]) -> list[Row]:
    """Return how many numbers each table and class has and what became of them, then a row for all."""
    counts: dict[tuple[str, str], Counter[str]] = {}
    for table in TABLES:
        for row in rows:
            if row["table"] == table:
                counts.setdefault((table, row["class"]), Counter())[row["outcome"]] += 1
    found: list[Row] = [
        {"table": TABLES[table], "class": kind, **_counted(counted)} for (table, kind), counted in counts.items()
    ]
    return [*found, {"table": "All", "class": "", **_counted(sum(counts.values(), Counter()))}] if found else []


def _counted(counts: Mapping[str, int]) -> Row:
    return {"printed": sum(counts.values()), **{name: counts.get(name, 0) for name in OUTCOMES}}


def said(rows: Sequence[Row]) -> dict[str, Any]:
    """Return the counts for the three sentences of the first page, and the tables that are missing.

    The sentences say what stands, what does not, and what cannot be decided.
    """
    of = {outcome: [row for row in rows if row["outcome"] == outcome] for outcome in OUTCOMES}
    outside = [row for row in of[OPEN] if row["reach"] is not None and (row["reach"][0] > 1 or row["reach"][1] < -1)]
    told = [row for row in of[OPEN] if row["reach"] is not None]
    return {
        "printed": len(rows),
        "tables": [title for name, title in TABLES.items() if any(row["table"] == name for row in rows)],
        "missing": missing(rows),
        "stands": len(of[STANDS]),
        "stands_by": _by_class(of[STANDS]),
        "fails": len(of[FAILS]),
        "fails_by": _by_class(of[FAILS]),
        "could": sum(row["could"] == "yes" for row in of[FAILS] if row["class"] != EXCLUDED),
        "drawn": sum(row["could"] is not None for row in of[FAILS] if row["class"] != EXCLUDED),
        "undecided": len(of[UNDECIDED]),
        "unregistered": sum(
            row["table"] == "cases" and row["class"] != BY_CONSTRUCTION and row["ours"] is not None
            for row in of[UNDECIDED]
        ),
        "open": len(of[OPEN]),
        "open_told": len(told),
        "outside": len(outside),
    }


def _by_class(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """Count the rows of each class, the largest class first."""
    return [
        {"class": kind, "count": count}
        for kind, count in sorted(Counter(row["class"] for row in rows).items(), key=lambda item: (-item[1], item[0]))
    ]


# See docs/decisions/fit-is-registered-first.md.
def judged(findings: Findings, folder: Traversable | None = None) -> Comparison | None:
    """Return the result in this folder (default: the packaged one), None if absent, or of another model or constants.

    Raises: FsarLedgerError if the file is not such a result.
    """
    if (found := packaged(Comparison, folder)) is None:
        return None
    constants = dict(flat("", read_parameters(found.parameters)))
    return found if (found.model_version, constants) == (findings.model_version, findings.parameters) else None


def outcomes(found: Comparison | None) -> list[Row]:
    """Return a row for each prediction."""
    return [
        {"name": one.name, "implies": one.implies, "checks": f"{one.held} of {one.of}", "holds": one.holds}
        for one in (found.predictions if found else ())
    ]


def predictions_said(found: Comparison | None) -> Row | None:
    """Say which predictions hold, which do not, and which cannot be decided; None without predictions.

    Where a query has changed since they were judged, the sentence names it.
    """
    rows = outcomes(found)
    if found is None or not rows:
        return None
    kept, failed, open_ones = (
        [row["name"] for row in rows if row["holds"] is answer] for answer in (True, False, None)
    )
    holds = f"{len(kept)} {'holds' if len(kept) == 1 else 'hold'}{_listed(kept)}"
    fails = f"{len(failed)} {'does' if len(failed) == 1 else 'do'} not{_listed(failed)}"
    undecided = f"; {len(open_ones)} cannot be decided{_listed(open_ones)}" if open_ones else ""
    later = changed(found.rules)
    since = f"; they were judged before {printable.some(map(words, later))} changed, and not again" if later else ""
    of = f"Of {len(rows)} predictions registered before they were run"
    return {"sentence": f"{of}, {holds} and {fails}{undecided}{since}."}


def _listed(names: Sequence[str]) -> str:
    return f" ({', '.join(names)})" if names else ""


PACKAGES = ("duckdb", "pyarrow", "numpy", "scipy", "msgspec", "matplotlib", "typst")


def versions() -> dict[str, str]:
    """Return the versions of the software that made the report, by name."""
    ours = {"fsar-ledger": fsar_ledger.__version__, "Python": platform.python_version()}
    return ours | {name: version(name) for name in PACKAGES}


def reproduction(findings: Findings, counted: Sequence[Row]) -> bytes:
    """Return the text of the file.

    It holds heads, model, all printed numbers beside ours (`numbers`), the tests, the multiverse and the
    digests of the queries. Values are in the units of the queries, shares in [0, 1]; null is what is undefined, not
    judged or not drawn.
    """
    read = findings.multiverse
    parts = {"ablation": findings.ablation, "scaling": findings.scaling, "mechanisms": findings.mechanisms}
    held = {name: part and part.head for name, part in parts.items()} | {"workflows": findings.workflows}
    said: dict[str, Any] = {
        "versions": versions(),
        "ledgers": {"results": _head(findings)} | {name: _head(one) for name, one in held.items() if one},
        "model_version": findings.model_version,
        "constants": findings.parameters,
        "parameters_sha256": findings.parameters_sha256,
        "tally": tally(counted),
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


def _head(one: Findings | LedgerHead | Workflows) -> Mapping[str, str | int]:
    """Return the head of the ledger that the numbers are from."""
    return {"commits": one.commits, "events": one.size, "root": one.root, "runs": one.run_count}
