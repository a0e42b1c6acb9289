"""Lay out the findings as a document for the template: tables, figures, passages and numbers, as JSON."""

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import zip_longest
from typing import Any

import msgspec

import fsar_ledger
from fsar_ledger.base import printable
from fsar_ledger.designs import constants
from fsar_ledger.designs.constants import Constants, write_constants
from fsar_ledger.metrics.definitions import metric_named, published_metrics
from fsar_ledger.metrics.registration import registration
from fsar_ledger.metrics.study_results import Calibration, changed
from fsar_ledger.report import (
    all_readings,
    contradictions,
    figures,
    mechanisms,
    numbers,
    printing,
    sections,
    sequence,
    specs,
)
from fsar_ledger.report.findings import Findings, Row, answer
from fsar_ledger.report.numbers import versions
from fsar_ledger.report.printing import Table, flat
from fsar_ledger.report.sensitivity import Section

POOLED = tuple(one.name for one in published_metrics() if one.is_pooled)  # a run without failures does not define them
MAX_DIFFERING = 2_000  # characters of the sentence on a pair's worlds
SHOWN_WEIGHTS = 3  # constants named for each direction of the fit


def _source(findings: Findings, query: str | None) -> str:
    """Return the file of the query behind a table's numbers; "" if it has none.

    The appendix lists the SHA-256 of that file.
    """
    return f"queries/{query}.sql" if any(one.name == query for one in findings.sources) else ""


def _table(findings: Findings, name: str, rows: Sequence[Row]) -> Table:
    return printing.table(name, rows, _source(findings, specs.table(name).query))


def _constants(items: Mapping[str, str]) -> list[Row]:
    """Return the constants in two columns, each with where its value is from."""
    words, ours = constants.origins(), dict(flat("", msgspec.json.decode(write_constants(Constants()))))
    said = [
        (name, value, words.get(name, constants.GIVEN) if ours.get(name) == value else constants.GIVEN)
        for name, value in items.items()
    ]
    half = (len(said) + 1) // 2
    pairs = zip_longest(said[:half], said[half:], fillvalue=("", "", ""))
    return [
        dict(zip(("name", "value", "from", "name2", "value2", "from2"), (*one, *other), strict=True))
        for one, other in pairs
    ]


def _versions() -> list[Row]:
    return [{"name": name, "version": one} for name, one in versions().items()]


def _ledger_tables(findings: Findings) -> dict[str, Table]:
    rows: dict[str, Sequence[Row]] = {
        "evaluation-results": findings.cells,
        "background": findings.background,
        "published-convention": [row for row in findings.cells if row["metric"] in POOLED],
        "verdict-rule": findings.rule,
        "statistical-significance": findings.tests,
        "pooled-tests": [row for row in findings.tests if row["metric"] in POOLED],
        "scenario-means": findings.scenarios,
        "cases": findings.cases,
        "other-runs": findings.others,
        "architectural-comparison": findings.features if findings.evidence else (),
        "feature-evidence": findings.evidence,
        "runs": findings.runs,
        "models": findings.models,
        "constants": _constants(findings.parameters),
        "queries": [msgspec.structs.asdict(one) for one in findings.sources],
        "versions": _versions(),
    }
    return {name: _table(findings, name, filled) for name, filled in rows.items() if filled}


def _workflow_tables(findings: Findings) -> dict[str, Table]:
    found, name = findings.workflows, "mechanism-coverage"
    return (
        {}
        if found is None
        else {name: printing.table(name, found.coverage, _source(findings, specs.table(name).query))}
    )


def _workflows(findings: Findings) -> dict[str, Any] | None:
    """Return the head of the ledger of workflows, and why cells differ; None without such a ledger."""
    found = findings.workflows
    if found is None:
        return None
    reasons = [reason for row in found.coverage for reason in row["reasons"]]
    head = {
        "size": printing.integer(found.size),
        "root": found.root,
        "runs": printing.integer(found.run_count),
        "commits": found.commits,
    }
    return head | {"reasons": reasons, "others": found.others and printable.counted(found.others, "run")}


def _fit_tables(findings: Findings, record: Calibration | None) -> dict[str, Table]:
    if record is None:
        return {}
    directions = [
        {
            "position": position,
            "singular_value": one.singular_value,
            "identified": one.identified,
            "weights": _weights(one.weights),
        }
        for position, one in enumerate(record.directions, 1)
    ]
    rows: dict[str, Sequence[Row]] = {
        "calibrated-parameters": [msgspec.structs.asdict(one) for one in record.parameters],
        "residuals": [msgspec.structs.asdict(one) for one in record.residuals],
        "directions": directions,
    }
    return {name: _table(findings, name, filled) for name, filled in rows.items() if filled}


def _weights(weights: Mapping[str, float]) -> str:
    largest = sorted(weights.items(), key=lambda item: (-abs(item[1]), item[0]))[:SHOWN_WEIGHTS]
    return ", ".join(f"{name} {printing.number(weight, 2)}" for name, weight in largest)


def _figure(findings: Findings, name: str) -> dict[str, Any]:
    spec = specs.figure(name)
    return {
        "file": f"{name}.svg",
        "title": spec.title,
        "caption": spec.caption,
        "alt": spec.alt,
        "width_in": spec.width_in,
        "source": _source(findings, spec.query),
    }


def _contradictions() -> list[dict[str, Any]]:
    computed = contradictions.facts()
    return [
        {
            "title": one.title,
            "claim": one.claim.format(**computed[one.id]),
            "arithmetic": one.arithmetic.format(**computed[one.id]),
            "paper": one.paper,
            "table": one.table,
        }
        for one in specs.contradictions()
    ]


def _changed(findings: Findings, record: Calibration | None) -> str | None:
    """Say that the record of the fit is of another model than these runs, or of other queries than judge them.

    None if it is of theirs, or if either is missing.
    """
    versions = (
        [findings.model_version]
        if findings.model_version
        else sorted({row["model_version"] for row in findings.models} - {None})
    )
    if record is None or not versions:
        return None
    if versions == [record.model_version]:
        return _judged_otherwise(record)
    ran = f"of version{'' if len(versions) == 1 else 's'} {printable.some(map(printing.words, versions))}"
    fitted = (
        "a model whose version is not on record"
        if record.model_version is None
        else f"model version {printing.words(record.model_version)}"
    )
    return f"The model has changed since the fit: the constants were fitted to {fitted}, and these runs are {ran}."


def _judged_otherwise(record: Calibration) -> str | None:
    if record.rules is None:
        return "The record of the fit does not say which queries judged its runs."
    if not (found := changed(record.rules)):
        return None
    return f"What judges the runs has changed since the fit: {printable.some(map(printing.words, found))}."


def _fit(findings: Findings, record: Calibration | None) -> dict[str, Any] | None:
    if record is None:
        return None
    objective = None if record.objective is None else msgspec.structs.asdict(record.objective)
    return {
        "objective": objective,
        "seeds": record.seeds,
        "runs_per_scenario": record.runs_per_scenario,
        "evaluations": record.evaluations,
        "model_version": record.model_version,
        "command": record.command,
        "constants": len(record.parameters),
        "identified": sum(one.identified for one in record.directions),
        "directions": len(record.directions),
        "changed": _changed(findings, record),
        # A fit under this registration came after the trial that the registration describes.
        "trial": record.model_version == registration().model_version,
    }


def _background(findings: Findings) -> list[dict[str, str]]:
    """Return what share of decisions and records is routine, and of records under an absence, in percent.

    Architectures without decisions or records are left out.
    """
    shares = {
        "decisions": "routine_share_of_decisions",
        "local": "routine_share_of_local_decisions",
        "records": "routine_share_of_coordination_events",
        "absent": "off_shift_share_of_coordination_events",
    }
    return [
        {"architecture": row["architecture"].upper()}
        | {name: "" if row[key] is None else printing.significant(100 * row[key], 3) for name, key in shares.items()}
        for row in findings.background
        if row["routine_share_of_decisions"] is not None and row["routine_share_of_coordination_events"] is not None
    ]


def _misses(findings: Findings, record: Calibration | None) -> list[dict[str, Any]]:
    """Return the cells whose printed number this model does not give, the farthest first.

    Each has the reason on record, if the record is of this model.
    """
    reasons = {} if _changed(findings, record) else {passage.id: passage.text for passage in specs.passages("reasons")}
    missing = sorted((row for row in findings.cells if row["gives"] == "no"), key=lambda row: -abs(row["distance"]))
    return [
        {
            "title": f"{metric_named(row['metric']).title}, {row['architecture'].upper()}",
            "distance": printing.number(row["distance"], 1),
            "reason": reasons.get(f"{row['metric']}/{row['architecture']}"),
        }
        for row in missing
    ]


def counted(findings: Findings, record: Calibration | None) -> tuple[Row, ...]:
    """Return every printed number with its class and outcome.

    None counts as fitted if the fit was of another model.
    """
    return numbers.numbers(findings, is_fitted=not _changed(findings, record))


def _heads(findings: Findings) -> list[dict[str, str]]:
    """Return the heads of the other ledgers, for the appendix."""
    parts = {"Ablation": findings.ablation, "Scaling": findings.scaling, "Mechanisms": findings.mechanisms}
    held = {name: part and part.head for name, part in parts.items()} | {"Workflows": findings.workflows}
    return [
        {"name": name, "size": printing.integer(one.size), "runs": printing.integer(one.run_count), "root": one.root}
        for name, one in held.items()
        if one
    ]


def data(findings: Findings, record: Calibration | None, effects: Section | None = None) -> dict[str, Any]:
    """Return everything that the template prints; tables keep each value beside its printed form."""

    def sourced(query: str | None) -> str:
        return _source(findings, query)

    tables = _ledger_tables(findings) | _fit_tables(findings, record) | _workflow_tables(findings)
    tables |= (
        sections.tables(findings, sourced)
        | mechanisms.tables(findings, sourced)
        | all_readings.tables(findings.multiverse)
    )
    tables |= {name: _table(findings, name, rows()) for name, rows in contradictions.TABLES.items()}
    rows, judged = counted(findings, record), numbers.judged(findings)
    foretold = numbers.outcomes(judged)
    tables |= {"predictions": _table(findings, "predictions", foretold)} if foretold else {}
    tables |= {"tally": _table(findings, "tally", numbers.tally(rows))} if rows else {}
    tables |= {"sensitivity": effects.table} if effects and effects.table else {}
    return {
        "head": {
            "commits": findings.commits,
            "size": printing.integer(findings.size),
            "root": findings.root,
            "runs": printing.integer(findings.run_count),
            "completeness": findings.completeness,
        },
        "heads": _heads(findings),
        "shown": findings.shown and printing.words(findings.shown),
        "unjudged": findings.unjudged and printing.words(findings.unjudged, MAX_DIFFERING),
        "differing": [printing.words(one, MAX_DIFFERING) for one in findings.differing],
        "answer": _sayable(answer(findings)),
        "said": numbers.said(rows),
        "every_way": all_readings.said(findings.multiverse),
        "tables": tables,
        "figures": {name: _figure(findings, name) for name in _drawers(findings)}
        | ({"sensitivity": _figure(findings, "sensitivity") | {"source": ""}} if effects and effects.figure else {}),
        "ablation": sections.ablation(findings),
        "scaling": sections.scaling(findings),
        "sensitivity": effects and effects.sentence,
        "workflows": _workflows(findings),
        "mechanisms": specs.passages("mechanisms"),
        "carried": mechanisms.sentences(findings),
        "readings": specs.passages("readings"),
        "contradictions": _contradictions(),
        "background": _background(findings),
        "misses": _misses(findings, record),
        "predictions": numbers.predictions_said(judged),
        "fit": _fit(findings, record),
        "version": fsar_ledger.__version__,
    }


def _sayable(numbers: Row) -> Row:
    """Return the answer with undefined cells named as in the tables."""
    undefined = [f"{metric_named(name).title} of {architecture.upper()}" for name, architecture in numbers["undefined"]]
    share = numbers["table_share"]
    return numbers | {"undefined": undefined, "table_share": None if share is None else printing.probability(share)}


def _drawers(findings: Findings) -> dict[str, sections.Drawer]:
    """Return how to draw each figure that these findings have, by name."""
    found: dict[str, sections.Drawer] = {
        "overview": lambda: figures.overview_figure(numbers.numbers(findings)),
        "evaluation-results": partial(figures.evaluation_results, findings.cells),
        "effects": partial(figures.effects, findings.tests),
    }
    flows = findings.workflows
    if flows is not None and flows.timeline:
        found["workflow-door-relay"] = partial(sequence.sequence, flows.timeline)
    if flows is not None and flows.recovery:
        found["workflow-layered-recovery"] = partial(sequence.ladder, flows.recovery)
    if findings.multiverse is not None:
        found["specification-curves"] = partial(all_readings.curves, findings.multiverse)
    return found | sections.drawers(findings)


def drawings(findings: Findings, effects: Section | None = None) -> dict[str, bytes]:
    """Return the figures as SVG, by file name."""
    drawn = {name: draw() for name, draw in _drawers(findings).items()} | (
        {"sensitivity": effects.figure} if effects and effects.figure else {}
    )
    return {f"{name}.svg": svg for name, svg in drawn.items()}


def encoded(document: Mapping[str, Any]) -> bytes:
    """Return the document as JSON; the same findings give the same bytes."""
    return msgspec.json.encode(document, order="deterministic")
